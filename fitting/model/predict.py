"""Tasks (a law or a free curve to be fitted to runs), and the positions and derivatives that they predict."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fitting.laws import Law
from fitting.least_squares.elimination import least_squares
from fitting.least_squares.normal_equations import Block, Derivatives, Evaluate
from fitting.model import unknowns
from fitting.model.curves import FreeCurve, FrictionCurve, LawCurve
from fitting.model.forces import FittedMotion, Force, Forcing
from fitting.model.path import Curve, FrictionSpline, Path, follow, positions
from fitting.model.problem import EstimationProblem, Run, break_away_position, slip_samples
from fitting.model.tangents import local_tangents, tangents
from fitting.model.unknowns import PER_RUN, Global
from fitting.model.windows import ShootingWindows
from stickslip.compute.arrays import Array, Integers

PIECES, KNOT_POWER = 13, 1.6  # knots s_max u^1.6: denser at low speed, where friction falls
FASTEST = 0.998  # quantile of the slip speeds of a cycle at which the last knot lies
# Weight of a second difference of a regressed curve's coefficients, over a slip sample's times the root of their count.
SMOOTHNESS = 0.03
LOW_SPEED = 0.06  # speed over the last knot's, below which smoothed slips constrain the curve poorly
OF_THE_LAW = (Global.LOG_F, Global.SHAPE, Global.STATIC)  # slots that a free curve does not use


class FitStart(NamedTuple):
    """A start: the task's unknowns (p + n + m,) and each cycle's own (cycles, 6)."""

    q: Array
    local: Array


@dataclass(frozen=True, eq=False)
class Task:
    """A fit to be done; the unknowns q are the shared ones at ``places``, the curve's theta, the forces' sizes."""

    problem: EstimationProblem  # the runs, with the priors, bounds and start of the shared unknowns
    curve: FrictionCurve
    places: tuple[int, ...]  # which shared unknowns are free (`fitting.model.unknowns`)
    forces: tuple[Force, ...] = ()  # departures that act in addition

    @property
    def widths(self) -> tuple[int, int, int]:
        return len(self.places), self.curve.size, sum(force.width for force in self.forces)

    def split(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the unknowns of all runs (13 runs,), the curve's theta and the forces' sizes."""
        p, n, _ = self.widths
        u = self.problem.start.copy()
        u[list(self.places)] = q[:p]
        return unknowns.copy_shared(u), q[p : p + n], q[p + n :]

    def without(self, *slots: Global) -> "Task":
        """Return the task with shared unknowns fixed at the regression."""
        return replace(self, places=tuple(place for place in self.places if place % PER_RUN not in slots))

    def predict(
        self,
        windows: ShootingWindows,
        longest_step: float,
        earlier_path: Path | None = None,
        count: Array | None = None,
    ) -> "Model":
        model: type[Model] = self.curve.model or Model
        return model(self, windows, longest_step, earlier_path, count)

    @property
    def resolution(self) -> float:
        return max(motion.resolution for motion in self.problem.motions)

    @property
    def with_static(self) -> "Task":
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
    runs: Sequence[Run], rest: float, columns: Callable[[Array], Array], prior_rows: Array | None = None
) -> tuple[Array, float]:
    """Regress the smoothed slips, acceleration = -K (x - rest) + columns(s) c; return K with c, and the squared error.

    ``prior_rows`` (r, n) are rows of c with prior 0.
    """
    samples = [slip_samples(run.motion, run.cut) for run in runs]
    x, s, a = (np.concatenate([getattr(slips, name) for slips in samples]) for name in ("x", "s", "a"))
    matrix, target = np.c_[rest - x, columns(s)], a
    if prior_rows is not None:
        weight = math.sqrt(float(np.mean(matrix[:, 1:] ** 2)) * a.size)
        rows = np.c_[np.zeros(prior_rows.shape[0]), weight * prior_rows]
        matrix, target = np.r_[matrix, rows], np.r_[a, np.zeros(prior_rows.shape[0])]
    solution, residual = least_squares(matrix, target)
    return solution, float(np.sum(residual**2))


def free_curve_task(problem: EstimationProblem, knots: Array, u: Array, coefficients: Array) -> Task:
    """Return the task of a free curve about u (13 runs,); curve and rest position move together."""
    places = tuple(place for place in problem.active if place % PER_RUN not in OF_THE_LAW)
    shared = u[list(places)]
    datums = np.array([place % PER_RUN == Global.DATUM for place in places])
    offset = np.where(datums, -u[Global.K] / len(problem.runs), 0.0)
    curve = FreeCurve(knots, ramp=problem.ramp, coefficients=coefficients, offset=offset, shared=shared)
    start = problem.start.copy()
    start[Global.K :: PER_RUN] = u[Global.K]
    return Task(replace(problem, start=start), curve, places)


def regress_curve(runs: Sequence[Run], start: Array, knots: Array, d: float) -> tuple[float, Array] | None:
    """Return K and the coefficients of a free curve from regression of the smoothed slips; None if not physical.

    At low speed, where slips constrain the curve poorly, it begins with the load at the break-aways.
    """
    spline = FrictionSpline.over(knots)
    prior_rows = SMOOTHNESS * np.diff(np.eye(spline.coefficients.size), 2, axis=0)
    solution, _ = regress(runs, start[Global.DATUM], lambda s: spline.basis(np.clip(s - d, 0, knots[-1])), prior_rows)
    K, coefficients = float(solution[0]), solution[1:].copy()
    if not (K > 0 and np.median(coefficients) > 0):
        return None
    if d == 0.0:
        loads = [
            K * (break_away_position(run.motion, run.cut) - u[Global.DATUM]) + u[Global.DAMPING] * u[Global.V_DR]
            for run, u in zip(runs, start.reshape(-1, PER_RUN), strict=True)
        ]
        low = max(3, int(np.sum(knots < LOW_SPEED * knots[-1])) + 1)
        coefficients[:low] = np.linspace(float(np.median(loads)), coefficients[low], low, endpoint=False)
    return K, coefficients


class Model:
    """A task's predictions; a force by velocity acts along the motion itself, others along the `earlier_path`."""

    def __init__(
        self,
        task: Task,
        windows: ShootingWindows,
        longest_step: float,
        earlier_path: Path | None = None,
        count: Array | None = None,
    ) -> None:
        self.task, self.windows, self.longest_step, self.earlier_path = task, windows, longest_step, earlier_path
        self._size = None if count is None else np.sqrt(count)
        fastest = max(float(np.max(np.abs(motion.velocity))) for motion in task.problem.motions)
        self._tables = [force.departure.drag_table(fastest) for force in task.forces]
        self._last: tuple[Array, Array, Array | None] | None = None
        self._along: tuple[Path, FittedMotion] | None = None

    @property
    def along(self) -> bool:
        """Whether a force acts along an earlier path."""
        return any(force.departure.drag is None for force in self.task.forces)

    def settle(self, q: Array, local: Array, times: int) -> None:
        """Evaluate forces along the path of these unknowns, repeated ``times`` as they change the path."""
        for _ in range(times if self.along else 0):
            path = self.path(q, local)
            if path is None:
                return
            self.earlier_path, self._last = path, None

    def path(self, q: Array, local: Array) -> Path | None:
        u, theta, sizes = self.task.split(q)
        curve = self._curve(q, theta)
        if curve is None:
            return None
        acting, _ = self._acting(sizes)
        return follow(self.windows, curve, u, local, longest_step=self.longest_step, **acting)

    def motion_in(self, windows: ShootingWindows, q: Array, local: Array, run: int | None) -> Array | None:
        """Return positions, m, and velocities, m/s, (2, N) in windows of all runs, or of one."""
        u, theta, _ = self.task.split(q)
        curve, u_of_run = self._curve(q, theta), u if run is None else u[PER_RUN * run : PER_RUN * (run + 1)]
        path = None if curve is None else follow(windows, curve, u_of_run, local)
        return None if path is None else np.array([path.position, path.velocity])[:, path.reached]

    def loop(self, windows: ShootingWindows, q: Array, local: Array, run: int | None, cycle: int) -> Array | None:
        """Return slip speed, m/s, and friction (2, n) per unit mass along a cycle's window; None without memory."""
        return None

    def residual(self, q: Array, local: Array) -> Array | None:
        if self._last is not None and np.array_equal(q, self._last[0]) and np.array_equal(local, self._last[1]):
            return self._last[2]
        u, theta, sizes = self.task.split(q)
        curve, residual = self._curve(q, theta), None
        if curve is not None:
            acting, reading = self._acting(sizes)
            residual = positions(self.windows, curve, u, local, longest_step=self.longest_step, **acting)
            residual = None if residual is None else residual + reading - self.windows.position
        self._last = q.copy(), local.copy(), residual
        return residual

    def evaluate(self, q: Array, local: Array, derivatives: bool) -> tuple[Array, Derivatives | None] | None:
        """As `fitting.least_squares.normal_equations.Evaluate`; rows are weighted by the root of their count."""
        return self._evaluate_by(self.all_derivatives if derivatives else None, q, local)

    def _evaluate_by(
        self, derive: Callable[[Array, Array], Derivatives] | None, q: Array, local: Array
    ) -> tuple[Array, Derivatives | None] | None:
        residual = self.residual(q, local)
        if residual is None:
            return None
        derivatives = None if derive is None else derive(q, local)
        return residual if self._size is None else residual * self._size, derivatives

    def evaluate_cycles(self, q: Array, cycles: Integers) -> Evaluate:
        """Return an evaluation of the own unknowns of these cycles alone, with q fixed."""
        model = Model(self.task, self.windows.of_cycles(cycles), self.longest_step)
        if self._size is not None:
            model._size = np.concatenate([self._size[self.windows.rows[k]] for k in cycles])

        derive = partial(model.derivatives, columns=local_tangents)
        return lambda _, local, derivatives: model._evaluate_by(derive if derivatives else None, q, local)

    def path_in(self, block: Block, q: Array, local: Array) -> Path | None:
        if self.along or block.rows == slice(0, self.windows.time.size):
            return self.path(q, local)
        cycles = np.arange(block.cycles.start, block.cycles.stop)
        return Model(self.task, self.windows.of_cycles(cycles), self.longest_step).path(q, local[block.cycles])

    def all_derivatives(self, q: Array, local: Array) -> Derivatives:
        return self.derivatives(q, local, partial(self._columns, q=q))

    def derivatives(self, q: Array, local: Array, columns: Callable[[Path], Array]) -> Derivatives:
        """Return the derivatives of the positions, ``columns`` (n, k) of the path of each block."""
        all_cycles = Block(slice(0, len(self.windows.rows)), slice(0, self.windows.time.size))
        return Derivatives(
            (all_cycles,) if self.along else self.windows.blocks, partial(self._derive_block, q, local, columns)
        )

    def _derive_block(self, q: Array, local: Array, columns: Callable[[Path], Array], block: Block) -> Array | None:
        path = self.path_in(block, q, local)
        jacobian = None if path is None else columns(path)
        return jacobian if jacobian is None or self._size is None else jacobian * self._size[block.rows, None]

    def _columns(self, path: Path, q: Array) -> Array:
        _, theta, sizes = self.task.split(q)
        parts = [self.task.curve.columns(path, theta, self.task.places)]
        for forcing in self._forcings(path, sizes):
            width = next(column.shape[1] for column in forcing if column is not None)
            if forcing.acceleration is None and forcing.belt_speed is None and forcing.reading is not None:
                parts.append(forcing.reading)
                continue
            acts = np.zeros((path.time.size, width)) if forcing.acceleration is None else forcing.acceleration
            parts.append(tangents(path, acts, belt_speed=forcing.belt_speed, position=forcing.reading))
        return np.asarray(np.hstack([*parts, local_tangents(path)]))

    def _curve(self, q: Array, theta: Array) -> Curve | None:
        return self.task.curve.on_path(theta, q[: len(self.task.places)])

    def _motion(self, path: Path) -> FittedMotion:
        return FittedMotion.from_path(path, self.task.problem.motions, path.residual)

    def _motion_along(self) -> FittedMotion | None:
        """Return the motion along which forces act; None without forces, or before the first path."""
        if self.earlier_path is None or not self.along:
            return None
        if self._along is None or self._along[0] is not self.earlier_path:
            self._along = self.earlier_path, self._motion(self.earlier_path)
        return self._along[1]

    def _forcings(self, path: Path, sizes: Array) -> list[Forcing]:
        if not self.task.forces:
            return []
        motion = self._motion(path)
        return [forcing for force, size in self._sizes(sizes) for forcing in force.derivatives(motion, size)]

    def _sizes(self, sizes: Array) -> list[tuple[Force, Array]]:
        ends = np.cumsum([force.width for force in self.task.forces]).tolist()
        return [(force, sizes[end - force.width : end]) for force, end in zip(self.task.forces, ends, strict=True)]

    def _acting(self, sizes: Array) -> tuple[dict[str, Any], Array | float]:
        """Return the forces' contribution to a path, as arguments of `follow`, and to the reading, m."""
        arguments: dict[str, Any] = {}
        reading: Array | float = 0.0
        motion = self._motion_along()
        for (force, size), table in zip(self._sizes(sizes), self._tables, strict=True):
            if force.departure.drag is not None:
                arguments["drag"] = table._replace(acceleration=float(size[0]) * table.acceleration)
                continue
            if motion is None:
                continue
            arguments["along"] = self.earlier_path
            forcing, coefficients = force.forcing(motion, size), force.coefficients(size)
            for name in ("acceleration", "belt_speed"):
                effect = getattr(forcing, name)
                if effect is not None:
                    arguments[name] = arguments.get(name, 0.0) + np.einsum("mk,k->m", effect, coefficients)
            if forcing.reading is not None:
                reading = reading + np.einsum("nk,k->n", forcing.reading, coefficients)
        return arguments, reading
