"""The terminal: whatever goes wrong in a command is one document under --json."""

import io
import json
import os
import shutil
import subprocess
import sys

import pytest

from daq.cli.app import app as daq
from fitting.cli import app as fit_friction
from processing.cli import app as process
from rig_sim.cli.app import app as rig_sim
from stickslip.console import application
from stickslip.errors import EXIT_DEVICE

from ...conftest import need


def test_a_system_error_without_a_file_name_is_a_json_document_too(capsys):
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
    from daq.cli import setup
    from daq.cli.app import app

    application.run(app, ["doctor", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert all(check["do"] == "" for check in found["checks"] if check["ok"])
    assert setup._check_requirements().do == ""
    assert all("uninstall ;" not in check.do for check in setup._check_packages())


def test_help_shows_the_defaults_that_say_something(capsys):
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


@pytest.mark.parametrize(
    ("app", "line"),
    [
        (fit_friction, "run.h5 -o a.html"),
        (fit_friction, "run.h5 --report a.html"),
        (fit_friction, "run.h5 --confidence 0.9"),
        (fit_friction, "run.h5 --alpha 0.1"),
        (fit_friction, "run.h5 --datum 1mm --datum-sd 0.1mm --damping 0.02 --damping-sd 0.001"),
        (process, "inspect run.h5 -o a.png"),
        (process, "inspect run.h5 --plot a.png"),
        (process, "export run.h5 -o a.csv"),
        (process, "export run.h5 --csv a.csv"),
        (daq, "export run.h5 --csv a.csv --parquet a.parquet"),
        (daq, "import a.csv --belt-speed 22cm/s"),
        (daq, "import a.csv --belt 22cm/s --datum 1mm"),
        (daq, "record --belt 22cm/s"),
        (rig_sim, "sweep two-mass --over belt.speed=0.1:0.2 -o a.png"),
        (rig_sim, "sweep two-mass --over belt.speed=0.1:0.2 --plot a.png"),
    ],
)
def test_flags_of_all_releases_are_read(app, line):
    app.parse_args(line, exit_on_error=False, print_error=False)


def test_the_help_of_a_fit_is_a_screen_and_a_half_in_groups(capsys, monkeypatch):
    # It had 115 lines, 33 flags without an order, and flags that have been replaced.
    monkeypatch.setenv("COLUMNS", "80")
    application.run(fit_friction, ["--help"])
    page = capsys.readouterr().out
    assert len(page.splitlines()) <= 72
    groups = [page.index(f"─ {title} ─") for title in ("Laws", "What you know", "Which part", "Output", "Many runs")]
    assert groups == sorted(groups)
    assert page.partition("Example: ")[2].splitlines()[0] == "fit-friction run.h5"
    assert not any(flag in page for flag in ("--datum", "--alpha", "--damping-sd"))


@pytest.mark.parametrize(("laws", "colour"), [(0, "31"), (1, "32"), (2, "33"), (3, "33")])
def test_the_verdict_has_a_colour_on_a_terminal_alone(monkeypatch, laws, colour):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert application.verdict("law 5.", laws) == "verdict: law 5."
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stdout", screen)
    application._print_text(application.verdict("law 5.", laws))
    assert screen.getvalue() == f"\x1b[1;{colour}mverdict: law 5.\x1b[0m\n"
