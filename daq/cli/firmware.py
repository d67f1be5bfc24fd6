"""`daq firmware`: the firmware of a board, and the command that flashes it."""

import os
from pathlib import Path
from typing import Annotated

import cyclopts

from daq.base.console.application import Answer, Json

DEFAULT_FOLDER = Path("stickslip-firmware")
SOME_PORT = "COM3" if os.name == "nt" else "/dev/ttyACM0"


def register(app: cyclopts.App) -> None:
    """Add the command to the `daq` application."""
    app.command(firmware)


def firmware(
    *,
    board: Annotated[str, cyclopts.Parameter(help="uno, nano or mega.")],
    output: Annotated[Path, cyclopts.Parameter(name=["--output", "-o"], help="Folder to write into.")] = DEFAULT_FOLDER,
    port: Annotated[
        str | None, cyclopts.Parameter(help="Port of the board; default the only serial port connected.")
    ] = None,
    force: Annotated[bool, cyclopts.Parameter(negative=(), help="Replace files with different content.")] = False,
    json: Json = False,
) -> Answer:
    """Write the firmware of a board (built .hex and source), and print how to flash it.

    Example: daq firmware --board uno -o firmware
    """
    from daq import firmware_files
    from daq.recorder.ports import SIMULATED_RIG, list_ports

    kind = firmware_files.board(board)
    hexfile, source = firmware_files.write(kind, output, force=force)
    if port is None:
        # A ttyS is a port of the machine itself, without a board.
        there = [found.port for found in list_ports() if found.port != SIMULATED_RIG and "ttyS" not in found.port]
        port = there[0] if len(there) == 1 else SOME_PORT
    flash = firmware_files.command(kind, hexfile, port)
    data = {
        "board": kind.name,
        "mcu": kind.mcu,
        "version": firmware_files.VERSION,
        "hex": hexfile,
        "source": source,
        "flash": flash,
        "port": port,
        "encoder_pins": kind.encoder_pins,
        "counter_pins": kind.counter_pins,
        "bauds": firmware_files.BAUDS,
    }
    lines = [
        f"firmware {firmware_files.VERSION} for {kind.name} ({kind.mcu}) -> {hexfile}, source beside it",
        f"wire: {kind.encoder_pins}, GND to GND; or, from a J-K box, {kind.counter_pins}",
        f"flash: {flash}",
    ]
    lines += [f"       {kind.other}"] if kind.other else []
    lines.append(f"next: daq record --port {port} --rate 1000")
    return Answer(data, "\n".join(lines))
