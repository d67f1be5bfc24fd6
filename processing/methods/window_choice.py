"""The smoothing window: read from what a person typed, or chosen from the record without knowing the truth.

How it is chosen.  Cross-validation fails at coarse counts, whose error is a slow sawtooth instead of white noise.
A motion of white jerk does not: its smoother is fitted to the record by likelihood
(`processing.polynomial.white_jerk_bands`), and of the Savitzky-Golay filters (window, order) that one is taken whose
velocity comes closest to the smoother's; where the record shows sticks beyond doubt, to that of
`processing.segmentation.smoother`.  It lies within a few per cent of the best window known with truth, from 1 to 200 um
a count, with and without jitter (tests/processing/methods/test_window_choice.py).

Uneven times are brought to the even grid for this choice alone (`processing.polynomial.even_grid`); the smoothing
itself uses the times as recorded.
"""

import math
import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from daq.compute.arrays import Array
from daq.errors import InputError
from processing.methods.registry import Setting
from processing.polynomial.even_grid import even_grid
from processing.polynomial.gram import coefficients
from processing.record.series import Series

ORDERS = (2, 4, 6)  # an odd order has the velocity of the even one above it
EQUIVALENT = {2: 5.0, 4: 9.0, 6: 13.5}  # window times rho**(1/6) of the filter that resembles the smoother
LOG_RHO = (-20.0, 5.0)  # below it the record is oversampled: average neighbours first; above it, no noise to smooth
HIGHEST = 20  # order
LONGEST = 3001  # samples: longer ones say nothing that this does not
MOST = 2**17  # samples the choice looks at; of a longer record, stretches spread over it
AVERAGED = 4  # neighbours averaged into one when the record is oversampled


@dataclass(frozen=True)
class Choice:
    """A window, its order, and the reading error found on the way (m; 0 when nothing was to be found)."""

    window: int
    order: int
    reading_error: float


def setting(window: int | str, order: int | None, series: Series) -> Setting:
    """Read a window as a person gives it.

    Parameters
    ----------
    window : int or str
        Odd number of samples; "auto"; or a duration with its unit ("20ms", "0.02 s", "500us"), rounded to the odd
        number of samples that spans it.
    order : int or None
        Degree of the polynomial.
    series : Series
        For the sample interval.

    Raises
    ------
    InputError
        For text that is none of these, an even window, one that does not exceed the order or that is longer than
        the record's longest stretch, or an order outside 1 to 20.
    """
    if order is not None and not 1 <= order <= HIGHEST:
        raise InputError(f"order is {order}", "--order", f"give 1 to {HIGHEST}")
    if isinstance(window, str):
        text = window.strip()
        if text == "auto":
            return Setting(None, order)
        match = re.fullmatch(r"([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(us|ms|s)?", text)
        if match is None:
            raise InputError(f"window is {window!r}", "--window", "give auto, an odd number of samples, or 20ms")
        if match[2] is not None:
            seconds = float(match[1]) * {"us": 1e-6, "ms": 1e-3, "s": 1.0}[match[2]]
            longest = _longest(series)
            if seconds > longest * series.interval:
                raise InputError(
                    f"window is {text}; the longest stretch of the record lasts {longest * series.interval:.4g} s",
                    "--window",
                    "give a shorter one",
                )
            samples = 2 * round(seconds / (2 * series.interval)) + 1
            if samples < 3:
                raise InputError(
                    f"window is {text}, less than two sample intervals of {series.interval * 1e3:.3g} ms",
                    "--window",
                    "give a longer one",
                )
            return _checked(samples, order, series)
        if not match[1].isdigit():
            raise InputError(f"window is {window!r}", "--window", "give a whole number of samples, or a unit: 20ms")
        window = int(match[1])
    return _checked(window, order, series)


def _checked(window: int, order: int | None, series: Series) -> Setting:
    check(window, 4 if order is None else order)
    longest = _longest(series)
    if window > longest:
        raise InputError(
            f"window is {window} samples; the longest stretch of the record has {longest}",
            "--window",
            "give a shorter one",
        )
    return Setting(window, order)


def _longest(series: Series) -> int:
    return int(max(piece.stop - piece.start for piece in series.pieces))


def check(window: int, order: int) -> None:
    """Raise InputError unless the window is odd and above the order."""
    if window % 2 == 0 or window <= order:
        raise InputError(
            f"window is {window}; need an odd number above order {order}",
            "--window",
            f"take {max(window + 1 - window % 2, order + 1 + order % 2)}",
        )


def choose(series: Series, order: int | None = None) -> Choice:
    """Choose the window (and the order, unless one is given) from the record.

    Parameters
    ----------
    series : Series
        The record.
    order : int, optional
        Look at this order only.

    Returns
    -------
    Choice
        Never longer than the longest piece.  A record without anything to tell (at rest, or a few samples) gets
        window 41 and order 4.
    """
    grids = [even_grid(series.time[own], series.position[own]) for own in looked_at(series, MOST)]
    usable = [grid for grid in grids if np.any(np.diff(grid, 3))]
    limit = min(_longest(series), LONGEST)
    if not usable:
        degree = 4 if order is None else order
        return Choice(_within(max(41, degree + 1 | 1), degree, limit), degree, 0.0)
    orders = (order,) if order is not None else ORDERS
    window, degree, error = _choose_by_segments(series, orders) or _choose(usable, orders)
    return Choice(_within(window, degree, limit), degree, error)


def _within(window: int, order: int, limit: int) -> int:
    """Return the longest odd window not above ``window`` or ``limit``, yet above the order."""
    return max(min(window, limit - 1 + limit % 2), order + 1 + order % 2)


def looked_at(series: Series, most: int, parts: int = 8) -> list[slice]:
    """Return the pieces from the first motion on, without holes; of more than ``most`` samples, ``parts`` stretches."""
    # A mass at rest tells nothing of the noise: its count does not move.
    moving = np.flatnonzero(np.abs(series.position) > 1.5 * series.pitch)
    begin = max(int(moving[0]) - 1, 0) if moving.size else 0
    cuts = {own.start for own in series.pieces if own.start > begin}
    steps = np.diff(series.time[begin:])
    usual = max(series.interval, float(np.percentile(steps, 90))) if steps.size else series.interval
    cut = sorted(cuts | set((np.flatnonzero(steps > 1.5 * usual) + 1 + begin).tolist()))
    edges = [begin, *cut, series.time.size]
    runs = [slice(first, last) for first, last in pairwise(edges) if last - first >= 16]
    if sum(run.stop - run.start for run in runs) <= most:
        return runs
    length = most // parts
    at = np.linspace(begin, series.time.size - length, parts).astype(int)
    windows = [(int(first), int(first) + length) for first in at]
    inside = [slice(max(run.start, low), min(run.stop, high)) for run in runs for low, high in windows]
    return [own for own in inside if own.stop - own.start >= 16]


def _choose_by_segments(series: Series, orders: tuple[int, ...]) -> tuple[int, int, float] | None:
    """Choose by the motion smoothed by segments, which is nearer to the truth; None where there is none."""
    if series.time.size > MOST:
        return None
    from processing.kalman import white_jerk
    from processing.methods import auto

    noise = white_jerk.fit(series)
    motion = auto.estimate(series, Setting())
    if motion.method != "segment":
        return None
    grids, target = [], []
    for own in looked_at(series, MOST):
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
