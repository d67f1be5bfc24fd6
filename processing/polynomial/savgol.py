"""Savitzky-Golay: position, velocity and acceleration as one local polynomial at every sample.

On an even grid the fit is a convolution with weights that are the same everywhere (`processing.polynomial.even_fit`);
where recorded times are uneven it is made on those times (`processing.polynomial.uneven`).  Sample times matter more
than encoder pitch: at 0.8 m/s, 30 us of jitter taken for an even grid is 24 um.  Ends of a piece are one-sided fits
with their larger errors; a piece shorter than the window is one polynomial over all of it.

Standard errors have two parts.  The reading error around each sample (from the residuals, at least pitch/sqrt(12))
goes through the norm of the weights.  At corners, where a polynomial of that length cannot follow, the fit is set
against one of half the window; what they differ by beyond 2.6 standard errors counts as error of the longer one,
over a quarter of the window to either side.
Not modelled: the slow sawtooth of a count that changes less than once per window, and corners shorter than the half
window.
"""

import numpy as np

from processing.polynomial import even_fit, uneven
from processing.polynomial.even_grid import is_even
from stickslip.compute.arrays import Array


def fit(time: Array, position: Array, window: int, order: int) -> tuple[Array, Array]:
    """Fit one piece; values and norms as in `processing.polynomial.uneven.fit`, a shorter piece as one polynomial.

    A derivative that the samples cannot give has an infinite norm.
    """
    n = time.size
    if n >= window and is_even(time):
        return even_fit.fit(position, window, order, (time[-1] - time[0]) / max(n - 1, 1))
    degree = min(order, n - 1)
    values, norms = uneven.fit(time, position, min(window, n), degree)
    if degree < order:
        norms[degree + 1 :] = np.inf
    return values, norms


def half(window: int, order: int) -> int:
    """Return the window of the probe that looks for corners: half as long, still overdetermined; odd."""
    return min(max(order + 3 - order % 2, window // 2 | 1), window)


def standard_errors(
    position: Array, long: tuple[Array, Array], short: tuple[Array, Array], window: int, floor: float
) -> Array:
    """Return one standard error of x, v and a at every sample of a piece, shape (3, n).

    position: The readings, m.
    long, short: (values, norms) The fit itself and its probe of half the window.
    window: Samples of the long fit.
    floor: The least reading error, m.
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
