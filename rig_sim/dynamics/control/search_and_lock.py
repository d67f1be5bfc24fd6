"""The thesis's search-and-lock (6.4.4): raise the parameter in steps until the section repeats, then take it back.

As far as the text defines it: while the section does not repeat with the period wanted, the parameter is perturbed a
little more; where it repeats, the motion has locked, the perturbation is removed and the motion goes on by itself.  A
section repeats where the changed system has a stable orbit of this period, so that what is found is a periodic window
near the chaos, and the unstable orbit is left again at the rate of its multiplier.
"""

from dataclasses import dataclass

import numpy as np

from rig_sim.dynamics.system.interface import Controlled, difference, orbit
from rig_sim.dynamics.system.period import period_of
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent

TRANSIENT = 400  # applications at every step before the section is judged; a window's edge may take longer
JUDGED = 130  # applications that are judged: twice the longest period that is recognised
REPEATS = 1e-7  # share of the scales within which the section repeats


@dataclass(frozen=True)
class SearchAndLock:
    """What stepping the parameter has found.

    Attributes
    ----------
    change : float or None
        Of the parameter, where the section repeated; None within the budget.
    events : int
        Applications of the map up to there, or in all.
    steps : int
        Steps of the parameter.
    points : (p, d) float64 or None
        The repeating section.
    kept : int or None
        Applications after the change was removed for which the motion stayed within ``near`` of those points.
    """

    change: float | None
    events: int
    steps: int
    points: Array | None
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

    Parameters
    ----------
    f, start
        The map, and the state to start from, (d,).
    period : int
        Of the orbit wanted, 1 or more.
    budget : float
        Largest change of the parameter, relative to its strength.
    steps : int
        Steps from 0 to the budget; as many motions are followed.
    near : float
        Of the scales; see ``kept``.
    progress : callable
        Called with the stage and what is done of it.
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
        if period_of(difference(f, states[TRANSIENT:], state), REPEATS) == period:
            points = states[-period:]
            return SearchAndLock(change, events, step, points, _kept(f, points, state, near))
    return SearchAndLock(None, events, steps, None, None)


def _kept(f: Controlled, points: Array, state: Array, near: float) -> int:
    """Return for how many applications the motion stays close to the points that it has visited in turn."""
    for count in range(TRANSIENT):
        state = f.after(state)
        if not np.linalg.norm(difference(f, state, points[count % len(points)])) < near:
            return count
    return TRANSIENT
