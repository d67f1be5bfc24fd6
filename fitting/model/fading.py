"""Kernels: how much of a cycle's friction level is left, where the contact wears within its slips.

The level of a run falls along a line of time, as `fitting.model.wear` reads it from the cycles' levels.  Each
cycle lies on a line of its own with the same zero: what it loses per second, as a fraction of its own level, grows
over the run.  A constant fraction left 2 um of a 16 s run that lost a tenth of its level.
"""

from stickslip.compute.arrays import Array


def remaining(fade: float, t: float, epoch: float) -> float:
    """Return the level at time t (s) over that at ``epoch``; ``fade`` is the loss per second over the level at 0 s."""
    return float((1.0 - fade * t) / (1.0 - fade * epoch))


def relative_change(fade: Array | float, t: Array, epoch: Array) -> Array:
    """Return the derivative of the logarithm of `remaining` by the fade, s; arrays (M,)."""
    return (epoch - t) / ((1.0 - fade * t) * (1.0 - fade * epoch))
