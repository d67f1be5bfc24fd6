"""Savitzky-Golay: position, velocity and acceleration as one local polynomial at every sample.

On an even grid the fit is a convolution with the weights of `processing.polynomial.gram`, of counts one in whole
numbers (`processing.polynomial.moments`); where recorded times are uneven it is made on those times by
`processing.polynomial.uneven`.  Sample times matter more than encoder pitch: at 0.8 m/s, 30 us of jitter taken for an
even grid is 24 um.  Ends of a piece are one-sided fits with their larger errors; a piece shorter than the window is one
polynomial over all of it.

Standard errors have two parts.  The reading error around each sample (from the residuals, at least pitch/sqrt(12))
goes through the norm of the weights.  At corners, where a polynomial of that length cannot follow, the fit is set
against one of half the window; what they differ by beyond 2.6 standard errors counts as error of the longer one,
over a quarter of the window to either side.
Not modelled: the slow sawtooth of a count that changes less than once per window, and corners shorter than the half
window.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from daq.compute.arrays import Array, Integers
from daq.compute.compile import compiled
from processing.polynomial import moments, uneven
from processing.polynomial.even_grid import is_even
from processing.polynomial.gram import coefficients

KERNELS = ("processing.polynomial.moments",)


@dataclass(frozen=True, eq=False)
class Counted:
    """Positions as counts (n,) of ``pitch`` metres each."""

    count: Integers
    pitch: float


def fit(time: Array, position: Array, window: int, order: int, counted: Counted | None = None) -> tuple[Array, Array]:
    """Fit one piece; values and norms as in `processing.polynomial.uneven.fit`, a shorter piece as one polynomial.

    A derivative that the samples cannot give has an infinite norm.  ``counted`` gives the positions as counts:
    then even times take `processing.polynomial.moments`, whose cost does not depend on the window, wherever it is
    exact.
    """
    n = time.size
    if n >= window and is_even(time):
        return _convolve(position, window, order, (time[-1] - time[0]) / max(n - 1, 1), counted)
    degree = min(order, n - 1)
    values, norms = uneven.fit(time, position, min(window, n), degree)
    if degree < order:
        norms[degree + 1 :] = np.inf
    return values, norms


def _convolve(
    position: Array, window: int, order: int, interval: float, counted: Counted | None
) -> tuple[Array, Array]:
    half_window = window // 2
    norms = np.empty((3, position.size))
    values = np.empty((3, position.size))
    inside(position, window, order, counted, values)
    norms[:, half_window : position.size - half_window] = np.linalg.norm(coefficients(window, order), axis=1)[:, None]
    begin, end = ends(position[:window], position[position.size - window :], order)
    if half_window:
        values[:, :half_window], values[:, -half_window:] = begin, end
        for k in range(half_window):
            norms[:, k] = norms[:, -1 - k] = np.linalg.norm(coefficients(window, order, k - half_window), axis=1)
    scale = np.array([1.0, 1.0 / interval, 1.0 / interval**2])[:, None]
    values *= scale
    return values, norms * scale


def inside(position: Array, window: int, order: int, counted: Counted | None, values: Array) -> None:
    """Fit around every sample that has half a window to either side, into those columns of ``values``, (3, n).

    Derivatives are per sample interval.
    """
    half_window = window // 2
    own = slice(half_window, position.size - half_window)
    if counted is not None and moments.fits(counted.count, window, order):
        weights, even = _power_weights(window, order)
        compiled(moments.slide, KERNELS)(counted.count, half_window, weights, even, values)
        values[:, own] *= counted.pitch
        values[0, own] += position[own]
        return
    for row, weights in enumerate(coefficients(window, order)):
        values[row, own] = np.correlate(position, weights, "valid")


def ends(first: Array, last: Array, order: int) -> tuple[Array, Array]:
    """Return the one-sided fits of the first and the last half of a window, (3, half) each, from a window of samples.

    Derivatives are per sample interval.
    """
    window = first.size
    half_window = window // 2
    begin, end = np.empty((3, half_window)), np.empty((3, half_window))
    first, mirrored = first.copy(), last[::-1].copy()
    for k in range(half_window):
        at = coefficients(window, order, k - half_window)
        begin[:, k] = at @ first
        # The far end is the mirror image: reversed weights, odd derivatives change sign.
        end[:, -1 - k] = (at @ mirrored) * (1, -1, 1)
    return begin, end


@lru_cache(maxsize=64)
def _power_weights(window: int, order: int) -> tuple[Array, Integers]:
    return moments.power_weights(window, order), moments.sums(window)


def half(window: int, order: int) -> int:
    """Return the window of the probe that looks for corners: half as long, still overdetermined; odd."""
    return min(max(order + 3 - order % 2, window // 2 | 1), window)


def standard_errors(
    position: Array, long: tuple[Array, Array], short: tuple[Array, Array], window: int, floor: float
) -> Array:
    """Return one standard error of x, v and a at every sample of a piece, shape (3, n).

    Parameters
    ----------
    position : array of shape (n,)
        The readings, m.
    long, short : (values, norms), each (3, n)
        The fit itself and its probe of half the window.
    window : int
        Samples of the long fit.
    floor : float
        The least reading error, m.
    """
    n = position.size
    window = min(window, n)
    noise = np.minimum(_reading_variance(position, long, window), _reading_variance(position, short, window // 2 | 1))
    noise = np.maximum(noise, floor**2)
    # A short piece cannot give every derivative: its weights are infinite, and no more is said about it.
    known = np.isfinite(long[1]) & np.isfinite(short[1])
    weights, probing = np.where(known, long[1], 0.0), np.where(known, short[1], 0.0)
    difference = np.where(known, long[0] - short[0], 0.0) ** 2
    expected = noise * np.maximum(probing**2 - weights**2, 0.0)
    corner = np.maximum(difference - 7 * expected, 0.0)
    reach = max(window // 4, 1)
    corner = _largest(np.pad(corner, ((0, 0), (reach, reach))), 2 * reach + 1)
    errors: Array = np.where(known, np.sqrt(noise * weights**2 + corner), np.inf)
    return errors


def _largest(rows: Array, width: int) -> Array:
    """Return the largest of every ``width`` neighbours, (3, n - width + 1), by ever longer runs of them."""
    done = 1
    while 2 * done <= width:
        rows = np.maximum(rows[:, :-done], rows[:, done:])
        done *= 2
    rest = width - done
    return np.maximum(rows[:, : rows.shape[1] - rest], rows[:, rest:])


def _reading_variance(position: Array, fitted: tuple[Array, Array], window: int) -> Array:
    """Mean over each sample's window of residual^2/(1 - leverage), m^2; the leverage is the weights' square norm."""
    window = min(window, position.size)
    residual = (position - fitted[0][0]) ** 2 / np.maximum(1 - fitted[1][0] ** 2, 1e-3)
    total = np.concatenate(([0.0], np.cumsum(residual)))
    first = uneven.starts(position.size, window)
    return np.asarray(np.maximum(total[first + window] - total[first], 0.0) / window)
