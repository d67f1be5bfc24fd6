"""The firmware of boards: which files are for which board, and the command that writes them into one.

Of Arduino Uno, Nano and Mega there is firmware of the project's own, built files and source beside each other: in
``firmware/`` of the project, or in an installed package in ``daq/firmware``.  Of the others there are sketches, in its
folder ``sketches``, which print text lines.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from stickslip.errors import InputError, nearest
from stickslip.output import disk

VERSION = "1.0.0"
FIRST_BAUD = 115_200  # what the board listens at first; it finds the other rates by itself
BAUDS = (FIRST_BAUD, 250_000, 500_000, 1_000_000)


@dataclass(frozen=True)
class BoardFirmware:
    """The firmware of one kind of board: its file, and how avrdude reaches its bootloader."""

    name: str
    hex_name: str
    mcu: str  # avrdude's ``-p`` and ``-c``
    programmer: str
    bootloader_baud: int  # avrdude's ``-b``
    encoder_pins: str  # where A and B go, and where the up and down pulses of a J-K box go
    counter_pins: str
    other: str = ""  # what to try where the bootloader is another one


UNO = BoardFirmware(
    "uno", "stickslip-uno.hex", "atmega328p", "arduino", 115_200, "A to D2, B to D3", "up to D5, down to D4"
)
NANO = replace(UNO, name="nano", bootloader_baud=57_600, other="a Nano with the new bootloader needs -b 115200")
MEGA = BoardFirmware(
    "mega", "stickslip-mega.hex", "atmega2560", "wiring", 115_200, "A to D2, B to D3", "up to D47, down to D38"
)
BOARDS = {board.name: board for board in (UNO, NANO, MEGA)}


@dataclass(frozen=True)
class Sketch:
    """A sketch that prints text lines, for one kind of board."""

    name: str  # the board, and what it is called in full
    what: str
    counter: str  # what counts the edges
    encoder_pins: str  # where A and B go
    core: str  # what must be installed to build it; "" for a file that is copied
    fqbn: str  # the board's name for arduino-cli
    baud: int | None  # of its line; None for USB, where it is only a name
    tested: str  # what was run on what


ESP32 = Sketch(
    "esp32",
    "ESP32",
    "its pulse counter (PCNT)",
    "A to GPIO 18, B to GPIO 19, 3.3 V",
    "the Arduino core esp32, 3.0 or later (arduino-cli core install esp32:esp32)",
    "esp32:esp32:esp32",
    921_600,
    "tested with a model of the pulse counter on a computer, whose lines were read by daq, but not on a board",
)
PICO = Sketch(
    "pico",
    "Raspberry Pi Pico",
    "a state machine of its PIO",
    "A to GP2, B to GP3, 3.3 V",
    "the Arduino core of Earle Philhower, 3.0 or later (arduino-cli core install rp2040:rp2040)",
    "rp2040:rp2040:rpipico",
    None,
    "tested with a model of the PIO on a computer, whose lines were read by daq, and in the emulator "
    "rp2040js, but not on a board",
)
PICO_MICROPYTHON = replace(
    PICO,
    name="pico-micropython",
    what="Raspberry Pi Pico with MicroPython",
    core="",
    fqbn="",
    tested="tested in MicroPython's Unix port, whose lines were read by daq, with the same PIO program as the sketch "
    "for the pico, but not on a board",
)
TEENSY = Sketch(
    "teensy",
    "Teensy 3 or 4",
    "interrupts",
    "A to pin 2, B to pin 3, 3.3 V",
    "Teensyduino, which includes the library Encoder",
    "teensy:avr:teensy41",
    None,
    "tested with a counter in place of the library Encoder on a computer, whose lines were read by daq, but "
    "not on a board",
)
SKETCHES = {sketch.name: sketch for sketch in (ESP32, PICO, PICO_MICROPYTHON, TEENSY)}


def board(name: str) -> BoardFirmware | Sketch:
    """Return a board by its name; InputError for another."""
    known = BOARDS | SKETCHES
    if name not in known:
        raise InputError(f"there is no firmware for a board {name!r}", "--board", nearest(name, list(known)))
    return known[name]


def folder() -> Path:
    """Return where the firmware's files are.

    Raises InputError: they are not there: the installation is incomplete.
    """
    here = Path(__file__).resolve().parent
    for place in (here.parent / "firmware", here / "firmware"):
        if (place / "latch.S").exists():
            return place
    raise InputError("the firmware files are missing", str(here / "firmware"), "install stickslip again")


def write(kind: BoardFirmware, target: Path, *, force: bool = False) -> tuple[Path, list[Path]]:
    """Write a board's .hex, and the source it was built from, into a folder.

    target: Made when it is not there.
    force: Replace files with different content.
    Returns: The .hex, and the source files.
    Raises InputError: A file of that name holds something else, or the target is not a folder.
    Raises RefusedError: the disk refuses; each file is there whole or not at all.
    """
    source = folder()
    others = {other.hex_name for other in BOARDS.values()} - {kind.hex_name}
    files = sorted(file for file in source.iterdir() if file.is_file() and file.name not in others)
    files = [file for file in files if file.suffix in (".hex", ".c", ".h", ".S", ".md") or file.name == "Makefile"]
    written = _copied({target / file.name: file for file in files}, target, force)
    return target / kind.hex_name, [file for file in written if file.name != kind.hex_name]


def write_sketch(sketch: Sketch, target: Path, *, force: bool = False) -> tuple[Path, list[Path]]:
    """Write a board's sketch into a folder, which the Arduino tools open as it is.

    Parameters, errors as of `write`.

    Returns: The folder of the sketch, or the file for MicroPython; and all files.
    """
    source = folder() / "sketches"
    sketch_folder = source / sketch.name
    files = {
        target / file.relative_to(sketch_folder): file for file in sorted(sketch_folder.rglob("*")) if file.is_file()
    }
    main = next(place for place in files if place.suffix in (".ino", ".py"))
    if main.suffix == ".ino":
        files |= {main.parent / file.name: file for file in sorted((source / "common").iterdir())}
    return (main if main.suffix == ".py" else main.parent), _copied(files, target, force)


def _copied(files: Mapping[Path, Path], target: Path, force: bool) -> list[Path]:
    """Copy files to their places in a folder, each whole or not at all; return the places."""
    for place, file in files.items():
        if place.exists() and not force and place.read_bytes() != file.read_bytes():
            do = "choose another folder with -o, or use --force"
            raise InputError("exists with different content", str(place), do)
    from stickslip.output import atomic

    if target.exists() and not target.is_dir():
        raise InputError("is not a folder", str(target), "choose a folder with -o")
    with disk.writing(target):
        for place in files:
            place.parent.mkdir(parents=True, exist_ok=True)
    for place, file in files.items():
        with atomic.replacing(place, force=True) as temporary:
            temporary.write_bytes(file.read_bytes())
    return list(files)


def command(kind: BoardFirmware, hexfile: Path, port: str) -> str:
    """Return the avrdude command line that writes a .hex into the board at a port."""
    import shlex

    words = ["avrdude", "-p", kind.mcu, "-c", kind.programmer, "-b", str(kind.bootloader_baud), "-P", port]
    return shlex.join([*words, "-D", "-U", f"flash:w:{hexfile}:i"])


def sketch_command(sketch: Sketch, main: Path, port: str) -> str:
    """Return the command line that writes a sketch into the board at a port."""
    import shlex

    if not sketch.core:
        return shlex.join(["mpremote", "connect", port, "cp", str(main), ":main.py", "+", "reset"])
    return shlex.join(["arduino-cli", "compile", "--upload", "-b", sketch.fqbn, "-p", port, str(main)])
