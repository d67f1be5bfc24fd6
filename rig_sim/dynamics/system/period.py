"""The period with which a sequence of points repeats."""

import numpy as np

from stickslip.compute.arrays import Array

LONGEST_PERIOD = 64
# Points at the end of the sequence that have to repeat, at the least: an intermittent motion stays near an unstable
# orbit of period p for a while, where fewer points repeat by accident.
REPEATS = 16


def period_of(orbit: Array, tolerance: float) -> int | None:
    """Return the least period with which the end of a sequence repeats; None without one up to `LONGEST_PERIOD`.

    Parameters
    ----------
    orbit : (n,) or (n, d) float64
        Points, in order.
    tolerance : float
        Largest difference in a coordinate that still counts as a repetition.
    """
    for period in range(1, min(LONGEST_PERIOD, len(orbit) // 2) + 1):
        span = min(max(period, REPEATS), len(orbit) - period)
        if np.all(np.abs(orbit[-span:] - orbit[-span - period : -period]) <= tolerance):
            return period
    return None
