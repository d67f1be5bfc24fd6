"""The tools of these tests, and what they make: the firmware built anew, the emulator, the bench around both."""

import shutil
import subprocess
from pathlib import Path

import pytest

from ..conftest import need
from . import bench

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parents[1] / "firmware"
COMPILER = "5.4.0"  # of the committed .hex files; another one makes other bytes


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    need(shutil.which("avr-gcc") and Path("/usr/lib/avr/include/avr/io.h").is_file(), "avr-gcc and avr-libc are needed")
    version = subprocess.run(["avr-gcc", "-dumpversion"], capture_output=True, text=True, check=True).stdout.strip()
    need(version == COMPILER, f"this is avr-gcc {version}; the committed .hex are built with {COMPILER}")
    folder = tmp_path_factory.mktemp("firmware")
    subprocess.run(["make", "-C", str(FIRMWARE), f"BUILD={folder}"], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="session")
def latch_address(built):
    """Give a function: the address inside the latch at which a sample is taken, of a board."""

    def of(kind):
        elf = built / f"stickslip-{kind}.elf"
        table = subprocess.run(["avr-nm", str(elf)], capture_output=True, text=True, check=True).stdout
        return next(f"0x{line.split()[0]}" for line in table.splitlines() if line.endswith(" latch_taken"))

    return of


@pytest.fixture(scope="session")
def emulator(tmp_path_factory):
    need(Path("/usr/include/simavr/sim_avr.h").is_file(), "libsimavr-dev is needed")
    need(shutil.which("gcc"), "gcc is needed")
    program = tmp_path_factory.mktemp("emulator") / "emulator"
    line = ["gcc", "-O2", "-Wall", "-Wextra", "-Werror", "-o", str(program), str(HERE / "emulator.c")]
    subprocess.run([*line, "-lsimavr", "-lutil"], check=True, capture_output=True)
    return program


@pytest.fixture
def switch_on(emulator, latch_address, tmp_path):
    """Give a function that returns a board in the emulator, with the firmware as committed; a context manager."""

    def on(kind="uno", **more):
        hexfile = FIRMWARE / f"stickslip-{kind}.hex"
        return bench.Board(emulator, kind, hexfile, tmp_path, watch=latch_address(kind), **more)

    return on
