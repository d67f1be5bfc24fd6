"""The model-free friction curve of a record: its fit, its level, and its simultaneous band.

A free spline is fitted to the measured positions of every window. The unknowns are the shared parameters of a law
except its level and shape, the coordinates of the spline, and six unknowns of each cycle. The search starts from a
law's fit and from the regression of the smoothed slips.

The motion determines K datum + friction. Without a calibrated datum only effects proportional to friction separate the
two: levels that scatter or wear, a ramp's creep, a belt that slows under load. Without these, curve and datum are
confounded: they can move together without any change of the motion. The level is then assumed, not fitted. The spring
is assumed relaxed where a record begins at rest below the middle of the motion, else at the lowest position, so that
friction is nowhere negative. Band and parameters include the uncertainty of the rest position (`CURVE_REST_SD`).

The simultaneous band contains the whole curve. Its factor is the quantile of the largest deviation over all speeds, in
standard deviations, from normal draws. As for the laws' parameters, the larger of two covariances is used: from the
noise, and from the scatter of the cycles' gradients (sandwich).

Not modelled: friction that depends on anything but relative speed and its level in each cycle.
"""

import math
import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from fitting import noise_levels
from fitting.judge.linearised import LinearisedFit
from fitting.judge.parameters import STATED_ERROR, Parameter
from fitting.least_squares import elimination
from fitting.least_squares.normal_equations import eigen
from fitting.model.path import Curve, FrictionSpline
from fitting.model.predict import FitStart, Task, curve_knots, free_curve, free_curve_task, regress_curve
from fitting.model.problem import EstimationProblem, rest_calibration
from fitting.model.unknowns import PER_RUN, Global, PerCycle
from fitting.search.exchange import settle_from_starts
from fitting.search.fit import Fit
from fitting.search.formula import Target
from fitting.search.passes import finish, start_from_regression
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled
from stickslip.units import Measured


@dataclass(frozen=True)
class BandExit:
    """The largest distance of a law from the band; means are subtracted if the level is poorly constrained."""

    half_widths: float  # below 1 the law is inside the band
    speed: float  # m/s


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Model-free friction per unit mass against relative speed, with a simultaneous band."""

    speed: Array = field(repr=False)  # (k,) relative speed, m/s, from a few percent of the largest slip speed
    friction: Array = field(repr=False)  # (k,) m/s^2, at the mean level of the record
    lo: Array = field(repr=False)  # (k,) the simultaneous band
    hi: Array = field(repr=False)
    shape_half: Array = field(repr=False)  # (k,) half-width of the band for the curve less its mean over the speeds
    k_over_m: Parameter  # 1/s^2
    chi: float  # weighted rms residual over the noise; far above 1 if friction depends on more than relative speed
    ramp: float  # half-width of the ramp, m/s; 0 for a jump
    spline_fit: Fit = field(repr=False)
    linear: LinearisedFit = field(repr=False)  # the curve's coordinates are the last unknowns
    noise: Array = field(repr=False)  # (runs,) standard deviation of a position, m
    confidence: float
    cpu_s: float

    @property
    def level_assumed(self) -> bool:
        """Whether the data constrain only differences of friction."""
        return self.spline_fit.assumed_rest is not None

    @property
    def level_known(self) -> bool:
        """Whether the error of the level is less than half of it."""
        return bool(np.median(self.hi - self.lo) < 2 * STATED_ERROR * np.median(self.friction))


# Standard deviation of an assumed rest position over the travel: if friction falls by a fifth, the spring's stretch is
# 2.5 travels. Only the band and the intervals depend on it.
CURVE_REST_SD = 3.0
# Variance of the levels over that from noise, above which they scatter, and so separate datum and friction.
SCATTER_SHOWN = 4.0
HIDDEN_STEP = 1e-3  # relative step of friction at rest in the derivative by a hidden move, which is linear
NARROWEST_MOVED = 0.1  # width of a ramp after a move, over that before


def rest_to_assume(fit: Fit) -> Measured | None:
    """Return the rest position to assume if levels do not scatter; None if calibrations determine the level."""
    yields = fit.law.ramp or Global.COMPLIANCE in fit.places
    for motion in fit.problem.motions:
        if motion.datum_prior is not None or (yields and (motion.belt_measured or motion.belt_prior is not None)):
            return None
    return rest_calibration(fit.problem.runs[0], CURVE_REST_SD)


def levels_scatter(fit: Fit, noise: Array) -> bool:
    """Return whether levels within a run scatter by more than noise (runs,), m, and misfit explain.

    The scatter must also move the spring by more than the noise: rounding to counts causes a fifth of that.
    """
    inliers, run = fit.inlier_cycles, fit.windows.run[fit.inlier_cycles]
    if inliers.sum() < np.unique(run).size + 1:
        return False
    stretch = float(fit.task.friction(fit.q, np.array([fit.values.v_dr]))[0]) / fit.values.K
    inverse = np.empty_like(fit.solution.blocks.Hl)
    compiled(elimination.invert, (elimination.__name__,))(fit.solution.blocks.Hl, inverse)
    by_noise = float(np.mean(inverse[inliers, PerCycle.LEVEL, PerCycle.LEVEL]))
    level = fit.solution.local[inliers, PerCycle.LEVEL]
    deviations = [level[run == number] - np.mean(level[run == number]) for number in np.unique(run)]
    scatter = float(np.sum(np.concatenate(deviations) ** 2)) / (level.size - len(deviations))
    return bool(scatter > SCATTER_SHOWN * by_noise and scatter * stretch**2 > float(np.max(noise)) ** 2)


def move_rest(u: Array, coefficients: Array, rest: Measured, *, ramp: bool) -> tuple[Array, Array]:
    """Return unknowns (13 runs,) and a curve (n,) that give the same motion with another rest position.

    The rest positions of all runs move equally. On a ramp the slope in stick and the speed at which slip begins stay.
    """
    rise = u[Global.K] * (u[Global.DATUM] - rest.value)
    moved = u.copy()
    moved[Global.DATUM :: PER_RUN] += rest.value - u[Global.DATUM]
    moved[Global.V_DR :: PER_RUN] -= u[Global.COMPLIANCE] * (rest.value - u[Global.DATUM])
    if ramp:
        wider = u[Global.D] * max(rise / coefficients[0], NARROWEST_MOVED - 1)
        moved[Global.D :: PER_RUN] += wider
        moved[Global.V_DR :: PER_RUN] += wider
    return moved, coefficients + rise


def hidden_moves(places: Sequence[int], curve: Curve, u: Array) -> Array:
    """Return the moves of the unknowns at ``places`` (p,) that compensate a move of the first run's rest position."""
    if curve.spline is None:
        raise ValueError("this is a law's curve: its level is not free")
    step = HIDDEN_STEP * curve.spline.coefficients[0] / u[Global.K]
    moved, _ = move_rest(u, curve.spline.coefficients, Measured(u[Global.DATUM] + step, 0.0), ramp=curve.ramp)
    moves = (moved - u)[list(places)] / step
    moves[list(places).index(Global.DATUM)] = 0.0
    return np.asarray(moves)


def linearise_spline_fit(fit: Fit) -> LinearisedFit:
    """Return the linearised problem, the curve's coordinates last; an assumed rest position stays uncertain."""
    linear, curve, rest = LinearisedFit.at(fit), fit.curve_on_path, fit.assumed_rest
    if linear is None or curve is None:
        raise RuntimeError("a fitted curve has a path")
    if rest is None:
        return linear
    datum, moves = fit.places.index(Global.DATUM), hidden_moves(fit.places, curve, fit.u)
    precision = linear.priors.precision.copy()
    precision[datum, datum] = 1 / rest.sd**2

    def move(jacobian: Array) -> Array:
        jacobian = jacobian.copy()
        jacobian[:, datum] = -np.einsum("ij,j->i", jacobian[:, : moves.size], moves)
        return jacobian

    return linear.transform(move, linear.priors._replace(precision=precision))


def chi(fit: Fit, noise: Array) -> float:
    """Return the weighted rms residual over the noise (runs,), m."""
    task = fit.least_squares
    w = task.weight
    noise_of_sample = noise[fit.windows.run].repeat(np.diff(task.first))
    return math.sqrt(float(np.sum(w * fit.residual**2) / np.sum(w * noise_of_sample**2)))


def fit_spline(fit: Fit, noise: Array) -> Fit | None:
    """Fit a spline on the contact (jump or ramp) of a law; None where its motion cannot be followed."""
    rest = rest_to_assume(fit)
    if rest is None:
        return _fit_spline(fit, noise, None)
    # the residuals of a wrong law can make its levels scatter, so the fit of the curve decides
    law_has_scatter = levels_scatter(fit, noise)
    spline_fit = _fit_spline(fit, noise, None if law_has_scatter else rest)
    if spline_fit is None or levels_scatter(spline_fit, noise) == law_has_scatter:
        return spline_fit
    return _fit_spline(fit, noise, rest if law_has_scatter else None)


def _fit_spline(fit: Fit, noise: Array, rest: Measured | None) -> Fit | None:
    from_law = _start_from_law(fit, rest)
    if from_law is None:
        return None
    task, law_end = from_law
    starts = [(law_end, fit.noise.without_fade), *((start, None) for start in _start_from_regression(task))]
    settled = settle_from_starts(task, starts, noise)
    finished = None if settled is None else finish(settled, noise) or settled
    return finished if finished is not None and finished.can_be_followed else None


def _start_from_law(fit: Fit, rest: Measured | None) -> tuple[Task, FitStart] | None:
    """Return the free curve's task, and a start from the law's fit; None if the ramp is wider than all slip speeds."""
    ramp = fit.law.ramp
    problem, local = _spline_problem(fit, rest), fit.local.copy()
    knots = curve_knots(problem.runs, float(fit.u[Global.D]) if ramp else 0.0)
    if knots[-1] <= 0:
        return None
    spline = FrictionSpline.over(knots)
    s = np.linspace(0.0, knots[-1], 20 * knots.size)
    friction = fit.task.friction(fit.q, s)
    u, coefficients = fit.u, np.einsum("ik,k->i", spline.projection(s), friction)
    if rest is not None:
        u, coefficients = move_rest(u, coefficients, rest, ramp=ramp)
        local[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = 0.0
    task = free_curve_task(problem, knots, u, coefficients)
    index = list(task.places)
    return task, FitStart(np.concatenate([u[index], task.curve.start]), _replace_fast_starts(fit, local))


def _start_from_regression(task: Task) -> list[FitStart]:
    """Return the start from the smoothed slips, or none if their regression is not physical."""
    problem, curve = task.problem, free_curve(task)
    d = float(problem.start[Global.D]) if curve.ramp else 0.0
    regression = regress_curve(problem.runs, problem.start, curve.spline.knots, d)
    if regression is None:
        return []
    task_start, start = start_from_regression(task), problem.start.copy()
    start[Global.K :: PER_RUN] = regression[0]
    shared = start[list(task.places)]
    return [task_start._replace(q=curve.basis.unknowns(shared, regression[1]))]


def _replace_fast_starts(fit: Fit, local: Array) -> Array:
    """Replace starts faster than the belt by those of the smoothed motion."""
    if fit.law.ramp:
        return local
    smoothed = fit.windows.starting_values(fit.problem.motions)
    too_fast = local[:, PerCycle.V_SLIP] > fit.windows.fastest_starts(fit.u)[:, PerCycle.V_SLIP]
    local[too_fast, : PerCycle.LEVEL] = smoothed[too_fast, : PerCycle.LEVEL]
    return local


def _spline_problem(fit: Fit, rest: Measured | None) -> EstimationProblem:
    problem = fit.problem
    prior, precision = problem.prior.copy(), problem.precision.copy()
    lower, upper, start = problem.lower.copy(), problem.upper.copy(), problem.start.copy()
    for number, run in enumerate(problem.runs):
        datum, stated = PER_RUN * number + Global.DATUM, rest_calibration(run, CURVE_REST_SD)
        prior[datum], precision[datum] = (stated.value, 1 / stated.sd**2 if stated.sd > 0 else precision[datum])
        if number == 0 and rest is not None:
            lower[datum] = upper[datum] = start[datum] = rest.value
    return replace(problem, prior=prior, precision=precision, lower=lower, upper=upper, start=start)


def curve_target(curve: MeasuredCurve) -> tuple[Target, float]:
    """Return the measured curve with its band as target of formulas, and the standard error of its level, m/s^2."""
    rest, friction = curve.spline_fit.assumed_rest, curve.friction
    target = Target(
        curve.speed - curve.ramp, np.diag(1 / curve.shape_half), friction / curve.shape_half, float(np.median(friction))
    )
    return target, 0.0 if rest is None else curve.spline_fit.values.K * rest.sd


SPEEDS = 200  # speeds of the curve: the band is smooth between them
SEEN_FROM, SEEN_TO = 0.03, 0.985  # of the fastest slip: below, few samples; beyond, few cycles
DRAWS = 400  # the quantile of 95 % is then known to 2 %
SEED = 20_240  # the draws are the same for every record


def covariances(linear: LinearisedFit) -> tuple[Array, Array]:
    """Return the covariances (p, p) of the shared unknowns from the noise, and from the scatter between cycles."""
    noise = linear.reduced.covariance
    gradients = linear.gradients
    cycles = gradients.shape[0]
    meat = np.einsum("ci,cj->ij", gradients, gradients) * (cycles / max(cycles - 1, 1)) + linear.priors.precision
    return noise, np.einsum("ik,kl,lj->ij", noise, meat, noise, optimize=False)


def band_speeds(fit: Fit) -> Array:
    """Return the slip speeds beyond the ramp (k,), m/s, of the band."""
    fastest = fit.spline.knots[-1]
    return np.linspace(SEEN_FROM * fastest, SEEN_TO * fastest, SPEEDS)


def curve_columns(fit: Fit, s: Array) -> Array:
    """Return derivatives (k, p) of friction at s beyond the ramp by the shared unknowns."""
    columns = np.asarray(np.einsum("ki,ij->kj", fit.spline.basis(s), free_curve(fit.task).basis.slopes))
    if Global.D in fit.places and fit.problem.ramp:
        h = 1e-4 * fit.spline.knots[-1]
        columns[:, fit.places.index(Global.D)] = -(fit.spline(s + h) - fit.spline(s - h)) / (2 * h)
    return columns


def half_widths(columns: Array, covariances: tuple[Array, Array], confidence: float, widening: float) -> Array:
    """Return the half-width of the band (k,), m/s^2; ``widening`` accounts for few cycles."""
    rng = np.random.default_rng(SEED)
    deviation, quantile = np.zeros(columns.shape[0]), 0.0
    for covariance in covariances:
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        size, axes = eigen(covariance / scale[:, None] / scale)
        root = scale[:, None] * axes * np.sqrt(np.maximum(size, 0.0))
        along = np.einsum("kp,pq->kq", columns, root)
        sd = np.sqrt(np.sum(along**2, axis=1))
        draws = rng.standard_normal((size.size, DRAWS))
        largest = np.max(np.abs(np.einsum("kq,qn->kn", along, draws)) / np.maximum(sd, 1e-300)[:, None], axis=0)
        quantile = max(quantile, float(np.quantile(largest, confidence)))
        deviation = np.maximum(deviation, sd)
    return np.asarray(widening * quantile * deviation)


# Error over that of the nearest jump law, below which a ramp is preferred; a true jump law is at 0.99 at least.
RAMP_NEARER = 0.97


def measure_curve(fits: Sequence[Fit], noise: Array, alpha: float = 0.05) -> MeasuredCurve | None:
    """Measure the friction curve of one contact from fits, best first; None if no motion can be followed.

    ``noise`` (runs,) is in m. The ramp is tried first if it is preferred and fits nearly to the noise. The other
    contact is tried if the first does not fit to the noise and the laws prefer a ramp, or if the search stalled.
    """
    begun = clock.process_time()
    ordered, prefers_ramp = _order_contacts(fits, noise)
    best: tuple[Fit, float] | None = None
    for fit in ordered:
        spline_fit = fit_spline(fit, noise)
        misfit = math.inf if spline_fit is None else chi(spline_fit, noise)
        if spline_fit is not None and (best is None or misfit < best[1]):
            best = spline_fit, misfit
        if best is not None and (
            best[1] < noise_levels.DESCRIBES or not (prefers_ramp or best[0].outcome == "no progress")
        ):
            break
    return None if best is None else _summarise(*best, noise, alpha, begun)


def _order_contacts(fits: Sequence[Fit], noise: Array) -> tuple[list[Fit], bool]:
    """Return the best fit of each contact, in the order to try them, and whether the laws prefer a ramp."""
    by_error = sorted(fits, key=lambda fit: fit.geometric_mean_rms)
    nearest = [next((fit for fit in by_error if fit.law.ramp == ramp), None) for ramp in (False, True)]
    jump, ramp = nearest
    if jump is None or ramp is None:
        return [fit for fit in nearest if fit is not None], False
    prefers_ramp = ramp.geometric_mean_rms < RAMP_NEARER * jump.geometric_mean_rms
    ramp_near_noise = ramp.geometric_mean_rms < noise_levels.NEAR * float(np.max(noise))
    return [ramp, jump] if prefers_ramp and ramp_near_noise else [jump, ramp], prefers_ramp


def _summarise(fit: Fit, misfit: float, noise: Array, alpha: float, begun: float) -> MeasuredCurve:
    linear = linearise_spline_fit(fit)
    by_noise_and_scatter = covariances(linear)
    speeds = band_speeds(fit)
    cycles = len(fit.rows)
    quantile = float(special.stdtrit(max(cycles - 1, 1), 1 - alpha / 2))
    columns, widening = curve_columns(fit, speeds), quantile / float(special.ndtri(1 - alpha / 2))
    half = half_widths(columns, by_noise_and_scatter, 1 - alpha, widening)
    friction = fit.spline(speeds)
    ramp = float(fit.u[Global.D]) if fit.problem.ramp else 0.0
    K, error = float(fit.u[Global.K]), float(np.sqrt(max(covariance[0, 0] for covariance in by_noise_and_scatter)))
    return MeasuredCurve(
        speed=speeds + ramp,
        friction=friction,
        lo=np.maximum(friction - half, 0.0),  # friction opposes the motion
        hi=friction + half,
        shape_half=half_widths(columns - columns.mean(axis=0), by_noise_and_scatter, 1 - alpha, widening),
        k_over_m=Parameter(K, error, K - quantile * error, K + quantile * error, "s^-2"),
        chi=misfit,
        ramp=ramp,
        spline_fit=fit,
        linear=linear,
        noise=noise,
        confidence=1 - alpha,
        cpu_s=clock.process_time() - begun,
    )


def furthest_exit(curve: MeasuredCurve, friction: Array) -> BandExit:
    off, half = friction - curve.friction, curve.hi - curve.friction
    if not curve.level_known:
        off, half = off - off.mean(), curve.shape_half
    away = np.abs(off) / half
    furthest = int(np.argmax(away))
    return BandExit(float(away[furthest]), float(curve.speed[furthest]))


def in_newtons(curve: MeasuredCurve, mass: float) -> MeasuredCurve:
    """Convert to a force on a mass, kg; k/m stays."""
    return replace(curve, **{name: mass * getattr(curve, name) for name in ("friction", "lo", "hi", "shape_half")})
