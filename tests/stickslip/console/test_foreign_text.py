"""Text from outside in a terminal: it stands there, and does nothing; and no terminal's encoding ends a command."""

import io
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.cli.app import app as daq
from daq.runfile import store
from fitting.cli import app as fit_friction
from processing.cli import app as process
from stickslip.compute.compile import ANNOUNCEMENT
from stickslip.console import application

SAMPLE = Path(__file__).parents[3] / "data_samples" / "law5.h5"
ODD = "\x1b]0;title\x07\x1b[31m\x9b7m\r\u202e[red]"
SHOWN = r"\x1b]0;title\x07\x1b[31m\x9b7m\x0d\u202e[red]"
ACTS = re.compile("[\0-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


@pytest.fixture
def odd(tmp_path, monkeypatch):
    """Return a run with escape sequences in its name and wherever it holds text; the folder is the current one."""
    monkeypatch.chdir(tmp_path)
    run = store.load(SAMPLE)
    path = Path("r\x1b[31m.h5")
    texts = {"title": f"T{ODD}", "operator": f"O{ODD}", "sample_name": f"S{ODD}", "note": f"N{ODD}"}
    kinds, notes = (*run.event_kind, "marker"), (*run.event_note, f"M{ODD}")
    at = np.append(run.event_sample, 5).astype(np.uint32)
    odd = replace(run, **texts, tags={"tag": f"V{ODD}"}, event_sample=at, event_kind=kinds, event_note=notes)
    store.write(path, odd)
    return path


@pytest.mark.parametrize(
    ("app", "line", "holds"),
    [
        (daq, ["note", "RUN"], [f"M{SHOWN}"]),
        (daq, ["list"], [r"T\x1b]0;title\x07\x1b[31m\x9b7m", r"V\x1b", "[red]"]),
        (daq, ["list", "RUN"], [r"r\x1b[31m.h5"]),
        (daq, ["list", f"--no-such{ODD}"], [r"\x1b[31m"]),
        (process, ["inspect", "RUN", "--plot", "p\x1b[31m.png"], [r"p\x1b[31m.png"]),
        (daq, ["export", "RUN", "--csv", "e\x1b[31m.csv"], [r"e\x1b[31m.csv"]),
        (daq, ["import", "t.csv", "--verbose", "--log", "a.log"], [r"pos\x1b[31m"]),
        (daq, ["record", "--rig", "rig.toml"], [r"/dev/x\x1b[31m"]),
        (daq, ["decode", "RUN"], [r"r\x1b[31m.h5"]),
        (fit_friction, ["RUN", "--to", "0.001"], [r"r\x1b[31m.h5"]),
    ],
)
def test_an_escape_sequence_is_printed_as_text(app, line, holds, odd, capfd):
    # rich takes "[red]" in a table for a colour of its own.
    samples = "".join(f"{0.01 * k:.2f},{np.sin(0.1 * k):.6f}\n" for k in range(300))
    Path("t.csv").write_text(f"time (s),pos\x1b[31m (m)\n{samples}", newline="")
    Path("rig.toml").write_text('[board]\nport = "/dev/x\\u001b[31m"\n')
    application.run(app, [str(odd) if word == "RUN" else word for word in line])
    out, err = capfd.readouterr()
    log = Path("a.log").read_text() if Path("a.log").exists() else ""
    for words in holds:
        assert words in out + err
    assert not ACTS.search(out + err + log)


def test_a_bar_shows_no_escape_sequences(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with application.progress("recording", 20.0, "s") as show:
        show.status("\x1b]0;title\x07")
    assert r"\x1b]0;title\x07" in stream.getvalue()
    assert "\x1b]0" not in stream.getvalue()


def output(line, folder, encoding):
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    line = [sys.executable, "-m", *line]
    return subprocess.run(line, cwd=folder, env=environment, capture_output=True, check=False)


@pytest.mark.usefixtures("asked_law_alone")
@pytest.mark.parametrize("encoding", ["ascii", "cp850"])
def test_no_encoding_of_the_terminal_loses_a_result(tmp_path, monkeypatch, encoding):
    # "…" ended the fit with a traceback, exit code 1, before its parameters were printed.
    run = tmp_path / "run.h5"
    run.write_bytes(SAMPLE.read_bytes())
    terminal = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr(sys, "stdout", terminal)
    assert application.run(fit_friction, [str(run), "--laws", "5", "--no-report"]) == 0
    terminal.flush()
    shown = terminal.buffer.getvalue().decode(encoding)
    assert re.search(r"k/m .* 35\.18\d* \.\.\. 35\.18", shown)
    assert ("+-" if encoding == "ascii" else "±") in shown


def test_no_encoding_of_the_terminal_loses_a_help_page(tmp_path):
    helped = output(["fitting.cli", "--help"], tmp_path, "ascii")
    assert (helped.returncode, helped.stderr) == (0, b"")


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
@pytest.mark.parametrize(
    "line",
    [
        ["daq.cli.app", "--help"],
        ["daq.cli.app", "list", "."],
        ["daq.cli.app", "list", ".", "--json"],
        pytest.param(["fitting.cli", "run.h5", "--laws", "5", "--no-report"], marks=pytest.mark.slow),
    ],
)
def test_a_reader_that_goes_away_is_no_error(tmp_path, line):
    # A table or a help page before `| head` ended with 1, the exit code of a bug: rich ends the process so.
    (tmp_path / "run.h5").write_bytes(SAMPLE.read_bytes())
    reading, writing = os.pipe()
    os.close(reading)
    line = [sys.executable, "-m", *line]
    try:
        done = subprocess.run(line, cwd=tmp_path, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(writing)
    assert done.returncode == 0, done.stderr
    assert set(done.stderr.splitlines()) <= {ANNOUNCEMENT}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("form", ["text", "--json"])
def test_a_result_that_cannot_be_printed_ends_in_3_whatever_it_says(form):
    # A result with an exit code of its own (5: undecided) kept that, though its JSON was cut.
    code = (
        "import sys; from stickslip.console import application as a\n"
        "app = a.application('rig', 'A rig.', 'rig say')\n"
        "@app.command\n"
        "def say(*, json: a.Json = False) -> a.Answer:\n"
        "    'Say.  Example: rig say.'\n"
        "    return a.Answer({'text': 'x' * 10_000}, 'x' * 10_000, 5)\n"
        "a.main(app)"
    )
    line = [sys.executable, "-c", code, "say", *([form] if form == "--json" else [])]
    with open("/dev/full", "w") as full:
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
        assert (done.returncode, "could not be printed" in done.stderr) == (3, True), done.stderr
        assert len(done.stderr.splitlines()) == 1
        assert subprocess.run(line, stdout=full, stderr=full, check=False).returncode == 3
        assert subprocess.run(line, stdout=subprocess.DEVNULL, stderr=full, check=False).returncode == 5
