"""Least-squares polynomials on the sample times of each window: Savitzky-Golay without an even grid.

For every sample the window's own orthogonal polynomials are built by Forsythe's three-term recurrence on its
abscissae u = (t_j - t_i)/(half window) (`processing.polynomial.local_kernel`):

    p_{k+1}(u) = (u - a_k) p_k(u) - b_k p_{k-1}(u),
    a_k = <u p_k, p_k>/<p_k, p_k>,   b_k = <p_k, p_k>/<p_{k-1}, p_{k-1}>

so no normal equations are formed and any spacing is allowed.  The fit is evaluated at u = 0, the sample itself.
Near the ends of a piece the window stops at the end and the fit becomes one-sided, without a special case.

Source: G. E. Forsythe, J. SIAM 5 (1957) 74.
"""

import numpy as np

from processing.polynomial import local_kernel
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import compiled

KERNELS = ("processing.polynomial.local_kernel",)


def window_starts(n: int, window: int) -> Integers:
    """Return the first sample of the window of every sample: centred, or ending with the piece."""
    return np.clip(np.arange(n) - window // 2, 0, n - window)


def fit(time: Array, position: Array, window: int, order: int) -> tuple[Array, Array]:
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
