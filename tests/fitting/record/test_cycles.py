"""A record is cut where the mass leaves the belt, and the random break-away falls into no window."""

from itertools import pairwise

import pytest

from fitting.record import cycles


@pytest.fixture(scope="module")
def law5(motion_of):
    motion = motion_of(law=5)
    return motion, cycles.segment_cycles(motion)


def break_aways(belt_rig, **changes):
    """Return the times at which slips begin, but for that with which the belt starts."""
    return belt_rig.sampled(belt_rig.Scene(**changes))[1].break_aways[1:]


def test_every_complete_cycle_is_found(law5, belt_rig):
    _, cut = law5
    breaks = [t for t in break_aways(belt_rig, law=5) if t < 19]
    assert len(cut.used) == len(breaks)
    assert [cycle.break_away for cycle in cut.cycles] == pytest.approx(breaks, abs=0.04)


def test_no_window_holds_a_break_away(law5, belt_rig):
    motion, cut = law5
    breaks = break_aways(belt_rig, law=5)
    for cycle in cut.used:
        for first, end in (cycle.stick, cycle.slip):
            if end > first:
                inside = (breaks > motion.time[first]) & (breaks < motion.time[end - 1])
                assert not inside.any()


@pytest.mark.parametrize("d", [0.03, 0.06])
def test_the_drag_of_a_wide_ramp_is_found(motion_of, belt_rig, d):
    """Creep slows the mass down at once: it was taken for the slip, and law 2 was not distinguished from law 1."""
    motion = motion_of(law=2, d=d)
    first, end = cycles.segment_cycles(motion).drag
    broken = break_aways(belt_rig, law=2, d=d)[0]
    assert motion.time[first] < 0.75
    assert 0 < broken - motion.time[end - 1] < 0.15


def test_a_long_record_is_fitted_by_cycles_spread_over_it(law5, monkeypatch):
    """A record of 30 minutes took 3.9 GB and more than 200 s."""
    motion, whole = law5
    monkeypatch.setattr(cycles, "MOST_CYCLES", 5)
    cut = cycles.segment_cycles(motion)
    numbers = [cycle.number for cycle in cut.used]
    assert len(numbers) == 5
    assert [numbers[0], numbers[-1]] == [whole.used[0].number, whole.used[-1].number]
    assert max(b - a for a, b in pairwise(numbers)) - min(b - a for a, b in pairwise(numbers)) <= 1
    assert cut.surplus == len(whole.used) - 5
