"""A record smoothed in blocks is the record smoothed in one go, in memory that does not grow with it."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import daq
from daq.protocols.request import RecordRequest
from daq.recorder import ports
from daq.recorder.record import record
from daq.runfile import store
from daq.runfile.recording import Recording
from processing import smoothing, stage
from processing.smoothing import smooth
from stickslip.units import Measured


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(smoothing, "BLOCK", 7000)
    monkeypatch.setattr(smoothing, "MARGIN", (2500, 2**16))


@pytest.fixture
def path(tmp_path, motion, run_data):
    target = tmp_path / "run.h5"
    store.write(target, run_data(motion(5, 20.0, start=0.5)))
    return target


def test_savitzky_golay_in_blocks_is_that_of_the_whole(path, small_blocks):
    whole = smooth(daq.load(path), "sg", 41, 4)
    summary = smoothing.smooth_file(path, "sg", 41, 4)
    found = stage.load(path)
    assert (summary.method, summary.window, summary.samples) == ("sg", 41, 20_000)
    assert np.array_equal(found.time, whole.time)
    assert found.velocity == pytest.approx(whole.velocity, abs=1e-11)
    assert found.position == pytest.approx(whole.position, abs=1e-13)
    assert found.velocity_errors == pytest.approx(whole.velocity_errors, rel=0.02)


def test_a_long_record_in_memory_is_smoothed_in_the_blocks_of_a_file(path, small_blocks, monkeypatch):
    """In one block, half an hour at 1 kHz took 0.85 GB."""
    monkeypatch.setattr(smoothing, "LARGE", 10_000)
    motion, summary = smooth(daq.load(path)), smoothing.smooth_file(path)
    stored = stage.load(path)
    assert motion.phases == summary.phases
    assert motion.dropped_frames == summary.dropped_frames
    for name in ("velocity", "velocity_errors"):
        assert getattr(motion, name) == pytest.approx(getattr(stored, name), rel=1e-6, abs=1e-9)


def test_sticks_and_slips_do_not_depend_on_the_blocks(tmp_path, pulled, monkeypatch):
    """Creep and 18 spikes a second: noise levels of each block gave 217 to 241 slips of one published record."""
    record = pulled(40.0).recording
    store.write(tmp_path / "run.h5", record)
    whole = smooth(record)
    monkeypatch.setattr(smoothing, "BLOCK", 11_000)
    summary = smoothing.smooth_file(tmp_path / "run.h5")
    assert len(whole.slips) > 20
    assert [phase.kind for phase in summary.phases] == [phase.kind for phase in whole.phases]
    for end in ("first", "last"):  # of samples; blocks smooth the edges of their neighbourhood from one side
        apart = [getattr(a, end) - getattr(b, end) for a, b in zip(summary.phases, whole.phases, strict=True)]
        assert np.abs(apart).max() <= 4
    assert summary.belt_speed == pytest.approx(whole.belt_speed, rel=1e-6)
    assert summary.noise == pytest.approx(whole.noise, rel=1e-6)


def assert_equal_in_blocks(path, monkeypatch, block, sticks):
    whole = smooth(daq.load(path))
    monkeypatch.setattr(smoothing, "BLOCK", block)
    summary = smoothing.smooth_file(path)
    found = stage.load(path)
    assert [(own.first, own.last) for own in summary.sticks] == [(own.first, own.last) for own in whole.sticks]
    assert len(whole.sticks) > sticks
    assert [own.what for own in summary.corners] == [own.what for own in whole.corners]
    assert len(whole.corners) > 2 * sticks - 2
    moved = [(a.time - b.time) / b.sd for a, b in zip(summary.corners, whole.corners, strict=True)]
    assert np.abs(moved).max() < 1e-3
    apart = np.abs(found.velocity - whole.velocity) / whole.velocity_errors
    assert np.quantile(apart, 0.999) < 1e-9
    assert apart.max() < 1e-8


@pytest.mark.parametrize(("law", "block"), [(3, 9000), (6, 15_000)])
def test_the_velocity_in_blocks_is_that_of_the_whole(tmp_path, motion, run_data, monkeypatch, law, block):
    """In a block the procedure of learning ran again with remembered results: ends of sticks differed by 4 samples."""
    store.write(tmp_path / "run.h5", run_data(motion(law, 30.0)))
    assert_equal_in_blocks(tmp_path / "run.h5", monkeypatch, block, 12)


def test_blocks_see_more_than_a_slip_to_either_side(tmp_path, monkeypatch):
    """Slips of law 1 last 6,800 samples: 4,096 beside a block cut one, and a stick of the block was 16 errors off."""
    run = tmp_path / "run.h5"
    record(RecordRequest(ports.rig_url("rig", ["friction.law=1", "seed=11"], False), run, 1000, 60.0))
    assert_equal_in_blocks(run, monkeypatch, 9000, 5)


@pytest.mark.parametrize("repair", ["flag", "fix"])
def test_lost_counts_are_carried_from_block_to_block(tmp_path, motion, run_data, small_blocks, repair):
    data = run_data(motion(5, 20.0, start=0.5))
    count = data.count.copy()
    for at, size in ((3000, 40), (6950, -25), (15_000, 60)):
        count[at:] += size
    target = tmp_path / "run.h5"
    store.write(target, replace(data, count=count, position=count * 7.67e-6 + 7.67e-6 / 2))
    summary = smoothing.smooth_file(target, "rts", repair_counts=repair)
    found = stage.load(target)
    assert [(loss.first, loss.counts) for loss in summary.losses] == [(3000, 40), (6950, -25), (15_000, 60)]
    assert found.repaired == (repair == "fix")
    right = data.position if repair == "fix" else daq.load(target).position
    assert np.abs(found.position - right).max() < 5e-5
    assert np.abs(found.measured - right).max() < 1e-9


def test_nominal_times_of_an_import_are_those_of_the_whole(path, small_blocks):
    asked = ("auto", "auto", None, "nominal")
    whole = smooth(daq.load(path), *asked)
    summary = smoothing.smooth_file(path, *asked)
    found = stage.load(path)
    assert daq.load(path).raw is None
    assert found.time == pytest.approx(whole.time, abs=1e-9)
    assert np.abs(whole.time - daq.load(path).time).max() > 3e-5
    assert len(summary.sticks) == len(whole.sticks)
    apart = np.abs(found.velocity - whole.velocity) / (found.velocity_errors + whole.velocity_errors)
    assert np.mean(apart < 2) > 0.99


def test_a_counted_belt_is_smoothed_in_blocks_too(tmp_path, small_blocks):
    changes, target = ["belt.channel=true", "belt.ripple=0.02", "belt.ripple_hz=2"], tmp_path / "run.h5"
    record(RecordRequest(ports.rig_url("rig", changes, False), target, 1000, 20.0))
    whole = smooth(daq.load(target))
    summary = smoothing.smooth_file(target)
    found = stage.load(target)
    assert whole.belt_counted
    assert summary.belt_counted
    assert summary.belt_speed == pytest.approx(whole.belt_speed, rel=1e-3)
    assert (len(summary.sticks), len(summary.slips)) == (len(whole.sticks), len(whole.slips))
    apart = np.abs(found.belt_velocity - whole.belt_velocity)
    assert np.mean(apart < 2 * (found.belt_velocity_errors + whole.belt_velocity_errors)) > 0.99
    with h5py.File(target) as file:
        assert file["entry/smooth/kinematics/belt_velocity"].dims[0].keys() == ["time"]


@pytest.mark.slow
def test_memory_stays_below_300_mb_however_long_the_record(tmp_path):
    if not Path("/proc/self/status").exists():
        pytest.skip("the peak of a process's own memory is read from Linux's /proc")
    n = 1_500_000
    script = """
import json
from pathlib import Path
from processing import smoothing
summary = smoothing.smooth_file(Path("long.h5"), "sg", 41, 4, "recorded")
peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
print(json.dumps([summary.samples, int(peak.split()[1]) / 1024]))
"""
    time = np.arange(n) * 1e-3
    count = np.floor(0.1 / 7.67e-6 * np.sin(2 * np.pi * time / 3)).astype(np.int64)
    run = Recording(
        title="long",
        started="2026-01-01T00:00:00+00:00",
        ended="2026-01-01T00:50:00+00:00",
        rate_hz=1000.0,
        rig=daq.runfile.rig.Rig(metres_per_count=Measured(7.67e-6)),
        time=time,
        position=count * 7.67e-6,
        count=count,
    )
    store.write(tmp_path / "long.h5", run)
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True, capture_output=True, text=True)
    samples, megabytes = json.loads(done.stdout.splitlines()[-1])
    assert samples == n
    assert megabytes < 300
