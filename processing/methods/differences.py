"""Finite differences: the thesis's first method, kept as the baseline that shows why one smooths.

The velocity is the gradient between a sample and the next, v_i = (x_{i+1} - x_i)/(t_{i+1} - t_i); the last sample of
a piece repeats the one before it.  One count over one interval is already pitch/interval: 7.7 mm/s at 1 kHz.
"""

import numpy as np

from processing.record.estimates import RecordEstimates
from processing.record.motion import Motion
from processing.record.noise import position_noise
from processing.record.series import Series
from processing.record.setting import Setting, refuse_window

WINDOW = 2  # samples


def estimate(series: Series, setting: Setting, estimates: RecordEstimates) -> Motion:
    """Differentiate by differences of neighbouring samples.

    Parameters
    ----------
    series : Series
        The record.
    setting : Setting
        Must be empty: two points and a straight line are the method.
    estimates : RecordEstimates
        Of the record that this is a block of, or empty.

    Returns
    -------
    Motion
        Position as recorded, velocity by the forward difference, acceleration by the second difference on the three
        samples around.  Errors are those of independent reading errors; they do not cover the truncation error
        a dt/2 of a one-sided difference.

    Raises
    ------
    InputError
        When a window or an order was asked for.
    """
    refuse_window(setting, "fd", "finite differences have no window")
    n = series.time.size
    velocity, acceleration = np.zeros(n), np.zeros(n)
    velocity_errors, acceleration_errors = np.full(n, np.inf), np.full(n, np.inf)
    sigma = estimates.once("floor", lambda: position_noise(series))
    for piece in series.pieces:
        t, x = series.time[piece], series.position[piece]
        if t.size < 2:
            continue
        step = np.diff(t)
        v = np.diff(x) / step
        velocity[piece] = np.append(v, v[-1])
        velocity_errors[piece] = np.sqrt(2.0) * sigma / np.append(step, step[-1])
        if t.size < 3:
            continue
        h, k = step[:-1], step[1:]
        a = 2 * np.diff(v) / (h + k)
        acceleration[piece] = np.concatenate((a[:1], a, a[-1:]))
        weight = 2 / (h + k) * np.sqrt(1 / h**2 + (1 / h + 1 / k) ** 2 + 1 / k**2)
        acceleration_errors[piece] = sigma * np.concatenate((weight[:1], weight, weight[-1:]))
    return Motion(
        position=series.origin + series.position,
        velocity=velocity,
        acceleration=acceleration,
        position_errors=np.full(n, sigma),
        velocity_errors=velocity_errors,
        acceleration_errors=acceleration_errors,
        window=WINDOW,
        order=1,
        method="fd",
    )
