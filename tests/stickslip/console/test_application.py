"""The terminal: whatever goes wrong in a command is one document under --json."""

import json
import os
import shutil
import subprocess
import sys

import pytest

from stickslip.console import application
from stickslip.errors import EXIT_DEVICE

from ...conftest import need


def test_a_system_error_without_a_file_name_is_a_json_document_too(capsys):
    # It used to be taken for a stdout that cannot be written to, and reported on stderr alone.
    app = application.application("rig", "A rig.", "rig fail")

    @app.command
    def fail(*, json: application.Json = False) -> application.Answer:
        """Fail.  Example: rig fail."""
        raise OSError(5, "Input/output error")

    assert application.run(app, ["fail", "--json"]) == EXIT_DEVICE
    out, err = capsys.readouterr()
    assert json.loads(out)["error"]["what"] == "Input/output error"
    assert err == ""


def test_the_version_is_a_json_document_too(capsys):
    from daq.cli.app import app
    from stickslip.version import VERSION

    assert application.run(app, ["--version", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"command": "daq", "version": VERSION}


def test_the_doctor_advises_only_what_is_needed_and_names_it(capsys):
    # Under --json a sound package used to be advised "python -m pip uninstall ; then ...", with no name.
    from daq.cli import setup
    from daq.cli.app import app

    application.run(app, ["doctor", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert all(check["do"] == "" for check in found["checks"] if check["ok"])
    assert setup._needs().do == ""
    assert all("uninstall ;" not in check.do for check in setup._packages())


def test_help_shows_the_defaults_that_say_something(capsys):
    # Every flag that is off used to show "[default: False]".
    from daq.cli.app import app

    application.run(app, ["record", "--help"])
    shown = capsys.readouterr().out
    assert "[default: 20.0]" in shown
    assert "False" not in shown
    assert "None" not in shown


def test_completion_is_installed_and_completes_commands(tmp_path):
    need(shutil.which("bash"), "bash is not installed")
    home = {**os.environ, "HOME": str(tmp_path), "SHELL": shutil.which("bash"), "XDG_DATA_HOME": str(tmp_path / "data")}
    line = [sys.executable, "-m", "daq.cli.app", "--install-completion"]
    done = subprocess.run(line, env=home, capture_output=True, text=True, check=True)
    script = next(path for path in tmp_path.rglob("daq") if path.is_file())
    assert str(script) in done.stdout
    complete = f". {script}; COMP_WORDS=(daq reco); COMP_CWORD=1; $(complete -p daq | sed 's/.*-F //; s/ .*//'); "
    shown = subprocess.run(
        ["bash", "-c", complete + 'echo "${COMPREPLY[@]}"'], env=home, capture_output=True, text=True
    )
    assert set(shown.stdout.split()) == {"record", "recover"}, shown.stderr


@pytest.mark.parametrize(("typed", "samples"), [("0.5", 500), ("0.5 s", 500), ("500ms", 500)])
def test_times_take_units(tmp_path, capsys, typed, samples):
    from daq.cli.app import app

    assert application.run(app, ["record", "--duration", typed, "-o", str(tmp_path / "run.h5"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == samples
