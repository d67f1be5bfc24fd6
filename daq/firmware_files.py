"""The board's firmware: which file is for which board, and the command that writes it into one.

The built files and their source stand beside each other: in ``firmware/`` of the project, or in an installed package in
``daq/firmware``.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from daq.base.errors import InputError, nearest
from daq.base.output import disk

VERSION = "1.0.0"
FIRST_BAUD = 115_200  # what the board listens at first; it finds the other rates by itself
BAUDS = (FIRST_BAUD, 250_000, 500_000, 1_000_000)


@dataclass(frozen=True)
class BoardFirmware:
    """The firmware of one kind of board: its file, and how avrdude reaches its bootloader.

    Attributes
    ----------
    mcu, programmer : str
        avrdude's ``-p`` and ``-c``.
    bootloader_baud : int
        avrdude's ``-b``.
    encoder_pins, counter_pins : str
        Where A and B go, and where the up and down pulses of a J-K box go.
    other : str
        What to try where the bootloader is another one.
    """

    name: str
    hex_name: str
    mcu: str
    programmer: str
    bootloader_baud: int
    encoder_pins: str
    counter_pins: str
    other: str = ""


UNO = BoardFirmware(
    "uno", "stickslip-uno.hex", "atmega328p", "arduino", 115_200, "A to D2, B to D3", "up to D5, down to D4"
)
NANO = replace(UNO, name="nano", bootloader_baud=57_600, other="a Nano with the new bootloader wants -b 115200")
MEGA = BoardFirmware(
    "mega", "stickslip-mega.hex", "atmega2560", "wiring", 115_200, "A to D2, B to D3", "up to D47, down to D38"
)
BOARDS = {board.name: board for board in (UNO, NANO, MEGA)}


def board(name: str) -> BoardFirmware:
    """Return a board by its name; InputError for another."""
    if name not in BOARDS:
        raise InputError(f"no firmware for a board {name!r}", "--board", nearest(name, list(BOARDS)))
    return BOARDS[name]


def folder() -> Path:
    """Return where the firmware's files are.

    Raises
    ------
    InputError
        They are not there: the installation is incomplete.
    """
    here = Path(__file__).resolve().parent
    for place in (here.parent / "firmware", here / "firmware"):
        if (place / "latch.S").is_file():
            return place
    raise InputError("the firmware's files are missing", str(here / "firmware"), "install stickslip again")


def write(kind: BoardFirmware, target: Path, *, force: bool = False) -> tuple[Path, list[Path]]:
    """Write a board's .hex, and the source it was built from, into a folder.

    Parameters
    ----------
    target : Path
        Made when it is not there.
    force : bool
        Replace files with different content.

    Returns
    -------
    tuple of (Path, list of Path)
        The .hex, and the source files.

    Raises
    ------
    InputError
        A file of that name holds something else, or the target is not a folder.
    RefusedError
        The disk refuses; each file is there whole or not at all.
    """
    source = folder()
    others = {other.hex_name for other in BOARDS.values()} - {kind.hex_name}
    files = sorted(file for file in source.iterdir() if file.is_file() and file.name not in others)
    files = [file for file in files if file.suffix in (".hex", ".c", ".h", ".S", ".md") or file.name == "Makefile"]
    for file in files:
        existing = target / file.name
        if existing.exists() and not force and existing.read_bytes() != file.read_bytes():
            raise InputError("exists with different content", str(existing), "give another -o, or --force")
    from daq.base.output import atomic

    if target.exists() and not target.is_dir():
        raise InputError("is not a folder", str(target), "give a folder, with -o")
    with disk.writing(target):
        target.mkdir(parents=True, exist_ok=True)
    for file in files:
        with atomic.replacing(target / file.name, force=True) as temporary:
            temporary.write_bytes(file.read_bytes())
    written = [target / file.name for file in files]
    return target / kind.hex_name, [file for file in written if file.name != kind.hex_name]


def command(kind: BoardFirmware, hexfile: Path, port: str) -> str:
    """Return the avrdude command line that writes a .hex into the board at a port."""
    import shlex

    words = ["avrdude", "-p", kind.mcu, "-c", kind.programmer, "-b", str(kind.bootloader_baud), "-P", port]
    return shlex.join([*words, "-D", "-U", f"flash:w:{hexfile}:i"])
