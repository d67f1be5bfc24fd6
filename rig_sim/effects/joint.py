"""Joint: where the belt's ends meet, a bump that kicks the mass once per turn of the belt."""

import math


def passing_time(turn: int, start: float, length: float, speed: float) -> float:
    """Return when (s) the joint passes for the ``turn``-th time, from 1: one turn after the belt's ``start`` (s).

    ``length`` of one turn in m, ``speed`` in m/s, without its ripple; infinite on a belt at rest.
    """
    return start + turn * length / abs(speed) if speed != 0.0 else math.inf
