"""Wear: how fast the friction level falls from cycle to cycle, by a straight line through the cycles' own levels.

A level is drawn anew at each landing, so the line's error comes from the scatter of the levels about it.  What a level
does within one cycle is another matter: the fit leaves it free (`fitting.model.parameters`, fade) and says nothing of
wear by it, since a contact may well lose its strength only where it is made anew.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from daq.runfile.rig import Measured
from fitting.model.parameters import LEVEL

if TYPE_CHECKING:
    from fitting.estimation.trajectory import Fit

FEWEST_LEVELS = 4  # a line through fewer has next to no error of its own


@dataclass(frozen=True)
class Wear:
    """The line through a run's levels.

    Attributes
    ----------
    loss : Measured
        Fraction of the mean level lost per second, 1/s; negative where the contact runs in.
    middle : float
        s, the mean time of the levels: there the line passes through their mean.
    freedom : int
        Degrees of freedom of the loss's error.
    """

    loss: Measured
    middle: float
    freedom: int

    @property
    def first(self) -> Measured:
        """Level when the recording begins, over the mean level; the error is the line's, not the mean's."""
        return Measured(1 + self.loss.value * self.middle, self.loss.sd * self.middle)

    @property
    def rate(self) -> Measured:
        """Fraction of the first level lost per second, 1/s."""
        first = self.first.value
        return Measured(self.loss.value / first, self.loss.sd / first**2)


def of(fit: "Fit", run: int = 0) -> Wear | None:
    """Fit the line of one run.

    Parameters
    ----------
    fit : Fit
        Of all runs together.
    run : int

    Returns
    -------
    Wear or None
        None with fewer than four cycles to trust, or where the line says that there was nothing left to lose.
    """
    own = (fit.windows.table[:, 1] == 0) & (fit.windows.table[:, 5] == run)
    own &= fit.trusted[fit.windows.table[:, 0]]
    return line(fit.windows.epoch[own], np.exp(fit.local[fit.windows.table[own, 0], LEVEL]))


def line(time: NDArray[np.float64], level: NDArray[np.float64]) -> Wear | None:
    """Return the least-squares line of levels (n,) over time (n,), s; None as `of` says."""
    if level.size < FEWEST_LEVELS:
        return None
    level = level / level.mean()
    middle = float(time.mean())
    t = time - middle
    square = float(t @ t)
    slope = float(t @ level) / square
    rest = level - 1 - slope * t
    freedom = level.size - 2
    found = Wear(Measured(-slope, float(np.sqrt(rest @ rest / freedom / square))), middle, freedom)
    return found if found.first.value > 0 else None
