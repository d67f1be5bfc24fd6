"""A parameter and the values it takes, as ``--over section.key=START:STOP:N`` writes them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.base.errors import InputError

FORM = "write section.key=START:STOP, or section.key=START:STOP:N, as in damper.c=0.3:0.6:31"
NUMBER = 41  # of values where none is given
MOST = 1_000_000


@dataclass(frozen=True)
class ParameterRange:
    """``number`` values of the scene's key ``key``, evenly from ``start`` to ``stop``, both included."""

    key: str
    start: float
    stop: float
    number: int

    def values(self) -> NDArray[np.float64]:
        """Return the values, shape (number,)."""
        return np.linspace(self.start, self.stop, self.number)


def parse(text: str) -> ParameterRange:
    """Return the range that ``text`` describes.

    Raises
    ------
    InputError
        Another form, numbers that are not finite, equal ends, or fewer than 2 values.
    """
    key, equals, span = text.partition("=")
    parts = span.split(":")
    if not equals or "." not in key or len(parts) not in (2, 3):
        raise InputError(f"{text!r} is no range of a parameter", "--over", FORM)
    try:
        start, stop = float(parts[0]), float(parts[1])
        number = int(parts[2]) if len(parts) == 3 else NUMBER
    except ValueError:
        raise InputError(f"{text!r} holds something that is no number", "--over", FORM) from None
    if not (math.isfinite(start) and math.isfinite(stop)) or start == stop:
        raise InputError(f"{text!r} is no interval", "--over", "give two different finite numbers")
    if not 2 <= number <= MOST:
        raise InputError(f"{number} values", "--over", f"give 2 to {MOST}")
    return ParameterRange(key.strip(), start, stop, number)
