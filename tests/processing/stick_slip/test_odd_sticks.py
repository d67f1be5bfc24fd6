"""Sticks that do not fit, and sticks or slips that a record cuts short, leave the rest of it its corners."""

from dataclasses import replace

import numpy as np
import pytest

from processing.smoothing import smooth


def rms(values):
    return 1e3 * float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("pitch", [7.67e-6, 5e-5])
def test_a_disturbed_stick_is_smoothed_by_itself(recorded, motion, pitch):
    """A tap of 3 mm within one stick of seventeen; the others keep their corners."""
    true = motion(5, 30.0)
    begin, end = true.sticks[len(true.sticks) // 2]
    middle = 0.6 * begin + 0.4 * end
    tap = 3e-3 * np.exp(-(((true.time - middle) / 0.02) ** 2))
    tapped = replace(true, x=true.x + tap, v=true.v - 2 * (true.time - middle) / 0.02**2 * tap)
    clean, made = (smooth(recorded(own, pitch)) for own in (true, tapped))
    assert made.method == clean.method == "segment"
    away = np.abs(true.time - middle) > 4.0  # beyond the middles of the sticks beside it
    plain = smooth(recorded(tapped, pitch), "rts")
    assert rms((made.velocity - tapped.v)[away]) < 1.2 * rms((clean.velocity - true.v)[away])
    assert rms((made.velocity - tapped.v)[away]) < 0.5 * rms((plain.velocity - tapped.v)[away])
    inside = np.abs(made.velocity - tapped.v) <= 2 * made.velocity_errors
    assert inside[~away].mean() > 0.85


def part(true, begin, end):
    """Return the motion from one time to another, s, without the sticks."""
    own = slice(*np.searchsorted(true.time, (begin, end)))
    return replace(true, time=true.time[own], x=true.x[own] - true.x[own.start], v=true.v[own], sticks=())


@pytest.mark.parametrize("length", [3.0, 12.0])
def test_a_stick_that_the_end_of_a_record_cuts_short_leaves_the_others_their_corners(recorded, motion, length):
    """After 30 ms that stick took all others their corners, in a short record."""
    true = motion(5, 20.0)
    landing = true.sticks[7][0]
    cut = part(true, landing + 0.03 - length, landing + 0.03)
    made = smooth(recorded(cut))
    assert made.method == "segment"
    assert rms((made.velocity - cut.v)[100:-100]) < 0.06


@pytest.mark.parametrize("law", [4, 6])
def test_a_stick_in_which_the_mass_creeps_does_not_break_away_where_the_record_ends(recorded, motion, law):
    true = motion(law, 20.0)
    sticks = [stick for stick in true.sticks if np.ptp(stick) > 0.25][-3:]
    for begin, end in sticks:
        cut = part(true, max(end - 10.0, 0.0), 0.4 * begin + 0.6 * end)
        made = smooth(recorded(cut))
        assert made.phases[-1].kind == "stick"
        assert cut.time[0] + made.sticks[-1].start == pytest.approx(begin, abs=0.03)


@pytest.mark.parametrize("rate", [1000 / 60, 20.0])
def test_sticks_that_are_read_far_better_than_slips_leave_variances_positive(motion, imported, rate):
    """0.8 mm of misfit passed for noise in slips of few samples; sticks were read to a nanometre, and a log was NaN."""
    true = motion(5, 40.0, 0.0, scatter=0.0, belt=0.1)
    thin = slice(None, None, round(1000 / rate))
    found = smooth(imported(np.round(true.time[thin], 9), np.round(true.x[thin], 9), rate))
    assert abs(len(found.sticks) - len(true.sticks)) <= 1
    assert np.isfinite(found.velocity).all()
    assert found.faults == ()


@pytest.mark.parametrize("counts_per_second", [3.0, 300.0])
def test_a_parked_counter_that_drifts_is_reported(recorded, motion, counts_per_second):
    """It used to be "1 stick, stuck for 100 %" without a word."""
    time = np.arange(10_000) * 1e-3
    dither = 0.8 * np.random.default_rng(1).random(time.size)
    moved = (counts_per_second * time + dither) * 7.67e-6
    made = smooth(recorded(replace(motion(5, 1.0), time=time, x=moved, v=moved)))
    assert [finding.code for finding in made.findings] == ["drift"]
    assert made.findings[0].value == pytest.approx(counts_per_second * 7.67e-6, rel=0.02)
    assert made.findings[0].sigmas > 100
    assert smooth(recorded(motion(5, 6.0))).findings == ()


def test_swings_before_the_first_stick_do_not_hide_the_sticks(recorded, motion):
    true = motion(5, 20.0)
    swing = 1e-3 * np.sin(2 * np.pi * np.arange(25_000) * 1e-3)  # flat, beside the accelerations of the slips
    x = np.concatenate((swing, true.x - true.x[0]))
    made = smooth(recorded(replace(true, time=np.arange(x.size) * 1e-3, x=x, v=np.gradient(x, 1e-3))))
    assert len(made.sticks) == len(true.sticks)
    assert made.belt_speed == pytest.approx(smooth(recorded(true)).belt_speed, rel=0.01)
