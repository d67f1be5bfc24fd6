"""Finite differences: the thesis's first method, kept as the baseline that shows why smoothing is needed.

The velocity is the gradient between a sample and the next, v_i = (x_{i+1} - x_i)/(t_{i+1} - t_i); the last sample of
a piece repeats the one before it.  One count over one interval is already pitch/interval: 7.7 mm/s at 1 kHz.
"""

import numpy as np

from processing.kalman import white_jerk
from processing.methods.registry import MethodModel
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting, reject_window

WINDOW = 2  # samples


def learn(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Return the model; InputError for a window or an order, since the method is a line through two points."""
    reject_window(setting, method, "finite differences have no window")
    jerk = white_jerk.fit(series)
    return MethodModel(method=method, noise=noise, jerk=jerk, window=WINDOW, order=1, stated=setting.belt_speed)


def apply(series: Series, model: MethodModel) -> Motion:
    """Differentiate by differences: the forward one for velocity, the second one of three samples for acceleration.

    The errors assume independent reading errors and exclude the truncation error a dt/2 of a one-sided difference.
    """
    n = series.time.size
    velocity, acceleration = np.zeros(n), np.zeros(n)
    velocity_errors, acceleration_errors = np.full(n, np.inf), np.full(n, np.inf)
    sigma = model.noise
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
        window=model.window,
        order=model.order,
        method=model.method,
    )
