"""Scales of the axes of a picture: linear, logarithmic, or of categories, with their ticks."""

import math
from dataclasses import dataclass

import numpy as np

from stickslip.compute.arrays import Array

EDGE = 0.04  # of the range, left free on both sides of the data


@dataclass(frozen=True)
class AxisScale:
    """A map from numbers to positions between 0 and 1."""

    low: float
    high: float
    log: bool = False  # both are then positive
    names: tuple[str, ...] = ()  # of the places 0, 1, 2 ... where the scale is one of categories.

    @classmethod
    def around(cls, values: Array, *, log: bool = False, edge: float = EDGE) -> "AxisScale":
        """Return a scale that holds all finite values, (n,)."""
        good = values[np.isfinite(values) & ((values > 0) | (not log))]
        low, high = (float(good.min()), float(good.max())) if good.size else (1.0, 1.0)
        if log:
            low, high = math.log10(low), math.log10(high)
        room = edge * (high - low) or 0.1 * abs(high) or 1.0
        low, high = low - room, high + room
        return cls(10**low, 10**high, log) if log else cls(low, high)

    def place(self, values: Array) -> Array:
        """Return positions (n,) of the values, 0 at ``low`` and 1 at ``high``."""
        if not self.log:
            return np.asarray((values - self.low) / (self.high - self.low))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.log(values / self.low) / math.log(self.high / self.low))

    def ticks(self, most: int) -> list[tuple[float, str]]:
        """Return at most so many round values, with their labels."""
        if self.names:
            return [(float(place), name) for place, name in enumerate(self.names)]
        if self.log:
            values = self._log_ticks(most)
        else:
            step = 10 ** math.floor(math.log10((self.high - self.low) / most))
            steps = [step * n for n in (0.5, 1, 2, 5, 10, 20)]
            place = next(k for k, one in enumerate(steps) if k and (self.high - self.low) / one <= most)
            values = self._multiples(steps[place])
            if len(values) < 2:  # one label says nothing of the scale
                values = self._multiples(steps[place - 1])
        return [(value, f"{value:.10g}".replace("-", "\N{MINUS SIGN}")) for value in values]

    def _multiples(self, step: float) -> list[float]:
        return [step * n for n in range(math.ceil(self.low / step), math.floor(self.high / step) + 1)]

    def _log_ticks(self, most: int) -> list[float]:
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        for factors in ((1, 2, 3, 5), (1, 2, 5), (1, 3), (1,)):
            values = [n * 10.0**decade for decade in decades for n in factors]
            values = [value for value in values if self.low <= value <= self.high]
            if len(values) <= most:
                return values
        return values[:: math.ceil(len(values) / most)]
