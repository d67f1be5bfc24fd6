"""A departure as a force of a fit: its coefficients, and its scale if scanned, are unknowns."""

import math
from dataclasses import dataclass

import numpy as np

from fitting.forces.departure import Departure, Forcing
from fitting.forces.fitted_motion import FittedMotion
from stickslip.compute.arrays import Array

# Relative step of the derivative by a scale; at 1e-3 its curvature shows, at 1e-6 rounding of the path.
SCALE_STEP = 1e-4
SCALE_RANGE = 0.15  # relative range of a scale: how far a scale may move from where the scan found it


@dataclass(frozen=True, eq=False)
class Force:
    """A force in addition to the law."""

    departure: Departure
    scale: float = math.nan  # its first scale (a frequency, a wavelength); NaN for a departure without one

    def __post_init__(self) -> None:
        if self.departure.scales is not None and not self.scanned:
            raise ValueError(f"{self.departure.name} depends on {self.departure.scale}: scan it first")

    @property
    def scanned(self) -> bool:
        return math.isfinite(self.scale)

    @property
    def width(self) -> int:
        """Number of unknowns: coefficients, then the relative change of the scale."""
        return self.departure.columns + self.scanned

    @property
    def lower(self) -> Array:
        """Lower bounds (width,): a drag dissipates energy; another force may have either sign."""
        least = 0.0 if self.departure.drag is not None else -np.inf
        return np.array([least] * self.departure.columns + [-SCALE_RANGE] * self.scanned)

    @property
    def upper(self) -> Array:
        """Upper bounds (width,)."""
        return np.array([np.inf] * self.departure.columns + [SCALE_RANGE] * self.scanned)

    def coefficients(self, size: Array) -> Array:
        return size[: self.departure.columns]

    def scale_of(self, size: Array) -> float:
        return self.scale * (1 + float(size[-1])) if self.scanned else self.scale

    def forcing(self, motion: FittedMotion, size: Array) -> Forcing:
        """Return the effect of a unit of each coefficient along a motion."""
        return self.departure.forcing(motion, self.scale_of(size))

    def derivatives(self, motion: FittedMotion, size: Array) -> list[Forcing]:
        """Return the effect of a unit of each unknown: coefficients, then the scale's relative change."""
        scale = self.scale_of(size)
        forcing = self.departure.forcing(motion, scale)
        if not self.scanned:
            return [forcing]
        beside = self.departure.forcing(motion, scale * (1 + SCALE_STEP))
        along = self.coefficients(size) / (self.scale / scale * SCALE_STEP)
        parts = [
            None if near is None or far is None else np.einsum("nk,k->n", far - near, along)[:, np.newaxis]
            for near, far in zip(forcing, beside, strict=True)
        ]
        return [forcing, Forcing(*parts)]
