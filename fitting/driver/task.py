"""What is fitted to which runs, and the tasks of the six laws and of a free curve."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from daq.base.compute.arrays import Array
from daq.base.compute.least_squares import least_squares
from fitting.curve.spline_fit import FASTEST, KNOT_POWER, PIECES
from fitting.departures.definition.departure import Departure
from fitting.driver.curves import FreeCurve, FrictionCurve, LawCurve
from fitting.model import parameters, starts
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import EstimationProblem, Run

# Weight of a second difference of a regressed curve's coefficients, over that of a typical slip sample times the root
# of their number: at half the curve follows the smoothing's noise at low speed, at twice it begins to lose its bend.
SMOOTHNESS = 0.03
OF_THE_LAW = (Global.LOG_F, Global.SHAPE, Global.STATIC)  # slots that a curve of its own has no use for


class FitStart(NamedTuple):
    """Where a fit starts: the task's unknowns (p + n + m,) and each cycle's own (cycles, 6)."""

    q: Array
    local: Array


@dataclass(frozen=True, eq=False)
class Task:
    """What is fitted.

    The unknowns q are the shared ones at ``places``, then the curve's own theta, then the sizes of the forces.

    Attributes
    ----------
    problem : EstimationProblem
        The runs, with the priors, bounds and start of the shared unknowns.
    curve : FrictionCurve
    places : tuple of int
        Which shared unknowns are free (`fitting.model.parameters`).
    forces : tuple of Departure
        What acts besides.  None of them has a scale that is scanned.
    """

    problem: EstimationProblem
    curve: FrictionCurve
    places: tuple[int, ...]
    forces: tuple[Departure, ...] = ()

    def __post_init__(self) -> None:
        for force in self.forces:
            if force.scales is not None:
                raise ValueError(f"{force.name} depends on {force.scale}, which a task does not fit; scan it")

    @property
    def widths(self) -> tuple[int, int, int]:
        """How many of the unknowns are shared ones, the curve's, and the forces'."""
        return len(self.places), self.curve.size, sum(force.columns for force in self.forces)

    def split(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the unknowns of all runs (13 runs,), the curve's own, and the forces' sizes."""
        p, n, _ = self.widths
        u = self.problem.start.copy()
        u[list(self.places)] = q[:p]
        return parameters.copy_shared(u), q[p : p + n], q[p + n :]

    def friction(self, q: Array, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,)."""
        u, theta, _ = self.split(q)
        return self.curve.friction(u, theta, q[: len(self.places)], s)


def law_task(law: int, runs: Sequence[Run], forces: Sequence[Departure] = (), *, static: bool = False) -> Task:
    """Return the task of one of the six laws; ``static`` frees a ramp's break-away level."""
    problem = EstimationProblem.build(law, runs)
    places = tuple(place for place in problem.active if static or place % PER_RUN != Global.STATIC)
    return Task(problem, LawCurve(law), places, tuple(forces))


def curve_problem(runs: Sequence[Run], *, ramp: bool) -> tuple[EstimationProblem, tuple[int, ...], float]:
    """Return what a curve that is no law's has beside it: the problem, free places, and the fastest slip, m/s."""
    problem = EstimationProblem.build(6 if ramp else 5, runs)
    places = tuple(place for place in problem.active if place % PER_RUN not in OF_THE_LAW)
    fastest = 0.0
    for run in runs:
        for cycle in run.cut.used:
            speed = run.motion.belt_speed - run.motion.velocity[slice(*cycle.slip)]
            if speed.size:
                fastest = max(fastest, float(np.quantile(speed, FASTEST)))
    return problem, places, fastest


def regress(
    runs: Sequence[Run], rest: float, columns: Callable[[Array], Array], held: Array | None = None
) -> tuple[Array, float]:
    """Regress the smoothed slips: acceleration = -K (x - rest) + columns(s) c.

    Parameters
    ----------
    runs : sequence of Run
    rest : float
        Rest position of the spring, m.
    columns : callable
        Slip speeds (k,) to what multiplies each number c (k, n).
    held : (r, n) f8, optional
        Rows of c that want to be 0.

    Returns
    -------
    found : (1 + n,) f8
        K, then c.
    error : float
        Sum of squares left.
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


def curve_task(runs: Sequence[Run], forces: Sequence[Departure] = (), *, ramp: bool = False) -> Task:
    """Return the task of the free curve, which starts from the regression."""
    problem, places, fastest = curve_problem(runs, ramp=ramp)
    start = problem.start.copy()
    d = float(start[Global.D]) if ramp else 0.0
    knots = (fastest - d) * np.linspace(0.0, 1.0, PIECES + 1) ** KNOT_POWER
    free = FreeCurve(
        knots,
        ramp=ramp,
        coefficients=np.ones(PIECES + 3),
        offset=np.zeros(len(places)),
        beside=start[list(places)],
    )
    held = SMOOTHNESS * np.diff(np.eye(free.size), 2, axis=0)
    found, _ = regress(runs, start[Global.DATUM], lambda s: free.spline.basis(np.clip(s - d, 0, knots[-1])), held)
    coefficients = np.full(free.size, math.exp(start[Global.LOG_F]))
    if found[0] > 0 and np.median(found[1:]) > 0:  # else the law's regression, which says something of any record
        start[Global.K :: PER_RUN], coefficients = found[0], found[1:]
    datums = np.array([place % PER_RUN == Global.DATUM for place in places])
    offset = np.where(datums, -start[Global.K] / len(runs), 0.0)
    curve = FreeCurve(knots, ramp=ramp, coefficients=coefficients, offset=offset, beside=start[list(places)])
    return Task(replace(problem, start=start), curve, places, tuple(forces))
