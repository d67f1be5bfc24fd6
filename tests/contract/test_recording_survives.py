"""A recording in a process of its own, over a pseudo-terminal: what happens beside it costs no sample."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import daq

from ..boards import FakeFrames, motion

pytestmark = [
    pytest.mark.slow,  # each records for seconds
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals and signals are POSIX"),
]

HANGS_S = 120
COMMAND = [sys.executable, "-m", "daq.cli.app"]


@pytest.fixture
def board(tmp_path):
    with FakeFrames(tmp_path / "ttyFAKE", paced=True) as fake:
        yield fake


def record_line(board, output, duration):
    return [*COMMAND, "record", "--port", str(board.path), "--duration", str(duration), "-o", str(output), "--json"]


def heed_hangup():
    """Undo what nohup does to the tests: a signal that is ignored at the start stays ignored."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def start(line, part, **more):
    """Start a recording, and wait until its journal holds samples."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(line, preexec_fn=heed_hangup, **(pipes | more))
    until = time.monotonic() + HANGS_S
    while not (part.exists() and part.stat().st_size > 8000):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.02)
    return process


def finish(process):
    out, err = process.communicate(timeout=HANGS_S)
    return process.returncode, out, err


def run(*arguments):
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False)


def assert_whole(path, samples):
    """Check that the run holds every sample that the board sent, with its count."""
    recorded = daq.load(path)
    assert recorded.count.size == samples
    k = np.round(recorded.time * 1000).astype(int)
    assert np.array_equal(k, np.arange(samples))
    assert np.array_equal(recorded.count - recorded.count[0], motion(k) - motion(0))


@pytest.mark.parametrize("stream", ["full", "broken pipe"])
@pytest.mark.parametrize("number", [1, 2])
def test_a_stream_that_takes_nothing_costs_nothing(board, tmp_path, number, stream):
    output, part = tmp_path / "run.h5", tmp_path / "run.h5.part"
    redirect = f"{number}>/dev/full" if stream == "full" else ""
    reading, writing = os.pipe()
    with (tmp_path / "printed").open("w") as printed:
        out, err = (writing if (number, stream) == (each, "broken pipe") else printed for each in (1, 2))
        line = ["sh", "-c", f'exec "$@" {redirect}', "sh", *record_line(board, output, 2)]
        recorder = start(line, part, stdout=out, stderr=err)
    os.close(writing)
    os.close(reading)
    assert recorder.wait(HANGS_S) == (3 if (number, stream) == (1, "full") else 0), (tmp_path / "printed").read_text()
    assert not part.exists()
    assert_whole(output, 2000)


def test_signals_that_were_ignored_at_the_start_stay_ignored(board, tmp_path):
    output, part = tmp_path / "run.h5", tmp_path / "run.h5.part"
    recorder = start(["sh", "-c", 'trap "" HUP INT; exec "$@"', "sh", *record_line(board, output, 2)], part)
    for number in (signal.SIGHUP, signal.SIGINT) * 3:
        recorder.send_signal(number)
        time.sleep(0.1)
    code, _, err = finish(recorder)
    assert code == 0, err
    assert_whole(output, 2000)


def test_a_port_that_stays_away_is_reported_at_once_and_ends_in_exit_4(board, tmp_path):
    output, part = tmp_path / "run.h5", tmp_path / "run.h5.part"
    recorder = start(record_line(board, output, 4), part)
    board.path.unlink()
    os.close(os.dup(board._master))
    began = time.monotonic()
    board._over.set()
    board.join()
    os.close(board._master)
    os.close(board._slave)
    board._unplug = lambda: None
    said = ""
    while "Waiting up to" not in said:
        said += recorder.stderr.readline()
    assert time.monotonic() - began < 2
    code, out, err = finish(recorder)
    answer = json.loads(out)
    assert (code, answer["ended"]) == (4, "port lost"), err
    assert any("of the requested 4 s were recorded: the port was lost" in warning for warning in answer["warnings"])
    assert_whole(output, answer["samples"])
