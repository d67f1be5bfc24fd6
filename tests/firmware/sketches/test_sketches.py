"""The sketches for boards that labs own: compiled for this computer, their lines read by daq without an error.

What stands in for a board is said in `host`: a model of ESP32's pulse counter by its driver's documentation, a model of
the PIO's state machine that runs the words of the sketch, and a counter in place of Teensy's library.  No board was
there.  The same words run on the emulator rp2040js, and the Pico's MicroPython on MicroPython's Unix port.
"""

import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import daq
from daq.cli.app import app
from daq.runfile import journal
from stickslip.console import application

from ...journals import HEADER, write_journal
from ..conftest import need

HERE = Path(__file__).resolve().parent
SKETCHES = HERE.parents[2] / "firmware" / "sketches"
BOARDS = ("esp32", "pico", "teensy")
START_US = 2**32 - 5_000_000
READ = 4096  # bytes that come at once


@pytest.fixture(scope="session")
def host(tmp_path_factory):
    """Give a function that compiles a board's sketch for this computer, once."""
    need(shutil.which("g++"), "g++ is needed")
    folder = tmp_path_factory.mktemp("host")

    def of(board):
        program = folder / board
        if not program.exists():
            pio = "#include <hardware/pio.h>\nstatic pio_hw_t block;\nPIO pio0 = &block;\n" if board == "pico" else ""
            source = program.with_suffix(".cpp")
            source.write_text(f'#include "Arduino.h"\n{pio}#include "stickslip_{board}.ino"\n')
            folders = [HERE / "host", SKETCHES / "common", SKETCHES / board / f"stickslip_{board}"]
            line = ["g++", "-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", *(f"-I{each}" for each in folders)]
            subprocess.run([*line, str(source), str(HERE / "host" / "main.cpp"), "-o", str(program)], check=True)
        return program

    return of


def printed(program, folder, lines, pause=0):
    truth = folder / "truth"
    done = subprocess.run([str(program), str(lines), str(truth), str(pause)], capture_output=True, check=True)
    return done.stdout, np.fromfile(truth, np.int32)


def recovered(folder, data, rate_hz, lines):
    """Record bytes as daq receives them, and make the run file; return the command's answer and the run."""
    whole_ns, ends = 1e9 * lines / rate_hz, [*range(READ, len(data), READ), len(data)]
    records = [
        (journal.RECEIVED, int(whole_ns * end / len(data)) + 1, data[at : at + READ])
        for at, end in zip(range(0, len(data), READ), ends, strict=True)
    ]
    records.append((journal.END, int(whole_ns) + 2, b'{"reason": "stopped"}'))
    part = write_journal(folder / "run.h5.part", records, HEADER | {"columns": None, "baud": None, "rate_hz": rate_hz})
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert application.run(app, ["recover", str(part), "--json"]) == 0
    return json.loads(said.getvalue()), daq.load(folder / "run.h5")


@pytest.mark.parametrize("lines", [20_000, pytest.param(200_000, marks=pytest.mark.slow)], ids=["20 s", "200 s"])
@pytest.mark.parametrize("board", BOARDS)
def test_the_lines_of_a_sketch_are_read_without_an_error(host, tmp_path, board, lines):
    data, truth = printed(host(board), tmp_path, lines, pause=200)
    said, run = recovered(tmp_path, data, 1000, lines)
    found = {key: said[key] for key in ("samples", "lost", "crc_errors", "segments", "retimed")}
    assert found == {"samples": lines, "lost": 0, "crc_errors": 0, "segments": 1, "retimed": 0}
    np.testing.assert_array_equal(run.count, truth)
    sent = (np.diff(run.raw.device_time.astype(np.int64)) + 2**31) % 2**32 - 2**31
    np.testing.assert_allclose(np.diff(run.time), 1e-6 * sent, atol=1e-9)
    assert run.raw.device_time[0] == START_US + 1000
    assert int(run.raw.device_time.max()) > START_US  # and it rolled over
    assert run.raw.device_time[-1] < START_US


@pytest.mark.parametrize("board", BOARDS)
def test_samples_that_the_line_does_not_carry_are_lost_with_their_numbers(host, tmp_path, board):
    data, truth = printed(host(board), tmp_path, 20_000, pause=300)  # the queue holds 256
    said, run = recovered(tmp_path, data, 1000, 20_000)
    kept = np.array([int(line.split(b",")[0]) for line in data.splitlines() if line[:1] != b"#"])
    assert said["lost"] == 20_000 - len(kept) > 0
    assert (said["crc_errors"], said["segments"]) == (0, 1)
    np.testing.assert_array_equal(run.count, truth[kept])


def test_a_sketch_states_its_columns_and_its_xor_finds_damage(host, tmp_path):
    data, truth = printed(host("esp32"), tmp_path, 5000)
    lines = data.split(b"\n")
    lines[2000] = lines[2000].replace(b",", b",1", 1)
    lines[3000] = lines[3000][:-4] + b"7" + lines[3000][-3:]
    said, run = recovered(tmp_path, b"\n".join(lines), 1000, 5000)
    assert (said["crc_errors"], said["lost"], said["samples"]) == (2, 2, 4998)
    assert set(run.count.tolist()) <= set(truth.tolist())


def test_the_words_of_the_pico_are_those_of_its_source():
    need(find_spec("adafruit_pioasm"), "adafruit-circuitpython-pioasm is needed")
    pioasm = import_module("adafruit_pioasm")
    program = pioasm.Program((SKETCHES / "pico" / "stickslip_pico" / "quadrature.pio").read_text())
    header, target, wrap = pico_words()
    assert list(program.assembled) == header
    assert (program.pio_kwargs["wrap_target"], program.pio_kwargs["wrap"]) == (target, wrap)


def pico_words():
    """Return the words of the Pico's header, and the bounds of its loop."""
    header = (SKETCHES / "pico" / "stickslip_pico" / "quadrature_pio.h").read_text()
    bounds = re.search(r"TARGET = (\d+), QUADRATURE_WRAP = (\d+)", header)
    return [int(word, 16) for word in re.findall(r"0x([0-9a-f]{4})", header)], int(bounds[1]), int(bounds[2])


def test_the_words_of_the_pico_count_on_an_emulator():
    node, modules = shutil.which("node"), os.environ.get("STICKSLIP_NODE_MODULES", "")
    need(node and (Path(modules) / "rp2040js").is_dir(), "node and rp2040js are needed (STICKSLIP_NODE_MODULES)")
    script = HERE / "rp2040.mjs"
    words, target, wrap = pico_words()
    line = [node, str(script), str(Path(modules) / "rp2040js"), json.dumps([words, target, wrap])]
    said = json.loads(subprocess.run(line, capture_output=True, text=True, check=True).stdout)
    assert said == {"reads": 5000, "wrong": 0}


@pytest.fixture
def micropython():
    beside = Path(sys.executable).with_name("micropython")
    found = str(beside) if beside.exists() else shutil.which("micropython")
    need(found, "the Unix port of MicroPython is needed")
    return found


def test_the_lines_of_micropython_are_read_without_an_error(micropython, tmp_path):
    paths = os.pathsep.join([str(HERE / "micropython"), str(SKETCHES / "pico-micropython")])
    line = [micropython, str(HERE / "micropython" / "bench.py"), "20000"]
    done = subprocess.run(line, capture_output=True, check=True, env=os.environ | {"MICROPYPATH": paths}).stdout
    program, _, rest = done.partition(b"\n")
    words, target, wrap = pico_words()
    assert [int(word) for word in program.split()] == [target, wrap, *words]
    data, _, last = rest.removesuffix(b"\n").rpartition(b"\n")
    assert last == b"-8 7,4294967295,-2147483648,12"
    said, run = recovered(tmp_path, data + b"\n", 500, 20_000)
    assert (said["samples"], said["lost"], said["crc_errors"], said["segments"]) == (20_000, 0, 0, 1)
    k = np.arange(20_000)
    np.testing.assert_array_equal(run.count, 40 * np.abs(k % 4000 - 2000) - 40_000)
    assert run.time[-1] == pytest.approx(19_999 / 500, abs=1e-3)


@pytest.mark.parametrize("board", ["esp32", "pico", "pico-micropython", "teensy"])
def test_the_command_writes_a_sketch_with_its_wiring_and_what_was_tested(tmp_path, monkeypatch, capsys, board):
    monkeypatch.chdir(tmp_path)
    assert application.run(app, ["firmware", "--board", board, "--port", "/dev/ttyACM3", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    written = {Path(path).name for path in said["source"]}
    own = SKETCHES / board
    assert written == {path.name for path in own.rglob("*") if path.is_file()} | (
        set() if board == "pico-micropython" else {"stickslip_lines.h"}
    )
    for path in said["source"]:
        origin = next(iter(SKETCHES.rglob(Path(path).name)))
        assert (tmp_path / path).read_bytes() == origin.read_bytes()
    assert "/dev/ttyACM3" in said["flash"]
    assert "not on a board" in said["tested"]
    assert application.run(app, ["firmware", "--board", board, "--port", "/dev/ttyACM3"]) == 0
    out = capsys.readouterr().out
    assert said["flash"] in out
    assert said["encoder_pins"] in out
    assert "--protocol text" in out
    assert said["tested"] in " ".join(out.split())
