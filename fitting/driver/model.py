"""Positions that a task predicts in windows, and their derivatives: what a least-squares problem evaluates."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fitting.driver.task import Task
from fitting.forces.departure import Forcing
from fitting.forces.fitted_motion import FittedMotion
from fitting.forces.force import Force
from fitting.least_squares.problem import Block, Derivatives, Evaluate
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.columns import local_tangents
from fitting.sensitivity.path import Curve, Path, follow
from fitting.sensitivity.tangents import tangents
from fitting.sensitivity.values import positions
from stickslip.compute.arrays import Array, Integers


class Model:
    """A task's predictions in windows.

    A force by the mass's velocity acts along the motion itself, others along an earlier path, `near`, which `settle`
    updates.
    """

    def __init__(
        self,
        task: Task,
        windows: ShootingWindows,
        longest_step: float,
        near: Path | None = None,
        count: Array | None = None,
    ) -> None:
        self.task, self.windows, self.longest_step, self.near = task, windows, longest_step, near
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
            found = self.path(q, local)
            if found is None:
                return
            self.near, self._last = found, None

    def path(self, q: Array, local: Array) -> Path | None:
        """Return the motion with all that tangents need; None where it cannot be followed."""
        u, theta, sizes = self.task.split(q)
        curve = self._curve(q, theta)
        if curve is None:
            return None
        acting, _ = self._acting(sizes)
        return follow(self.windows, curve, u, local, longest_step=self.longest_step, **acting)

    def residual(self, q: Array, local: Array) -> Array | None:
        if self._last is not None and np.array_equal(q, self._last[0]) and np.array_equal(local, self._last[1]):
            return self._last[2]
        u, theta, sizes = self.task.split(q)
        curve, found = self._curve(q, theta), None
        if curve is not None:
            acting, reading = self._acting(sizes)
            found = positions(self.windows, curve, u, local, longest_step=self.longest_step, **acting)
            found = None if found is None else found + reading - self.windows.position
        self._last = q.copy(), local.copy(), found
        return found

    def evaluate(self, q: Array, local: Array, derivatives: bool) -> tuple[Array, Derivatives | None] | None:
        """As `fitting.least_squares.problem.Evaluate`; rows are weighted by the root of their count."""
        residual = self.residual(q, local)
        if residual is None:
            return None
        found = self.all_derivatives(q, local) if derivatives else None
        return residual if self._size is None else residual * self._size, found

    def some(self, q: Array, cycles: Integers) -> Evaluate:
        """Return an evaluation of the own unknowns of these cycles alone, with q fixed."""
        part = Model(self.task, self.windows.some(cycles), self.longest_step)
        if self._size is not None:
            part._size = np.concatenate([self._size[self.windows.rows[k]] for k in cycles])

        def evaluate(_: Array, local: Array, derivatives: bool) -> tuple[Array, Derivatives | None] | None:
            residual = part.residual(q, local)
            if residual is None:
                return None
            found = part.derivatives(q, local, local_tangents) if derivatives else None
            return residual if part._size is None else residual * part._size, found

        return evaluate

    def path_in(self, block: Block, q: Array, local: Array) -> Path | None:
        """Return the motion in a block of cycles; of all cycles where a force acts along an earlier path."""
        if self.along or block.rows == slice(0, self.windows.time.size):
            return self.path(q, local)
        cycles = np.arange(block.cycles.start, block.cycles.stop)
        return Model(self.task, self.windows.some(cycles), self.longest_step).path(q, local[block.cycles])

    def all_derivatives(self, q: Array, local: Array) -> Derivatives:
        return self.derivatives(q, local, partial(self._columns, q=q))

    def derivatives(self, q: Array, local: Array, columns: Callable[[Path], Array]) -> Derivatives:
        """Return the derivatives of the positions, ``columns`` (n, k) of the path of each block."""

        def derive(block: Block) -> Array | None:
            path = self.path_in(block, q, local)
            part = None if path is None else columns(path)
            return part if part is None or self._size is None else part * self._size[block.rows, None]

        whole = Block(slice(0, len(self.windows.rows)), slice(0, self.windows.time.size))
        return Derivatives((whole,) if self.along else self.windows.blocks, derive)

    def _columns(self, path: Path, q: Array) -> Array:
        _, theta, sizes = self.task.split(q)
        parts = [self.task.curve.columns(path, theta, self.task.places)]
        for forcing in self._forcings(path, sizes):
            width = next(part.shape[1] for part in forcing if part is not None)
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
        if self.near is None or not self.along:
            return None
        if self._along is None or self._along[0] is not self.near:
            self._along = self.near, self._motion(self.near)
        return self._along[1]

    def _forcings(self, path: Path, sizes: Array) -> list[Forcing]:
        """Return the effect of a unit of each force unknown along a path."""
        if not self.task.forces:
            return []
        motion = self._motion(path)
        return [one for force, own in self._sizes(sizes) for one in force.derivatives(motion, own)]

    def _sizes(self, sizes: Array) -> list[tuple[Force, Array]]:
        ends = np.cumsum([force.width for force in self.task.forces]).tolist()
        return [(force, sizes[end - force.width : end]) for force, end in zip(self.task.forces, ends, strict=True)]

    def _acting(self, sizes: Array) -> tuple[dict[str, Any], Array | float]:
        """Return the forces' contribution to a path, as arguments of `follow`, and to the reading, m."""
        more: dict[str, Any] = {}
        reading: Array | float = 0.0
        motion = self._motion_along()
        for (force, own), table in zip(self._sizes(sizes), self._tables, strict=True):
            if force.departure.drag is not None:
                more["drag"] = table._replace(acceleration=float(own[0]) * table.acceleration)
                continue
            if motion is None:
                continue
            more["along"] = self.near
            forcing, coefficients = force.forcing(motion, own), force.coefficients(own)
            for name in ("acceleration", "belt_speed"):
                part = getattr(forcing, name)
                if part is not None:
                    more[name] = more.get(name, 0.0) + np.einsum("mk,k->m", part, coefficients)
            if forcing.reading is not None:
                reading = reading + np.einsum("nk,k->n", forcing.reading, coefficients)
        return more, reading
