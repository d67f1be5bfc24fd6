"""A law given as a formula, fitted to the positions of every window from the end of the measured curve's fit.

Where nothing is known of the parameters they start from the measured curve itself (`fitting.curve.formula_start`).

The motion is followed along a spline through the formula, whose knots are set closer until it errs by less than
`TOLERANCE` of the friction; its derivatives by the parameters are the formula's own.  Everything else (windows, noise,
weights of the cycles, calibrations) is that of the measured curve, so that the fit differs from it in the curve alone.

A parameter that bends the curve and is never negative is fitted by its logarithm.  A trial whose formula is not finite
or is negative at a speed of the motion is refused as one that cannot be followed.
"""

import math
import time as clock
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.base.compute.arrays import Array
from daq.base.compute.distributions import student_quantile
from daq.base.errors import InputError
from daq.base.measured import Measured
from fitting.curve.band import covariances, curve_columns, seen_speeds
from fitting.curve.formula_start import FormulaStart, Target, find_starts
from fitting.curve.level import REST_SD, rest_prior
from fitting.curve.spline_fit import FINAL, SplineFit
from fitting.data.cycles import Cycle
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.result import Parameter
from fitting.law import Law
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.problem import LeastSquaresProblem
from fitting.model import parameters
from fitting.model.parameters import NUISANCE, PER_RUN, Global
from fitting.model.windows import ShootingWindows
from fitting.sensitivity import flow
from fitting.sensitivity.columns import local_tangents, shared_tangents
from fitting.sensitivity.path import Path, follow, spline_curve
from fitting.sensitivity.spline import FrictionSpline
from fitting.sensitivity.tangents import tangents
from rig_sim.flow.modes import STICK

TOLERANCE = 1e-6  # of the largest friction: how far the spline may be from the formula
FIRST_PIECES, KNOT_POWER = 24, 1.8  # knots s_max u^1.8, before they are set closer where the curve bends most
MOST_PIECES = 300  # a power with an infinite slope at rest takes 150; more are a curve with a corner
PER_PIECE = 6  # speeds of each piece at which the spline is put through the formula, and compared with it
BEYOND = 1.1  # of the measured curve's last knot: slips of the fit may be a little faster
STEPS: dict[str, Any] = FINAL | {"max_steps": 40, "damping": 1e-6}  # a form leaves the measured curve by a few bands
DOUBLED = 2.0  # of a parameter: whether the derivative by it changes then shows whether it bends the curve
LEAST_SHOWN = 1e-6  # of a prior's precision: a record that adds less shows nothing of the unknown
SAME = 1e-9  # of a derivative: less is rounding
LEVEL = 1e-6  # of a constant: what is left of it beside the derivatives of a formula that has one
FREE_LEVEL_STEPS = 80  # most steps where the level of a formula without a constant determines the rest position


class FormulaFriction:
    """A law's formula as the friction that a path is followed with.

    Unknowns theta (k,) stand for the law's free parameters: the value, or its logarithm (``by_log``).
    """

    def __init__(self, law: Law, fastest: float, start: dict[str, float], *, ramp: bool) -> None:
        self.law, self.fastest, self.ramp = law, fastest, ramp
        self._speeds = np.linspace(0.0, fastest, 41)
        self.by_log = np.array([self._bends(name, start) and law.limits(name)[0] >= 0.0 for name in law.free])
        self.start = self.theta(start)
        self._through(fastest * np.linspace(0.0, 1.0, FIRST_PIECES + 1) ** KNOT_POWER)

    def values(self, theta: Array) -> dict[str, float]:
        """Return the parameters by name."""
        free = np.where(self.by_log, np.exp(np.clip(theta, -700.0, 700.0)), theta)
        return dict(self.law.fix or {}) | dict(zip(self.law.free, free.tolist(), strict=True))

    def theta(self, values: dict[str, float]) -> Array:
        """Return the unknowns (k,) of parameters."""
        free = np.array([values[name] for name in self.law.free])
        return np.where(self.by_log, np.log(np.where(self.by_log, free, 1.0)), free)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (k,) of the unknowns."""
        lower, upper = np.array([self.law.limits(name) for name in self.law.free]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.by_log, np.log(lower), lower), np.where(self.by_log, np.log(upper), upper)

    def friction(self, theta: Array, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,), m/s.

        Raises
        ------
        InputError
            Where it is not finite, or negative.
        """
        found = self.law.curve.value(s, self.values(theta))
        if found.min() < 0:
            at = self.law.curve.place(float(s[np.argmin(found)]), self.values(theta))
            what = f"law {self.law.name}: friction is negative, {found.min():.4g} m/s^2, {at}"
            raise InputError(what, "formula", "give bounds, or a form that stays above 0")
        return found

    def slopes(self, theta: Array, s: Array) -> Array:
        """Return the derivatives (k, unknowns) of friction at slip speeds s (k,) by the unknowns."""
        values = self.values(theta)
        found = self.law.curve.gradient(s, values, self.law.free)
        return np.asarray(found * np.where(self.by_log, [values[name] for name in self.law.free], 1.0))

    def spline(self, theta: Array) -> FrictionSpline | None:
        """Return a spline through the formula; None where it is no friction, or too abrupt to be followed."""
        while True:
            try:
                target = self.friction(theta, self._at)
            except InputError:
                return None
            found = self._spline.with_coefficients(np.einsum("ij,j->i", self._project, target))
            away = np.abs(found(self._at) - target) > TOLERANCE * target.max()
            if not away.any():
                return found
            knots = self._spline.knots
            bad = np.unique(np.clip(np.searchsorted(knots, self._at[away], side="right") - 1, 0, knots.size - 2))
            if knots.size + bad.size > MOST_PIECES:
                return None
            self._through(np.sort(np.concatenate((knots, 0.5 * (knots[bad] + knots[bad + 1])))))

    def _through(self, knots: Array) -> None:
        """Make splines through the formula with these knots."""
        parts = [np.linspace(a, b, PER_PIECE, endpoint=False) for a, b in pairwise(knots)]
        self._at = np.append(np.concatenate(parts), knots[-1])
        self._spline = FrictionSpline.over(knots)
        self._project = np.linalg.pinv(self._spline.basis(self._at))

    def _bends(self, name: str, start: dict[str, float]) -> bool:
        whole = dict(self.law.fix or {}) | start
        first, other = (
            self.law.curve.gradient(self._speeds, whole | {name: factor * whole[name]}, (name,))
            for factor in (1.0, DOUBLED)
        )
        return bool(np.any(np.abs(first - other) > SAME * np.max(np.abs(first))))


@dataclass(frozen=True, eq=False)
class FormulaFit:
    """A law as a formula, fitted to the windows of a measured curve.

    Attributes
    ----------
    formula : Law
    host : SplineFit
        The measured curve that the fit began at.
    friction : FormulaFriction
    solution : Solution
        Unknowns are those of ``host.places``, then theta.
    path : Path
    jacobian : (N, p + 6) f8
    task : LeastSquaresProblem
    cpu_s : float
    """

    formula: Law
    host: SplineFit
    friction: FormulaFriction
    solution: Solution
    path: Path
    jacobian: Array
    task: LeastSquaresProblem
    cpu_s: float

    @property
    def places(self) -> tuple[int, ...]:
        """The shared unknowns beside the formula's own."""
        return self.host.places

    @property
    def level_held(self) -> bool:
        """Whether the rest position is assumed, since the formula has a constant that stands for it."""
        place = self.places.index(Global.DATUM)
        return self.host.rest is not None and bool(self.task.lower[place] == self.task.upper[place])

    @property
    def law(self) -> str:
        """The law's name."""
        return self.formula.name

    @property
    def windows(self) -> ShootingWindows:
        """The windows that were fitted."""
        return self.path.windows

    @property
    def rows(self) -> tuple[slice, ...]:
        """The residuals of each cycle."""
        return self.windows.rows

    @property
    def residual(self) -> Array:
        """Model minus measurement, m, (N,)."""
        return self.solution.residual

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        """The cycles that were fitted."""
        return self.host.fit.cycles

    @property
    def inlier_cycles(self) -> NDArray[np.bool_]:
        """Which cycles (cycles,) fit about as well as the others."""
        return self.host.inlier

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
        return self.solution.u[len(self.host.places) :]

    @property
    def values(self) -> dict[str, float]:
        """The formula's parameters by name, per unit mass."""
        return self.friction.values(self.theta)

    @property
    def law_parameters(self) -> int:
        """Number of the law's own shared unknowns, as `fitting.estimation.fit.Fit.law_parameters` counts them.

        Where the rest position is assumed, a constant of the formula stands for it, and no law pays for that.
        """
        own = len(self.formula.free) - self.level_held
        free = self.task.lower < self.task.upper
        shared = (place % PER_RUN not in NUISANCE and own for place, own in zip(self.places, free, strict=False))
        return int(sum(shared) + own)

    @property
    def calibration_deviations(self) -> Array:
        """How far the unknowns are from their calibrations, in standard deviations; 0 where there is none."""
        places, motions = self.host.places, self.host.fit.problem.motions
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

    def linearised(self) -> LinearisedFit:
        """Return the problem made linear at the solution; the formula's unknowns are the last of the shared ones."""
        return LinearisedFit(
            shared=np.ascontiguousarray(self.jacobian[:, : self.solution.u.size]),
            local=np.ascontiguousarray(self.jacobian[:, self.solution.u.size :]),
            residual=self.residual,
            rows=self.rows,
            weights=self.task.weights,
            prior_precision=np.diag(self.task.precision),
            prior_gradient=self.task.precision * (self.solution.u - self.task.prior),
            local_precision=self.task.local_precision,
            local_gradient=self.task.local_precision * (self.solution.local - self.task.local_prior),
        )

    @cached_property
    def covariances(self) -> Array:
        """Covariances (2, p, p) of the shared unknowns, by the noise and by the scatter of the cycles."""
        return np.array(covariances(self.linearised()))

    @cached_property
    def variances(self) -> Array:
        """Variances (p,) of the shared unknowns: the larger of the two."""
        return np.asarray(np.maximum(np.einsum("spp->sp", self.covariances).max(axis=0), 0.0))

    def without_prior(self, slot: Global, run: int = 0) -> Measured | None:
        """Return what the record alone shows of an unknown with a prior; None where there is none, or nothing shown."""
        place = PER_RUN * run + slot
        index = self.host.places.index(place if place in self.host.places else slot)
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
        u, places = self.solution.u, list(self.host.places)
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


def fit_formula(law: Law, host: SplineFit, start: FormulaStart | None = None) -> FormulaFit | None:
    """Fit a law from the measured curve's end; None where its motion cannot be followed.

    Parameters
    ----------
    law : Law
        On the contact of the measured curve: a jump or a ramp.
    host : SplineFit
    start : FormulaStart, optional
        Where its parameters start, per unit mass; without, nearest to the measured curve.

    Raises
    ------
    InputError
        The formula is no friction curve with any of the values tried.
    """
    begun = clock.process_time()
    ramp = bool(host.path.curve.ramp)
    p = len(host.places)
    begin = host.solution.u[:p].copy()
    start = starts_near(law, host)[0] if start is None else start
    begin += [start.offset / host.u[Global.K] if _guessed(host, place) else 0.0 for place in host.places]
    friction = FormulaFriction(law, BEYOND * float(host.spline.knots[-1]), start.values, ramp=ramp)
    task = _with_given(host, law)
    if host.rest is not None and not _has_constant(friction):
        task = _with_free_rest(host, task)

    def path(q: Array, local: Array) -> Path | None:
        spline = friction.spline(q[p:])
        if spline is None:
            return None
        u = host.u.copy()
        u[list(host.places)] = q[:p]
        curve = spline_curve(spline, ramp)
        return follow(host.path.windows, curve, parameters.copy_shared(u), local, longest_step=flow.LONGEST_STEP)

    def evaluate(q: Array, local: Array, derivatives: bool) -> tuple[Array, Array] | None:
        found = path(q, local)
        if found is None:
            return None
        if not derivatives:
            return found.residual, np.zeros((0, 0))
        try:
            own = _formula_tangents(found, friction, q[p:])
        except InputError:  # a derivative that is not finite
            return None
        return found.residual, np.hstack([shared_tangents(found, host.places), own, local_tangents(found)])

    none = np.zeros(len(law.free))
    lower, upper = friction.bounds
    own = replace(
        task,
        evaluate=evaluate,
        some=None,
        lower=np.concatenate((task.lower[:p], lower)),
        upper=np.concatenate((task.upper[:p], upper)),
        prior=np.concatenate((task.prior[:p], none)),
        precision=np.concatenate((task.precision[:p], none)),
    )
    steps = STEPS if task.lower is host.task.lower else STEPS | {"max_steps": FREE_LEVEL_STEPS}
    first = np.concatenate((begin, friction.start))
    solution = levenberg_marquardt.minimise(own, first, host.solution.local, **steps)
    if solution is None:
        return None
    last, there = path(solution.u, solution.local), own.evaluate(solution.u, solution.local, True)
    if last is None or there is None:
        return None
    return FormulaFit(law, host, friction, solution, last, there[1], own, clock.process_time() - begun)


def starts_near(law: Law, host: SplineFit) -> list[FormulaStart]:
    """Return where a law's parameters may start, nearest to the measured curve first.

    Raises
    ------
    InputError
        The formula is no friction curve with any of the values tried.
    """
    target = measured_target(host)
    return find_starts(law, target, BEYOND * float(host.spline.knots[-1]) / target.fastest)


def measured_target(host: SplineFit) -> Target:
    """Return the measured curve as what a formula starts near: its shape, and how well its level is known."""
    speeds = seen_speeds(host)
    columns = curve_columns(host, speeds)
    level = columns.mean(axis=0)
    both = covariances(host.linearised())
    shape = [np.einsum("kp,pq,kq->k", columns - level, one, columns - level) for one in both]
    of_level = max(float(np.einsum("p,pq,q->", level, one, level)) for one in both)
    friction = host.spline(speeds)
    sd = np.sqrt(np.maximum(np.max(shape, axis=0), (TOLERANCE * float(np.max(np.abs(friction)))) ** 2))
    return Target(speeds, friction, sd, math.sqrt(max(of_level, 0.0)))


def _guessed(host: SplineFit, place: int) -> bool:
    """Return whether a shared unknown is a rest position that no calibration gives."""
    run, slot = divmod(place, PER_RUN)
    return slot == Global.DATUM and host.fit.problem.motions[run].datum_prior is None


def _has_constant(friction: FormulaFriction) -> bool:
    """Return whether a constant can be added to the formula by its parameters: it then hides the rest position."""
    speeds = np.linspace(0.0, friction.fastest, 41)
    slopes = friction.slopes(friction.start, speeds)
    slopes = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    one = np.ones(speeds.size)
    left = one - np.einsum("kp,p->k", slopes, np.linalg.lstsq(slopes, one, rcond=None)[0])
    return bool(np.max(np.abs(left)) < LEVEL)


def _with_free_rest(host: SplineFit, task: LeastSquaresProblem) -> LeastSquaresProblem:
    """Return the host's task with the rest position of its first run free again, about as well known as nothing."""
    place = host.places.index(Global.DATUM)
    lower, upper, precision, prior = (own.copy() for own in (task.lower, task.upper, task.precision, task.prior))
    known = rest_prior(host.fit.problem.runs[0], REST_SD)
    lower[place], upper[place] = -np.inf, np.inf
    prior[place], precision[place] = known.value, known.sd**-2.0
    return replace(task, lower=lower, upper=upper, prior=prior, precision=precision)


def _with_given(host: SplineFit, law: Law) -> LeastSquaresProblem:
    """Return the host's task with what the user gives of a formula's law beside its own parameters."""
    problem = host.fit.problem.with_given(law.name)
    if problem is host.fit.problem:
        return host.task
    index, p = list(host.places), len(host.places)
    given = (problem.lower != host.fit.problem.lower) | (problem.upper != host.fit.problem.upper)
    changed = {}
    for name in ("lower", "upper", "prior", "precision"):
        own = getattr(host.task, name).copy()
        own[:p] = np.where(given[index], getattr(problem, name)[index], own[:p])
        changed[name] = own
    return replace(host.task, **changed)


def _formula_tangents(path: Path, friction: FormulaFriction, theta: Array) -> Array:
    """Return the derivatives of the positions by the unknowns of the formula, shape (N, k)."""
    spline = path.curve.spline
    if spline is None:
        raise RuntimeError("the path of a formula follows a spline")
    at_rest = float(spline.coefficients[0])
    d = path.unknown(Global.D) if path.curve.ramp else 0.0
    q = path.unknown(Global.COMPLIANCE) * np.exp(path.unknown(Global.LOG_F)) / path.unknown(Global.K)
    giving = 1 - q * path.friction_slope / path.level if np.any(q) else 1.0
    slips = path.slips
    forces = np.zeros((path.time.size, theta.size))
    speed = np.clip(path.slip_speed[slips], 0.0, friction.fastest)
    side = np.broadcast_to(path.level * path.side * giving, path.time.shape)[slips]
    forces[slips] = side[:, None] * friction.slopes(theta, speed)
    rest = friction.slopes(theta, np.zeros(1))[0]
    if path.curve.ramp or np.any(q):
        ramp = ~slips & (path.mode != STICK)
        share = path.friction / at_rest * (d / np.maximum(d + q * at_rest, 1e-300))
        forces[ramp] = share[ramp][:, None] * rest
    edge = np.broadcast_to(q, path.time.shape)[path.first_point[:-1]][:, None] * rest
    return tangents(path, forces, edge=edge)
