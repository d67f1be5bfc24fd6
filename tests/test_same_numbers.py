"""Functions and commands of daq and processing give the same numbers; fitting and rig_sim have their own tests."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import daq
import processing
from daq.cli.app import app as daq_app
from processing import stage, statistics
from processing.cli import app as process_app
from stickslip.console import application

SAMPLES = Path(__file__).resolve().parent.parent / "data_samples"


def assert_same(found, said):
    """Compare a smoothed motion with the document that the command printed, to the last bit."""
    for name in ("method", "window", "order", "belt_speed", "noise", "plateau_fraction"):
        assert said[name] == getattr(found, name), name
    phases = [(phase.kind, phase.start, phase.end) for phase in found.phases]
    assert [(phase["kind"], phase["start"], phase["end"]) for phase in said["phases"]] == phases


@pytest.mark.parametrize("flags", [{}, {"method": "sg", "window": 41, "order": 4}])
def test_smoothing_by_function_and_by_command(tmp_path, capsys, flags):
    path = shutil.copy(SAMPLES / "law5.h5", tmp_path / "run.h5")
    typed = [word for name, value in flags.items() for word in (f"--{name}", str(value))]
    application.run(process_app, ["smooth", str(path), *typed, "--json"])
    said = json.loads(capsys.readouterr().out)
    found = processing.smooth(daq.load(path), **flags)
    assert_same(found, said)
    stored = stage.load(path)
    assert stored is not None
    assert_same(stored, said)
    np.testing.assert_array_equal(stored.velocity, found.velocity)
    counted = statistics.from_kinematics(found).as_json()
    assert said["statistics"] == json.loads(json.dumps(application.plain(counted)))


def test_a_table_in_memory_and_imported_by_the_command(tmp_path, capsys):
    run = daq.load(SAMPLES / "camera.csv")
    application.run(daq_app, ["import", str(SAMPLES / "camera.csv"), "-o", str(tmp_path / "camera.h5"), "--json"])
    said, imported = json.loads(capsys.readouterr().out), daq.load(tmp_path / "camera.h5")
    np.testing.assert_array_equal(run.time, imported.time)
    np.testing.assert_array_equal(run.position, imported.position)
    assert said["samples"] == run.time.size
