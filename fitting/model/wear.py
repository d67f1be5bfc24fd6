"""Wear: the decrease of the friction level from cycle to cycle, by a straight line through the cycles' levels.

A level is drawn anew at each landing, so the line's error comes from the scatter of the levels about it.  The change of
a level within one cycle is a separate parameter of the fit (`fitting.model.parameters`, fade) and is not used for wear,
since a contact may lose its strength only where it is formed anew.
"""

from dataclasses import dataclass

import numpy as np

from fitting.model.parameters import PerCycle
from fitting.model.windows import ShootingWindows
from stickslip.compute.arrays import Array, Mask
from stickslip.units import Measured

FEWEST_LEVELS = 4  # a line through fewer has next to no error of its own


@dataclass(frozen=True)
class Wear:
    relative_rate: Measured  # fraction of the mean level lost per second, 1/s; negative where the contact runs in
    middle: float  # s, the mean time of the levels: there the line passes through their mean
    degrees_of_freedom: int  # of the standard error of ``relative_rate``

    @property
    def first(self) -> Measured:
        """Level when the recording begins, over the mean level; the error is the line's."""
        return Measured(1 + self.relative_rate.value * self.middle, self.relative_rate.sd * self.middle)

    @property
    def rate(self) -> Measured:
        """Fraction of the first level lost per second, 1/s."""
        first = self.first.value
        return Measured(self.relative_rate.value / first, self.relative_rate.sd / first**2)


def level_trend(time: Array, level: Array) -> Wear | None:
    """Fit a line to levels (n,) at times (n,), s; None for fewer than four, or if it is negative at the start."""
    if level.size < FEWEST_LEVELS:
        return None
    level = level / level.mean()
    middle = float(time.mean())
    t = time - middle
    square = float(np.sum(t**2))
    slope = float(np.sum(t * level)) / square
    rest = level - 1 - slope * t
    freedom = level.size - 2
    found = Wear(Measured(-slope, float(np.sqrt(np.sum(rest**2) / freedom / square))), middle, freedom)
    return found if found.first.value > 0 else None


def of_cycles(windows: ShootingWindows, inlier: Mask, local: Array, run: int) -> Wear | None:
    """Return the line through one run's inlier levels, whose logs ``local`` (cycles, 6) has."""
    table = windows.table
    own = (table[:, 1] == 0) & (table[:, 5] == run) & inlier[table[:, 0]]
    return level_trend(windows.level_epoch[own], np.exp(local[table[own, 0], PerCycle.LEVEL]))
