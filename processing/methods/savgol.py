"""Savitzky-Golay filters, with a window that is given or chosen from the record, and standard errors."""

import numpy as np

from processing.kalman import white_jerk
from processing.methods import window_choice
from processing.methods.method_model import MethodModel
from processing.polynomial import savgol
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import DEFAULT_ORDER, Setting, check_window


def learn(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Return the model with window and order, chosen from the record if they are None in the setting.

    InputError for an even window, or one that does not exceed the order.
    """
    if setting.window is None:
        chosen = window_choice.choose(series, setting.order)
        length, order = chosen.window, chosen.order
    else:
        length, order = setting.window, DEFAULT_ORDER if setting.order is None else setting.order
    check_window(length, order)
    jerk = white_jerk.fit(series)
    return MethodModel(method=method, noise=noise, jerk=jerk, window=length, order=order, stated=setting.belt_speed)


def apply(series: Series, model: MethodModel) -> Motion:
    """Fit local polynomials."""
    length, order = model.window, model.order
    values, norms, probe, probe_norms = (np.empty((3, series.time.size)) for _ in range(4))
    for piece in series.pieces:
        samples = series.time[piece], series.position[piece]
        values[:, piece], norms[:, piece] = savgol.fit(*samples, length, order)
        probe[:, piece], probe_norms[:, piece] = savgol.fit(*samples, savgol.probe_window(length, order), order)
    errors = np.empty_like(values)
    floor = series.pitch / np.sqrt(12) if length > order + 3 else model.noise
    for piece in series.pieces:
        errors[:, piece] = savgol.standard_errors(
            series.position[piece],
            (values[:, piece], norms[:, piece]),
            (probe[:, piece], probe_norms[:, piece]),
            length,
            floor,
        )
    return Motion.from_rows(series, values, errors, window=length, order=order, method=model.method)
