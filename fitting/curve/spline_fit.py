"""A spline as the friction curve, fitted to the measured positions of every window as the laws are.

Unknown are the law's shared parameters but its own level and shape, the coordinates of the curve's coefficients, and
each cycle's own six.  Positions come from `fitting.sensitivity`, with their exact derivatives.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.base.compute.arrays import Array, Mask
from daq.base.measured import Measured
from fitting.curve.coordinates import CurveCoordinates
from fitting.curve.level import (
    REST_SD,
    SEARCH_REST_SD,
    assumed_rest,
    law_scatters,
    levels_scatter,
    moved_to,
    rest_prior,
    unseen,
)
from fitting.curve.starts import CurveStart, own_start, weak_starts
from fitting.estimation.fit import OVERTAKING_FACTOR, Fit, cycle_weights, without_outliers
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.objective import fit_objective, fitted_windows
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.problem import LeastSquaresProblem, cost
from fitting.model import parameters
from fitting.model.parameters import PER_RUN, Global, PerCycle
from fitting.model.problem import level_prior
from fitting.model.windows import ShootingWindows
from fitting.sensitivity import flow
from fitting.sensitivity.columns import local_tangents, shared_tangents, spline_tangents
from fitting.sensitivity.path import Curve, Path, follow, spline_curve, with_coefficients
from fitting.sensitivity.spline import FrictionSpline
from rig_sim.friction.law import LAWS

PIECES, KNOT_POWER = 13, 1.6  # knots s_max u^1.6: denser at low speed, where friction falls; 22 pieces widen the band
FASTEST = 0.998  # quantile of the slip speeds of a cycle at which the last knot lies
START_SPEED_SD = 0.03  # of the belt's speed: how well smoothing knows the velocity where a slip window starts
REACHED = 1.03  # times the noise: no other start can be much better
# From one start on the thinned record: times the noise, most steps, the gain at which it stops, and the first damping.
SEARCH = ((30.0, 8, 1e-2, 1e-4), (4.0, 8, 1e-2, 1e-6), (1.0, 15, 1e-3, 1e-6))
# The valley of the low-speed coefficients is flat: with a first damping of 1e-4 the last steps number nine, not four.
WEIGHTED: dict[str, Any] = {"max_steps": 20, "tolerance": 1e-5, "damping": 1e-8}  # the same with the cycles' weights
FINAL: dict[str, Any] = {"max_steps": 10, "tolerance": 3e-5, "damping": 1e-10}  # the same on every sample
# Most steps where the scatter of the levels determines the rest position: levels and friction are a product, and the
# valley bends.  After 10 steps one contact in ten was still 15 to 20 % off.
FREE_REST_STEPS = 30
MISSED = 1.2  # times the noise: beyond, friction is no curve, and more steps would not make it one
LOST = 3.0  # times the noise as it is assumed first: a start still so far off leads nowhere
HOPELESS = 1e3  # times the lowest cost of a start, both as if the noise were larger: such a start is left out
LEAST_SCATTER, INLIER = 0.01, 0.2


@dataclass(frozen=True, eq=False)
class SplineFit:
    """A spline fitted to the windows of a law's fit.

    Attributes
    ----------
    fit : Fit
        The law's, whose windows, calibrations and contact it has.
    places : tuple of int
        The shared unknowns beside the curve (`fitting.model.parameters`).
    basis : CurveCoordinates
    path : Path
        Along every sample, with the curve.
    task : LeastSquaresProblem
        What the last pass minimised: unknowns are ``places``, then the curve's coordinates.
    solution : Solution
    jacobian : (N, p + 6) f8
        At the solution.
    chi : float
        Weighted rms residual over the noise.
    inlier : (cycles,) bool
        Which cycles fit about as well as the others.
    rest : Measured or None
        Of the first run's spring, where no datum was fitted (`fitting.curve.level`).
    """

    fit: Fit
    places: tuple[int, ...]
    basis: CurveCoordinates
    path: Path
    task: LeastSquaresProblem
    solution: Solution
    jacobian: Array
    chi: float
    inlier: Mask
    rest: Measured | None

    @property
    def spline(self) -> FrictionSpline:
        """The curve."""
        spline = self.path.curve.spline
        if spline is None:
            raise RuntimeError("a spline fit follows a spline")
        return spline

    @property
    def u(self) -> Array:
        """Unknowns of all runs, (13 runs,)."""
        return self.path.u

    def scatters(self, noise: Array) -> bool:
        """Return `fitting.curve.level.levels_scatter` by the friction at the belt's speed; ``noise`` is (runs,)."""
        friction = float(self.spline(self.u[[Global.V_DR]])[0])
        return levels_scatter(self.solution, self.inlier, friction / float(self.u[Global.K]), noise)

    def linearised(self) -> LinearisedFit:
        """Return the problem made linear at the solution; the curve's coordinates are the last unknowns.

        A rest position that was assumed does not show in the motion, and is as uncertain as assumed.
        """
        task, p = self.task, self.solution.u.size
        shared, precision = np.ascontiguousarray(self.jacobian[:, :p]), task.precision.copy()
        if self.rest is not None:
            place, beside = self.places.index(Global.DATUM), unseen(self.places, self.path)
            shared[:, place] = -np.einsum("ij,j->i", shared[:, : beside.size], beside)
            precision[place] = 1 / self.rest.sd**2
        return LinearisedFit(
            shared=shared,
            local=np.ascontiguousarray(self.jacobian[:, p:]),
            residual=self.solution.residual,
            rows=task.rows,
            weights=task.weights,
            prior_precision=np.diag(precision),
            prior_gradient=precision * (self.solution.u - task.prior),
            local_precision=task.local_precision,
            local_gradient=task.local_precision * (self.solution.local - task.local_prior),
        )


def fit_spline(fit: Fit, noise: Array) -> SplineFit | None:
    """Fit a spline on the contact (jump or ramp) of a law's fit; None where its flow cannot be followed.

    Parameters
    ----------
    fit : Fit
        The best law of that contact.
    noise : (runs,) f8
        Standard deviation of one position of each run, m.
    """
    rest = assumed_rest(fit)
    if rest is None:
        return _fit_spline(fit, noise, None)
    # the residuals of a wrong law can make its levels scatter: the curve decides
    scatter = law_scatters(fit, noise)
    found = _fit_spline(fit, noise, None if scatter else rest)
    if found is None or found.scatters(noise) == scatter:
        return found
    return _fit_spline(fit, noise, rest if scatter else None)


def _fit_spline(fit: Fit, noise: Array, rest: Measured | None) -> SplineFit | None:
    """Fit a spline with the rest position that is assumed, or with that which the record shows."""
    problem, law = fit.problem, LAWS[fit.law]
    places = tuple(place for place in fit.active if place % PER_RUN not in (Global.LOG_F, Global.SHAPE))
    knots = _knots(fit)
    curve = spline_curve(FrictionSpline.over(knots), bool(law.ramp))
    own = own_start(fit, curve)
    if rest is not None:
        u, coefficients = moved_to(own.u, own.coefficients, rest, ramp=bool(law.ramp))
        own = CurveStart(u, coefficients, own.local)
        own.local[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = 0.0
        fit = replace(fit, u=u)
    datums = np.array([place % PER_RUN == Global.DATUM for place in places])
    offset = np.where(datums, -fit.values.K / fit.runs, 0.0)
    basis = CurveCoordinates.around(own.coefficients, offset, fit.u[list(places)])
    thinned = fitted_windows(problem, thinned=True)

    def task_from(start: CurveStart) -> LeastSquaresProblem:
        return _task(fit, thinned, places, curve, basis, start, noise, rest, SEARCH_REST_SD, flow.SEARCH_STEP)

    best = None
    usual = (fit.cycle_rms / noise[fit.windows.run])[fit.inlier_cycles]
    if float(np.mean(np.log(usual))) < math.log(REACHED):
        # the law leaves nothing but noise: its own curve is next to the minimum, and its outlying cycles are known
        task = task_from(own)
        weighted = replace(task, weights=task.weights * fit.state.weights)
        best = _best_end([own], places, basis, lambda _: weighted, SEARCH[-1:])
    if best is None or not _reached(*best):
        best = _best_end([*weak_starts(fit, curve), own], places, basis, task_from, SEARCH)
    if best is None:
        return None
    task, solution = best
    task = _reweighted(fit, task, solution)
    moved = levenberg_marquardt.minimise(task, solution.u, solution.local, **WEIGHTED)
    solution = solution if moved is None else moved
    start = CurveStart(fit.u, own.coefficients, solution.local)
    full = _task(fit, fit.windows, places, curve, basis, start, noise, rest, REST_SD, flow.LONGEST_STEP)
    weights = task.weights / _task_weights(thinned, noise)
    full = replace(full, weights=full.weights * weights, local_precision=task.local_precision)
    steps = FINAL["max_steps"] if _datum_known(fit) or rest is not None else FREE_REST_STEPS
    final = FINAL | {"max_steps": steps if _usual_chi(task, solution) < MISSED else 2}
    last = levenberg_marquardt.minimise(full, solution.u, solution.local, **final)
    if last is None:
        return None
    jacobian = full.evaluate(last.u, last.local, True)
    path = _path(fit, fit.windows, places, curve, basis, last.u, last.local, flow.LONGEST_STEP)
    if jacobian is None or path is None:
        return None
    w = np.repeat(full.weights, [rows.stop - rows.start for rows in full.rows])
    chi = math.sqrt(float(np.sum(w * last.residual**2) / np.sum(w * noise[fit.windows.run][full.owner] ** 2)))
    return SplineFit(fit, places, basis, path, full, last, jacobian[1], chi, weights > INLIER, rest)


def _datum_known(fit: Fit) -> bool:
    return any(motion.datum_prior is not None for motion in fit.problem.motions)


def _best_end(
    starts: Sequence[CurveStart],
    places: tuple[int, ...],
    basis: CurveCoordinates,
    task_from: Callable[[CurveStart], LeastSquaresProblem],
    search: Sequence[tuple[float, int, float, float]],
) -> tuple[LeastSquaresProblem, Solution] | None:
    """Return the first end of the search that reaches the noise, else the best; None where none can be followed."""
    ranked: list[tuple[float, LeastSquaresProblem, CurveStart, Array]] = []
    for start in starts:
        task = task_from(start)
        u = basis.unknowns(start.u[list(places)], start.coefficients)
        found = task.evaluate(u, start.local, False)
        if found is not None:
            value = cost(_noisier(task, SEARCH[0][0]), u, start.local, found[0])
            ranked.append((value, task, start, u))
    lowest = min((row[0] for row in ranked), default=0.0)
    best: tuple[LeastSquaresProblem, Solution] | None = None
    for value, task, start, u in ranked:
        if value > HOPELESS * lowest:
            continue
        solution = _descend(task, u, start.local, search)
        if solution is None:
            continue
        if best is None or solution.cost < best[1].cost:
            best = task, solution
        if _reached(task, solution):
            break
    return best


def _reached(task: LeastSquaresProblem, solution: Solution) -> bool:
    return solution.outcome == "converged" and _usual_chi(task, solution) < REACHED


def _descend(
    task: LeastSquaresProblem, u: Array, local: Array, search: Sequence[tuple[float, int, float, float]]
) -> Solution | None:
    """Minimise on the thinned record, at first as if the noise were larger: priors then hold what is far off."""
    solution: Solution | None = None
    for factor, max_steps, tolerance, damping in search:
        own = _noisier(task, factor)
        solution = levenberg_marquardt.minimise(
            own, u, local, max_steps=max_steps, tolerance=tolerance, damping=damping
        )
        if solution is None:
            return None
        u, local = solution.u, solution.local
        if _usual_chi(own, solution) > LOST:
            value = cost(task, u, local, solution.residual)
            return replace(solution, cost=value, outcome="no progress")
    return solution


def _noisier(task: LeastSquaresProblem, factor: float) -> LeastSquaresProblem:
    return replace(task, weights=task.weights / factor**2)


def _knots(fit: Fit) -> Array:
    """Return knots from 0 to the fastest slip speed beyond the ramp, m/s."""
    fastest = 0.0
    for number, run in enumerate(fit.problem.runs):
        own = fit.u[PER_RUN * number :]
        width = own[Global.D] if LAWS[fit.law].ramp else 0.0
        for cycle in run.cut.used:
            speed = own[Global.V_DR] - run.motion.velocity[slice(*cycle.slip)]
            if speed.size:
                fastest = max(fastest, float(np.quantile(speed, FASTEST)) - width)
    return np.asarray(fastest * np.linspace(0.0, 1.0, PIECES + 1) ** KNOT_POWER)


def _path(
    fit: Fit,
    windows: ShootingWindows,
    places: tuple[int, ...],
    curve: Curve,
    basis: CurveCoordinates,
    q: Array,
    local: Array,
    longest_step: float,
) -> Path | None:
    u = fit.u.copy()
    u[list(places)] = q[: len(places)]
    own = with_coefficients(curve, basis.coefficients(q))
    return follow(windows, own, parameters.copy_shared(u), local, longest_step=longest_step)


def _task(
    fit: Fit,
    windows: ShootingWindows,
    places: tuple[int, ...],
    curve: Curve,
    basis: CurveCoordinates,
    start: CurveStart,
    noise: Array,
    rest: Measured | None,
    rest_sd: float,
    longest_step: float,
) -> LeastSquaresProblem:
    """Return what is minimised over ``windows``; priors are the law's, those of the curve's coordinates besides."""
    law = fit_objective(fit)
    kept = [fit.active.index(place) for place in places]
    lower, upper, prior, precision = (part[kept] for part in (law.lower, law.upper, law.prior, law.precision))
    for number, run in enumerate(fit.problem.runs):
        place = places.index(PER_RUN * number + Global.DATUM)
        known = rest_prior(run, rest_sd)
        prior[place], precision[place] = known.value, 1 / known.sd**2 if known.sd > 0 else precision[place]
        if number == 0 and rest is not None:
            lower[place] = upper[place] = rest.value
    none = np.full(basis.precision.size, np.inf)

    def evaluate(q: Array, local: Array, derivatives: bool) -> tuple[Array, Array] | None:
        path = _path(fit, windows, places, curve, basis, q, local, longest_step)
        if path is None:
            return None
        if not derivatives:
            return path.residual, np.zeros((0, 0))
        found = np.einsum("ni,ij->nj", spline_tangents(path), basis.slopes)
        found[:, : len(places)] += shared_tangents(path, places)
        return path.residual, np.hstack([found, local_tangents(path)])

    return LeastSquaresProblem(
        evaluate=evaluate,
        rows=windows.rows,
        weights=_task_weights(windows, noise),
        lower=np.concatenate((lower, -none)),
        upper=np.concatenate((upper, none)),
        prior=np.concatenate((prior, 0 * basis.precision)),
        precision=np.concatenate((precision, basis.precision)),
        local_prior=law.local_prior,
        local_precision=_local_precision(fit, law.local_precision, start.local),
        local_upper=np.inf if LAWS[fit.law].ramp else windows.fastest_starts(fit.u),
    )


def _task_weights(windows: ShootingWindows, noise: Array) -> Array:
    return np.asarray(1 / noise[windows.run] ** 2)


def _local_precision(fit: Fit, law: Array, local: Array) -> Array:
    """Return the precisions of the cycles' own unknowns: the law's, but of the start speed and the levels' scatter."""
    found = law.copy()
    belt = np.array([motion.belt_speed for motion in fit.problem.motions])[fit.windows.run]
    found[:, PerCycle.V_SLIP] = 1 / (START_SPEED_SD * belt) ** 2
    return _with_levels(found, fit, _scatter(fit, local))


def _with_levels(precision: Array, fit: Fit, scatter: float) -> Array:
    """Set the precisions of the levels by their scatter, as the priors of the laws do."""
    precision[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = 1 / scatter**2
    precision[fit.windows.overtaking, PerCycle.NEXT_LEVEL] /= OVERTAKING_FACTOR**2
    return precision


def _scatter(fit: Fit, local: Array) -> float:
    """Return the standard deviation of the levels' logarithms that their prior has.

    Without a datum it is a loose one, as for the laws: levels that differ less in proportion, the higher friction is,
    would otherwise pull the datum away and the whole curve up.
    """
    return level_prior(fit.problem.motions) * max(float(np.std(local[:, PerCycle.LEVEL])), LEAST_SCATTER)


def _cycle_chi(task: LeastSquaresProblem, solution: Solution) -> Array:
    """Return each cycle's rms residual over the noise that ``task`` assumes, shape (cycles,)."""
    square = np.add.reduceat(solution.residual**2, task.starts) / np.diff(task.first)
    return np.asarray(np.sqrt(square * task.weights))


def _usual_chi(task: LeastSquaresProblem, solution: Solution) -> float:
    """Return the geometric mean of the cycles' rms residuals over the noise: a few spoilt cycles hardly move it."""
    return float(np.exp(np.mean(np.log(np.maximum(_cycle_chi(task, solution), 1e-6)))))


def _reweighted(fit: Fit, task: LeastSquaresProblem, solution: Solution) -> LeastSquaresProblem:
    """Return the task with less weight on cycles that fit worse than the others, and the levels' scatter as found."""
    chi = _cycle_chi(task, solution)
    weight = without_outliers(cycle_weights(chi, max(_usual_chi(task, solution), 1.0)))
    inlier = weight > INLIER
    scatter = _scatter(fit, solution.local[inlier] if inlier.sum() > 1 else solution.local)
    precision = _with_levels(task.local_precision.copy(), fit, scatter)
    return replace(task, weights=task.weights * weight, local_precision=precision)
