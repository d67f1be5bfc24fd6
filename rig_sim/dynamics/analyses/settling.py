"""Attractors of a system and their periods: each start is followed until its motion repeats, or for a long time.

A motion is periodic when its state at the section comes back within `SAME`, again and again
(`rig_sim.dynamics.system.period`).  Of a driven system the section is the drive's phase 0, so that the period counts in
drive periods.  Starts whose motions end on the same points share an attractor.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rig_sim.dynamics.analyses.sweep import SAME_POINT, AttractorAt, distinct
from rig_sim.dynamics.system.interface import Motion, ReturnMap
from rig_sim.dynamics.system.period import LONGEST_PERIOD, REPEATS, period_of
from rig_sim.flow.modes import COMPLETED, OUTCOMES, Outcome
from stickslip.compute.arrays import Array
from stickslip.compute.stages import parts, silent

# Relative to the system's scale: how closely a state has to come back.  Rounding of a stable orbit stays at 1e-13; a
# chaotic one does not come back so closely within the passages looked at.  100 times less costs as many more passages
# as a factor of 100 takes to decay.
SAME = 1e-8
# Times `SAME`: how far apart points have to be that count as two.  Near a period doubling an orbit of period 1 is
# approached from both sides in turn, and every second point comes back before every point does.
APART = 1e3
WINDOW = 2 * LONGEST_PERIOD + REPEATS  # passages that are compared
# Passages, or the system's own oscillations, left out before each comparison, one after the other: an orbit on which
# deviations fall by a factor of 0.993 or less is recognised.  Twice as many at the end double the cost of what is not
# periodic.
TRANSIENTS = (64, 128, 256, 512, 1024)
AT_ONCE = 100_000  # passages of a transient that are followed in one call, 8 MB; a fast drive passes millions
SAME_ORBIT = 1e-5  # relative to the scale: how closely two starts on one periodic orbit agree
# The same of motions with different periods: beside a bifurcation one start may come close enough to be recognised, and
# another one, on the same orbit, not yet.
CLOSE_ORBIT = 1e-3
NEIGHBOURS = 0.05  # of the extent: median distance from a point of an attractor that is not periodic to another start's
DRAWN = 512  # passages that are drawn of an attractor that is not periodic
# Of the size over the last transient, above which a motion counts as growing; one in proportion to time doubles.
GROWTH = 1.5
LARGE = 2.0  # size over the scale: a motion that does not exceed it is not called growing; a mass in stick is below 1
GROWING = Outcome("growing", "the motion still grows after a long time: add damping, or move off the resonance")


@dataclass(frozen=True)
class Settled:
    """Where a motion has settled.

    Attributes
    ----------
    states : (n, d) float64
        One period, or `WINDOW` passages of what is not periodic.
    period : int or None
        None for what is not periodic.
    outcome : Outcome
        'completed', 'growing', or why the motion ended.
    """

    states: Array
    period: int | None
    outcome: Outcome


def settled(
    motion: Motion, transients: Sequence[int] = TRANSIENTS, window: int = WINDOW, same: float = SAME
) -> Settled:
    """Follow a motion until it repeats, or for as long as ``transients`` say.

    Parameters
    ----------
    motion : Motion
        It ends where it has settled.
    transients : sequence of int
        Passages, or the system's own oscillations, left out before each comparison.
    window : int
        Passages that are compared.
    same : float
        Relative to the system's scale: how closely a state has to come back.
    """
    system = motion.system
    before: Array | None = None
    for transient in transients:
        for begin, end in parts("transient", transient * system.unit, silent, AT_ONCE):
            found = motion.follow(end - begin)
            if found.outcome != OUTCOMES[COMPLETED]:
                break
        else:
            found = motion.follow(window)
        if found.outcome != OUTCOMES[COMPLETED]:
            return Settled(found.states, None, found.outcome)
        scaled = found.states / system.scale
        period = period_of(scaled, APART * same)
        repeats = period_of(scaled, same)
        if repeats is not None and (repeats == period or transient == transients[-1]):
            return Settled(found.states[-repeats:], repeats, found.outcome)
        grows = before is not None and is_growing(before, scaled)
        before = scaled
    return Settled(found.states, None, GROWING if grows else found.outcome)


def is_growing(before: Array, after: Array) -> bool:
    """Return whether states (n, d), relative to the system's scale, are larger than they were half as long ago."""
    return bool(np.max(np.abs(after)) > max(GROWTH * np.max(np.abs(before)), LARGE))


def attractors(f: ReturnMap, starts: Iterable[Array], value: float) -> list[AttractorAt]:
    """Return the attractors that the starts lead to, the one with the most starts first; ``value`` of the parameter.

    Where no start leads to one, the only row has the number 0 and says why.
    """
    kinds: list[Settled] = []
    shown: list[Array] = []
    counts: list[int] = []
    failed: list[Outcome] = []
    for start in starts:
        motion = f.motion(start)
        end = settled(motion)
        if end.outcome != OUTCOMES[COMPLETED]:
            failed.append(end.outcome)
            continue
        for index, other in enumerate(kinds):
            if is_same(end, other, f.scale):
                counts[index] += 1
                if end.period and (other.period is None or end.period < other.period):
                    kinds[index], shown[index] = end, motion.drawn(end.period)
                break
        else:
            kinds.append(end)
            shown.append(motion.drawn(end.period or DRAWN))
            counts.append(1)
    if not kinds:
        return [AttractorAt(value, 0, (), None, 0.0, (np.nan, np.nan), None, failed[0].name)]
    rows = []
    number = len(failed) + sum(counts)
    for rank, index in enumerate(sorted(range(len(kinds)), key=lambda index: -counts[index]), 1):
        end = kinds[index]
        first = end.states[:, 0]
        tolerance = SAME_POINT * float(np.max(np.abs(shown[index]), initial=0.0))
        points = distinct(shown[index].tolist(), tolerance)
        extent = float(first.min()), float(first.max())
        outcome = "completed" if points else "no passage"
        repeats = len(shown[index]) if points and end.period else None
        share = counts[index] / number
        rows.append(AttractorAt(value, rank, points, repeats, share, extent, end.period, outcome))
    return rows


def is_same(one: Settled, other: Settled, scale: Array) -> bool:
    """Return whether two motions have settled on the same attractor."""
    a, b = one.states / scale, other.states / scale
    apart = np.max(np.abs(a[:, None, :] - b[None, :, :]), axis=2)
    if one.period is None and other.period is None:
        extent = float(np.max(np.ptp(a, axis=0)))
        return bool(np.median(np.min(apart, axis=1)) <= NEIGHBOURS * extent)
    farthest = max(np.min(apart, axis=1).max(), np.min(apart, axis=0).max())
    return bool(farthest <= (SAME_ORBIT if one.period == other.period else CLOSE_ORBIT))
