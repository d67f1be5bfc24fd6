"""The belt's counts: unwrapped like every counter, made a speed by the calibration, and in the file only when sent."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest

import daq
from daq.cli.app import app
from daq.imports import replay
from daq.protocols import link_budget
from daq.protocols.request import RecordRequest
from daq.protocols.session import Plan
from daq.recorder import ports
from daq.recorder.record import record
from daq.runfile import belt_counter, store
from daq.runfile.rig import Rig
from daq.stream.timeline import Samples
from daq.wire.frames import Capability, Ident
from rig_sim.board import board
from stickslip.errors import InputError
from stickslip.units import Measured

from ..samples import check_counts, make_samples

DELTA = 0.12566 / 4096 / 4


def test_the_speed_is_the_mean_over_its_span_and_knows_no_other_segment() -> None:
    time = np.arange(200) * 1e-3 + np.where(np.arange(200) >= 100, 5.0, 0.0)
    count = np.where(np.arange(200) < 100, 30 * np.arange(200), -20 * np.arange(200))
    found = belt_counter.yield_velocities(count, time, np.array([0, 100]), 1000.0, 1e-5)
    np.testing.assert_allclose(np.concatenate([*found]), np.where(np.arange(200) < 100, 0.3, -0.2), rtol=1e-12)
    (one,) = belt_counter.yield_velocities(count[:1], time[:1], np.array([0]), 1000.0, 1e-5)
    assert one.tolist() == [0.0]


def samples(belt_column: np.ndarray | None, gap_s: float) -> Samples:
    """Return 400 samples at 1 kHz of a slow mass, with a gap in the middle."""
    index = np.arange(400) + np.where(np.arange(400) >= 200, round(gap_s * 1000) - 1, 0)
    belt = None if belt_column is None else (belt_column[index] & 0xFFFF).astype(np.uint16)
    return make_samples(index, up=index.astype(np.uint16), belt=belt)


def test_a_gap_the_belts_counter_may_have_gone_round_in_is_not_joined() -> None:
    run = 29 * np.arange(5000)
    assert len(check_counts(samples(None, 0.8)).starts) == 1
    short, long = (check_counts(samples(run, gap)) for gap in (0.3, 0.8))
    assert short.starts.tolist() == [0]
    sent = samples(run, 0.3).belt
    assert belt_counter.unwrap_count(sent, 16, short.starts)[-1] == 29 * 698
    assert long.starts.tolist() == [0, 200]
    assert long.reasons[1] == "invalid"


def test_a_rate_too_slow_for_the_belts_counter_is_refused_before_the_run() -> None:
    ident = Ident((1, 0, 0), "x4", Capability.BELT, 16, 1000, 1, 5000, 0, "board")
    fine = Rig(metres_per_count=Measured(1e-4), belt_speed=Measured(0.22), belt_metres_per_count=Measured(1e-6))
    with pytest.raises(InputError, match="roll over"):
        link_budget.check(ident, fine, Plan(10.0, 1, 0.0), None)
    assert link_budget.check(ident, fine, Plan(20.0, 1, 0.0), None) == []


def recorded(path: Path, *changes: str, duration: float = 8.0) -> daq.Recording:
    record(RecordRequest(ports.rig_url("rig", list(changes), False), path, 1000, duration))
    return daq.load(path)


def test_a_recorded_belt_is_the_simulated_one_through_every_roll_over(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run.h5", "belt.channel=true", "tell.truth=true")
    assert run.raw.belt_count.dtype == np.uint16
    assert (np.diff(run.raw.belt_count.astype(int)) < 0).sum() == 3
    truth = store.truth(tmp_path / "run.h5")
    np.testing.assert_array_equal(
        run.belt_count, np.floor(0.22 * np.maximum(truth.time - 0.5, 0) / DELTA + 1e-6).astype(int)
    )
    running = run.time > 0.52
    np.testing.assert_allclose(run.belt_velocity[running], 0.22, atol=2 * DELTA / 0.02 + 4 * 2e-4 * 0.22)
    assert not run.belt_velocity[run.time < 0.48].any()


def test_without_a_channel_the_file_holds_nothing_of_it_and_with_one_an_export_its_speed(tmp_path: Path) -> None:
    plain = recorded(tmp_path / "plain.h5", duration=1.0)
    counted = recorded(tmp_path / "counted.h5", "belt.channel=true", duration=1.0)
    assert (plain.belt_count, plain.belt_velocity) == (None, None)
    assert plain.rig == counted.rig.__class__(**{**vars(counted.rig), "belt_metres_per_count": None})
    names: list[set[str]] = []
    for path in (tmp_path / "plain.h5", tmp_path / "counted.h5"):
        found: set[str] = set()
        with h5py.File(path) as file:
            file.visit(found.add)  # a hard link is visited once: the log's time is the encoder's
        names.append(found)
    belt_group = "entry/instrument/belt"
    assert names[1] - names[0] == {
        "entry/raw/belt_count",
        *(f"{belt_group}/value_log{name}" for name in ("", "/value", "/raw_value")),
        *(f"{belt_group}/calibration{name}" for name in ("", "/metres_per_count", "/metres_per_count_errors")),
    }
    assert names[0] < names[1]
    with h5py.File(tmp_path / "counted.h5") as file:
        log = file[f"{belt_group}/value_log"]
        assert (log["value"].attrs["units"], log["raw_value"].attrs["units"]) == ("m/s", "count")
        np.testing.assert_array_equal(log["time"][()], file["entry/instrument/encoder/value_log/time"][()])
    app(["export", str(tmp_path / "counted.h5"), "--csv", str(tmp_path / "run.csv"), "--json"])
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["belt_velocity_m_per_s"], counted.belt_velocity)


def test_counts_of_a_belt_nobody_calibrated_are_kept_and_give_no_speed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = board.format_calibration
    monkeypatch.setattr(board, "format_calibration", lambda *of: re.sub("belt_metres.*\n", "", known(*of)))
    path = tmp_path / "run.h5"
    found = record(RecordRequest(ports.rig_url("rig", ["belt.channel=true"], False), path, 1000, 1.0))
    run = store.load(path)
    assert any("metres per belt count are not known" in warning for warning in found.warnings)
    assert run.raw.belt_count.any()
    assert run.belt_count is None
    assert run.belt_velocity is None


def test_a_replayed_run_has_its_belt_and_another_calibration_gives_it_another_speed(tmp_path: Path) -> None:
    first = recorded(tmp_path / "run.h5", "belt.channel=true", "gaps.rate=0.4", "gaps.duration=0.7")
    assert len(set(first.segment.tolist())) > 1
    again = replay.decode_run(tmp_path / "run.h5")
    np.testing.assert_array_equal(again.belt_count, first.belt_count)
    np.testing.assert_array_equal(again.belt_velocity, first.belt_velocity)
    halved = replay.recalibrate(again, Rig(belt_metres_per_count=Measured(-DELTA / 2)))
    scale = -DELTA / 2 / first.rig.belt_metres_per_count.value
    np.testing.assert_allclose(halved.belt_velocity, scale * first.belt_velocity, rtol=1e-12)
    unknown = replay.recalibrate(again, Rig())
    assert unknown.belt_velocity is None
    assert unknown.raw is again.raw
