"""Least-squares polynomials on each window's own sample times: Savitzky-Golay without an even grid.

For every sample the window's own orthogonal polynomials are built by Forsythe's three-term recurrence on its
abscissae u = (t_j - t_i)/(half window), many windows at a time:

    p_{k+1}(u) = (u - a_k) p_k(u) - b_k p_{k-1}(u),
    a_k = <u p_k, p_k>/<p_k, p_k>,   b_k = <p_k, p_k>/<p_{k-1}, p_{k-1}>

so no normal equations are formed and any spacing is welcome.  The fit is evaluated at u = 0, the sample itself.
Near the ends of a piece the window stops at the end and the fit becomes one-sided: nothing special is done for it.

Source: G. E. Forsythe, J. SIAM 5 (1957) 74.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK = 2**15  # numbers per working array: a few of them fit a core's cache


def starts(n: int, window: int) -> NDArray[np.int64]:
    """Return the first sample of every sample's window: centred, or up against the end of the piece."""
    return np.clip(np.arange(n) - window // 2, 0, n - window)


def fit(time: Array, position: Array, window: int, order: int) -> tuple[Array, Array]:
    """Fit a polynomial around every sample of one piece.

    Parameters
    ----------
    time, position : array of shape (n,)
        s, increasing, and m.
    window : int
        Samples per fit, at most n; even is allowed here, since the abscissae are explicit.
    order : int
        Degree, below the window.

    Returns
    -------
    values : array of shape (3, n)
        Position, velocity, acceleration at the samples; a derivative above the order is zero.
    norms : array of shape (3, n)
        Root sum of squares of the weights: times the reading error it is the standard error.
    """
    n = time.size
    first = starts(n, window)
    span = (time[-1] - time[0]) / (n - 1) * max(window // 2, 1) if n > 1 else 1.0
    times, positions = sliding_window_view(time, window), sliding_window_view(position, window)
    values, norms = np.empty((3, n)), np.empty((3, n))
    rows = max(8, BLOCK // window)
    scale = np.array([1.0, 1.0 / span, 1.0 / span**2])[:, None]
    for begin in range(0, n, rows):
        block = slice(begin, min(begin + rows, n))
        own = first[block]
        # The position at the centre is taken off first: a local fit should not carry the whole travel's digits.
        u = (times[own] - time[block, None]) / span
        x = positions[own] - position[block, None]
        value, variance = _fit_block(u, x, order)
        values[:, block] = value * scale
        norms[:, block] = np.sqrt(variance) * scale
    values[0] += position
    return values, norms


def _fit_block(u: Array, x: Array, order: int) -> tuple[Array, Array]:
    """Fit windows of shape (rows, window); return value and weight variance at u = 0, derivatives 0-2, (3, rows)."""
    rows, window = u.shape
    p, p_last = np.ones_like(u), np.zeros_like(u)
    e, e_last = np.zeros((3, rows)), np.zeros((3, rows))  # p_k(0) and two derivatives
    e[0] = 1.0
    g, g_last = np.full(rows, float(window)), np.ones(rows)
    value, variance = np.zeros((3, rows)), np.zeros((3, rows))
    for k in range(order + 1):
        value += np.einsum("ij,ij->i", p, x) / g * e
        variance += e * e / g
        if k == order:
            break
        up = u * p
        a = np.einsum("ij,ij->i", up, p) / g
        up -= a[:, None] * p
        b = g / g_last if k else np.zeros(rows)
        if k:
            up -= b[:, None] * p_last
        e, e_last = np.array([-a * e[0], e[0] - a * e[1], 2 * e[1] - a * e[2]]) - b * e_last, e
        p, p_last = up, p
        g, g_last = np.einsum("ij,ij->i", p, p), g
    return value, variance
