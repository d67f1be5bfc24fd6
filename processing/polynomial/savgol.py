"""Savitzky-Golay: position, velocity and acceleration as one local polynomial at every sample.

On an even grid the fit is a convolution with weights that are the same everywhere (`processing.polynomial.even`).
Uneven times are used as recorded: for every sample the window's own orthogonal polynomials are built by Forsythe's
three-term recurrence on its abscissae u = (t_j - t_i)/(half window) (`processing.polynomial.local_kernel`):

    p_{k+1}(u) = (u - a_k) p_k(u) - b_k p_{k-1}(u),
    a_k = <u p_k, p_k>/<p_k, p_k>,   b_k = <p_k, p_k>/<p_{k-1}, p_{k-1}>

so no normal equations are formed, and the fit is evaluated at u = 0, the sample itself.  Sample times matter more than
encoder pitch: at 0.8 m/s, 30 us of jitter taken for an even grid is 24 um.  Near the ends of a piece the fit becomes
one-sided, with larger errors; a piece shorter than the window is one polynomial over all of it.

Standard errors have two parts.  The reading error around each sample (from the residuals, at least pitch/sqrt(12))
goes through the norm of the weights.  At corners, where a polynomial of that length cannot follow, the fit is set
against one of half the window; what they differ by beyond 2.6 standard errors counts as error of the longer one,
over a quarter of the window to either side.

Not modelled: the slow sawtooth of a count that changes less than once per window, and corners shorter than the half
window.

Source: G. E. Forsythe, J. SIAM 5 (1957) 74.
"""

import numpy as np

from processing.polynomial import even, local_kernel
from processing.polynomial.even import is_even
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import compiled

KERNELS = ("processing.polynomial.local_kernel",)


def window_starts(n: int, window: int) -> Integers:
    """Return the first sample of the window of every sample: centred, or ending with the piece."""
    return np.clip(np.arange(n) - window // 2, 0, n - window)


def fit_uneven(time: Array, position: Array, window: int, order: int) -> tuple[Array, Array]:
    """Fit a polynomial around every sample of one piece; return x, v, a (3, n) and the norms of their weights (3, n).

    A norm times the reading error is the standard error.  Derivatives above the order are zero; the window may be even.
    """
    n = time.size
    first = window_starts(n, window)
    span = (time[-1] - time[0]) / (n - 1) * max(window // 2, 1) if n > 1 else 1.0
    span = 2.0 ** round(np.log2(span))  # a power of two: the same for a part of the record as for the whole
    values, norms = np.empty((3, n)), np.empty((3, n))
    compiled(local_kernel.fit, KERNELS)(time, position, first, window, order, span, values, norms)
    # The position at the centre was taken off: a local fit should not carry the whole travel's digits.
    scale = np.array([1.0, 1.0 / span, 1.0 / span**2])[:, None]
    values *= scale
    values[0] += position
    return values, norms * scale


def fit(time: Array, position: Array, window: int, order: int) -> tuple[Array, Array]:
    """Fit one piece as `uneven.fit` does, a piece shorter than the window as one polynomial.

    The norm of a derivative that the samples cannot determine is infinite.
    """
    n = time.size
    if n >= window and is_even(time):
        return even.fit(position, window, order, (time[-1] - time[0]) / max(n - 1, 1))
    degree = min(order, n - 1)
    values, norms = fit_uneven(time, position, min(window, n), degree)
    if degree < order:
        norms[degree + 1 :] = np.inf
    return values, norms


def probe_window(window: int, order: int) -> int:
    """Return the odd window of the probe for corners: half as long, still overdetermined."""
    return min(max(order + 3 - order % 2, window // 2 | 1), window)


def standard_errors(
    position: Array, long: tuple[Array, Array], short: tuple[Array, Array], window: int, floor: float
) -> Array:
    """Return one standard error of x, v and a at every sample of a piece, (3, n).

    ``long`` is the fit over ``window`` samples and ``short`` its probe, values and norms each; ``floor`` is the least
    reading error, m.
    """
    from scipy.ndimage import maximum_filter1d

    window = min(window, position.size)
    noise = np.minimum(_reading_variance(position, long, window), _reading_variance(position, short, window // 2 | 1))
    noise = np.maximum(noise, floor**2)
    # A short piece does not determine every derivative: those have infinite weights.
    finite = np.isfinite(long[1]) & np.isfinite(short[1])
    weights, probing = np.where(finite, long[1], 0.0), np.where(finite, short[1], 0.0)
    difference = np.where(finite, long[0] - short[0], 0.0) ** 2
    expected = noise * np.maximum(probing**2 - weights**2, 0.0)
    corner = np.maximum(difference - 7 * expected, 0.0)
    reach = max(window // 4, 1)
    corner = maximum_filter1d(corner, 2 * reach + 1, axis=1, mode="constant")
    errors: Array = np.where(finite, np.sqrt(noise * weights**2 + corner), np.inf)
    return errors


def _reading_variance(position: Array, fitted: tuple[Array, Array], window: int) -> Array:
    """Mean over each sample's window of residual^2/(1 - leverage), m^2; the leverage is the weights' square norm."""
    window = min(window, position.size)
    residual = (position - fitted[0][0]) ** 2 / np.maximum(1 - fitted[1][0] ** 2, 1e-3)
    total = np.concatenate(([0.0], np.cumsum(residual)))
    first = window_starts(position.size, window)
    return np.asarray(np.maximum(total[first + window] - total[first], 0.0) / window)
