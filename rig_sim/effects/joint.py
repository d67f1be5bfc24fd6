"""Joint: where the belt's ends meet, a bump that kicks the mass once per turn of the belt."""

import math

from rig_sim.scenes.sections import Belt


def passing(belt: Belt, turn: int) -> float:
    """Return when (s) the joint comes by for the ``turn``-th time, from 1; never (inf) on a belt that stands.

    One turn after the belt's start is the first time; a ripple of the speed is left out.
    """
    if belt.length is None or belt.speed == 0:
        return math.inf
    return belt.start + turn * belt.length / abs(belt.speed)
