"""The unknowns: those that cycles share, which of them several runs share, where each stands; and a cycle's own.

One run has twelve, in the order below.  Several runs of one contact have twelve each, end to end; the law's own and the
damping are one number for all, standing first and copied to every run, the others are each run's own.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from rig_sim.friction.law import LAWS

K, LOG_F, V_DR, SHAPE, D, DATUM, DAMPING, FADE, GIVE, COSINE, SINE, OMEGA = range(12)
PER_RUN = 12
RIPPLE = (COSINE, SINE, OMEGA)
X_SLIP, V_SLIP, LEVEL, NEXT_LEVEL, X_STICK, V_STICK = range(6)  # a cycle's own
PER_CYCLE = 6
SHARED = (K, LOG_F, SHAPE, D, DAMPING)  # by all runs
NUISANCE = (DATUM, DAMPING, FADE, GIVE, *RIPPLE)  # what every law has besides its own


def active_places(law: int, gives: Sequence[bool], ripples: Sequence[bool]) -> tuple[int, ...]:
    """Return the places of the unknowns that a law has.

    ``gives`` and ``ripples`` tell of each run's belt whether it gives way and whether its speed swings.
    """
    kind = LAWS[law]
    shape = () if kind.curve == "constant" else (SHAPE,)
    ramp = () if kind.contact == "jump" else (D,)
    found = [K, LOG_F, *shape, *ramp, DAMPING]
    for run, (give, ripple) in enumerate(zip(gives, ripples, strict=True)):
        own = (V_DR, DATUM, FADE, *((GIVE,) if give else ()), *(RIPPLE if ripple else ()))
        found += [PER_RUN * run + slot for slot in own]
    return tuple(sorted(found))


def columns(places: Sequence[int], runs: int) -> NDArray[np.int64]:
    """Return which of a run's twelve each place is, shape (runs, places); -1 where the run does not know it."""
    table = np.full((runs, len(places)), -1, np.int64)
    for j, place in enumerate(places):
        run, slot = divmod(place, PER_RUN)
        table[slice(None) if slot in SHARED else run, j] = slot
    return table


def copy_shared(u: Array) -> Array:
    """Return the unknowns of all runs with what they share copied from the first."""
    whole = u.reshape(-1, PER_RUN).copy()
    whole[:, SHARED] = whole[0, SHARED]
    return whole.ravel()
