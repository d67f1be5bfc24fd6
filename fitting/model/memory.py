"""Friction with memory along the windows of a fit: one a cycle, from the middle of its slip to that of the next one.

Landing, stick and break-away lie within a window, so it shows how the contact yields and how it strengthens.  A cycle
before a gap has a window that ends in its stick.  Its memory begins near that of steady slip.

The stiff kernel of the simulator is followed in steps chosen by its errors; derivatives are differences over the same
steps, so they are those of the discrete map.  The friction level changes where the model itself lands: where its slip
speed falls to a share of the belt's.  That step ends there also in the differences, and the next one takes up what
it is longer or shorter.

Unknowns of a cycle (`fitting.model.unknowns.PerCycle`): X_SLIP and V_SLIP where the window starts, LEVEL before and
NEXT_LEVEL after the landing; X_STICK is the log of the memory over that of steady slip, times `MEMORY_LENGTH` travels.

Not modelled: a ripple of the belt, a compliant belt, a level that fades within a cycle.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from fitting.laws import Law
from fitting.least_squares.normal_equations import Block, Derivatives, Evaluate
from fitting.model.curves import FrictionCurve
from fitting.model.path import Path
from fitting.model.predict import FitStart, Model, Task
from fitting.model.problem import EstimationProblem, Run, cycle_starts, thinned_to
from fitting.model.unknowns import PER_RUN, Global, PerCycle
from fitting.model.windows import EVERY_SAMPLE, ShootingWindows, Thinning
from fitting.record.cycles import Cycle, CycleSegmentation
from fitting.record.motion import MeasuredMotion
from rig_sim.flow import modes
from rig_sim.flow.memory import LANDING, MemoryFlow, Vector, motion_of, second_variable, slip
from rig_sim.friction.memory import AGEING, BRISTLE, MEMORY_LAWS
from rig_sim.integrate import memory
from rig_sim.integrate.memory import TRIALS, event_share, motion_within, relative_error, rosenbrock_step
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import compiled

MEMORY_LENGTH = 2.0  # travels: the prior of a start, a tenth of the travel, is then 5 % of the memory
TOLERANCE = 3e-8  # of the position, over the travel, as the simulator would use it
LOOSER = 30.0  # error of a step over the one that the simulator allows
FIRST_STEP = 1e-3  # x sqrt(m/k)
MOST_STEPS = 2000  # of a window; usual ones take 100 to 300
# Of rate and state, over the belt's speed: slip below which friction balances the load, and from which it ends to.
CREEP_BEGINS, CREEP_ENDS = 1e-4, 1e-6
SHORTEST_CREEP = 1e-4  # x sqrt(m/k)
LANDING_STEPS = 3  # Newton steps to the end of the step that lands
DIFFERENCE = 1e-6  # of an unknown over its size, for derivatives
SLOWEST_STEADY = 1e-6  # slip speed over the belt's below which steady friction is constant
LARGEST_POWER = 300.0  # of an exponential: asinh is its logarithm there
SHARED = (Global.K, Global.V_DR, Global.DATUM, Global.DAMPING)
PARAMETERS = ("s0", "s1", "Fc", "Fs", "v_s", "F0", "a", "b", "D", "v0")
X, V, LEVEL, NEXT_LEVEL, MEMORY = (int(column) for column in tuple(PerCycle)[:5])
S0, FC, FS, V_S, V0 = (len(SHARED) + PARAMETERS.index(name) for name in ("s0", "Fc", "Fs", "v_s", "v0"))
KERNELS = (*memory.MODULES, "rig_sim.flow.modes")


def flow_of(law: int, p: Array, level: float, tolerance: float) -> MemoryFlow:
    """Return the flow of `SHARED` and `PARAMETERS` p (14,), per unit mass, at the log of a friction level."""
    return MemoryFlow(
        1.0,
        p[0],
        p[2],
        p[3],
        p[1],
        math.exp(level),
        0.0,
        0.0,
        0.0,
        0.0,
        law,
        LANDING * p[1],
        tolerance,
        p[4],
        p[5],
        0.0,
        p[6],
        p[7],
        p[8],
        p[9],
        p[10],
        p[11],
        p[12],
        p[13],
    )


def steady_memory(law: int, p: Array, level: float, e: float) -> float:
    """Return the memory of steady slip at a speed e > 0 (m/s)."""
    if law == BRISTLE:
        g = p[FC] + (p[FS] - p[FC]) * math.exp(-((e / p[V_S]) ** 2))
        return math.exp(level) * float(g / p[S0])
    return math.log(p[V0] / e)


def balanced(flow: MemoryFlow, x: float) -> float:
    """Return y of a mass that moves with the belt, at a position."""
    return (flow.k * (x - flow.x0) + flow.c * flow.v_belt) / (flow.factor * flow.a)


def creep(flow: MemoryFlow, u: Vector, h: float, fastest: float) -> Vector:
    """Return the state after a time h bound to the belt; u where slip would be above ``fastest`` of its speed.

    As friction balances the load, slip falls by e-folds in 1e-20 s and less: kept steps cannot repeat that.
    """
    x, z = u[0] + flow.v_belt * h, u[2]
    if flow.law == AGEING:
        z += math.log1p(flow.v0 / flow.D * h * math.exp(-z))
    y = balanced(flow, x)
    if y - (flow.F0 + flow.b * z) / flow.a > math.log(fastest * flow.v_belt / flow.v0):
        return u
    return x, y, z


def follow_window(
    law: int, p: Array, own: Array, spread: float, tolerance: float, time: Array, steps: Array, kept: Integers, x: Array
) -> bool:
    """Follow one window to positions and velocities x (2, n) at ``time`` (n,), s; return whether that is possible.

    ``kept`` are the number of ``steps`` and the one that lands (-1 for none); steps are chosen where the number is 0.
    """
    flow = flow_of(law, p, own[LEVEL], tolerance)
    v = own[V]
    z = steady_memory(law, p, own[LEVEL], max(p[1] - v, 1e-6 * p[1]))
    change = own[MEMORY] / spread
    z = z * math.exp(change) if law == BRISTLE else z + change
    u = (own[X], second_variable(flow, v - p[1], z), z)
    start = motion_of(flow, 0.0, u)
    choosing, landed, creeping = kept[0] == 0, False, False
    t, end = time[0], time[time.size - 1]
    step, shift = FIRST_STEP / math.sqrt(p[0]), 0.0
    n, i, trials = 0, 0, 0
    while (choosing and t < end) or (not choosing and n < kept[0]):
        h = min(step, end - t) if choosing else abs(steps[n]) - shift
        shift = 0.0
        if choosing and creeping:
            while h > SHORTEST_CREEP / math.sqrt(p[0]) and creep(flow, u, h, CREEP_ENDS) == u:
                h *= 0.5
        if creeping and (creep(flow, u, h, CREEP_ENDS) == u if choosing else steps[n] > 0.0):
            creeping, step = False, h
            u = (u[0], balanced(flow, u[0]), u[2])
            start = motion_of(flow, t, u)
        if not choosing:
            creeping = steps[n] < 0.0
        if creeping:
            if choosing and n == steps.size:
                return False
            while i < time.size and time[i] <= t + h:
                x[0, i], x[1, i] = u[0] + p[1] * (time[i] - t), p[1]
                i += 1
            u = creep(flow, u, h, math.inf)
            if choosing:
                steps[n] = -h
                step = 2.0 * h
            t = end if choosing and h == end - t else t + h
            start = (u[0], p[1], 0.0)
            n += 1
            continue
        after, error = rosenbrock_step(flow, t, u, h)
        if choosing:
            size = relative_error(flow, u, after, error) / LOOSER
            if not size <= 1.0:
                trials += 1
                if trials > TRIALS:
                    return False
                step = h * (max(0.2, 0.9 * size**-0.25) if size < 1e100 else 0.2)
                continue
            trials = 0
            longer = h * min(4.0, 0.9 * max(size, 1e-10) ** -0.25)
            step = max(longer, step) if h < step else longer
        stop = motion_of(flow, t + h, after)
        lands = (not landed and p[1] - stop[1] < flow.edge) if choosing else n == kept[1]
        if lands:
            if choosing:
                h *= event_share(flow, modes.NEGATIVE, h, start, stop)
                after, error = rosenbrock_step(flow, t, u, h)
                stop = motion_of(flow, t + h, after)
            for _i in range(LANDING_STEPS):
                h += (slip(flow, after[1], after[2])[0] - flow.edge) / stop[2]
                after, error = rosenbrock_step(flow, t, u, h)
                stop = motion_of(flow, t + h, after)
            if not choosing:
                shift = h - steps[n]
        if not (math.isfinite(stop[0]) and math.isfinite(stop[1]) and math.isfinite(after[2])):
            return False
        while i < time.size and time[i] <= t + h:
            x[0, i], x[1, i], _a = motion_within(flow, h, (time[i] - t) / h, start, stop)
            i += 1
        if choosing:
            if n == steps.size:
                return False
            steps[n] = h
        t = end if choosing and h == end - t else t + h
        u, start = after, stop
        if lands:
            landed = True
            if choosing:
                kept[1] = n
            flow = flow_of(law, p, own[NEXT_LEVEL], tolerance)
            start = motion_of(flow, t, u)
        if choosing and law != BRISTLE and p[1] - start[1] < CREEP_BEGINS * p[1]:
            creeping = creep(flow, u, SHORTEST_CREEP / math.sqrt(p[0]), CREEP_ENDS) != u
        n += 1
    if choosing:
        kept[0] = n
    while i < time.size:
        x[0, i], x[1, i] = start[0] + start[1] * (time[i] - t), start[1]
        i += 1
    return True


def follow_windows(
    law: int,
    p: Array,
    local: Array,
    table: Integers,
    scale: Array,
    time: Array,
    steps: Array,
    kept: Integers,
    x: Array,
) -> bool:
    """Follow windows (w, 6) of runs with parameters p (runs, 14); ``scale`` (runs, 2) are spread and tolerance."""
    for w in range(table.shape[0]):
        run, begin, stop = table[w, 5], table[w, 2], table[w, 2] + table[w, 3]
        spread, tolerance = scale[run, 0], scale[run, 1]
        if not follow_window(
            law, p[run], local[w], spread, tolerance, time[begin:stop], steps[w], kept[w], x[:, begin:stop]
        ):
            return False
    return True


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
        return [Thinning(thinned_to(run).stride) for run in self.runs]

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
        taken = first + thinning.taken(end - first, end - first)
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
    """The positions that a law with memory predicts; their derivatives are differences over the same steps."""

    def residual(self, q: Array, local: Array) -> Array | None:
        if self._last is None or not (np.array_equal(q, self._last[0]) and np.array_equal(local, self._last[1])):
            found = self._follow(self._parameters(q), local, self.windows, *new_steps(len(self.windows.rows)))
            self._last = q.copy(), local.copy(), None if found is None else found[0] - self.windows.position
        return self._last[2]

    def motion_in(self, windows: ShootingWindows, q: Array, local: Array, run: int | None) -> Array | None:
        p = self._parameters(q)
        own = p if run is None else p[run : run + 1]
        return self._follow(own, local, windows, *new_steps(len(windows.table)))

    def all_derivatives(self, q: Array, local: Array) -> Derivatives:
        return Derivatives(self.windows.blocks, partial(self._differences, q, local, q.size))

    def some(self, q: Array, cycles: Integers) -> Evaluate:
        part = MemoryModel(self.task, self.windows.some(cycles), self.longest_step)
        if self._size is not None:
            part._size = np.concatenate([self._size[self.windows.rows[k]] for k in cycles])

        def evaluate(_: Array, local: Array, derivatives: bool) -> tuple[Array, Derivatives | None] | None:
            residual = part.residual(q, local)
            if residual is None:
                return None
            found = Derivatives(part.windows.blocks, partial(part._differences, q, local, 0)) if derivatives else None
            return residual if part._size is None else residual * part._size, found

        return evaluate

    def _differences(self, q: Array, local: Array, shared: int, block: Block) -> Array | None:
        """Return the derivatives of a block by the first ``shared`` unknowns and by the cycles' own."""
        whole = block.rows == slice(0, self.windows.time.size)
        cycles = np.arange(block.cycles.start, block.cycles.stop)
        windows, own = self.windows if whole else self.windows.some(cycles), local[block.cycles]
        steps, kept = new_steps(len(own))
        x = self._follow(self._parameters(q), own, windows, steps, kept)
        if x is None:
            return None
        found = np.zeros((x.shape[1], shared + local.shape[1]))
        for j, size in enumerate(self.sizes(q)[:shared] * DIFFERENCE):
            moved = q.copy()
            moved[j] += size
            there = self._follow(self._parameters(moved), own, windows, steps, kept)
            if there is None:
                return None
            found[:, j] = (there[0] - x[0]) / size
        motion = self.task.problem.motions[0]
        for j, scale in enumerate((motion.travel, motion.belt_speed, 1.0, 1.0, motion.travel)):
            beside = own.copy()
            beside[:, j] += DIFFERENCE * scale
            there = self._follow(self._parameters(q), beside, windows, steps, kept)
            if there is None:
                return None
            found[:, shared + j] = (there[0] - x[0]) / (DIFFERENCE * scale)
        return found if self._size is None else found * self._size[block.rows, None]

    def sizes(self, q: Array) -> Array:
        """Return the sizes of the shared unknowns; logarithms have 1."""
        problem = self.task.problem
        K, motion = float(problem.start[Global.K]), problem.motions[0]
        sizes = {Global.K: K, Global.V_DR: motion.belt_speed, Global.DATUM: motion.travel}
        of_places = [sizes.get(Global(place % PER_RUN), math.sqrt(K)) for place in self.task.places]
        return np.array([*of_places, *np.ones(q.size - len(of_places))])

    def _parameters(self, q: Array) -> Array:
        u, theta, _ = self.task.split(q)
        values = self.task.curve.values(theta, u)
        p = np.zeros((len(self.task.problem.runs), len(SHARED) + len(PARAMETERS)))
        p[:, : len(SHARED)] = u.reshape(-1, PER_RUN)[:, list(SHARED)]
        p[:, len(SHARED) :] = [values.get(name, 0.0) for name in PARAMETERS]
        if "Fs" not in values:
            p[:, FS], p[:, V_S] = p[:, FC], 1.0
        return p

    def _follow(self, p: Array, local: Array, windows: ShootingWindows, steps: Array, kept: Integers) -> Array | None:
        motions, x = self.task.problem.motions, np.empty((2, windows.time.size))
        scale = np.array([(MEMORY_LENGTH * own.travel, TOLERANCE * own.travel) for own in motions])
        law = MEMORY_LAWS[self.task.curve.law.name].code  # type: ignore[union-attr]
        follow = compiled(follow_windows, (*KERNELS, __name__), _nrt=False)
        with np.errstate(all="ignore"):
            done = follow(law, p, local, windows.table, scale, windows.time, steps, kept, x)
        return x if done and np.all(np.isfinite(x)) else None


def new_steps(windows: int) -> tuple[Array, Integers]:
    kept = np.zeros((windows, 2), np.int64)
    kept[:, 1] = -1
    return np.empty((windows, MOST_STEPS)), kept


class MemoryCurve(FrictionCurve):
    """A law with memory; theta are the logarithms of its free parameters."""

    law: Law
    ramp = False
    model = MemoryModel

    def __init__(self, law: Law, start: dict[str, float]) -> None:
        self.law, self.fixed, self.free = law, dict(law.fix or {}), law.free
        self.size, self.by_log = len(self.free), np.ones(len(self.free), np.bool_)
        self.prior = self.precision = np.zeros(self.size)
        low, high = np.array([law.limits(name) for name in self.free]).reshape(-1, 2).T
        with np.errstate(divide="ignore", invalid="ignore"):
            self.lower, self.upper = np.log(np.maximum(low, 0.0)), np.log(high)
        self.start = np.log([start[name] for name in self.free])

    def values(self, theta: Array, u: Array) -> dict[str, float]:
        return self.fixed | dict(zip(self.free, np.exp(np.clip(theta, -700.0, 700.0)).tolist(), strict=True))

    def on_path(self, theta: Array, beside: Array) -> None:
        """Return None: its motion is stiff, and followed by `MemoryModel` alone."""

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        raise TypeError("derivatives of a law with memory are differences, made by its model")

    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
        """Return the friction of steady slip, of rate and state in the regularised form of the simulator."""
        speed, own = np.maximum(s, SLOWEST_STEADY * float(u[Global.V_DR])), self.values(theta, u)
        if "a" not in own:
            return self.law.curve.value(speed, own)
        power = np.log(speed / (2.0 * own["v0"])) + (own["F0"] + own["b"] * np.log(own["v0"] / speed)) / own["a"]
        grown = np.arcsinh(np.exp(np.minimum(power, LARGEST_POWER)))
        return np.asarray(own["a"] * np.where(power < LARGEST_POWER, grown, power + math.log(2.0)))


def memory_task(law: Law, runs: Sequence[Run], start: dict[str, float]) -> Task:
    """Return the task of a law with memory, from first values of its parameters."""
    problem = MemoryProblem.of_law(law, runs)
    places = tuple(place for place in problem.active if place % PER_RUN in SHARED)
    return Task(problem, MemoryCurve(law, start | dict(law.start or {})), places)


def start_beside(task: Task, u: Array) -> FitStart:
    """Return the start of a task at the rig of unknowns u (13 runs,), its windows at the smoothed motion."""
    problem = task.problem
    local = cycle_starts(problem.windows(thinned=True), problem.motions, problem.cycles, u)
    return FitStart(np.concatenate([u[list(task.places)], task.curve.start]), local)
