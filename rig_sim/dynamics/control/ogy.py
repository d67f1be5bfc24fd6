"""Lock a chaotic motion onto an unstable orbit by the method of Ott, Grebogi and Yorke.

The motion is left alone until it comes by the orbit.  With e_i the left eigenvector of the unstable multiplier at the
point z_i, A_i the slope of the map there and g_i its response to the parameter, the deviation y = e_i . (z - z_i) off
the stable manifold becomes

    y' = lambda_i y + b_i u,    lambda_i e_i = e_(i+1) A_i,    b_i = e_(i+1) . g_i

and the change u = -lambda_i y/b_i sends the next state onto the stable manifold.  A larger u than the budget U is cut
off, and used while later changes can still bring y to 0, that is while |y| < r_i = (|b_i| U + r_(i+1))/|lambda_i|;
waiting for u within the budget takes 1.5 to 2 times as long.  u falls by itself: on the orbit no control is needed.
"""

from dataclasses import dataclass

import numpy as np

from rig_sim.dynamics.analyses.unstable_orbits import UnstableOrbit
from rig_sim.dynamics.system.interface import Controlled, difference
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent

# Of r_i, within which control begins: rounding and the map's curvature take the rest.  0.8 takes 1.5 times as long.
CERTAIN = 0.95
# Of the scales: farther from every point of the orbit the map counts as no line.  Within a budget of 2.35 % of the
# thesis's drive r_i is below 0.01; values of 0.02 to 0.5 lock after the same times.
REACH = 0.1
# Controls in a row that make a lock, at least, and turns of the orbit: a motion that only passes by needs a change
# beyond the budget after 1 to 3.
HELD, TURNS_HELD = 40, 4
REPORTED = 100  # applications between two reports of progress, some 5 ms
TURNS_AHEAD = 50  # of the orbit; a multiplier of 1.5 leaves 1e-9 of the rest


@dataclass(frozen=True)
class Lock:
    """An attempt to lock a motion onto an orbit.

    Attributes
    ----------
    outcome : str
        'locked'; 'not locked' within the applications allowed; 'motion ended' where the map ends; 'stable orbit': it
        needs no control; 'several unstable directions' or 'no response', where one parameter cannot hold the orbit.
    events_to_lock : int or None
        Applications of the map before the control that held.
    states : (n + 1, d) float64
        The motion, start included.
    changes : (n,) float64
        Of the parameter, from every state to the next.
    """

    outcome: str
    events_to_lock: int | None
    states: Array
    changes: Array

    @property
    def locked(self) -> bool:
        """Whether the motion stays on the orbit."""
        return self.outcome in ("locked", "stable orbit")


def lock(
    f: Controlled, orbit: UnstableOrbit, start: Array, budget: float, events: int, progress: Stages = silent
) -> Lock:
    """Lock the motion from a state onto an orbit.

    Parameters
    ----------
    f, orbit
        The map and one of its orbits.
    start : (d,) float64
        Where the motion begins.
    budget : float
        Largest change of the parameter, relative to its strength; 0 or more.
    events : int
        Applications of the map after which the attempt ends.
    progress : callable
        Called with the stage and what is done of it.
    """
    directions = orbit.unstable_directions
    if directions > 1:
        return _ended("several unstable directions", start)
    if directions == 0:
        return _settle(f, orbit, start, events)
    mode = unstable_mode(orbit)
    if not np.any(mode.response):
        return _ended("no response", start)
    reach = CERTAIN * mode.controllable(budget)
    held = max(HELD, TURNS_HELD * orbit.period)
    state = start
    states = [start]
    changes: list[float] = []
    controlled = 0
    while len(changes) < events and controlled < held:
        away = difference(f, state, orbit.points)
        distances = np.linalg.norm(away, axis=1)
        i = int(np.argmin(distances))
        y = float(mode.left[i] @ away[i])
        change = 0.0
        controlled = controlled + 1 if distances[i] < REACH and abs(y) <= reach[i] else 0
        if controlled and mode.response[i] != 0.0:
            change = min(max(-float(mode.factor[i] / mode.response[i]) * y, -budget), budget)
        state = f.after(state, change * f.strength)
        if not np.all(np.isfinite(state)):
            return Lock("motion ended", None, np.array(states), np.array(changes))
        states.append(state)
        changes.append(change * f.strength)
        if len(changes) % REPORTED == 0:
            progress("controlling", len(changes), events)
    if controlled < held:
        return Lock("not locked", None, np.array(states), np.array(changes))
    return Lock("locked", len(changes) - held, np.array(states), np.array(changes))


@dataclass(frozen=True)
class UnstableMode:
    """The unstable direction of an orbit: left eigenvectors (p, d), factors lambda and responses b, (p,) each."""

    left: Array
    factor: Array
    response: Array

    def controllable(self, budget: float) -> Array:
        """Return r, (p,): the largest deviations that changes within the budget can bring to 0."""
        period = len(self.factor)
        sizes, pushes = np.abs(self.factor), np.abs(self.response) * budget
        reach = np.zeros(period)
        for _ in range(TURNS_AHEAD):
            for i in range(period - 1, -1, -1):
                reach[i] = (pushes[i] + reach[(i + 1) % period]) / sizes[i]
        return reach


def unstable_mode(orbit: UnstableOrbit) -> UnstableMode:
    """Return the unstable direction of an orbit that has one."""
    period, d = orbit.responses.shape
    turn = np.eye(d)
    for slope in orbit.slopes:
        turn = slope @ turn
    values, vectors = np.linalg.eig(turn.T)
    e = np.real(vectors[:, int(np.argmax(np.abs(values)))])
    left = np.zeros((period, d))
    factor = np.zeros(period)
    for i in range(period - 1, -1, -1):
        behind = left[(i + 1) % period] = e / np.linalg.norm(e)
        e = behind @ orbit.slopes[i]
        factor[i] = np.linalg.norm(e)
    factor[0] = e @ left[0]  # with the sign with which e comes round
    response = np.einsum("ij,ij->i", np.roll(left, -1, axis=0), orbit.responses)
    return UnstableMode(left, factor, response)


def _settle(f: Controlled, orbit: UnstableOrbit, start: Array, events: int) -> Lock:
    """Return how the uncontrolled motion comes to a stable orbit."""
    states = [start]
    near = 0
    while len(states) <= events and near < HELD:
        distance = np.min(np.linalg.norm(difference(f, states[-1], orbit.points), axis=1))
        near = near + 1 if distance < REACH else 0
        state = f.after(states[-1])
        if not np.all(np.isfinite(state)):
            return Lock("motion ended", None, np.array(states), np.zeros(len(states) - 1))
        states.append(state)
    outcome, count = ("stable orbit", len(states) - 1 - near) if near == HELD else ("not locked", None)
    return Lock(outcome, count, np.array(states), np.zeros(len(states) - 1))


def _ended(outcome: str, start: Array) -> Lock:
    return Lock(outcome, None, start[None, :], np.zeros(0))
