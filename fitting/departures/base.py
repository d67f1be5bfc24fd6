"""The base of the tests for departures: a fit of a law or of the free curve, made linear about its solution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.driver.fit import Fit
from fitting.driver.model import Model
from fitting.estimation.linearised import LinearisedFit
from fitting.forces.departure import Forcing
from fitting.forces.fitted_motion import FittedMotion
from fitting.sensitivity.flow import SEARCH_STEP
from fitting.sensitivity.path import Path
from fitting.sensitivity.tangents import tangents
from stickslip.compute.arrays import Array


@dataclass(frozen=True, eq=False)
class Base:
    fit: Fit
    linear: LinearisedFit
    path: Path
    motion: FittedMotion

    @classmethod
    def at(
        cls,
        fit: Fit,
        records: Sequence[MeasuredMotion],
        revolution: float | None = None,
        linear: LinearisedFit | None = None,
    ) -> "Base | None":
        """Linearise a fit, unless it comes linearised; None where the motion near its solution cannot be followed.

        ``revolution`` is the encoder's travel per revolution, m, if calibrated.
        """
        linear, path = LinearisedFit.at(fit) if linear is None else linear, fit.path
        if linear is None or path is None or not math.isfinite(linear.cost):
            return None
        return cls(fit, linear, path, FittedMotion.from_path(path, records, linear.residual, revolution))

    def thinned(self) -> "Base":
        """Return the base on the samples of a first pass, which suffice to choose a scale."""
        windows = self.fit.task.problem.windows(thinned=True)
        model = Model(self.fit.task, windows, SEARCH_STEP)
        residual = model.residual(self.fit.q, self.fit.local)
        if residual is None:
            return self
        thin = replace(self.fit, model=model, residual=residual)
        return Base.at(thin, self.motion.records, self.motion.revolution) or self

    def respond(self, forcings: Sequence[Forcing]) -> Array:
        """Return the response of the positions to forcings of one kind, shape (N, columns of all)."""
        acceleration, belt_speed, reading = (
            None if parts[0] is None else np.hstack(parts) for parts in zip(*forcings, strict=True)
        )
        if acceleration is None and belt_speed is None and reading is not None:
            return reading
        columns = acceleration if belt_speed is None else np.zeros_like(belt_speed)
        if columns is None:
            raise ValueError("a forcing without any effect")
        return tangents(self.path, columns, belt_speed=belt_speed, position=reading)

    def misfit_beyond_noise(self, noise: float) -> float:
        """Return the cost of the residuals above that of the noise, m, which a departure can at most explain."""
        weights = np.repeat(self.linear.weights, np.diff(self.linear.first))
        return max(0.5 * float(np.sum(weights * (self.linear.residual**2 - noise**2))), 0.0)


def usual_rms(residual: Array, rows: Sequence[slice]) -> float:
    """Return the median of the cycles' errors, m, which spoilt cycles do not move."""
    return math.sqrt(float(np.median([np.mean(residual[cycle] ** 2) for cycle in rows])))
