"""`daq firmware`: the firmware of a board, and the command that flashes it."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import cyclopts

from stickslip.console.application import Answer, Json

if TYPE_CHECKING:
    from daq.firmware_files import Sketch

DEFAULT_FOLDER = Path("stickslip-firmware")
SOME_PORT = "COM3" if os.name == "nt" else "/dev/ttyACM0"


def firmware(
    *,
    board: Annotated[str, cyclopts.Parameter(help="Board: uno, nano, mega, esp32, pico, pico-micropython or teensy.")],
    output: Annotated[Path, cyclopts.Parameter(name=["--output", "-o"], help="Folder to write into.")] = DEFAULT_FOLDER,
    port: Annotated[
        str | None, cyclopts.Parameter(help="Port of the board; by default the only connected serial port.")
    ] = None,
    force: Annotated[bool, cyclopts.Parameter(negative=(), help="Replace files with different content.")] = False,
    json: Json = False,
) -> Answer:
    """Write the firmware or the sketch for a board, and print how to wire and flash the board.

    For Uno, Nano and Mega, this is a .hex file with its source; for the others, a sketch that prints text lines.

    Example: daq firmware --board uno -o firmware

    Example: daq firmware --board pico-micropython
    """
    from daq import firmware_files
    from daq.recorder.ports import SIMULATED_RIG, list_ports

    kind = firmware_files.board(board)
    if port is None:
        # A ttyS is a port of the machine itself, without a board.
        devices = [info.port for info in list_ports() if info.port != SIMULATED_RIG and "ttyS" not in info.port]
        port = devices[0] if len(devices) == 1 else SOME_PORT
    if isinstance(kind, firmware_files.Sketch):
        return _write_sketch(kind, output, port, force)
    hexfile, source = firmware_files.write(kind, output, force=force)
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
        f"firmware {firmware_files.VERSION} for {kind.name} ({kind.mcu}) -> {hexfile}, source in the same folder",
        f"wire: {kind.encoder_pins}, GND to GND; or, from a J-K box, {kind.counter_pins}",
        f"flash: {flash}",
    ]
    lines += [f"       {kind.other}"] if kind.other else []
    lines.append(f"next: daq record --port {port} --rate 1000")
    return Answer(data, "\n".join(lines))


def _write_sketch(sketch: "Sketch", output: Path, port: str, force: bool) -> Answer:
    from daq import firmware_files

    main, source = firmware_files.write_sketch(sketch, output, force=force)
    flash = firmware_files.sketch_command(sketch, main, port)
    record = f"daq record --port {port} --protocol text" + (f" --baud {sketch.baud}" if sketch.baud else "")
    data = {
        "board": sketch.name,
        "sketch": main,
        "source": source,
        "flash": flash,
        "port": port,
        "encoder_pins": sketch.encoder_pins,
        "needs": sketch.core,
        "bauds": [sketch.baud] if sketch.baud else [],
        "tested": sketch.tested,
        "record": record,
    }
    needs = sketch.core or "MicroPython on the board, and mpremote or any editor for it"
    lines = [
        f"sketch for {sketch.what} -> {main}; {sketch.counter} counts the edges",
        f"wire: {sketch.encoder_pins}; GND to GND",
        f"needs: {needs}",
        f"flash: {flash}",
        f"tested: {sketch.tested}",
        f"next: {record}",
    ]
    return Answer(data, "\n".join(lines))
