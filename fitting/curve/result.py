"""Results of a measurement of the friction curve."""

from dataclasses import dataclass, field

import numpy as np

from fitting.driver.fit import Fit
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.result import STATED_ERROR, Parameter
from stickslip.compute.arrays import Array


@dataclass(frozen=True)
class BandExit:
    """The largest exit from the band, in half-widths (below 1 it stays inside), and its speed.

    Where the curve's level is hardly known, both curves are taken less their means over the speeds.
    """

    half_widths: float
    speed: float


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Friction per unit mass against relative speed, measured without a law, with a simultaneous band."""

    # (k,) relative speed, m/s, where the record shows the curve: from a few percent of the largest slip speed on
    speed: Array = field(repr=False)
    # (k,) m/s^2; mean level of the record, and the band that holds the whole curve at the stated confidence
    friction: Array = field(repr=False)
    lo: Array = field(repr=False)
    hi: Array = field(repr=False)
    # (k,) m/s^2; half the width of the same band for the curve less its mean over the speeds
    shape_half: Array = field(repr=False)
    k_over_m: Parameter  # 1/s^2
    # weighted rms residual over the noise: well above 1, friction is no function of relative speed on a constant spring
    chi: float
    ramp: float  # Half-width of the ramp that slip begins beyond, m/s; 0 for a jump
    spline_fit: Fit = field(repr=False)
    # about the solution; the coordinates of the curve's coefficients are the last unknowns
    linear: LinearisedFit = field(repr=False)
    noise: Array = field(repr=False)  # (runs,) standard deviation of a position, m
    confidence: float
    cpu_s: float

    @property
    def level_assumed(self) -> bool:
        """Whether the record constrains only differences of friction (`fitting.curve.level`)."""
        return self.spline_fit.held_rest is not None

    @property
    def level_known(self) -> bool:
        """Whether the error of the level is less than half of it."""
        return bool(np.median(self.hi - self.lo) < 2 * STATED_ERROR * np.median(self.friction))
