"""The Savitzky-Golay window, chosen from the record without knowing the truth.

Cross-validation fails at coarse counts, whose error is a slow sawtooth instead of white noise.
A motion of white jerk does not: its smoother is fitted to the record by likelihood
(`processing.polynomial.white_jerk_bands`), and of the Savitzky-Golay filters (window, order) that one is taken whose
velocity comes closest to the smoother's; where the record shows sticks beyond doubt, to that of
`processing.segmentation.smoother`.  It lies within a few per cent of the best window known with truth, from 1 to 200 um
a count, with and without jitter (tests/processing/methods/test_window_choice.py).

Uneven times are brought to the even grid for this choice alone (`processing.polynomial.even_grid`); the smoothing
itself uses the times as recorded.
"""

import math
from dataclasses import dataclass

import numpy as np

from daq.compute.arrays import Array
from processing.kalman import white_jerk
from processing.methods import auto
from processing.polynomial.even_grid import even_grid
from processing.polynomial.gram import coefficients
from processing.record.series import Series
from processing.record.setting import Setting, longest_piece
from processing.record.stretches import representative_stretches

ORDERS = (2, 4, 6)  # an odd order has the velocity of the even one above it
EQUIVALENT = {2: 5.0, 4: 9.0, 6: 13.5}  # window times rho**(1/6) of the filter that resembles the smoother
LOG_RHO = (-20.0, 5.0)  # below it the record is oversampled: average neighbours first; above it, no noise to smooth
LONGEST = 3001  # samples: longer ones say nothing that this does not
MOST = 2**17  # samples the choice looks at; of a longer record, stretches spread over it
AVERAGED = 4  # neighbours averaged into one when the record is oversampled


@dataclass(frozen=True)
class WindowChoice:
    """A window, its order, and the reading error found on the way (m; 0 when nothing was to be found)."""

    window: int
    order: int
    reading_error: float


def choose(series: Series, order: int | None = None) -> WindowChoice:
    """Choose the window (and the order, unless one is given) from the record.

    Parameters
    ----------
    series : Series
        The record.
    order : int, optional
        Look at this order only.

    Returns
    -------
    WindowChoice
        Never longer than the longest piece.  A record without anything to tell (at rest, or a few samples) gets
        window 41 and order 4.
    """
    grids = [even_grid(series.time[own], series.position[own]) for own in representative_stretches(series, MOST)]
    usable = [grid for grid in grids if np.any(np.diff(grid, 3))]
    limit = min(longest_piece(series), LONGEST)
    if not usable:
        degree = 4 if order is None else order
        return WindowChoice(_within(max(41, degree + 1 | 1), degree, limit), degree, 0.0)
    orders = (order,) if order is not None else ORDERS
    window, degree, error = _choose_by_segments(series, orders) or _choose(usable, orders)
    return WindowChoice(_within(window, degree, limit), degree, error)


def _within(window: int, order: int, limit: int) -> int:
    """Return the longest odd window not above ``window`` or ``limit``, yet above the order."""
    return max(min(window, limit - 1 + limit % 2), order + 1 + order % 2)


def _choose_by_segments(series: Series, orders: tuple[int, ...]) -> tuple[int, int, float] | None:
    """Choose by the motion smoothed by segments, which is nearer to the truth; None where there is none."""
    if series.time.size > MOST:
        return None
    noise = white_jerk.fit(series)
    motion = auto.estimate(series, Setting())
    if motion.method != "segment":
        return None
    grids, target = [], []
    for own in representative_stretches(series, MOST):
        time = series.time[own]
        step = (time[-1] - time[0]) / (time.size - 1)
        off = time - (time[0] + step * np.arange(time.size))
        grids.append(even_grid(time, series.position[own]))
        target.append((motion.velocity[own] - off * motion.acceleration[own])[4:-4] * step)
    window, degree = _closest(grids, target, math.log(noise.rho(series.interval)), orders)
    return window, degree, math.sqrt(noise.reading)


def _choose(grids: list[Array], orders: tuple[int, ...]) -> tuple[int, int, float]:
    # Loads scipy, which a window that was given does not need.
    from processing.polynomial import white_jerk_bands

    log_rho, error = white_jerk_bands.fit([np.diff(grid, 3) for grid in grids], LOG_RHO)
    averaged = [grid[: grid.size // AVERAGED * AVERAGED].reshape(-1, AVERAGED).mean(axis=1) for grid in grids]
    averaged = [grid for grid in averaged if grid.size >= 16 and np.any(np.diff(grid, 3))]
    if log_rho < LOG_RHO[0] + 1 and averaged:
        window, degree, error = _choose(averaged, orders)
        return AVERAGED * (window - 1) + 1, degree, error * math.sqrt(AVERAGED)
    derivative = coefficients(9, 8)[1]
    target = [np.correlate(white_jerk_bands.smoothed(grid, log_rho), derivative, "valid") for grid in grids]
    return *_closest(grids, target, log_rho, orders), error


def _closest(grids: list[Array], target: list[Array], log_rho: float, orders: tuple[int, ...]) -> tuple[int, int]:
    """Return window and order of the filter whose velocity comes closest to the target, which starts 4 samples in."""
    best = (math.inf, 41, 4)
    for degree in orders:
        even = degree + degree % 2
        middle = EQUIVALENT.get(even, 2.25 * even) / math.exp(log_rho / 6)
        tried = -1
        for factor in np.geomspace(0.6, 1.6, 14):
            window = max(int(middle * factor) | 1, even + 3)
            if window == tried:
                continue
            tried = window
            distance = _distance(grids, target, window, degree)
            best = min(best, (distance, window, degree))
    return best[1], best[2]


def _distance(grids: list[Array], target: list[Array], window: int, order: int) -> float:
    """Mean square difference of the filter's velocity from the smoother's, where both are centred."""
    weights = coefficients(window, order)[1]
    total, count = 0.0, 0
    for grid, goal in zip(grids, target, strict=True):
        if grid.size < window + 8:
            continue
        velocity = np.correlate(grid, weights, "valid")
        lag = window // 2 - 4  # the target starts 4 samples in, the filter half a window
        goal = goal[lag : lag + velocity.size] if lag >= 0 else goal
        velocity = velocity if lag >= 0 else velocity[-lag : -lag + goal.size]
        total += float(np.sum((velocity - goal) ** 2))
        count += goal.size
    return total / count if count else math.inf
