"""Lock a chaotic motion onto an unstable orbit by the method of Ott, Grebogi and Yorke.

The motion is left alone until it comes by the orbit.  With e_i the left eigenvector of the unstable multiplier at the
point z_i, A_i the slope of the map there and g_i its response to the parameter, the deviation y = e_i . (z - z_i) off
the stable manifold becomes

    y' = lambda_i y + b_i u,    lambda_i e_i = e_(i+1) A_i,    b_i = e_(i+1) . g_i

and the change u = -lambda_i y/b_i sends the next state onto the stable manifold.  A larger u than the budget U is cut
off, and used while later changes can still bring y to 0, that is while |y| < r_i = (|b_i| U + r_(i+1))/|lambda_i|;
waiting for u within the budget takes 1.5 to 2 times as long.  u falls by itself: on the orbit no control is needed.

Find an unstable orbit in a chaotic motion and lock the motion onto it: the whole of the search and the control.
"""

from dataclasses import dataclass

import numpy as np

from rig_sim.analyses.settling import find_period
from rig_sim.analyses.unstable_orbits import UnstableOrbit, find_orbits_in_motion
from rig_sim.systems.interface import Controlled, StepLimitError, difference, orbit
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, parts, silent

# Share of r_i within which control starts: the rest is for rounding and the map's curvature.
CERTAIN = 0.95
# Of the scales: farther from every point of the orbit the map does not count as linear.  Within a budget of 2.35 % of
# the thesis's drive r_i is below 0.01.
REACH = 0.1
# Least number of controls in a row, and of turns of the orbit, that make a lock: a motion that only passes by needs a
# change beyond the budget after 1 to 3.
HELD, TURNS_HELD = 40, 4
REPORTED = 100  # applications between two reports of progress, about 5 ms
TURNS_AHEAD = 50  # of the orbit; with a multiplier of 1.5 the rest is 1e-9


@dataclass(frozen=True)
class Lock:
    """An attempt to lock a motion onto an orbit."""

    # 'locked'; 'not locked' within the applications allowed; 'motion ended' where the map ends; 'stable orbit': it
    # needs no control; 'several unstable directions' or 'no response', where one parameter cannot hold the orbit
    outcome: str
    events_to_lock: int | None  # applications of the map before the control that lasted
    states: Array  # (n + 1, d) the motion, start included
    changes: Array  # (n,) of the parameter, from every state to the next

    @property
    def locked(self) -> bool:
        """Whether the motion stays on the orbit."""
        return self.outcome in ("locked", "stable orbit")


def lock(
    f: Controlled, orbit: UnstableOrbit, start: Array, budget: float, events: int, progress: Stages = silent
) -> Lock:
    """Lock the motion from ``start``, (d,), onto an orbit, within ``events`` applications of the map.

    ``budget`` is the largest change of the parameter relative to its strength.
    """
    directions = orbit.unstable_directions
    if directions > 1:
        return end_at_start("several unstable directions", start)
    if directions == 0:
        return wait_for_stable_orbit(f, orbit, start, events)
    mode = find_unstable_mode(orbit)
    if not np.any(mode.response):
        return end_at_start("no response", start)
    reach = CERTAIN * mode.controllable_deviation(budget)
    needed = max(HELD, TURNS_HELD * orbit.period)
    state = start
    states = [start]
    changes: list[float] = []
    controlled = 0
    while len(changes) < events and controlled < needed:
        deviations = difference(f, state, orbit.points)
        distances = np.linalg.norm(deviations, axis=1)
        i = int(np.argmin(distances))
        y = float(mode.left[i] @ deviations[i])
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
    if controlled < needed:
        return Lock("not locked", None, np.array(states), np.array(changes))
    return Lock("locked", len(changes) - needed, np.array(states), np.array(changes))


@dataclass(frozen=True)
class UnstableMode:
    left: Array  # (p, d) left eigenvectors
    factor: Array  # (p,) lambda
    response: Array  # (p,) b

    def controllable_deviation(self, budget: float) -> Array:
        """Return r, (p,): the largest deviations that changes within the budget can bring to 0."""
        period = len(self.factor)
        sizes, pushes = np.abs(self.factor), np.abs(self.response) * budget
        reach = np.zeros(period)
        for _ in range(TURNS_AHEAD):
            for i in range(period - 1, -1, -1):
                reach[i] = (pushes[i] + reach[(i + 1) % period]) / sizes[i]
        return reach


def find_unstable_mode(orbit: UnstableOrbit) -> UnstableMode:
    """Return the unstable direction of an orbit that has exactly one."""
    period, d = orbit.responses.shape
    turn = np.eye(d)
    for slope in orbit.slopes:
        turn = slope @ turn
    values, vectors = np.linalg.eig(turn.T)
    e = np.real(vectors[:, int(np.argmax(np.abs(values)))])
    left_vectors = np.zeros((period, d))
    factor = np.zeros(period)
    for i in range(period - 1, -1, -1):
        following = left_vectors[(i + 1) % period] = e / np.linalg.norm(e)
        e = following @ orbit.slopes[i]
        factor[i] = np.linalg.norm(e)
    factor[0] = e @ left_vectors[0]  # with the sign with which e comes round
    response = np.einsum("ij,ij->i", np.roll(left_vectors, -1, axis=0), orbit.responses)
    return UnstableMode(left_vectors, factor, response)


def wait_for_stable_orbit(f: Controlled, orbit: UnstableOrbit, start: Array, events: int) -> Lock:
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


def end_at_start(outcome: str, start: Array) -> Lock:
    return Lock(outcome, None, start[None, :], np.zeros(0))


# Applications of the map in which orbits are searched, after `TRANSIENT`; 1000 show the least unstable orbits of the
# periods 1 to 5 of the thesis's two motions.
SEARCHED, TRANSIENT = 4000, 100
REGULAR = 1e-8  # share of the scales within which a regular motion repeats
ADVICE = {
    "not locked": "the motion did not come close enough to the orbit; allow more events or a larger budget",
    "no budget": "an unstable orbit requires control; use a budget above 0",
    "no orbit": "the motion does not return close to an orbit of this period; choose another period",
    "regular motion": "the motion settles on a stable orbit of another period; use that period or other parameters",
    "motion ended": "the map has no next state under control; use a smaller budget",
    "several unstable directions": "a single parameter can control only one unstable direction; use another period",
    "no response": "the parameter does not affect this orbit; use another period",
    "step limit": "the search has used all its integrator steps; use a shorter period or other parameters",
}


@dataclass(frozen=True)
class Locking:
    """An orbit of a motion, and the attempt to lock the motion onto it."""

    # as of `Lock`; or 'no orbit', 'no budget', 'regular motion', 'step limit' (the map raised `StepLimitError`)
    outcome: str
    # of the period, the least unstable first: the motion is locked onto that one
    orbits: tuple[UnstableOrbit, ...]
    regular: int | None  # period of the stable orbit that the motion itself settles on
    lock: Lock | None  # the motion under control

    @property
    def advice(self) -> str:
        return ADVICE.get(self.outcome, "")


def find_and_lock(
    f: Controlled, start: Array, period: int, budget: float, events: int, progress: Stages = silent
) -> Locking:
    """Search a motion from ``start``, (d,), for orbits of a period and lock it onto the least unstable one.

    ``budget`` is the largest change of the parameter relative to its strength; after ``events`` applications of the map
    the control gives up.
    """
    orbits: tuple[UnstableOrbit, ...] = ()
    regular = None
    try:
        states = follow_states(f, start, progress)
        if len(states) <= period:
            return Locking("no orbit", (), None, None)
        regular = find_period(difference(f, states, states[-1]), REGULAR)
        orbits = tuple(find_orbits_in_motion(f, states, period, progress))
        if not orbits:
            return Locking("no orbit" if regular is None else "regular motion", (), regular, None)
        if budget == 0.0 and orbits[0].unstable_directions > 0:
            return Locking("no budget", orbits, regular, None)
        attempt = lock(f, orbits[0], start, budget, events, progress)
    except StepLimitError:
        return Locking("step limit", orbits, regular, None)
    outcome = "regular motion" if attempt.outcome == "not locked" and regular is not None else attempt.outcome
    return Locking(outcome, orbits, regular, attempt)


def follow_states(f: Controlled, start: Array, progress: Stages) -> Array:
    """Return the `SEARCHED` states after the transient, (n, d); fewer where the map ends."""
    pieces = [start[None, :]]
    for begin, end in parts("following the motion", TRANSIENT + SEARCHED, progress, REPORTED):
        pieces.append(orbit(f, pieces[-1][-1], end - begin))
        if len(pieces[-1]) < end - begin:
            break
    return np.concatenate(pieces[1:])[TRANSIENT:]
