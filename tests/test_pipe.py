"""The whole pipe as a user types it: record, smooth, fit; the verdict that the simulated contact deserves."""

import contextlib
import importlib
import io
import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

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


@pytest.fixture(scope="module", params=[6, *(pytest.param(law, marks=pytest.mark.slow) for law in (1, 5))])
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
    if law in (3, 4, 5, 6):
        assert smoothed["sticks"] >= 5
        assert abs(smoothed["belt_speed"] - 0.22) < (0.001 if law in (3, 5) else 0.03)
    assert smoothed["lost_counts"] == 0
    assert smoothed["window"] % 2 == 1


def test_the_true_law_is_in_the_set_and_first_where_it_can_be_told(pipe):
    law, _, _, _, fitted = pipe
    assert law in fitted["set"], fitted["verdict"]
    if law in (1, 2):
        assert set(fitted["set"]) <= {1, 2}
        assert "without a sustained stick, friction is constant" in fitted["verdict"]
    if law in (3, 5, 6):
        assert fitted["set"][0] == law, fitted["verdict"]
        assert fitted["ranking"][0]["law"] == law


def test_the_parameters_of_the_true_law_come_back(pipe):
    law, _, _, _, fitted = pipe
    if law in (1, 2):
        return
    row = next(row for row in fitted["ranking"] if row["law"] == law)
    for parameter in row["parameters"].values():
        assert parameter["lo"] <= parameter["value"] <= parameter["hi"]
        assert parameter["stderr"] > 0
        assert "unit" in parameter


def test_the_run_file_opens_on_a_plot_for_nexus_h5py_and_xarray(pipe):
    _, folder, _, _, _ = pipe
    with h5py.File(folder / "run.h5") as file:
        node = file
        while node.attrs.get("NX_class") != "NXdata":
            node = node[node.attrs["default"]]
        assert node.attrs["signal"] in node
        raw = file["entry/raw"]
        assert np.all(np.diff(raw["sample"][:].astype(int)) == 1)
    with xarray.open_dataset(folder / "run.h5", engine="h5netcdf", group="entry/smooth/kinematics") as kinematics:
        assert kinematics["velocity"].dims == ("time",)
        assert kinematics["time"].size == 12_000


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


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn_reports", "no_rivals")
def test_a_jump_law_is_not_left_in_a_poor_minimum_that_its_ramp_law_avoids(tmp_path):
    # Law 3 used to err by 255 um here where law 4 with a ramp of next to no width erred by 83: law 4 was named.
    changes = (
        "friction.law=3", "seed=4", "scatter.Fs=0.0979", "wear.rate=0.00251", "joint.kick=-0.0106",
        "jitter.rms=2.64e-05", "damper.c=0.01329", "encoder.circumference=0.8192",
    )  # fmt: skip
    flags = [part for change in changes for part in ("--set", change)]
    called(tmp_path, "daq", "record", "--duration", 30, "-o", "run.h5", *flags)
    fitted = called(tmp_path, "fit-friction", "run.h5", codes=(0, 5))
    assert fitted["set"][0] == 3, fitted["verdict"]
    rms = {row["law"]: row["rms_m"] for row in fitted["ranking"]}
    assert rms[3] < 1.02 * rms[4]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn_reports", "no_rivals")
def test_law_5_on_a_belt_that_gives_one_per_cent_cannot_be_told_from_law_6(tmp_path):
    changes = ["--set", "droop.fraction=0.01", "--set", "seed=2"]
    called(tmp_path, "daq", "record", "--rate", 1000, "-o", "run.h5", *changes)
    fitted = called(tmp_path, "fit-friction", "run.h5", codes=(5,))
    assert fitted["set"] == [5, 6]
    drooping, ramp = fitted["ranking"][:2]
    assert drooping["rms_m"] < 3e-6  # the encoder's counts, and nothing else
    assert drooping["parameters"]["droop"]["value"] == pytest.approx(0.01 * 0.22, rel=0.02)
    assert ramp["parameters"]["d"]["value"] == pytest.approx(0.01 * 0.22, rel=0.02)
    assert any("slows under load" in warning for warning in fitted["warnings"])
