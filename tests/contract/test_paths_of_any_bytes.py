"""A path is bytes: a run in a folder or file whose name is no UTF-8 is recorded, fitted and read as any other."""

import logging
import os
import shutil
import sys
from pathlib import Path

import pytest

import daq
from daq.cli.app import app
from fitting.cli import app as fit_friction
from processing.cli import app as process
from stickslip.console import application

SAMPLE = Path(__file__).parents[2] / "data_samples" / "law5.h5"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    made = tmp_path / os.fsdecode(b"f\xff")
    try:
        made.mkdir()
    except OSError:
        pytest.skip("this file system takes UTF-8 alone")
    monkeypatch.chdir(made)
    # Names in a captured log reach the test's report as they are, and a report must be UTF-8 to leave its process.
    # A command that logs to a file sets the level of its own loggers: only `logging.disable` holds for all of them.
    logging.disable(logging.CRITICAL)
    yield made
    logging.disable(logging.NOTSET)


def run(monkeypatch, command, *words):
    line = [os.fsdecode(word) for word in words]
    monkeypatch.setattr(sys, "argv", [command.name[0], *line])
    return application.run(command, line)


def test_a_recording_is_kept_under_a_name_of_any_bytes(folder, monkeypatch):
    # Its own header was refused when the run was built ("provenance ..., not texts ... with names"), exit code 2.
    assert run(monkeypatch, app, "record", "--duration", "1", "-o", b"r\xfe.h5") == 0
    assert [os.fsencode(path.name) for path in folder.iterdir()] == [b"r\xfe.h5"]
    found = daq.load(folder / os.fsdecode(b"r\xfe.h5"))
    assert found.provenance["command_line"] == r"daq record --duration 1 -o 'r\xfe.h5'"


@pytest.mark.usefixtures("asked_law_alone")
def test_a_run_is_read_drawn_and_fitted_under_a_name_of_any_bytes(folder, monkeypatch, capfd):
    # A picture and a report ended with a traceback, exit code 1, after all was computed; so did an import.
    shutil.copy(SAMPLE, folder / os.fsdecode(b"l\xfe.h5"))
    assert run(monkeypatch, process, "inspect", b"l\xfe.h5", "--plot", b"p\xfe.png") == 0
    assert run(monkeypatch, fit_friction, b"l\xfe.h5", "--laws", "5", "--csv", "table.csv") == 0
    assert (folder / os.fsdecode(b"l\xfe.report.html")).read_text(encoding="utf-8").count(r"l\xfe.h5") > 0
    assert (folder / "table.csv").read_bytes().splitlines()[1].startswith(b"l\xfe.h5,5,")
    assert run(monkeypatch, app, "export", b"l\xfe.h5", "--csv", b"e\xfe.csv") == 0
    assert run(monkeypatch, app, "import", b"e\xfe.csv", "-o", b"i\xfe.h5") == 0
    assert daq.load(folder / os.fsdecode(b"i\xfe.h5")).title == r"e\xfe.csv, imported"
    capfd.readouterr()
    assert run(monkeypatch, app, "list") == 0
    assert r"e\xfe.csv, imported" in capfd.readouterr().out
