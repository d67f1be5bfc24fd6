"""Quantiles and tails of the usual distributions, on `scipy.special`: `scipy.stats` takes 0.4 s to import.

scipy is imported by the functions, not with the module.
"""

import math
import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any


@cache
def _special(name: str) -> Any:
    """Return a function of `scipy.special`, where possible from its machine code alone.

    The rest of that package imports scipy's interface to other array libraries, and with it `numpy.f2py`: 0.2 s of CPU,
    a twelfth of a short fit.  The function is the same object.
    """
    package = "scipy.special"
    spec = None if package in sys.modules else find_spec(package)
    if spec is None or spec.submodule_search_locations is None:
        return getattr(import_module(package), name)
    sys.modules[package] = stand_in = ModuleType(package)  # a package that runs nothing when it is imported
    stand_in.__path__ = spec.submodule_search_locations
    try:
        function = getattr(import_module(f"{package}._ufuncs"), name, None)
    except ImportError:
        function = None
    finally:
        del sys.modules[package]
    return getattr(import_module(package), name) if function is None else function


def student_quantile(p: float, freedom: float) -> float:
    """Return the p-quantile of Student's t with so many degrees of freedom."""
    return float(_special("stdtrit")(freedom, p))


def normal_quantile(p: float) -> float:
    """Return the p-quantile of the standard normal distribution."""
    return float(_special("ndtri")(p))


def chi_square_quantile(p: float, freedom: float) -> float:
    """Return the p-quantile of chi square."""
    return 2 * float(_special("gammaincinv")(0.5 * freedom, p))


def fisher_log_tail(value: float, numerator: float, denominator: float) -> float:
    """Return the logarithm of the probability of ``value`` or more under Fisher's F; -inf below the smallest number."""
    probability = float(_special("fdtrc")(numerator, denominator, max(value, 0.0)))
    return math.log(probability) if probability > 0 else -math.inf


def gamma_tail(value: float, mean: float, spread: float) -> float:
    """Return the probability of ``value`` or more under the gamma distribution with this mean and deviation."""
    shape = (mean / spread) ** 2
    return float(_special("gammaincc")(shape, max(value * mean / spread**2, 0.0)))


def gamma_upper_quantile(p: float, mean: float, spread: float) -> float:
    """Return what is exceeded with probability p under that distribution."""
    return float(_special("gammainccinv")((mean / spread) ** 2, p)) * spread**2 / mean
