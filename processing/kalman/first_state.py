"""The state of a filter before its first sample: the speed of the first nine readings, everything else unknown."""

import math

import numpy as np

from processing.kalman.motion_kernel import state_size
from stickslip.compute.arrays import Array

FIRST = 8  # samples after the first one


def first_state(time: Array, position: Array, variance: float, derivatives: int) -> Array:
    """Return the state before the first sample, the upper triangle of its covariance by rows, and its time, s.

    ``derivatives`` is 2 for x, v, a (`white_jerk`), 3 for x, v, a, j (`stick_slip`) and 1 for x, v and zeros there.  At
    least two readings are not NaN.
    """
    t, x = time[: FIRST + 1].tolist(), position[: FIRST + 1].tolist()  # so few are faster as plain numbers
    if math.isnan(sum(x)):
        readings = np.flatnonzero(~np.isnan(position))[: FIRST + 1]
        t, x = time[readings].tolist(), position[readings].tolist()
    k = len(x) - 1
    h = (t[k] - t[0]) / k
    slope = (x[k] - x[0]) / (t[k] - t[0])
    speeds = [(x[i + 1] - x[i]) / (t[i + 1] - t[i]) for i in range(k)]
    spread = 2 * max(math.sqrt(variance) / h, max(speeds) - slope, slope - min(speeds))
    size = 3 if derivatives == 2 else 4
    state = np.zeros(state_size(size))
    state[0], state[1], state[-1] = x[0] + slope * (time[0] - t[0]), slope, time[0]
    diagonal = size
    for d in range(derivatives + 1):
        state[diagonal] = (spread * h ** (1 - d)) ** 2
        diagonal += size - d
    return state
