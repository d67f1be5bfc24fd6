"""Find an unstable orbit in a chaotic motion and lock the motion onto it: the whole of the search and the control."""

from dataclasses import dataclass

import numpy as np

from rig_sim.analyses.control.ogy import REPORTED, Lock, lock
from rig_sim.analyses.settling import find_period
from rig_sim.analyses.unstable_orbits import UnstableOrbit, find_orbits_in_motion
from rig_sim.systems.interface import Controlled, StepLimitError, difference, orbit
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, parts, silent

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
