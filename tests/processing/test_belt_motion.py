"""A counted belt: its speed through the mass's own filter, sticks found beside it, and the stage that keeps it."""

import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

import daq
import processing
from daq.protocols.request import RecordRequest
from daq.recorder import ports
from daq.recorder.record import record
from daq.runfile import store
from daq.runfile.run_data import Truth
from processing import stage
from processing.cli import app
from stickslip.console import application

PITCH = 0.12566 / 4096 / 4
FS = 1.379353536


def run(path: Path, *changes: str, duration: float = 12.0, channel: bool = True) -> tuple[Path, Truth]:
    listed = ["tell.truth=true", "scatter.Fs=0", f"belt.channel={str(channel).lower()}", *changes]
    record(RecordRequest(ports.rig_url("rig", listed, False), path, 1000, duration))
    truth = store.truth(path)
    assert truth is not None
    return path, truth


def scale(recording: daq.Recording) -> float:
    """Return what the lab's calibration makes of a metre of belt."""
    assert recording.rig.belt_metres_per_count is not None
    return recording.rig.belt_metres_per_count.value / PITCH


@pytest.mark.parametrize("sign", [1, -1])
def test_the_belts_speed_falls_in_stick_by_the_droops_fraction(tmp_path: Path, sign: int) -> None:
    path, truth = run(tmp_path / "run.h5", "droop.fraction=0.05", f"belt.speed={sign * 0.22}")
    recording = daq.load(path)
    motion = processing.smooth(recording)
    assert motion.belt_velocity is not None
    assert motion.belt_velocity_errors is not None
    true = sign * 0.22 * (1 - 0.05 * sign * truth.F / FS) * scale(recording)
    away = np.ones(truth.time.size, bool)
    for phase in motion.phases:  # a landing bends the belt's speed faster than any window follows
        away &= np.abs(truth.time - phase.start) > 0.03
    away &= (truth.time > 0.6) & (truth.time < truth.time[-1] - 0.03)
    error = (motion.belt_velocity - true)[away]
    assert np.sqrt(np.mean(error**2)) < 3e-4
    assert np.sqrt(np.mean((error / motion.belt_velocity_errors[away]) ** 2)) < 2
    falls = []
    for stick in motion.sticks[1:-1]:
        inside = slice(stick.first + 40, stick.last - 40)
        load = sign * truth.F[inside] / FS
        falls.append(np.polyfit(load, sign * motion.belt_velocity[inside] / scale(recording), 1))
    assert len(falls) >= 4
    np.testing.assert_allclose([fall[0] for fall in falls], -0.05 * 0.22, rtol=0.05)
    np.testing.assert_allclose([fall[1] for fall in falls], 0.22, rtol=1e-3)


def test_a_belt_that_swings_hides_its_sticks_from_a_record_without_its_counts(tmp_path: Path) -> None:
    swing = ("belt.ripple=0.04", "belt.ripple_hz=8")
    found = {}
    for channel in (True, False):
        path, truth = run(tmp_path / f"{channel}.h5", *swing, channel=channel)
        motion = processing.smooth(daq.load(path))
        belt = 0.22 + 0.04 * np.sin(2 * np.pi * 8 * (truth.time - 0.5))
        riding = (np.abs(truth.v - belt) < 1e-9) & (truth.time > 0.5)
        found[channel] = np.mean(motion.stick == riding)
    assert found[True] > 0.95  # what is missing are onsets, soft, and slips of some ms inside a stick
    assert found[False] < 0.85


@pytest.mark.parametrize("changes", [(), ("friction.law=6",), ("friction.law=2",)])
def test_on_a_steady_belt_sticks_are_the_same_with_and_without_its_counts(
    tmp_path: Path, changes: tuple[str, ...]
) -> None:
    with_counts = processing.smooth(daq.load(run(tmp_path / "with_counts.h5", *changes)[0]))
    plain = processing.smooth(daq.load(run(tmp_path / "plain.h5", *changes, channel=False)[0]))
    assert np.mean(with_counts.stick == plain.stick) > 0.97
    assert len(with_counts.sticks) == len(plain.sticks)
    assert with_counts.belt_speed == pytest.approx(0.22 * scale(with_counts.recording), abs=5e-5)
    assert plain.belt_velocity is None
    np.testing.assert_array_equal(with_counts.velocity, plain.velocity)


@pytest.mark.parametrize("method", ["sg", "fd"])
def test_the_stage_keeps_the_belts_velocity_and_gives_it_back(tmp_path: Path, method: str) -> None:
    path, _ = run(tmp_path / "run.h5", duration=4.0)
    made = processing.smooth(daq.load(path), method)
    stage.save(made, path)
    back = stage.load(path)
    assert back is not None
    assert made.belt_velocity is not None
    assert back.belt_velocity is not None
    np.testing.assert_array_equal(back.belt_velocity, made.belt_velocity)
    assert back.belt_speed == made.belt_speed
    with h5py.File(path) as file:
        kept = file["entry/smooth/kinematics/belt_velocity"]
        assert kept.attrs["units"] == "m/s"
        assert file["entry/smooth/kinematics/belt_velocity_errors"].dtype == np.float32


def test_the_command_reports_the_counted_speed_and_the_export_has_its_columns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, _ = run(tmp_path / "run.h5", "droop.fraction=0.2", duration=6.0)
    assert application.run(app, ["smooth", str(path), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["belt_channel"] is True
    assert data["belt_speed"] == pytest.approx(processing.smooth(daq.load(path)).belt_speed)
    assert application.run(app, ["export", str(path), "--csv", str(tmp_path / "out.csv")]) == 0
    table = pd.read_csv(tmp_path / "out.csv")
    assert {"belt_velocity_m_per_s", "belt_velocity_error_m_per_s"} <= set(table.columns)
