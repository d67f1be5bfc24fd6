"""Savitzky-Golay filters, with a window that is given or chosen from the record without knowing the truth.

Cross-validation fails at coarse counts, whose error is a slow sawtooth instead of white noise.  The likelihood of a
smoother does not: the record is smoothed by the default (`processing.methods.smoothers`), and the Savitzky-Golay filter
(window, order) whose velocity is closest to the smoother's is chosen.  It is within a few per cent of the best window
for the true motion, from 1 to 200 um a count, with and without jitter (tests/processing/methods/test_window_choice.py).
Uneven times are moved to the even grid for this choice only; the smoothing uses the recorded times.
"""

import math
from dataclasses import dataclass

import numpy as np

from processing.kalman import white_jerk
from processing.methods import registry
from processing.methods.registry import MethodModel
from processing.polynomial import savgol
from processing.polynomial.even import coefficients, convolve, even_grid
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import DEFAULT_ORDER, Setting, check_window, longest_piece
from processing.record.stretches import representative_stretches
from stickslip.compute.arrays import Array

ORDERS = (2, 4, 6)  # an odd order has the velocity of the even one above it
EQUIVALENT = {2: 5.0, 4: 9.0, 6: 13.5}  # window times rho**(1/6) of the filter nearest to a white-jerk smoother
LONGEST = 3001  # samples: the longest window that `processing.polynomial.even` is tested for
MOST = 2**17  # samples that the filters are compared on; of a longer record, stretches spread over it
FACTORS = np.geomspace(0.6, 1.6, 14)  # windows tried, relative to the equivalent one, in steps of 8 %


@dataclass(frozen=True)
class WindowChoice:
    window: int
    order: int
    reading_error: float  # estimated for the choice, m; 0 for a record without information on it


def choose(series: Series, order: int | None = None) -> WindowChoice:
    """Choose the window (and the order, unless one is given) from the record, at most as long as its longest piece.

    A record without information on the noise (at rest, or of few samples) gets window 41 and order 4.
    """
    limit = min(longest_piece(series), LONGEST)
    stretches = representative_stretches(series, MOST)
    grids = [even_grid(series.time[stretch], series.position[stretch]) for stretch in stretches]
    if not any(np.any(np.diff(grid, 3)) for grid in grids):
        degree = 4 if order is None else order
        return WindowChoice(_limit_window(max(41, degree + 1 | 1), degree, limit), degree, 0.0)
    noise = white_jerk.fit(series)
    motion = registry.estimate("auto", series, Setting())
    velocities = [
        _move_velocity_to_grid(series.time[stretch], motion.velocity[stretch], motion.acceleration[stretch])
        for stretch in stretches
    ]
    orders = (order,) if order is not None else ORDERS
    window, degree = _find_closest(grids, velocities, math.log(noise.rho(series.interval)), orders)
    return WindowChoice(_limit_window(window, degree, limit), degree, math.sqrt(noise.reading))


def _move_velocity_to_grid(time: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the velocity, m per sample interval, moved to the even grid of `even_grid`."""
    step = (time[-1] - time[0]) / (time.size - 1)
    offset = time - (time[0] + step * np.arange(time.size))
    return np.asarray((velocity - offset * acceleration) * step)


def _limit_window(window: int, order: int, limit: int) -> int:
    """Return the longest odd window not above ``window`` or ``limit``, yet above the order."""
    return max(min(window, limit - 1 + limit % 2), order + 1 + order % 2)


def _find_closest(grids: list[Array], goals: list[Array], log_rho: float, orders: tuple[int, ...]) -> tuple[int, int]:
    """Return window and order of the filter whose velocity is closest to ``goals``, the smoother's, of each stretch."""
    best = (math.inf, 41, 4)
    for degree in orders:
        even = degree + degree % 2
        middle = EQUIVALENT.get(even, 2.25 * even) / math.exp(log_rho / 6)
        for window in sorted({min(max(int(middle * factor) | 1, even + 3), LONGEST) for factor in FACTORS}):
            best = min(best, (_mean_square_difference(grids, goals, window, degree), window, degree))
    return best[1], best[2]


def _mean_square_difference(grids: list[Array], goals: list[Array], window: int, order: int) -> float:
    """Return the mean square difference of the filter's velocity from the smoother's, where the window is centred."""
    weights = coefficients(window, order)[:2]
    half = window // 2
    differences = [
        convolve(grid, weights)[1] - goal[half : goal.size - half]
        for grid, goal in zip(grids, goals, strict=True)
        if grid.size >= window
    ]
    return float(np.mean(np.concatenate(differences) ** 2)) if differences else math.inf


def learn(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Return the model with window and order, chosen from the record if they are None in the setting.

    InputError for an even window, or one that does not exceed the order.
    """
    if setting.window is None:
        chosen = choose(series, setting.order)
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
