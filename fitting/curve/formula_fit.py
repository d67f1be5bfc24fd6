"""A law given as a formula, fitted by the driver to the positions of every window.

Windows, noise and calibrations are those of the measured curve, so that the fit differs from it in the curve alone.
The search starts where the measured curve ended, and where the best law did.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from daq.base.compute.arrays import Array
from daq.base.compute.distributions import student_quantile
from daq.base.measured import Measured
from fitting.curve.band import covariances
from fitting.curve.forms import GRID, metric_of
from fitting.curve.spline_fit import SplineFit
from fitting.data.cycles import Cycle
from fitting.driver.driver import best_end, start_beside
from fitting.driver.fit import TaskFit
from fitting.driver.formula import BEYOND, FormulaCurve, Target
from fitting.driver.passes import finish
from fitting.driver.task import KNOT_POWER, OF_THE_LAW, Task
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.result import Parameter
from fitting.law import Law
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.problem import LeastSquaresProblem
from fitting.model.parameters import NUISANCE, PER_RUN, Global
from fitting.model.problem import EstimationProblem
from fitting.model.windows import ShootingWindows

LEAST_SHOWN = 1e-6  # of a prior's precision: a record that adds less shows nothing of the unknown


@dataclass(frozen=True, eq=False)
class FormulaFit:
    """A law as a formula, fitted to the windows of a measured curve.

    Attributes
    ----------
    formula : Law
    host : SplineFit
        The measured curve that the fit began at.
    friction : FormulaCurve
    at : TaskFit
        Where the driver ended; unknowns are those of ``places``, then theta.
    """

    formula: Law
    host: SplineFit
    friction: FormulaCurve
    at: TaskFit

    @property
    def places(self) -> tuple[int, ...]:
        """The shared unknowns beside the formula's own."""
        return self.at.task.places

    @property
    def solution(self) -> Solution:
        """Where the last pass stopped."""
        return self.at.solution

    @property
    def task(self) -> LeastSquaresProblem:
        """What the last pass minimised."""
        return self.at.problem

    @property
    def cpu_s(self) -> float:
        """CPU time of the fit, s."""
        return self.at.cpu_s

    @property
    def law(self) -> str:
        """The law's name."""
        return self.formula.name

    @property
    def windows(self) -> ShootingWindows:
        """The windows that were fitted."""
        return self.at.windows

    @property
    def rows(self) -> tuple[slice, ...]:
        """The residuals of each cycle."""
        return self.windows.rows

    @property
    def residual(self) -> Array:
        """Model minus measurement, m, (N,)."""
        return self.at.residual

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        """The cycles that were fitted."""
        return self.host.fit.cycles

    @property
    def inlier_cycles(self) -> NDArray[np.bool_]:
        """Which cycles (cycles,) fit about as well as the others."""
        return self.at.noise.inliers

    @property
    def cycle_rms(self) -> Array:
        """Rms residual of each cycle, m."""
        return self.windows.rms(self.residual)

    @property
    def rms(self) -> float:
        """Root mean square of all residuals, m."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def geometric_mean_rms(self) -> float:
        """Geometric mean of the cycles' errors, m."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    @property
    def theta(self) -> Array:
        """Unknowns (k,) of the formula."""
        return self.solution.u[len(self.places) :]

    @property
    def values(self) -> dict[str, float]:
        """The formula's parameters by name, per unit mass."""
        return self.friction.values(self.theta)

    @property
    def law_parameters(self) -> int:
        """Number of the law's own shared unknowns, as `fitting.estimation.fit.Fit.law_parameters` counts them.

        Where the rest position is assumed, a constant of the formula stands for it, and no law pays for that.
        """
        own = len(self.formula.free) - (self.host.rest is not None)
        return sum(place % PER_RUN not in NUISANCE for place in self.places) + own

    @property
    def calibration_deviations(self) -> Array:
        """How far the unknowns are from their calibrations, in standard deviations; 0 where there is none."""
        places, motions = self.places, self.host.fit.problem.motions
        off = np.abs(self.solution.u - self.task.prior) * np.sqrt(self.task.precision)
        guessed = [
            place % PER_RUN == Global.DATUM and motions[place // PER_RUN].datum_prior is None for place in places
        ]
        return np.where(guessed, 0.0, off[: len(places)])

    def for_run(self, run: int) -> "_RunResiduals":
        """Return the residuals of one run."""
        own = np.flatnonzero(self.windows.run == run)
        parts = self.windows.parts
        return _RunResiduals(
            parts[run] if parts else self.windows,
            np.concatenate([self.residual[self.rows[k]] for k in own]),
            tuple(self.cycles[k] for k in own),
        )

    @cached_property
    def variances(self) -> Array:
        """Variances (p,) of the shared unknowns: the larger of those by the noise and by the scatter of the cycles."""
        linear = LinearisedFit.at(self.at)
        if linear is None:
            raise RuntimeError("the fit of a formula has a path")
        return np.asarray(np.maximum(np.max([np.diag(found) for found in covariances(linear)], axis=0), 0.0))

    def without_prior(self, slot: Global, run: int = 0) -> Measured | None:
        """Return what the record alone shows of an unknown with a prior; None where there is none, or nothing shown."""
        place = PER_RUN * run + slot
        index = self.places.index(place if place in self.places else slot)
        weight, variance = float(self.task.precision[index]), float(self.variances[index])
        alone = 1 / variance - weight if variance > 0 else 0.0
        if weight == 0 or alone <= LEAST_SHOWN * weight:
            return None
        value = float(self.solution.u[index])
        return Measured(value + weight * (value - float(self.task.prior[index])) / alone, math.sqrt(1 / alone))

    def parameters(self, alpha: float) -> dict[str, Parameter]:
        """Return k/m and the formula's parameters, with intervals of confidence 1 - alpha; per unit mass."""
        error = np.sqrt(self.variances)
        quantile = student_quantile(1 - alpha / 2, max(len(self.rows) - 1, 1))
        u, places = self.solution.u, list(self.places)
        found = {"k/m": _interval(float(u[0]), float(error[places.index(Global.K)]), quantile, "s^-2")}
        place = places.index(Global.V_DR)
        found["v_dr"] = _interval(float(u[place]), float(error[place]), quantile, "m/s")
        for name in self.formula.curve.parameters:
            if name not in self.formula.free:
                value = self.values[name]
                found[name] = Parameter(value, 0.0, value, value, self.formula.unit(name))
                continue
            k = self.formula.free.index(name)
            own, value = float(error[len(places) + k]), self.values[name]
            if self.friction.by_log[k]:
                lo, hi = (value * math.exp(min(max(sign * quantile * own, -700.0), 700.0)) for sign in (-1, 1))
                found[name] = Parameter(value, value * own, lo, hi, self.formula.unit(name))
            else:
                found[name] = _interval(value, own, quantile, self.formula.unit(name), *self.formula.limits(name))
        return found


@dataclass(frozen=True, eq=False)
class _RunResiduals:
    """What a fit leaves of one run."""

    windows: ShootingWindows
    residual: Array
    cycles: tuple[Cycle, ...]

    @property
    def rows(self) -> tuple[slice, ...]:
        """The residuals of each cycle."""
        return self.windows.rows


def _interval(
    value: float, error: float, quantile: float, unit: str, low: float = -math.inf, high: float = math.inf
) -> Parameter:
    lo, hi = max(value - quantile * error, low), min(value + quantile * error, high)
    return Parameter(value, error, lo, hi, unit)


def fit_formula(law: Law, host: SplineFit, start: dict[str, float] | None = None) -> FormulaFit | None:
    """Fit a law to the runs of the measured curve; None where its motion cannot be followed.

    Parameters
    ----------
    law : Law
        With a jump or a ramp of its own.
    host : SplineFit
        The measured curve.
    start : dict of str to float, optional
        First values of free parameters, per unit mass.

    Raises
    ------
    InputError
        Where no value of the parameters makes a friction.
    """
    given = law if start is None else replace(law, start=start)
    fastest = BEYOND * (float(host.spline.knots[-1]) + (0.0 if law.ramp else _ramp_width(host)))
    curve = FormulaCurve(given, fastest, _target(host))
    problem = _problem(law, host)
    places = tuple(place for place in problem.active if place % PER_RUN not in OF_THE_LAW)
    task = Task(problem, curve, places)
    beside = start_beside(task, host.at)
    begin = beside._replace(q=np.concatenate([beside.q[: len(places)], curve.start]))
    settled = best_end(task, [(begin, host.at.noise.without_fade), (begin, None)], host.noise)
    found = None if settled is None else finish(settled, host.noise) or settled
    return None if found is None or found.path is None else FormulaFit(law, host, curve, found)


def _target(host: SplineFit) -> Target:
    """Return the measured curve, in the metric of the record (`fitting.curve.forms.Metric`)."""
    metric, fastest = metric_of(host, host.linearised()), float(host.spline.knots[-1])
    s = fastest * np.linspace(0.0, 1.0, GRID) ** KNOT_POWER
    root = np.einsum("mn,nk->mk", metric.root, host.spline.projection(s))
    return Target(s, root, metric.aim, float(np.median(host.spline.coefficients)))


def _ramp_width(host: SplineFit) -> float:
    return float(host.u[Global.D]) if host.path.curve.ramp else 0.0


def _problem(law: Law, host: SplineFit) -> EstimationProblem:
    """Return the measured curve's problem, on the contact of the law."""
    problem = host.at.task.problem
    if law.ramp == problem.ramp:
        return problem
    other = EstimationProblem.build(6 if law.ramp else 5, problem.runs)
    datum = [PER_RUN * run + Global.DATUM for run in range(len(problem.runs))]
    changed = {}
    for name in ("start", "prior", "precision", "lower", "upper"):
        values = getattr(other, name).copy()
        values[datum] = getattr(problem, name)[datum]
        changed[name] = values
    return replace(other, **changed)
