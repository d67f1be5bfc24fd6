"""The period with which a sequence of points repeats."""

import numpy as np

from stickslip.compute.arrays import Array

LONGEST_PERIOD = 64
# Least number of points at the end of the sequence that have to repeat: an intermittent motion stays near an unstable
# orbit of period p for a while, where fewer points repeat by accident.
REPEATS = 16


def find_period(orbit: Array, tolerance: float) -> int | None:
    """Return the least period with which the end of an orbit repeats within ``tolerance``; None without one."""
    for period in range(1, min(LONGEST_PERIOD, len(orbit) // 2) + 1):
        span = min(max(period, REPEATS), len(orbit) - period)
        if np.all(np.abs(orbit[-span:] - orbit[-span - period : -period]) <= tolerance):
            return period
    return None
