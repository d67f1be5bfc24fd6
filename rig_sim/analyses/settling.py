"""Attractors of a system and their periods: each start is followed until its motion repeats, or for a long time.

A motion is periodic when its state at the section comes back within `SAME`, again and again
(`find_period`).  Of a driven system the section is the drive's phase 0, so that the period counts in
drive periods.  Starts whose motions end on the same points share an attractor.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rig_sim.analyses.sweep import SAME_POINT, AttractorAt, merge_close_points
from rig_sim.flow.modes import COMPLETED, OUTCOMES, Outcome
from rig_sim.systems.interface import Motion, ReturnMap
from stickslip.compute.arrays import Array
from stickslip.compute.stages import parts, silent

LONGEST_PERIOD = 64
# Least number of points at the end of the sequence that have to repeat: an intermittent motion stays near an unstable
# orbit of period p for a while, where fewer points repeat by accident.
REPEATS = 16
# Relative to the system's scale: how closely a state has to come back.  Rounding of a stable orbit stays at 1e-13; a
# chaotic one does not come back so closely within the compared passages.
SAME = 1e-8
# Times `SAME`: distance of points that count as two.  Near a period doubling an orbit of period 1 is approached from
# both sides in turn, and every second point comes back before every point does.
APART = 1e3
WINDOW = 2 * LONGEST_PERIOD + REPEATS  # passages that are compared
# Passages, or natural oscillations of the system, left out before each comparison in turn: an orbit on which deviations
# fall by a factor of 0.993 or less is recognised.
TRANSIENTS = (64, 128, 256, 512, 1024)
AT_ONCE = 100_000  # passages of a transient in one call, 8 MB; a fast drive passes millions
SAME_ORBIT = 1e-5  # relative to the scale: how closely two starts on one periodic orbit agree
# The same of motions with different periods: near a bifurcation one start on an orbit may already be recognised, and
# another not yet.
CLOSE_ORBIT = 1e-3
NEIGHBOURS = 0.05  # of the extent: median distance between points of two starts on one attractor that is not periodic
DRAWN = 512  # drawn passages of an attractor that is not periodic
# Of the size over the last transient, above which a motion counts as growing; one in proportion to time doubles.
GROWTH = 1.5
LARGE = 2.0  # size over the scale that a growing motion exceeds; a mass in stick is below 1
GROWING = Outcome("growing", "the motion still grows after a long time; add damping, or move away from the resonance")


def find_period(orbit: Array, tolerance: float) -> int | None:
    """Return the least period with which the end of an orbit repeats within ``tolerance``; None without one."""
    for period in range(1, min(LONGEST_PERIOD, len(orbit) // 2) + 1):
        span = min(max(period, REPEATS), len(orbit) - period)
        if np.all(np.abs(orbit[-span:] - orbit[-span - period : -period]) <= tolerance):
            return period
    return None


@dataclass(frozen=True)
class Settled:
    """The end of a motion: a period, or a window of passages."""

    states: Array  # (n, d) one period, or `WINDOW` passages of a motion that is not periodic
    period: int | None  # None for a motion that is not periodic
    outcome: Outcome  # 'completed', 'growing', or why the motion ended


def settle(motion: Motion, transients: Sequence[int] = TRANSIENTS, window: int = WINDOW, same: float = SAME) -> Settled:
    """Follow a motion until it repeats, at most over ``transients``: passages left out before each comparison.

    ``window`` passages are compared; ``same``, relative to the system's scale, is how closely a state has to come back.
    """
    system = motion.system
    before: Array | None = None
    for transient in transients:
        for begin, end in parts("transient", transient * system.unit, silent, AT_ONCE):
            passages = motion.follow(end - begin)
            if passages.outcome != OUTCOMES[COMPLETED]:
                break
        else:
            passages = motion.follow(window)
        if passages.outcome != OUTCOMES[COMPLETED]:
            return Settled(passages.states, None, passages.outcome)
        scaled = passages.states / system.scale
        period = find_period(scaled, APART * same)
        repeats = find_period(scaled, same)
        if repeats is not None and (repeats == period or transient == transients[-1]):
            return Settled(passages.states[-repeats:], repeats, passages.outcome)
        grows = before is not None and is_growing(before, scaled)
        before = scaled
    return Settled(passages.states, None, GROWING if grows else passages.outcome)


def is_growing(before: Array, after: Array) -> bool:
    """Return whether states (n, d), relative to the system's scale, are larger than they were half as long ago."""
    return bool(np.max(np.abs(after)) > max(GROWTH * np.max(np.abs(before)), LARGE))


def find_attractors(f: ReturnMap, starts: Iterable[Array], value: float) -> list[AttractorAt]:
    """Return the attractors that the starts lead to, the one with the most starts first; ``value`` of the parameter.

    Where no start leads to one, the only row has the number 0 and the reason.
    """
    distinct_ends: list[Settled] = []
    drawn_points: list[Array] = []
    counts: list[int] = []
    failures: list[Outcome] = []
    for start in starts:
        motion = f.motion(start)
        end = settle(motion)
        if end.outcome != OUTCOMES[COMPLETED]:
            failures.append(end.outcome)
            continue
        for index, other in enumerate(distinct_ends):
            if is_same(end, other, f.scale):
                counts[index] += 1
                if end.period and (other.period is None or end.period < other.period):
                    distinct_ends[index], drawn_points[index] = end, motion.draw_points(end.period)
                break
        else:
            distinct_ends.append(end)
            drawn_points.append(motion.draw_points(end.period or DRAWN))
            counts.append(1)
    if not distinct_ends:
        return [AttractorAt(value, 0, (), None, 0.0, (np.nan, np.nan), None, failures[0].name)]
    rows = []
    number = len(failures) + sum(counts)
    for rank, index in enumerate(sorted(range(len(distinct_ends)), key=lambda index: -counts[index]), 1):
        end = distinct_ends[index]
        first = end.states[:, 0]
        tolerance = SAME_POINT * float(np.max(np.abs(drawn_points[index]), initial=0.0))
        points = merge_close_points(drawn_points[index].tolist(), tolerance)
        extent = float(first.min()), float(first.max())
        outcome = "completed" if points else "no passage"
        repeats = len(drawn_points[index]) if points and end.period else None
        share = counts[index] / number
        rows.append(AttractorAt(value, rank, points, repeats, share, extent, end.period, outcome))
    return rows


def is_same(first: Settled, second: Settled, scale: Array) -> bool:
    a, b = first.states / scale, second.states / scale
    apart = np.max(np.abs(a[:, None, :] - b[None, :, :]), axis=2)
    if first.period is None and second.period is None:
        extent = float(np.max(np.ptp(a, axis=0)))
        return bool(np.median(np.min(apart, axis=1)) <= NEIGHBOURS * extent)
    farthest = max(np.min(apart, axis=1).max(), np.min(apart, axis=0).max())
    return bool(farthest <= (SAME_ORBIT if first.period == second.period else CLOSE_ORBIT))
