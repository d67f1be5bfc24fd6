"""The whole pipe as a user types it: record, smooth, fit; the verdict that the simulated contact deserves."""

import contextlib
import importlib
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest

from stickslip.console import application

APPS = {"daq": "daq.cli.app", "process": "processing.cli", "fit-friction": "fitting.cli"}


def typed(folder, command, *arguments, codes=(0,)):
    """Run a command with --json in a folder, check its exit code and return its document."""
    line = [Path(sys.executable).parent / command, *map(str, arguments), "--json"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=folder, check=False)
    assert done.returncode in codes, done.stdout + done.stderr
    return json.loads(done.stdout)


def called(folder, command, *arguments, codes=(0,)):
    """Do as `typed`, within this process, which has loaded what the commands need."""
    app = importlib.import_module(APPS[command]).app
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as out:
        code = application.run(app, [*map(str, arguments), "--json"])
    assert code in codes, out.getvalue()
    return json.loads(out.getvalue())


@pytest.fixture(scope="module", params=[6, pytest.param(5, marks=pytest.mark.slow)])
def pipe(request, tmp_path_factory, undrawn_reports):
    """Record, smooth and fit 12 s of the rig with one law, law 5 as typed; give what each command said."""
    run = typed if request.param == 5 else called
    folder = tmp_path_factory.mktemp(f"law{request.param}")
    changes = ["--set", f"friction.law={request.param}", "--set", "seed=2"]
    recorded = run(folder, "daq", "record", "--rate", 1000, "--duration", 12, "-o", "run.h5", *changes)
    smoothed = run(folder, "process", "smooth", "run.h5")
    fitted = run(folder, "fit-friction", "run.h5", codes=(0, 5))
    return request.param, folder, recorded, smoothed, fitted


def test_every_sample_is_recorded(pipe):
    _, _, recorded, _, _ = pipe
    assert recorded["samples"] == 12_000
    assert recorded["duration_s"] == pytest.approx(12.0, abs=1e-3)
    for key in ("lost", "crc_errors", "illegal", "phase_errors"):
        assert recorded[key] == 0
    assert recorded["segments"] == 1
    assert recorded["warnings"] == []


def test_sticks_and_slips_are_found(pipe):
    law, _, _, smoothed, _ = pipe
    assert smoothed["sticks"] >= 5
    assert abs(smoothed["belt_speed"] - 0.22) < (0.001 if law == 5 else 0.03)
    assert smoothed["lost_counts"] == 0
    assert smoothed["window"] % 2 == 1


def test_the_true_law_is_first(pipe):
    law, _, _, _, fitted = pipe
    assert fitted["set"][0] == law, fitted["verdict"]
    assert fitted["ranking"][0]["law"] == law


def test_the_validator_finds_nothing_to_say(pipe):
    _, folder, _, _, _ = pipe
    done = subprocess.run(
        [Path(sys.executable).parent / "nxcheck", "run.h5"],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )
    text = done.stdout + done.stderr
    assert "Total number of errors: 0" in text, text[-3000:]
    assert "Total number of warnings: 0" in text, text[-3000:]
