"""The motion of white jerk: the likelihood of a record under it, and its fixed-interval smoother, on an even grid.

Let the jerk be white noise of density q and the readings err independently by r.  Third differences z = D x of the
positions then are a stationary banded Gaussian series,

    cov(z) = r (B + rho C),   B = (-1, 6, -15, 20, -15, 6, -1),  C = (1, 26, 66, 26, 1)/120,   rho = q interval^5 / r

(B = D D'; C is the overlap of the quadratic B-splines through which third differences see the jerk).  One banded
Cholesky factor gives the likelihood of rho, and at its maximum the smoother x - D'(B + rho C)^-1 z, which is the
quintic smoothing spline.  Position and initial state need no prior: differencing removes them.

Not modelled: corners of the velocity, which real slips have; they raise q for the whole record.

Source: G. Wahba, Spline Models for Observational Data, SIAM (1990), chapters 1 and 4.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.optimize import minimize_scalar

from daq.compute.arrays import Array

READING = np.array([-1.0, 6.0, -15.0, 20.0])  # upper bands of B, farthest first
JERK = np.array([0.0, 1.0, 26.0, 66.0]) / 120


def likelihood(log_rho: float, third: Array, joints: tuple[int, ...] = ()) -> tuple[float, float, Array]:
    """Return minus the log likelihood of rho, the reading variance at its best, and the banded Cholesky factor.

    Parameters
    ----------
    log_rho : float
        Natural logarithm of rho.
    third : array of shape (m,)
        Third differences of the positions on an even grid, m; those of several stretches laid end to end.
    joints : tuple of int
        Where a further stretch begins in ``third``: nothing correlates across.
    """
    bands = np.empty((4, third.size))
    bands[:] = (READING + math.exp(log_rho) * JERK)[:, None]
    for joint in joints:
        for apart in (1, 2, 3):
            bands[3 - apart, joint : joint + apart] = 0.0
    factor = cholesky_banded(bands, overwrite_ab=True, check_finite=False)
    white = dtbtrs(factor, third[:, None], uplo="U", trans="T")[0][:, 0]
    variance = float(white @ white) / third.size
    determinant = float(np.log(factor[3]).sum())
    return 0.5 * third.size * math.log(variance) + determinant, variance, factor


def smoothed(position: Array, log_rho: float) -> Array:
    """Return the fixed-interval smoother's positions of a white-jerk motion, even grid, m."""
    third = np.diff(position, 3)
    factor = likelihood(log_rho, third)[2]
    solved = cho_solve_banded((factor, False), third, check_finite=False)
    return np.asarray(position - np.convolve(solved, (-1.0, 3.0, -3.0, 1.0)))


def fit(third: Sequence[Array], bounds: tuple[float, float]) -> tuple[float, float]:
    """Return log rho of the greatest likelihood within ``bounds``, and the reading error there, m.

    Parameters
    ----------
    third : sequence of arrays
        Third differences of each stretch of the record.
    bounds : (float, float)
        Where to look for log rho.
    """
    ends = np.cumsum([own.size for own in third])
    joints = tuple(ends[:-1].tolist())
    series = np.concatenate(third)
    found = minimize_scalar(
        lambda log_rho: likelihood(log_rho, series, joints)[0], bounds=bounds, method="bounded", options={"xatol": 0.05}
    )
    log_rho = float(found.x)
    return log_rho, math.sqrt(likelihood(log_rho, series, joints)[1])
