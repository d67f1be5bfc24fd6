"""Tasks: what is fitted to which runs; those of the six laws and of a free curve."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fitting.driver.curves import FreeCurve, FrictionCurve, LawCurve
from fitting.forces.force import Force
from fitting.law import Law
from fitting.least_squares.linear import least_squares
from fitting.model import parameters, starts
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import EstimationProblem, Run
from fitting.sensitivity.spline import FrictionSpline
from stickslip.compute.arrays import Array

PIECES, KNOT_POWER = 13, 1.6  # knots s_max u^1.6: denser at low speed, where friction falls; 22 pieces widen the band
FASTEST = 0.998  # quantile of the slip speeds of a cycle at which the last knot lies
# Weight of a second difference of a regressed curve's coefficients, over that of a typical slip sample times the root
# of their number: at half the curve follows the smoothing's noise at low speed, at twice it begins to lose its bend.
SMOOTHNESS = 0.03
LOW_SPEED = 0.06  # speed over the last knot's: regressed slips show little below
OF_THE_LAW = (Global.LOG_F, Global.SHAPE, Global.STATIC)  # slots that a curve of its own has no use for


class FitStart(NamedTuple):
    """A start: the task's unknowns (p + n + m,) and each cycle's own (cycles, 6)."""

    q: Array
    local: Array


@dataclass(frozen=True, eq=False)
class Task:
    """A fit to be done; the unknowns q are the shared ones at ``places``, the curve's theta, the forces' sizes."""

    problem: EstimationProblem  # the runs, with the priors, bounds and start of the shared unknowns
    curve: FrictionCurve
    places: tuple[int, ...]  # which shared unknowns are free (`fitting.model.parameters`)
    forces: tuple[Force, ...] = ()  # what acts besides

    @property
    def widths(self) -> tuple[int, int, int]:
        """Numbers of shared, curve and force unknowns."""
        return len(self.places), self.curve.size, sum(force.width for force in self.forces)

    def split(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the unknowns of all runs (13 runs,), the curve's theta and the forces' sizes."""
        p, n, _ = self.widths
        u = self.problem.start.copy()
        u[list(self.places)] = q[:p]
        return parameters.copy_shared(u), q[p : p + n], q[p + n :]

    def without(self, *slots: Global) -> "Task":
        """Return the same with shared unknowns fixed at the regression."""
        return replace(self, places=tuple(place for place in self.places if place % PER_RUN not in slots))

    @property
    def resolution(self) -> float:
        """The coarsest resolution of the runs, m."""
        return max(motion.resolution for motion in self.problem.motions)

    @property
    def with_static(self) -> "Task":
        """The same with a separate break-away level, where it is a ramp that can have one."""
        free = Global.STATIC in self.problem.active and Global.STATIC not in self.places
        return replace(self, places=tuple(sorted((*self.places, int(Global.STATIC))))) if free else self

    def friction(self, q: Array, s: Array) -> Array:
        u, theta, _ = self.split(q)
        return self.curve.friction(u, theta, q[: len(self.places)], s)


def law_task(law: Law, runs: Sequence[Run], forces: Sequence[Force] = ()) -> Task:
    """Return the task of one of the six laws; a ramp breaks away at the level of slip."""
    problem = EstimationProblem.build(law, runs)
    return Task(problem, LawCurve(law), problem.active, tuple(forces)).without(Global.STATIC)


def free_curve(task: Task) -> FreeCurve:
    """Return the free curve of a task; TypeError for that of a law."""
    if not isinstance(task.curve, FreeCurve):
        raise TypeError("not the task of a free curve")
    return task.curve


def curve_knots(runs: Sequence[Run], d: float) -> Array:
    """Return the knots of a free curve, m/s: from 0 to the fastest slip beyond a ramp of half-width d."""
    fastest = 0.0
    for run in runs:
        for cycle in run.cut.used:
            speed = run.motion.belt_speed - run.motion.velocity[slice(*cycle.slip)]
            if speed.size:
                fastest = max(fastest, float(np.quantile(speed, FASTEST)))
    return np.asarray((fastest - d) * np.linspace(0.0, 1.0, PIECES + 1) ** KNOT_POWER)


def regress(
    runs: Sequence[Run], rest: float, columns: Callable[[Array], Array], held: Array | None = None
) -> tuple[Array, float]:
    """Regress the smoothed slips, acceleration = -K (x - rest) + columns(s) c; return K with c, and the squares left.

    ``columns`` maps slip speeds (k,) to (k, n); ``held`` (r, n) are rows of c with prior 0.
    """
    samples = [starts.slip_samples(run.motion, run.cut) for run in runs]
    x, s, a = (np.concatenate([getattr(own, name) for own in samples]) for name in ("x", "s", "a"))
    matrix, target = np.c_[rest - x, columns(s)], a
    if held is not None:
        weight = math.sqrt(float(np.mean(matrix[:, 1:] ** 2)) * a.size)
        rows = np.c_[np.zeros(held.shape[0]), weight * held]
        matrix, target = np.r_[matrix, rows], np.r_[a, np.zeros(held.shape[0])]
    found, left = least_squares(matrix, target)
    return found, float(np.sum(left**2))


def free_curve_task(problem: EstimationProblem, knots: Array, u: Array, coefficients: Array) -> Task:
    """Return the task of a free curve on the contact of a problem, in coordinates about u (13 runs,).

    Moving the curve and the rest position together does not change the motion.
    """
    places = tuple(place for place in problem.active if place % PER_RUN not in OF_THE_LAW)
    beside = u[list(places)]
    datums = np.array([place % PER_RUN == Global.DATUM for place in places])
    offset = np.where(datums, -u[Global.K] / len(problem.runs), 0.0)
    curve = FreeCurve(knots, ramp=problem.ramp, coefficients=coefficients, offset=offset, beside=beside)
    start = problem.start.copy()
    start[Global.K :: PER_RUN] = u[Global.K]
    return Task(replace(problem, start=start), curve, places)


def regressed_curve(runs: Sequence[Run], start: Array, knots: Array, d: float) -> tuple[float, Array] | None:
    """Return K and the coefficients of a free curve by regression of the smoothed slips; None if absurd.

    At low speed, where slips show little, the curve begins with the load at the break-aways: with more friction the
    mass sticks in every window, with far less it slips too early.
    """
    spline = FrictionSpline.over(knots)
    held = SMOOTHNESS * np.diff(np.eye(spline.coefficients.size), 2, axis=0)
    found, _ = regress(runs, start[Global.DATUM], lambda s: spline.basis(np.clip(s - d, 0, knots[-1])), held)
    K, coefficients = float(found[0]), found[1:].copy()
    if not (K > 0 and np.median(coefficients) > 0):
        return None
    if d == 0.0:
        loads = [
            K * (starts.break_away_position(run.motion, run.cut) - own[Global.DATUM])
            + own[Global.DAMPING] * own[Global.V_DR]
            for run, own in zip(runs, start.reshape(-1, PER_RUN), strict=True)
        ]
        low = max(3, int(np.sum(knots < LOW_SPEED * knots[-1])) + 1)
        coefficients[:low] = np.linspace(float(np.median(loads)), coefficients[low], low, endpoint=False)
    return K, coefficients
