"""Sticks and slips while a recording runs: where a closed form has them, and where `process smooth` does."""

import math
from pathlib import Path

import numpy as np
import pytest

import daq
from daq.live.analysis import FEW_CYCLES, FEWEST_CYCLES, LiveAnalysis, advise
from daq.live.finished import RunSamples
from daq.live.tail import NewSamples
from daq.runfile.rig import Rig
from fitting import noise_levels
from fitting.judge import screening
from processing.smoothing import smooth
from processing.statistics import from_kinematics
from stickslip.units import Measured

from .motions import BELT, K_OVER_M, KINETIC, LEVER, analysed, pieces, stick_slip

SAMPLES = Path(__file__).resolve().parents[3] / "data_samples"


@pytest.mark.parametrize(("rate_hz", "noise"), [(1000.0, 2e-6), (1000.0, 0.0), (400.0, 2e-4), (100.0, 1e-5)])
def test_break_aways_and_landings_are_placed_within_the_noise(rate_hz: float, noise: float) -> None:
    motion = stick_slip(12, rate_hz, noise)
    live = analysed(motion.time, motion.x, rate_hz)
    slip_s, stick_s = motion.landings[0] - motion.break_aways[0], 2 * LEVER * (1 - KINETIC) / BELT
    # How long a slip is within four standard deviations of the stick: its acceleration jumps.
    hidden_s = math.sqrt(8 * noise / (K_OVER_M * LEVER * (1 - KINETIC)))
    found = np.array(live.break_aways)
    assert len(found) >= 10
    for column, true in ((0, motion.break_aways), (2, motion.landings)):
        nearest = true[np.abs(found[:, column, None] - true).argmin(axis=1)]
        assert np.abs(found[:, column] - nearest).max() < 0.01 * slip_s + 2 / rate_hz + hidden_s
    assert live.belt.value == pytest.approx(BELT, rel=2e-3)
    assert live.belt.source == "sticks"
    statistics = live.summarise()["statistics"]
    assert statistics["break_away"]["mean"] == pytest.approx(
        LEVER, abs=0.01 * LEVER + BELT * (hidden_s / 2 + 2 / rate_hz)
    )
    assert statistics["slip_s"]["mean"] == pytest.approx(slip_s, abs=0.01 * slip_s + hidden_s / 2 + 2 / rate_hz)
    assert statistics["stick_s"]["mean"] == pytest.approx(stick_s, abs=0.01 * stick_s + hidden_s / 2 + 2 / rate_hz)
    assert statistics["drop"]["mean"] == pytest.approx(np.ptp(motion.x[motion.time > 3]), rel=0.01)


@pytest.mark.parametrize("law", [3, 4, 5, 6])
def test_statistics_are_those_of_process_smooth(law: int) -> None:
    run = daq.load(SAMPLES / f"law{law}.h5")
    live = analysed(run.time, run.position, run.rate_hz, run.rig)
    smoothed = from_kinematics(smooth(run))
    found = live.summarise()["statistics"]
    rows = ("stick_s", "stick_s", 0.06), ("slip_s", "slip_s", 0.03), ("break_away", "break_away_m", 0.04)
    for name, other, most in (*rows, ("drop", "drop_m", 0.01)):
        assert found[name]["mean"] == pytest.approx(smoothed.summary(other)["mean"], rel=most)
    assert smoothed.slips - 2 <= live.cycles <= smoothed.slips


def test_a_belt_that_runs_backwards_is_the_mirror_image() -> None:
    motion = stick_slip(8, 1000.0, 2e-6)
    forward, back = analysed(motion.time, motion.x, 1000.0), analysed(motion.time, -motion.x, 1000.0)
    assert back.belt.value == pytest.approx(-forward.belt.value, rel=1e-9)
    assert back.cycles == forward.cycles >= 5
    for name, of in forward.summarise()["statistics"].items():
        assert back.summarise()["statistics"][name] == pytest.approx(of, rel=1e-6)


def test_a_mass_that_swings_or_rests_shows_no_cycle() -> None:
    t = np.arange(30_000) / 1000
    noise = np.random.default_rng(6).normal(0, 2e-6, t.size)
    for x in (0.05 * np.sin(6 * t) + noise, noise, 0.05 * np.exp(-t / 20) * np.cos(6 * t) + noise):
        live = analysed(t, x, 1000.0)
        assert (live.cycles, len(live.break_aways)) == (0, 0)
        assert math.isnan(live.belt.value)
        assert live.state == "moving"
        assert live.summarise()["friction"] is None
    # The calibration's belt speed makes no stick of a turn.
    grazing = analysed(t, BELT / 6 * np.sin(6 * t) + noise, 1000.0, Rig(belt_speed=Measured(BELT)))
    assert (grazing.belt.source, grazing.cycles) == ("calibration", 0)


def test_a_spike_in_a_stick_is_no_slip() -> None:
    motion = stick_slip(10, 1000.0, 2e-6)
    clean = analysed(motion.time, motion.x, 1000.0)
    x = motion.x.copy()
    x[5000 + np.arange(3)] += 5e-3
    x[8000] -= 0.05
    spoilt = analysed(motion.time, x, 1000.0)
    assert spoilt.cycles == clean.cycles
    assert len(spoilt.break_aways) == len(clean.break_aways)


def test_a_gap_ends_a_stick_and_what_follows_is_counted_anew() -> None:
    motion = stick_slip(14, 1000.0, 2e-6)
    keep = (motion.time < 9.0) | (motion.time > 9.4)
    whole, cut = (analysed(motion.time[own], motion.x[own], 1000.0) for own in (slice(None), keep))
    assert whole.cycles - 2 <= cut.cycles < whole.cycles
    assert cut.summarise()["statistics"]["slip_s"]["max"] < 1.02 * whole.summarise()["statistics"]["slip_s"]["max"]


def test_the_belts_own_encoder_gives_its_speed_now() -> None:
    t = np.arange(6000) / 1000
    speed = np.where(t < 3, 0.2, 0.25)
    belt = np.cumsum(speed) / 1000
    live = LiveAnalysis(1000.0)
    live.unit = "m"
    for piece in pieces(NewSamples(t, belt, t == 0, belt), 100):
        live.feed(piece)
    assert live.belt.source == "encoder"
    assert live.belt.value == pytest.approx(0.25, rel=1e-3)


def test_without_sticks_the_belts_speed_is_that_of_the_calibration_in_its_own_unit() -> None:
    t = np.arange(3000) / 1000
    rig = Rig(belt_speed=Measured(0.2), metres_per_count=Measured(1e-5))
    assert analysed(t, 0 * t, 1000.0, rig).belt.value == 0.2
    assert math.isnan(analysed(t, 0 * t, 1000.0, rig, "count").belt.value)  # 0.2 m/s was taken for 0.2 count/s


def test_a_belt_that_changes_its_speed_is_followed() -> None:
    motion = stick_slip(8, 1000.0, 2e-6)
    end = motion.time[-1]
    faster = stick_slip(25, 1000.0, 2e-6)
    x = np.concatenate((motion.x, 2.5 * faster.x))  # lengths and the belt's speed 2.5 times as large
    t = np.concatenate((motion.time, end + 1e-3 + faster.time))
    live = analysed(t, x, 1000.0)
    assert live.belt.value == pytest.approx(2.5 * BELT, rel=5e-3)


def test_the_least_number_of_cycles_is_that_of_the_fit() -> None:
    assert (FEWEST_CYCLES, FEW_CYCLES) == (noise_levels.FEWEST, screening.FEW)
    assert "a verdict needs at least 4" in advise(FEWEST_CYCLES - 1)
    assert "a single bad cycle" in advise(FEWEST_CYCLES)
    assert advise(FEW_CYCLES) == "enough for a verdict; 32 cycles would halve the standard errors"


def test_a_run_file_is_read_in_pieces_as_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = daq.load(SAMPLES / "law5.h5")
    monkeypatch.setattr("daq.live.finished.PIECE", 701)
    run = RunSamples(SAMPLES / "law5.h5")
    parts = list(run.read_pieces())
    assert len(parts) > 5
    for name, truth in (("time", whole.time), ("position", whole.position)):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), truth)
    assert np.concatenate([part.fresh for part in parts]).sum() == 1
    assert (run.counts.samples, run.counts.segments, run.counts.lost) == (whole.time.size, 1, 0)
    cut = run.load_between(3.0, 4.0, 10, 10_000)
    own = (whole.time >= 3.0) & (whole.time <= 4.0)
    np.testing.assert_array_equal(cut.time[11:-11], whole.time[own])
    assert run.load_between(3.0, 4.0, 0, 50).time.size == 52
