"""What a person sees: lines broken between words, help in whole paragraphs, progress with rate, losses and ETA."""

import io
import json
import re
import sys
from itertools import pairwise

import pytest

from daq.cli.app import app as daq
from fitting.cli import app as fit_friction
from processing.cli import app as process
from rig_sim.cli.app import app as rig_sim
from stickslip.console import application
from stickslip.console.commands import app as stickslip

APPS = [daq, process, fit_friction, rig_sim, stickslip]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("app", APPS, ids=lambda app: app.name[0])
def test_every_help_page_fills_80_columns_and_shows_an_example(app, capsys, monkeypatch):
    # Paragraphs kept the line breaks of the source as well, and came out ragged; fit-friction showed one sentence.
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("", *(name for name in app if not name.startswith("-"))):
        assert application.run(app, [*filter(None, [name]), "--help"]) == 0
        page = capsys.readouterr().out
        assert max(map(len, page.splitlines())) <= 80
        words = page.split("╭")[0].split("\n", 1)[1]
        assert "Example: " in words
        for paragraph in re.split(r"\n\s*\n", words):
            for line, after in pairwise(paragraph.strip().splitlines()):
                assert len(line.rstrip()) + 1 + len(after.split()[0]) > 80, line


def test_a_long_line_is_broken_between_words_in_a_terminal_alone(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    line = "fit-friction: run.h5: exists and contains the report of another run; choose another name (--report)"
    shown = application._wrap_lines(line, Terminal())
    assert max(map(len, shown.splitlines())) <= 40
    assert shown.split() == line.split()
    assert application._wrap_lines(line, io.StringIO()) == line
    command = f"next: process smooth '{'long name ' * 5}.h5'"
    assert application._wrap_lines(command, Terminal()) == command  # it is copied into a shell


def test_progress_shows_amount_rate_losses_and_eta_in_a_terminal_alone(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        with application.progress("recording", 20.0, "s") as show:
            show(5.0)
            show.status("1000 Hz, 3 lost, 0 illegal")
        drawn = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue())
        if not stream.isatty():
            assert drawn == ""
            continue
        assert "5/20 s 1000 Hz, 3 lost, 0 illegal ETA" in drawn
        assert max(map(len, re.split(r"[\r\n]+", drawn))) <= 80


def test_an_amount_is_shown_with_its_whole_as_soon_as_that_is_known(monkeypatch):
    # The bar of daq import never showed how many lines there are, and "ETA" stood there without a time.
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with application.progress("reading", None, "lines") as show:
        show(0)
    assert "ETA" not in stream.getvalue()
    with application.progress("reading", None, "lines") as show:
        show.stage("splitting lines", 4096, 1200001)
    drawn = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue())
    assert "4096/1200001 lines" in drawn
    assert "ETA" in drawn
    assert max(map(len, re.split(r"[\r\n]+", drawn))) <= 80


SHAKER = ("--c", "0", "--gamma", "0.3", "--a", "0.5")


@pytest.mark.parametrize(
    ("app", "command", "typed", "bare"),
    [
        (rig_sim, ["shaker", *SHAKER, "--m", "1", "--k", "1"], ["--phi", "90 deg"], ["--phi", "1.5707963267948966"]),
        (rig_sim, ["shaker", *SHAKER, "--phi", "3"], ["--m", "300 g", "--k", "10 N/m"], ["--m", "0.3", "--k", "10"]),
        (rig_sim, ["events", "rig"], ["--until", "0.05 min", "--since", "500ms"], ["--until", "3", "--since", "0.5"]),
        (daq, ["record", "--duration", "0.1", "--force", "-o", "run.h5"], ["--rate", "1 kHz"], ["--rate", "1000"]),
    ],
)
def test_a_number_with_a_unit_is_the_bare_number_in_si(app, command, typed, bare, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = []
    for flags in (typed, bare):
        assert application.run(app, [*command, *flags, "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        found.append({key: value for key, value in document.items() if not key.startswith("clock_ppm")})
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("command", "stages"),
    [
        ("basins two-mass --cells 500", ["mapping cells", "following cycles"]),
        ("lyapunov two-mass --events 300 --set belt.speed=0.08075", ["following the motion", "slopes on its orbit"]),
        ("lyapunov forced --events 300", ["following the motion"]),
        ("lock forced --period 1 --budget 0.02 --events 50", ["following the motion", "searching orbits"]),
        ("quench forced --set drive.omega=20", ["settling", "trying amplitudes"]),
    ],
)
def test_every_stage_of_a_long_analysis_shows_its_progress_in_a_terminal_alone(command, stages, monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    answers = []
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        assert application.run(rig_sim, [*command.split(), "--json"]) == 0
        answers.append(json.loads(capsys.readouterr().out))
        drawn = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue())
        lines = re.split(r"[\r\n]+", drawn)
        shown = [stage for stage in stages if any(stage in line and "ETA" in line for line in lines)]
        assert shown == (stages if stream.isatty() else [])
        assert max(map(len, lines)) <= 80
    assert answers[0] == answers[1]
