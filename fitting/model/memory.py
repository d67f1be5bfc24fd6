"""Friction with memory along the windows of a fit: one a cycle, from the middle of its slip to that of the next one.

Landing, stick and break-away lie within a window, so it shows how the contact yields and how it strengthens.  A cycle
before a gap has a window that ends in its stick.  Its memory begins near that of steady slip.

The motion and its derivatives are those of `fitting.model.memory_flow`.

Unknowns of a cycle (`fitting.model.unknowns.PerCycle`): X_SLIP and V_SLIP where the window starts, LEVEL before and
NEXT_LEVEL after the landing; X_STICK is the log of the memory over that of steady slip, times `MEMORY_LENGTH` travels.

Not modelled: a ripple of the belt, a compliant belt, a level that fades within a cycle.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fitting.laws import Law, hold_confounded, natural_size
from fitting.least_squares.normal_equations import Block, Derivatives, Evaluate
from fitting.model import memory_flow, unknowns
from fitting.model.curves import FrictionCurve
from fitting.model.flow import SEARCH_STEP
from fitting.model.memory_flow import BRISTLES, P0, PER_WINDOW, RATE_AND_STATE, SHARED
from fitting.model.path import Path
from fitting.model.predict import FitStart, Model, Task
from fitting.model.problem import EstimationProblem, Run, choose_thinning, cycle_starts
from fitting.model.unknowns import PER_RUN, Global
from fitting.model.windows import EVERY_SAMPLE, ShootingWindows, Thinning
from fitting.record.cycles import Cycle, CycleSegmentation
from fitting.record.motion import MeasuredMotion
from rig_sim.friction import pair
from rig_sim.friction.memory import BRISTLE, MEMORY_LAWS, PAIR
from rig_sim.integrate import memory
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import compiled

MEMORY_LENGTH = 2.0  # travels: the prior of a start, a tenth of the travel, is then 5 % of the memory
TOLERANCE = 3e-8  # of the position, over the travel, as the simulator would use it
# Error of a step over the one that the simulator allows: in searches, and at the end, where the cost must not jump.
SEARCH_LOOSER, LOOSER = 30.0, 1.0
SLOWEST_STEADY = 1e-6  # slip speed over the belt's below which steady friction is constant
LARGEST_POWER = 300.0  # of an exponential: asinh is its logarithm there
LOOP_POINTS = 4000  # of a picture
STICK_SPEED = 1e-8  # over the belt's: slip of two formulas below which is a stick, of 1e-8 of the stick's length
KERNELS = (*memory.MODULES, "rig_sim.flow.modes", memory_flow.__name__)


class MemoryProblem(EstimationProblem):
    """The constants of the fit of a law with memory."""

    @classmethod
    def of_law(cls, law: Law, runs: Sequence[Run]) -> "MemoryProblem":
        return cls(**vars(EstimationProblem.build(law, runs)))

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        """A mass on bristles overtakes the belt by itself."""
        return tuple(replace(cycle, overtakes=False) for cycle in super().cycles)

    @property
    def thinning(self) -> list[Thinning]:
        """A break-away lies in each window, so its stick is not thinned more than its slip."""
        return [Thinning(choose_thinning(run).stride) for run in self.runs]

    def windows(self, *, thinned: bool) -> ShootingWindows:
        taken = self.thinning if thinned else [EVERY_SAMPLE] * len(self.runs)
        return ShootingWindows.join(
            [memory_windows(run.motion, run.cut, own) for run, own in zip(self.runs, taken, strict=True)]
        )


def middle_of_slip(motion: MeasuredMotion, cycle: Cycle) -> int:
    return int(np.searchsorted(motion.time, 0.5 * (cycle.break_away + cycle.landing)))


def memory_windows(motion: MeasuredMotion, cut: CycleSegmentation, thinning: Thinning) -> ShootingWindows:
    following = {cycle.number - 1: cycle for cycle in cut.cycles if not cycle.flag}
    cycles, table, samples, total = cut.used, [], [], 0
    for k, cycle in enumerate(cycles):
        after = following.get(cycle.number)
        end = cycle.slip[1] if after is None else middle_of_slip(motion, after)
        first = middle_of_slip(motion, cycle)
        if motion.broken[first + 1 : end].any():
            end = cycle.slip[1]
        taken = first + thinning.select(end - first, end - first)
        table.append((k, 0, total, taken.size, 0, 0))
        samples.append(taken)
        total += taken.size
    index, edges = np.concatenate(samples), np.cumsum([0, *(own.size for own in samples)])
    return ShootingWindows(
        table=np.array(table, np.int64),
        level_epoch=np.array([cycle.break_away for cycle in cycles]),
        earliest_landing=np.array([cycle.break_away for cycle in cycles]),
        time=motion.time[index],
        position=motion.measured[index],
        source=index,
        rows=tuple(slice(int(a), int(b)) for a, b in pairwise(edges)),
    )


class MemoryModel(Model):
    """The positions that a law with memory predicts."""

    def residual(self, q: Array, local: Array) -> Array | None:
        if self._last is None or not (np.array_equal(q, self._last[0]) and np.array_equal(local, self._last[1])):
            found, _ = self._follow(self._parameters(q), local, self.windows)
            self._last = q.copy(), local.copy(), None if found is None else found[0] - self.windows.position
        return self._last[2]

    def motion_in(self, windows: ShootingWindows, q: Array, local: Array, run: int | None) -> Array | None:
        p = self._parameters(q)
        found, _ = self._follow(p if run is None else p[run : run + 1], local, windows)
        return None if found is None else found[:2]

    def loop(self, windows: ShootingWindows, q: Array, local: Array, run: int | None, cycle: int) -> Array | None:
        p, own = self._parameters(q), windows.of_cycles(np.array([cycle]))
        own.table[0, 3], run = LOOP_POINTS, int(own.table[0, 5]) if run is None else run
        own.table[0, 5] = 0
        dense = replace(own, time=np.linspace(own.time[0], own.time[-1], LOOP_POINTS))
        found, _ = self._follow(p[run : run + 1], local[cycle : cycle + 1], dense)
        return None if found is None else np.array([p[run, SHARED.index(Global.V_DR)] - found[1], found[2]])

    def all_derivatives(self, q: Array, local: Array) -> Derivatives:
        return Derivatives(self.windows.blocks, partial(self._derive, q, local, self.task.places))

    def evaluate_cycles(self, q: Array, cycles: Integers) -> Evaluate:
        part = MemoryModel(self.task, self.windows.of_cycles(cycles), self.longest_step)
        if self._size is not None:
            part._size = np.concatenate([self._size[self.windows.rows[k]] for k in cycles])

        def evaluate(_: Array, local: Array, derivatives: bool) -> tuple[Array, Derivatives | None] | None:
            residual = part.residual(q, local)
            if residual is None:
                return None
            found = Derivatives(part.windows.blocks, partial(part._derive, q, local, None)) if derivatives else None
            return residual if part._size is None else residual * part._size, found

        return evaluate

    def _derive(self, q: Array, local: Array, places: Sequence[int] | None, block: Block) -> Array | None:
        """Return the derivatives of a block by the cycles' own unknowns, unless None after those at ``places``."""
        whole = block.rows == slice(0, self.windows.time.size)
        windows = self.windows if whole else self.windows.of_cycles(np.arange(block.cycles.start, block.cycles.stop))
        p = self._parameters(q)
        x, derivatives = self._follow(p, local[block.cycles], windows, derive=True)
        if x is None or not np.all(np.isfinite(derivatives)):
            return None
        parts = [derivatives[:, -PER_WINDOW:], np.zeros((len(derivatives), local.shape[1] - PER_WINDOW))]
        if places is not None:
            parts = [self._by_places(derivatives, windows, places), self._by_theta(derivatives, q), *parts]
        found = np.hstack(parts)
        return found if self._size is None else found * self._size[block.rows, None]

    def _by_places(self, derivatives: Array, windows: ShootingWindows, places: Sequence[int]) -> Array:
        found = np.zeros((len(derivatives), len(places)))
        run = np.repeat(windows.table[:, 5], windows.table[:, 3])
        for k, slots in enumerate(unknowns.columns(places, len(self.task.problem.runs))):
            for j in np.flatnonzero(slots >= 0):
                found[run == k, j] = derivatives[run == k, SHARED.index(Global(slots[j]))]
        return found

    def _by_theta(self, derivatives: Array, q: Array) -> Array:
        """Return the derivatives by the logarithms of the law's free parameters."""
        own = dict(zip(self._law_curve.names, derivatives[:, P0:-PER_WINDOW].T, strict=True))
        values = self.task.curve.values(self.task.split(q)[1], q)
        if self._law_curve.code == BRISTLE and "Fs" not in values:
            own["Fc"] = own["Fc"] + own["Fs"]
        return np.stack([own[name] * values[name] for name in self.task.curve.free], axis=1)

    @property
    def _law_curve(self) -> "MemoryCurve":
        return self.task.curve  # type: ignore[return-value]

    def _parameters(self, q: Array) -> Array:
        u, theta, _ = self.task.split(q)
        values = self.task.curve.values(theta, u)
        if self._law_curve.code == BRISTLE and "Fs" not in values:
            values |= {"Fs": values["Fc"], "v_s": 1.0}
        own = np.tile([values[name] for name in self._law_curve.names], (len(self.task.problem.runs), 1))
        return np.hstack([u.reshape(-1, PER_RUN)[:, list(SHARED)], own])

    def _follow(
        self, p: Array, local: Array, windows: ShootingWindows, *, derive: bool = False
    ) -> tuple[Array | None, Array]:
        """Return positions, velocities, friction (3, n), None where lost, and the derivatives of the positions."""
        motions, x = self.task.problem.motions, np.empty((3, windows.time.size))
        looser = SEARCH_LOOSER if self.longest_step == SEARCH_STEP else LOOSER
        scale = np.array([(MEMORY_LENGTH * own.travel, TOLERANCE * own.travel, looser) for own in motions])
        columns = p.shape[1] + PER_WINDOW
        derivatives, work = np.empty((windows.time.size, columns * derive)), np.empty((4, columns, 3))
        follow = compiled(memory_flow.follow_windows, KERNELS, _nrt=False)
        with np.errstate(all="ignore"):
            own = self._law_curve.code, p, local.copy(), windows.table, scale, windows.time, x, derivatives, work
            done = follow(*own, self._law_curve.formulas)
        return x if done and np.all(np.isfinite(x)) else None, derivatives


class Sizes(NamedTuple):
    """Sizes in a run: of friction (m/s^2), of the fastest slip and of the belt's speed (m/s)."""

    friction: float
    speed: float
    belt: float

    @classmethod
    def of(cls, problem: MemoryProblem) -> "Sizes":
        motion, p = problem.motions[0], unknowns.values(problem.start[:PER_RUN])
        return cls(float(p.F), float(np.max(motion.belt_speed - motion.velocity)), float(p.v_dr))


def encode(law: Law, sizes: Sizes) -> Array:
    """Return the formulas of a law of one's own for kernels; its steady state is sought from a state of its unit."""
    seed = natural_size(law, pair.STATE, sizes.friction, sizes.speed)
    return pair.encode(law.curve, law.state_rate, law.parameters, STICK_SPEED * sizes.belt, seed)


class MemoryCurve(FrictionCurve):
    """A law with memory; theta are the logarithms of its free parameters, each with the sign of its first value."""

    law: Law
    ramp = False
    model = MemoryModel

    def __init__(self, law: Law, start: dict[str, float], sizes: Sizes) -> None:
        self.code, self.names, self.formulas = PAIR, law.parameters, None
        fitted = law
        if law.own_memory:
            self.together, fitted = hold_confounded(law, sizes.friction, sizes.speed)
            self.formulas = encode(law, sizes)
        else:
            self.code = MEMORY_LAWS[law.name].code
            self.names = BRISTLES if self.code == BRISTLE else RATE_AND_STATE
        self.law, self.fixed, self.free = law, dict(fitted.fix or {}), fitted.free
        self.size = len(self.free)
        self.prior = self.precision = np.zeros(self.size)
        self.by_log = np.ones(self.size, np.bool_)
        own = np.array([start[name] for name in self.free])
        self.sign = np.where(own < 0.0, -1.0, 1.0)
        ends = self.sign * np.array([law.limits(name) for name in self.free]).reshape(-1, 2).T
        with np.errstate(divide="ignore", invalid="ignore"):
            self.lower, self.upper = np.log(np.maximum(ends.min(axis=0), 0.0)), np.log(ends.max(axis=0))
            self.start = np.log(np.abs(own))

    def values(self, theta: Array, u: Array) -> dict[str, float]:
        values = self.sign * np.exp(np.clip(theta, -700.0, 700.0))
        return self.fixed | dict(zip(self.free, values.tolist(), strict=True))

    def on_path(self, theta: Array, beside: Array) -> None:
        """Return None: its motion is stiff, and followed by `MemoryModel` alone."""

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        raise TypeError("derivatives of a law with memory are made by its model")

    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
        """Return the friction of steady slip, of rate and state in the regularised form of the simulator."""
        speed, own = np.maximum(s, SLOWEST_STEADY * float(u[Global.V_DR])), self.values(theta, u)
        if self.code == PAIR:
            found, values = np.empty(speed.shape), np.array([own[name] for name in self.names])
            follow = compiled(pair.steady_friction, (pair.__name__,), _nrt=False)
            follow(self.formulas, values, speed.ravel(), found.ravel())
            return found
        if "a" not in own:
            return self.law.curve.value(speed, own)
        power = np.log(speed / (2.0 * own["v0"])) + (own["F0"] + own["b"] * np.log(own["v0"] / speed)) / own["a"]
        grown = np.arcsinh(np.exp(np.minimum(power, LARGEST_POWER)))
        return np.asarray(own["a"] * np.where(power < LARGEST_POWER, grown, power + math.log(2.0)))


def memory_task(law: Law, problem: MemoryProblem, start: dict[str, float]) -> Task:
    """Return the task of a law with memory, from first values of its parameters."""
    places = tuple(place for place in problem.active if place % PER_RUN in SHARED)
    return Task(problem, MemoryCurve(law, start | dict(law.start or {}), Sizes.of(problem)), places)


def warm_start(task: Task, u: Array) -> FitStart:
    """Return the start of a task at the rig of unknowns u (13 runs,), its windows at the smoothed motion."""
    problem = task.problem
    local = cycle_starts(problem.windows(thinned=True), problem.motions, problem.cycles, u)
    return FitStart(np.concatenate([u[list(task.places)], task.curve.start]), local)
