"""Friction that fluctuates at random within a slip: how large it must be to leave what a law leaves.

Random friction acts on the fitted motion and all unknowns are fitted again, to first order in it.  Its correlation time
is the one for which what is then left, with the noise, has the correlation time of the residual.
"""

import math
from collections.abc import Callable

import numpy as np

from fitting.curve.level import rest_prior
from fitting.departures.base import Base, usual_rms
from fitting.driver.fit import Fit
from fitting.forces.departure import Forcing
from stickslip.compute.arrays import Array, autocorrelation_time

# The size is then known to a factor of two or three; the same draws for every record.  Half of them changed one size
# from 14.8 to 14.4 %.
DRAWS, SEED = 6, 5
HARMONICS = 64  # sines whose sum is one draw
# Correlation times of the friction that are tried, over that of the residual: a position follows a force late.
TIMES_TRIED = (1.0, 0.5, 0.25, 0.125, 0.0625)


def fluctuation_share(base: Base, count_repeated: Callable[[Array], Array], noise: float) -> float | None:
    """Return the standard deviation of random friction over the friction at rest.

    None where more of the residual repeats from slip to slip than random friction leaves, or beside an unstable motion.

    count_repeated: Returns the share of residuals (N, B) that repeats, (B,).
    noise: Standard deviation of a position, m.
    """
    linear, path = base.linear, base.path
    excess = usual_rms(linear.residual, linear.rows) ** 2 - noise**2
    if not excess > 0:
        return None
    rng = np.random.default_rng(SEED)
    white = noise * rng.standard_normal((linear.residual.size, DRAWS))
    friction = np.where(path.stuck, 0.0, path.friction)[:, None]
    steps = np.diff(path.windows.time)
    seen = _correlation(linear.residual, base)
    found: list[tuple[float, float]] = []
    repeat = -math.inf
    for share in TIMES_TRIED:
        time = share * seen * float(np.median(steps[steps > 0])) / math.sqrt(2 * math.pi)
        response = base.respond([Forcing(acceleration=friction * _random(path.time, time, rng))])
        left = linear.refit_columns(response)
        unit = float(np.median([usual_rms(one, linear.rows) for one in left.T]))
        if math.isfinite(unit) and unit > 0:
            size = math.sqrt(excess) / unit
            drawn = size * left + white
            times = [_correlation(one, base) for one in drawn.T]
            found.append((abs(math.log(float(np.median(times)) / seen)), size))
            repeat = max(repeat, float(np.max(count_repeated(drawn))))
    if not found or count_repeated(linear.residual[:, None])[0] > repeat:
        return None
    return min(found)[1] * base.fit.values.F / _friction_at_rest(base.fit)


def _friction_at_rest(fit: Fit) -> float:
    """Return friction at the break-aways (m/s^2) by the stretch of the spring from the stated or assumed rest position.

    A law that does not describe the record may end at any level: 100 times the true one was seen.
    """
    own = [rows for rows, run in zip(fit.rows, fit.windows.run, strict=True) if run == 0]
    highest = float(np.mean([np.max(fit.windows.position[rows]) for rows in own]))
    return fit.values.K * (highest - rest_prior(fit.problem.runs[0]).value)


def _correlation(residual: Array, base: Base) -> float:
    """Return the correlation time of residuals (N,), in samples."""
    return autocorrelation_time([residual[rows] for rows in base.linear.rows])


def _random(time: Array, correlation: float, rng: np.random.Generator) -> Array:
    """Return random numbers of unit variance at times (M,), s, with a Gaussian correlation; shape (M, DRAWS)."""
    rate = rng.standard_normal((HARMONICS, DRAWS)) / correlation
    phase = rng.uniform(0.0, 2 * math.pi, (HARMONICS, DRAWS))
    total = np.zeros((time.size, DRAWS))
    for one, shift in zip(rate, phase, strict=True):
        total += np.cos(time[:, None] * one + shift)
    return math.sqrt(2 / HARMONICS) * total
