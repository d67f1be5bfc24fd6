"""Branches of solutions over a parameter, the special points where they change, and how such a point is found."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

HALVINGS = 60  # of an interval of the parameter: its width falls below rounding
PRECISION = 1e-14  # of the parameter, relative to its step


@dataclass(frozen=True)
class BranchPoint:
    """A solution at one value of the parameter: ``state``, a fixed point or an orbit."""

    value: float
    state: Any


@dataclass
class Branch:
    """Neighbouring values at which one solution exists with the same stability.

    ``kind`` is 'fixed point' or 'orbit', of a map 'period 1' ...
    """

    kind: str
    stable: bool
    rows: list[BranchPoint] = field(default_factory=list)


@dataclass(frozen=True)
class SpecialPoint:
    """A value of the parameter where the picture changes: ``kind`` is 'hopf', 'fold' ..."""

    kind: str
    value: float


@dataclass(frozen=True)
class Continuation:
    """The branches and the special points of an interval of the parameter, in increasing order of their values."""

    branches: tuple[Branch, ...]
    points: tuple[SpecialPoint, ...]


def bisect(holds: Callable[[float], bool], first: float, last: float, halvings: int = HALVINGS) -> float:
    """Return, to rounding, where a property changes that holds at one of two values and not at the other."""
    at_first = holds(first)
    for _ in range(halvings):
        middle = 0.5 * (first + last)
        if holds(middle) == at_first:
            first = middle
        else:
            last = middle
    return 0.5 * (first + last)


def find_zero(
    function: Callable[[float], float | None], first: float, last: float, precision: float = PRECISION
) -> float | None:
    """Return where a function passes 0 between two values; None where it does not, or is not defined on the way.

    ``precision`` is relative to the distance of the two.
    """
    from scipy.optimize import brentq

    ends = function(first), function(last)
    if ends[0] is None or ends[1] is None or (ends[0] > 0.0) == (ends[1] > 0.0):
        return None

    def require_value(value: float) -> float:
        result = function(value)
        if result is None:
            raise ArithmeticError("the orbit was lost")
        return result

    try:
        return float(brentq(require_value, first, last, xtol=precision * abs(last - first), rtol=8.9e-16))
    except ArithmeticError:
        return None


def minimise(function: Callable[[float], float], lo: float, hi: float, precision: float) -> tuple[float, float]:
    """Return where a function of one variable is least between lo and hi, to ``precision``, and its value there."""
    from scipy.optimize import minimize_scalar

    minimum = minimize_scalar(function, bounds=(lo, hi), method="bounded", options={"xatol": precision})
    return float(minimum.x), float(minimum.fun)
