"""Quantiles and tails of the usual distributions, on `scipy.special`: `scipy.stats` takes 0.4 s to import."""

import math

from scipy import special


def student_quantile(p: float, freedom: float) -> float:
    """Return the p-quantile of Student's t with so many degrees of freedom."""
    return float(special.stdtrit(freedom, p))


def normal_quantile(p: float) -> float:
    """Return the p-quantile of the standard normal distribution."""
    return float(special.ndtri(p))


def chi_square_quantile(p: float, freedom: float) -> float:
    return 2 * float(special.gammaincinv(0.5 * freedom, p))


def fisher_log_tail(value: float, numerator: float, denominator: float) -> float:
    """Return the logarithm of the probability of ``value`` or more under Fisher's F; -inf below the smallest number."""
    probability = float(special.fdtrc(numerator, denominator, max(value, 0.0)))
    return math.log(probability) if probability > 0 else -math.inf


def gamma_tail(value: float, mean: float, spread: float) -> float:
    """Return the probability of ``value`` or more under the gamma distribution with this mean and deviation."""
    shape = (mean / spread) ** 2
    return float(special.gammaincc(shape, max(value * mean / spread**2, 0.0)))


def gamma_upper_quantile(p: float, mean: float, spread: float) -> float:
    """Return what is exceeded with probability p under that distribution."""
    return float(special.gammainccinv((mean / spread) ** 2, p)) * spread**2 / mean
