"""Results of a fit: a parameter with its interval, and one break-away."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stickslip.compute.arrays import Array

# Standard error over a value, from which that is not stated in words; of a level of friction only its difference to
# another is.  At half known levels are withheld, at twice levels of either sign are stated.
STATED_ERROR = 0.5


NO_LIMITS = (-math.inf, math.inf)
LARGEST_LOG = 300.0  # logarithm of a value's factor: at more the end of an interval is no number


@dataclass(frozen=True)
class Parameter:
    """A value with its standard error and confidence interval, in its unit.

    ``trusted`` is False where the law does not describe the record: error and interval are then too small, and withheld
    from documents and tables.  ``fixed`` values were not fitted.
    """

    value: float
    stderr: float
    lo: float
    hi: float
    unit: str
    trusted: bool = True
    fixed: bool = False

    @property
    def decimals(self) -> int:
        """Digits after the point: two of the error, at most 12."""
        return min(max(0, 1 - math.floor(math.log10(self.stderr))), 12) if self.stderr > 0 else 6

    def __str__(self) -> str:
        if self.fixed:
            return f"{self.value:.6g} {self.unit} (fixed)".replace("  ", " ")
        if not self.trusted:
            return f"{self.value:.4g} {self.unit} (interval withheld)".replace("  ", " ")
        digits = self.decimals
        return f"{self.value:.{digits}f} [{self.lo:.{digits}f}, {self.hi:.{digits}f}] {self.unit}".rstrip()

    def as_json(self) -> dict[str, Any]:
        """Return the document's form; null for what is withheld."""
        error = {"stderr": self.stderr, "lo": self.lo, "hi": self.hi} if self.trusted else _WITHHELD
        return {"value": self.value, **error, "unit": self.unit} | ({"fixed": True} if self.fixed else {})

    @classmethod
    def around(
        cls,
        value: float,
        stderr: float,
        quantile: float,
        limits: tuple[float, float] = NO_LIMITS,
        *,
        by_log: bool = False,
    ) -> "Parameter":
        """Return a value with its interval within the limits, by a factor for one that is fitted by its logarithm.

        ``quantile`` is half the width of the interval over the standard error.
        """
        if by_log and value > 0:
            factor = math.exp(min(quantile * stderr / value, LARGEST_LOG))
            lo, hi = value / factor, value * factor
        else:
            lo, hi = value - quantile * stderr, value + quantile * stderr
        return cls(value, stderr, max(lo, limits[0]), min(hi, limits[1]), "")


def in_columns(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return table cells: value, "NAME stderr", "NAME lo", "NAME hi"; None for what is withheld."""
    found: dict[str, Any] = {}
    for name, item in parameters.items():
        cells = item.as_json()
        found[name] = cells["value"]
        found |= {f"{name} {part}": cells[part] for part in ("stderr", "lo", "hi")}
    return found


_WITHHELD = dict.fromkeys(("stderr", "lo", "hi"))


@dataclass(frozen=True, eq=False)
class Correlations:
    """Correlations (p, p) of the errors of the parameters ``names`` (p,), -1 to 1."""

    names: tuple[str, ...]
    matrix: Array

    def as_json(self) -> dict[str, Any]:
        return {"parameters": list(self.names), "matrix": self.matrix.tolist()}


@dataclass(frozen=True)
class BreakAway:
    number: int
    t: float  # s, when the mass leaves the belt
    break_away_level: float  # load at the break-away over Fs; NaN for a cycle that was not fitted
    kinetic_scale: float  # this cycle's kinetic level over Fs; NaN for a cycle that was not fitted
    # "" for a cycle that counted, "rough" for one that fits far worse than the others, else why it was left out
    flag: str

    def as_json(self) -> dict[str, Any]:
        return {"static_level" if name == "break_away_level" else name: item for name, item in vars(self).items()}
