"""Find an unstable orbit in a chaotic motion and lock the motion onto it: the whole of the search and the control."""

from dataclasses import dataclass

import numpy as np

from rig_sim.dynamics.analyses.unstable_orbits import UnstableOrbit, periodic_orbits
from rig_sim.dynamics.control.ogy import REPORTED, Lock, lock
from rig_sim.dynamics.system.interface import Controlled, difference, orbit
from rig_sim.dynamics.system.period import period_of
from rig_sim.dynamics.system.step_budget import StepLimitError
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, parts, silent

# Applications of the map that orbits are searched in, after as many as `TRANSIENT`.  The least unstable orbits of
# periods 1 to 5 of the thesis's two motions come out of 1000 already.
SEARCHED, TRANSIENT = 4000, 100
REGULAR = 1e-8  # share of the scales within which a regular motion repeats
ADVICE = {
    "not locked": "the motion did not come close enough to the orbit: allow more events or a larger budget",
    "no budget": "an unstable orbit needs control: give a budget above 0",
    "no orbit": "the motion does not come back close to an orbit of this period: take another one",
    "regular motion": "the motion settles on a stable orbit of another period: take this one or other parameters",
    "motion ended": "under control the map has no next state: take a smaller budget",
    "several unstable directions": "one parameter holds orbits with one unstable direction: take another period",
    "no response": "the parameter does not move the state off this orbit: take another period",
    "step limit": "the search has taken all its integrator steps: take a shorter period or other parameters",
}


@dataclass(frozen=True)
class Locking:
    """An orbit of a motion, and how the motion was locked onto it.

    Attributes
    ----------
    outcome, advice : str
        As of `Lock`; besides 'no orbit', 'no budget', 'regular motion', 'step limit' (the map raised
        `StepLimitError`), and what to do.
    orbits : tuple of UnstableOrbit
        All orbits of the period that were found, the least unstable first: that one is locked onto.
    regular : int or None
        Period of the stable orbit that the motion itself settles on.
    lock : Lock or None
        The motion under control.
    """

    outcome: str
    advice: str
    orbits: tuple[UnstableOrbit, ...]
    regular: int | None
    lock: Lock | None


def find_and_lock(
    f: Controlled, start: Array, period: int, budget: float, events: int, progress: Stages = silent
) -> Locking:
    """Search a motion for orbits of a period and lock it onto the least unstable one.

    Parameters
    ----------
    f, start
        The map, and the state to start from, (d,).
    period : int
        Applications of the map in one turn of the orbit, 1 or more.
    budget : float
        Largest change of the parameter, relative to its strength; 0 or more.
    events : int
        Applications of the map after which the control gives up.
    progress : callable
        Called with the stage and what is done of it.
    """
    orbits: tuple[UnstableOrbit, ...] = ()
    regular = None
    try:
        states = followed(f, start, progress)
        if len(states) <= period:
            return _locking("no orbit", (), None, None)
        regular = period_of(difference(f, states, states[-1]), REGULAR)
        orbits = tuple(periodic_orbits(f, states, period, progress))
        if not orbits:
            return _locking("no orbit" if regular is None else "regular motion", (), regular, None)
        if budget == 0.0 and orbits[0].unstable_directions > 0:
            return _locking("no budget", orbits, regular, None)
        found = lock(f, orbits[0], start, budget, events, progress)
    except StepLimitError:
        return _locking("step limit", orbits, regular, None)
    outcome = "regular motion" if found.outcome == "not locked" and regular is not None else found.outcome
    return _locking(outcome, orbits, regular, found)


def followed(f: Controlled, start: Array, progress: Stages) -> Array:
    """Return the `SEARCHED` states after the transient, (n, d); fewer where the map ends."""
    pieces = [start[None, :]]
    for begin, end in parts("following the motion", TRANSIENT + SEARCHED, progress, REPORTED):
        pieces.append(orbit(f, pieces[-1][-1], end - begin))
        if len(pieces[-1]) < end - begin:
            break
    return np.concatenate(pieces[1:])[TRANSIENT:]


def _locking(outcome: str, orbits: tuple[UnstableOrbit, ...], regular: int | None, control: Lock | None) -> Locking:
    return Locking(outcome, ADVICE.get(outcome, ""), orbits, regular, control)
