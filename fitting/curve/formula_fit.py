"""A law given as a formula, fitted by the driver to the positions of every window.

Windows, noise and calibrations are those of the measured curve, so that the fit differs from it in the curve alone.
The search starts where the measured curve ended, at each minimum of the formula on it.

A formula with a constant hides the rest position where no calibration gives that: it is then assumed, as for the
measured curve (`fitting.curve.level`).  The shape of one without a constant says where the spring rests.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np

from fitting import noise_levels
from fitting.curve.level import rest_prior
from fitting.curve.metric import GRID_SPEEDS, MeasuredTarget, friction_target, measured_target
from fitting.curve.spline_fit import SplineFit
from fitting.driver.driver import CONTAINED_ERROR, FAR_BEYOND_BEST, best_end, start_beside
from fitting.driver.fit import TaskFit
from fitting.driver.formula import SPLINE_REACH, FormulaCurve
from fitting.driver.noise import PassNoise
from fitting.driver.passes import finish
from fitting.driver.start_search import Target, find_starts
from fitting.driver.task import KNOT_POWER, OF_THE_LAW, FitStart, Task
from fitting.estimation.covariance import covariances
from fitting.estimation.fitted_law import FittedLaw
from fitting.law import LIMITS, Law
from fitting.model.parameters import NUISANCE, PER_RUN, Global
from fitting.model.problem import EstimationProblem
from fitting.undetermined import Undetermined
from stickslip.compute.arrays import Array
from stickslip.errors import InputError
from stickslip.units import Measured

LEAST_SHOWN = 1e-6  # precision over a prior's: a record that adds less shows nothing of the unknown
CONSTANT_LEFT = 1e-6  # share of a constant: what is left of it beside the derivatives of a formula that has one
# Other minima on the measured curve are starts too: those that are off it by less than its errors, or by less than so
# many times the nearest one's chi square.  A fall over which the record has few samples has two such minima; at twice a
# wrong formula is started once or twice more.  A formula whose nearest is off by more than so many times the curve's
# errors starts where friction itself is nearest.
START_MISFIT = 4.0


@dataclass(frozen=True, eq=False)
class FormulaFit(FittedLaw):
    """A formula fitted to the runs."""

    # the law as it was asked for; of parameters that no record can determine apart some are held in the fit
    asked_for: Law
    number: int | None  # that of one of the six, which was fitted as its formula
    together: tuple[Undetermined, ...]  # parameters that the formula has only together
    level_held: bool  # whether the rest position is assumed, since a constant of the formula stands for it

    @property
    def law(self) -> int | str:
        return self.asked_for.name if self.number is None else self.number

    @property
    def curve(self) -> FormulaCurve:
        curve = self.at.task.curve
        if not isinstance(curve, FormulaCurve):
            raise TypeError("not the fit of a formula")
        return curve

    @property
    def places(self) -> tuple[int, ...]:
        """The shared unknowns of all runs, without the formula's."""
        return self.at.task.places

    @property
    def theta(self) -> Array:
        return self.at.q[len(self.places) :]

    @property
    def own_values(self) -> dict[str, float]:
        """The formula's parameters by name, per unit mass."""
        return self.curve.values(self.theta)

    @property
    def law_parameters(self) -> int:
        """Number of the law's own free unknowns, without a constant that replaces the rest position."""
        held = self.at.task.problem.held
        shared = sum(place % PER_RUN not in NUISANCE and not held[place] for place in self.places)
        return shared + self.curve.size - self.level_held

    @cached_property
    def spreads(self) -> Array:
        """Covariances (2, p + k, p + k) of the shared unknowns and the formula's, by scatter and by curvature."""
        return np.array(covariances(self, self.at.problem.precision))

    def without_prior(self, slot: Global, run: int = 0) -> Measured | None:
        """Return an unknown as constrained by the record alone; None where its value was fixed or is unconstrained."""
        place, problem = PER_RUN * run + slot, self.at.problem
        index = self.places.index(place if place in self.places else int(slot))
        if problem.lower[index] == problem.upper[index]:
            return None
        value, weight = float(self.at.q[index]), float(problem.precision[index])
        variance = float(self.spreads[:, index, index].max())
        if weight == 0:
            return Measured(value, math.sqrt(variance))
        alone = 1 / variance - weight if variance > 0 else 0.0
        if alone <= LEAST_SHOWN * weight:
            return None
        return Measured(value + weight * (value - float(problem.prior[index])) / alone, math.sqrt(1 / alone))


def fit_formula(
    law: Law,
    host: SplineFit,
    *,
    others: Sequence[FittedLaw] = (),
    target: MeasuredTarget | None = None,
    asked_for: Law | None = None,
    number: int | None = None,
    together: Sequence[Undetermined] = (),
) -> FormulaFit | None:
    """Fit a law with a jump or its own ramp to the measured curve's runs; None where its motion cannot be followed.

    law: With a jump or a ramp of its own.
    host: The measured curve.
    others: Other laws fitted to the runs: where the law errs more than constant friction, or than another one that it
        contains, it starts again where the best of them ended.
    target: The measured curve in the metric of the record, where it is known already.
    asked_for, number, together: See `FormulaFit`.
    Raises InputError: with none of the values tried is the formula a friction curve.
    """
    fastest = SPLINE_REACH * (float(host.spline.knots[-1]) + (0.0 if law.ramp else _ramp_width(host)))
    curve, measured, within_errors = _started(law, host, fastest, target)
    level_held = host.rest is not None and _has_constant(curve)
    problem = _problem(law, host, rest_free=host.rest is not None and not level_held)
    task = Task(problem, curve, tuple(place for place in problem.active if place % PER_RUN not in OF_THE_LAW))
    beside = start_beside(task, host.at)
    starts = []
    for start in curve.starts:
        if start.misfit <= max(START_MISFIT * curve.starts[0].misfit, within_errors):
            theta = curve.theta(start.values)
            friction = curve.at_speeds(theta, measured.alone.speeds)
            rise = measured.alone.constant_beside(friction, measured.level_sd) / host.u[Global.K]
            shared = beside.q[: len(task.places)] + [rise * _is_free_rest(problem, place) for place in task.places]
            starts.append(beside._replace(q=np.concatenate([shared, theta])))
    settled = best_end(task, [(start, host.at.noise.without_fade) for start in starts], host.noise)
    best = min(others, key=lambda one: one.geometric_mean_rms, default=None)
    inner = min((one.geometric_mean_rms for one in others if one.law in contained(law)), default=math.inf)
    least = math.inf if best is None else best.geometric_mean_rms
    again: list[tuple[FitStart, PassNoise | None]] = []
    if settled is None or settled.geometric_mean_rms < noise_levels.LOST * least:
        again += [(start, None) for start in starts]
    if best is not None and (settled is None or settled.geometric_mean_rms > CONTAINED_ERROR * inner):
        again += [(start, best.at.noise.without_fade) for start in _at_end_of(task, best.at)]
    if again and not (settled and settled.geometric_mean_rms < noise_levels.DESCRIBES * float(np.max(host.noise))):
        ends = (settled, best_end(task, again, host.noise))
        settled = min((end for end in ends if end), key=attrgetter("geometric_mean_rms"), default=None)
    found = settled
    if settled is not None and settled.geometric_mean_rms < FAR_BEYOND_BEST * least:
        found = finish(settled, host.noise) or settled
    if found is None or not found.can_be_followed:
        return None
    return _read(found, law if asked_for is None else asked_for, number, tuple(together), level_held=level_held)


def contained(law: Law) -> tuple[int | str, ...]:
    """Return the fitted laws that may err no less than this one: constant friction, and those that it contains."""
    return (1, *(LIMITS.get(law.name, ())))


def _at_end_of(task: Task, neighbour: TaskFit) -> list[FitStart]:
    """Return where a formula starts from another law's end: nearest to its friction, at the rest that is assumed."""
    curve, knots = task.curve, np.linspace(0.0, 1.0, GRID_SPEEDS)
    if not isinstance(curve, FormulaCurve):
        raise TypeError("not the task of a formula")
    beside = start_beside(task, neighbour)
    speeds = curve.fastest / SPLINE_REACH * knots**KNOT_POWER
    u = task.split(beside.q)[0]
    raised = float(u[Global.K] * (neighbour.u[Global.DATUM] - u[Global.DATUM]))
    friction = neighbour.task.friction(neighbour.q, speeds) + raised
    try:
        nearest = find_starts(curve.law, Target.of(speeds, friction, float(np.median(np.abs(friction)))), curve.fastest)
    except InputError:
        return []
    shared = beside.q[: len(task.places)]
    return [beside._replace(q=np.concatenate([shared, curve.theta(start.values)])) for start in nearest]


def _started(
    law: Law, host: SplineFit, fastest: float, target: MeasuredTarget | None
) -> tuple[FormulaCurve, MeasuredTarget, float]:
    """Return the formula with its starts, what these are near, and the misfit of one that is off by the curve's errors.

    A formula that is far off starts where friction itself is nearest, unless it is no friction there.
    """
    measured, curve = target or measured_target(host, host.linearised()), None
    within_errors = float(measured.alone.aim.size)
    try:
        curve = FormulaCurve(law, fastest, measured.near)
    except InputError as error:
        refused = error
    if curve is not None and curve.starts[0].misfit <= START_MISFIT * within_errors:
        return curve, measured, within_errors
    nearest = friction_target(host)
    with suppress(InputError):
        return FormulaCurve(law, fastest, nearest.near), nearest, 0.0
    if curve is None:
        raise refused
    return curve, measured, within_errors


def _read(
    at: TaskFit, asked_for: Law, number: int | None, together: tuple[Undetermined, ...], *, level_held: bool
) -> FormulaFit:
    read = FormulaFit.read(at)
    u = at.u.copy()
    u[Global.LOG_F :: PER_RUN] = math.log(float(at.task.friction(at.q, np.zeros(1))[0]))
    return FormulaFit(**(read | {"u": u}), asked_for=asked_for, number=number, together=together, level_held=level_held)


def _is_free_rest(problem: EstimationProblem, place: int) -> bool:
    """Return whether a shared unknown is a rest position without calibration and without assumption."""
    run, slot = divmod(place, PER_RUN)
    given = problem.motions[run].datum_prior is not None or problem.held[place]
    return slot == Global.DATUM and not given


def _ramp_width(host: SplineFit) -> float:
    return float(host.u[Global.D]) if host.curve.ramp else 0.0


def _has_constant(curve: FormulaCurve) -> bool:
    """Return whether the parameters can add a constant to the formula, which then hides the rest position."""
    speeds = np.linspace(0.0, curve.fastest, 41)
    slopes = curve.slopes(curve.start, speeds)
    slopes = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    one = np.ones(speeds.size)
    left = one - np.einsum("kp,p->k", slopes, np.linalg.lstsq(slopes, one, rcond=None)[0])
    return bool(np.max(np.abs(left)) < CONSTANT_LEFT)


def _problem(law: Law, host: SplineFit, *, rest_free: bool) -> EstimationProblem:
    """Return the problem of a law of that contact; a rest position that the law's shape determines is free."""
    curve = host.at.task.problem
    own = EstimationProblem.build(6 if law.ramp else 5, curve.runs, law.name)
    changed = {name: getattr(own, name).copy() for name in ("start", "prior", "precision", "lower", "upper")}
    for run in range(len(curve.runs)):
        place = PER_RUN * run + Global.DATUM
        if own.held[place]:
            continue
        for name, values in changed.items():
            values[place] = getattr(curve, name)[place]
        if run == 0 and rest_free:
            known = rest_prior(curve.runs[0])
            changed["lower"][place], changed["upper"][place] = -math.inf, math.inf
            changed["prior"][place], changed["precision"][place] = known.value, known.sd**-2.0
    return replace(own, **changed)
