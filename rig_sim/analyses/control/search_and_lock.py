"""The thesis's search-and-lock (6.4.4): raise the parameter in steps until the section repeats, then take it back.

As far as the text defines it: while the section does not repeat with the period wanted, the parameter is perturbed a
little more; where it repeats, the motion has locked, the perturbation is removed and the motion goes on by itself.  A
section repeats where the changed system has a stable orbit of this period, so that what is found is a periodic window
near the chaos, and the unstable orbit is left again at the rate of its multiplier.
"""

from dataclasses import dataclass

import numpy as np

from rig_sim.analyses.settling import find_period
from rig_sim.systems.interface import Controlled, difference, orbit
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent

TRANSIENT = 400  # applications at every step before the section is judged; a window's edge may take longer
JUDGED = 130  # applications that are judged: twice the longest period that is recognised
REPEATS = 1e-7  # share of the scales within which the section repeats


@dataclass(frozen=True)
class SearchAndLock:
    """The result of stepping the parameter."""

    change: float | None  # of the parameter, where the section repeated; None if it did not within the budget
    events: int  # applications of the map up to there, or in all
    steps: int  # steps of the parameter
    points: Array | None  # (p, d) the repeating section
    # applications after the change was removed for which the motion stayed within ``near`` of those points
    kept: int | None

    @property
    def stays(self) -> bool:
        """Whether the motion stays there without the change, as long as it was followed."""
        return self.kept == TRANSIENT


def search_and_lock(
    f: Controlled,
    start: Array,
    period: int,
    budget: float,
    *,
    steps: int = 100,
    near: float = 0.01,
    progress: Stages = silent,
) -> SearchAndLock:
    """Raise the parameter from 0 up to the budget until the section repeats with ``period``, then remove the change.

    ``budget`` is relative to the parameter's strength and reached in ``steps`` steps, each with its own motion;
    ``near``, in units of the scales, decides on ``kept``.
    """
    state = start
    events = 0
    for step in range(steps + 1):
        progress("raising the amplitude", step, steps)
        change = step / steps * budget * f.strength
        states = orbit(f, state, TRANSIENT + JUDGED, change)
        events += len(states)
        if len(states) < TRANSIENT + JUDGED:
            break
        state = states[-1]
        if find_period(difference(f, states[TRANSIENT:], state), REPEATS) == period:
            points = states[-period:]
            return SearchAndLock(change, events, step, points, count_kept(f, points, state, near))
    return SearchAndLock(None, events, steps, None, None)


def count_kept(f: Controlled, points: Array, state: Array, near: float) -> int:
    """Return for how many applications the motion stays close to the points that it has visited in turn."""
    for count in range(TRANSIENT):
        state = f.after(state)
        if not np.linalg.norm(difference(f, state, points[count % len(points)])) < near:
            return count
    return TRANSIENT
