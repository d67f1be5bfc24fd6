"""The Savitzky-Golay window, chosen from the record without knowing the truth.

Cross-validation fails at coarse counts, whose error is a slow sawtooth instead of white noise.  The likelihood of a
smoother does not: the record is smoothed by the default (`processing.methods.smoothers`), and of the Savitzky-Golay
filters (window, order) the one is taken whose velocity comes closest to the smoother's.  It lies within
a few per cent of the best window known with truth, from 1 to 200 um a count, with and without jitter
(tests/processing/methods/test_window_choice.py).

Uneven times are brought to the even grid for this choice alone (`processing.polynomial.even_grid`); the smoothing
itself uses the times as recorded.
"""

import math
from dataclasses import dataclass

import numpy as np

from processing.kalman import white_jerk
from processing.methods import registry
from processing.polynomial.even_fit import coefficients, convolved
from processing.polynomial.even_grid import even_grid
from processing.record.series import Series
from processing.record.setting import Setting, longest_piece
from processing.record.stretches import representative_stretches
from stickslip.compute.arrays import Array

ORDERS = (2, 4, 6)  # an odd order has the velocity of the even one above it
EQUIVALENT = {2: 5.0, 4: 9.0, 6: 13.5}  # window times rho**(1/6) of the filter nearest to a white-jerk smoother
LONGEST = 3001  # samples: the longest window that `processing.polynomial.even_fit` is tested for
MOST = 2**17  # samples the filters are compared on; of a longer record, stretches spread over it
FACTORS = np.geomspace(0.6, 1.6, 14)  # windows tried, of the equivalent one: steps of 8 %, the error is flat within one


@dataclass(frozen=True)
class WindowChoice:
    """A window, its order, and the reading error found on the way (m; 0 when nothing was to be found)."""

    window: int
    order: int
    reading_error: float


def choose(series: Series, order: int | None = None) -> WindowChoice:
    """Choose the window (and the order, unless one is given) from the record.

    series: The record.
    order: Look at this order only.
    Returns: Never longer than the longest piece. A record without information on the noise (at rest, or a few samples)
        gets window 41 and order 4.
    """
    limit = min(longest_piece(series), LONGEST)
    stretches = representative_stretches(series, MOST)
    grids = [even_grid(series.time[own], series.position[own]) for own in stretches]
    if not any(np.any(np.diff(grid, 3)) for grid in grids):
        degree = 4 if order is None else order
        return WindowChoice(_within(max(41, degree + 1 | 1), degree, limit), degree, 0.0)
    noise = white_jerk.fit(series)
    motion = registry.estimate("auto", series, Setting())
    goals = [_velocity_on_grid(series.time[own], motion.velocity[own], motion.acceleration[own]) for own in stretches]
    orders = (order,) if order is not None else ORDERS
    window, degree = _closest(grids, goals, math.log(noise.rho(series.interval)), orders)
    return WindowChoice(_within(window, degree, limit), degree, math.sqrt(noise.reading))


def _velocity_on_grid(time: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the velocity, m per sample interval, moved onto the even grid of `even_grid`, (n,)."""
    step = (time[-1] - time[0]) / (time.size - 1)
    off = time - (time[0] + step * np.arange(time.size))
    return np.asarray((velocity - off * acceleration) * step)


def _within(window: int, order: int, limit: int) -> int:
    """Return the longest odd window not above ``window`` or ``limit``, yet above the order."""
    return max(min(window, limit - 1 + limit % 2), order + 1 + order % 2)


def _closest(grids: list[Array], goals: list[Array], log_rho: float, orders: tuple[int, ...]) -> tuple[int, int]:
    """Return window and order of the filter whose velocity comes closest to the smoother's, (n,) each a stretch."""
    best = (math.inf, 41, 4)
    for degree in orders:
        even = degree + degree % 2
        middle = EQUIVALENT.get(even, 2.25 * even) / math.exp(log_rho / 6)
        for window in sorted({min(max(int(middle * factor) | 1, even + 3), LONGEST) for factor in FACTORS}):
            best = min(best, (_distance(grids, goals, window, degree), window, degree))
    return best[1], best[2]


def _distance(grids: list[Array], goals: list[Array], window: int, order: int) -> float:
    """Return the mean square difference of the filter's velocity from the smoother's, where the window is centred."""
    weights = coefficients(window, order)[:2]
    half = window // 2
    apart = [
        convolved(grid, weights)[1] - goal[half : goal.size - half]
        for grid, goal in zip(grids, goals, strict=True)
        if grid.size >= window
    ]
    return float(np.mean(np.concatenate(apart) ** 2)) if apart else math.inf
