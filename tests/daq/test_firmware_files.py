"""`daq firmware`: what it writes is what the project holds, and the command it prints flashes that file."""

import json
import os
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from daq.cli.app import app
from stickslip.console import application

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Give a function that runs the command in a folder of its own and returns its exit code and what it printed."""
    monkeypatch.chdir(tmp_path)

    def of(*words):
        code = application.run(app, ["firmware", *words])
        return code, capsys.readouterr().out

    return of


@pytest.mark.parametrize(
    ("board", "name", "mcu", "programmer"),
    [
        ("uno", "stickslip-uno.hex", "atmega328p", "arduino"),
        ("nano", "stickslip-uno.hex", "atmega328p", "arduino"),
        ("mega", "stickslip-mega.hex", "atmega2560", "wiring"),
    ],
)
def test_it_writes_hex_and_source_and_prints_the_flashing_command(run, tmp_path, board, name, mcu, programmer):
    code, printed = run("--board", board, "-o", "my board", "--port", "/dev/ttyUSB3", "--json")
    assert code == 0
    said = json.loads(printed)
    assert Path(said["hex"]) == Path("my board") / name
    assert (tmp_path / said["hex"]).read_bytes() == (FIRMWARE / name).read_bytes()
    sources = {Path(path).name for path in said["source"]}
    beside = {file.name for file in FIRMWARE.iterdir() if file.is_file() and file.suffix not in (".hex", ".elf")}
    assert sources == beside
    words = shlex.split(said["flash"])
    assert words[0] == "avrdude"
    assert words[words.index("-p") + 1] == mcu
    assert words[words.index("-c") + 1] == programmer
    assert words[words.index("-P") + 1] == "/dev/ttyUSB3"
    assert words[-1] == f"flash:w:my board/{name}:i"
    assert said["flash"] in run("--board", board, "-o", "my board", "--port", "/dev/ttyUSB3")[1]


def test_an_installed_package_brings_the_firmware_along(tmp_path):
    root = FIRMWARE.parent
    settings = tomllib.loads((root / "pyproject.toml").read_text())
    included = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    site = tmp_path / "site"
    for package in ("daq", "stickslip"):
        shutil.copytree(root / package, site / package, ignore=shutil.ignore_patterns("__pycache__"))
    for source, target in included.items():
        shutil.copytree(root / source, site / target)
    words = [sys.executable, "-m", "daq.cli.app", "firmware", "--board", "mega", "-o", "here", "--json"]
    path = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False, env=path)
    assert done.returncode == 0, done.stdout + done.stderr
    written = tmp_path / json.loads(done.stdout)["hex"]
    assert written.read_bytes() == (FIRMWARE / "stickslip-mega.hex").read_bytes()
    words[words.index("mega")] = "teensy"
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False, env=path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / json.loads(done.stdout)["sketch"] / "stickslip_lines.h").is_file()


def test_a_nano_is_reached_at_its_bootloaders_baud_rate(run):
    _, said = run("--board", "nano")
    assert "-b 57600" in said
    assert "-b 115200" in said  # the new bootloader


def test_what_holds_something_else_is_kept_unless_forced(run, tmp_path):
    assert run("--board", "uno")[0] == 0
    assert run("--board", "mega")[0] == 0  # the same source beside it
    mine = tmp_path / "stickslip-firmware" / "command.c"
    mine.write_text("my own\n")
    code, printed = run("--board", "uno", "--json")
    assert code == 2
    assert "command.c" in json.loads(printed)["error"]["where"]
    assert mine.read_text() == "my own\n"
    assert run("--board", "uno", "--force")[0] == 0
    assert mine.read_bytes() == (FIRMWARE / "command.c").read_bytes()
