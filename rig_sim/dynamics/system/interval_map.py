"""What a map of an interval is to the analyses of this folder; they name no system."""

from typing import Protocol

import numpy as np

from daq.base.compute.arrays import Array

# Step of the difference quotient, relative to the interval.  Slopes of the thesis's map come out to 1e-8 and better:
# its rounding, 1e-15 of f over the step, and its fourth-order remainder are both below that; not swept.
STEP = 2e-5


class IntervalMap(Protocol):
    """A map of the interval [lo, hi] to itself: f of an array (n,), NaN where the map is not defined."""

    lo: float
    hi: float

    def __call__(self, x: Array, times: int = 1) -> Array:
        """Return the ``times``-th iterate of each x."""
        ...

    def orbit(self, start: float, number: int) -> Array:
        """Return f(start), f(f(start)) ..., shape (number,)."""
        ...


def slope(f: IntervalMap, x: Array) -> Array:
    """Return f'(x), shape (n,): a difference quotient of fourth order; NaN where f is not defined about x."""
    h = STEP * (f.hi - f.lo)
    x = np.asarray(x, dtype=np.float64)
    values = f((x[:, None] + h * np.array([-2.0, -1.0, 1.0, 2.0])).ravel()).reshape(-1, 4)
    return (values @ np.array([1.0, -8.0, 8.0, -1.0])) / (12.0 * h)  # type: ignore[no-any-return]


def survey(f: IntervalMap, x: Array, times: int = 1) -> Array:
    """Return the ``times``-th iterate of each x to see its sign and place: by a faster way where the map has one.

    That is a method ``survey``.
    """
    values: Array = getattr(f, "survey", f)(x, times)
    return values
