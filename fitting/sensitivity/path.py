"""The path: the motion along the windows, at the stage points of the integration of tangents."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fitting.model.parameters import PER_RUN
from fitting.model.windows import ShootingWindows
from fitting.sensitivity import flow, rates
from fitting.sensitivity.friction import SPLINE
from fitting.sensitivity.spline import FrictionSpline
from rig_sim.flow.modes import NEGATIVE, RAMP, STICK
from stickslip.compute.arrays import Array, Integers, Mask
from stickslip.compute.compile import compiled

KERNELS = (
    "rig_sim.friction.curve",
    "rig_sim.friction.spline",
    "fitting.sensitivity.friction",
    "fitting.sensitivity.rates",
    "fitting.sensitivity.flow",
)
# A motion of more steps, 230 bytes each, is not followed.  Trial splines that were too steep took 1200 a sample, and
# 21 GB of memory; motions that a fit accepted took 16 a sample at most.
MOST_STEPS, MOST_STEPS_A_SAMPLE = 1_000_000, 32
# Steps a sample for which there is room at first, on a jump and on a ramp; where they are more, the motion is followed
# again with more room.  At 1 kHz jumps take 1.0, ramps of the rig scene 1.3 to 1.8.
STEPS_A_SAMPLE = 1.2, 2.2
# m: a motion that goes further is not followed.  Trials of a search went to 1e110 m, where a hard spring's force is no
# number.
FARTHEST = 1e9
NO_SPLINE, NOTHING, NO_FORCES = np.zeros(1), np.zeros(0), np.zeros((1, 0))
NO_DRAG = rates.Drag(NOTHING, NOTHING, 0.0)


@dataclass(frozen=True, eq=False)
class Curve:
    """The friction of a path: ``code`` of a law's curve (`rig_sim.friction.curve`) or a spline; ramp or jump."""

    code: int
    ramp: bool
    spline: FrictionSpline | None = None


@dataclass(frozen=True, eq=False)
class Path:
    """The motion along all windows; M stage points: each step's start, middle and end, shared by consecutive steps."""

    windows: ShootingWindows
    curve: Curve
    u: Array  # (13 runs,) the unknowns that it was followed with
    local: Array
    time: Array  # (M,) s, m, m/s
    position: Array
    velocity: Array
    belt_speed: Array  # (M,) of the unloaded belt, m/s
    level: Array  # (M,) the cycle's friction level over F, faded
    # (M,) m/s^2 and 1/s: friction on the mass per unit mass, level included, positive along x, and its derivative by
    # the relative speed; in stick what holds the mass, and 0
    friction: Array
    friction_slope: Array
    slip_speed: Array  # (M,) m/s; the argument of the curve, >= 0; 0 on a ramp and in stick
    # (M,) derivative of what the mass's own velocity takes from its acceleration, 1/s: c/m, and that of a drag
    damping: Array
    mode: Integers  # (M,) `rig_sim.flow.modes`, or CREEP (`fitting.sensitivity.rates`)
    landed: Mask  # (M,) whether the cycle's next level holds: after the landing of a slip window
    first_point: Integers  # (windows + 1,) where each window's points and steps begin
    first_step: Integers
    steps: Integers  # (S, 3) first of a step's three points, its window, the sample at its end or -1
    jumps: Array  # (S, 3) what a change of mode at a step's end does to tangents (`flow.crossing`)
    reached: Integers  # (N,) the point of each sample

    def unknown(self, slot: int) -> Array | float:
        """Return a shared unknown at every point, (M,); one number for a single run."""
        of_runs = self.u.reshape(-1, PER_RUN)[:, slot]
        return float(of_runs[0]) if of_runs.size == 1 else np.asarray(of_runs[self.run])

    @property
    def model(self) -> Array:
        """Position at every sample, m, shape (N,)."""
        return np.asarray(self.position[self.reached])

    @property
    def residual(self) -> Array:
        """Model minus measurement, m, shape (N,)."""
        return self.model - self.windows.position

    @cached_property
    def window(self) -> Integers:
        """Window of each point, shape (M,)."""
        return np.repeat(np.arange(self.first_point.size - 1), np.diff(self.first_point))

    @cached_property
    def cycle(self) -> Integers:
        """Cycle of each point, shape (M,)."""
        return np.asarray(self.windows.table[self.window, 0])

    @cached_property
    def run(self) -> Integers:
        """Run of each point, shape (M,)."""
        return np.asarray(self.windows.table[self.window, 5])

    @property
    def stuck(self) -> Mask:
        """Where the mass moves with the belt or creeps on it, without its own acceleration, shape (M,)."""
        return np.asarray((self.mode == STICK) | (self.mode == rates.CREEP))

    @cached_property
    def side(self) -> Array:
        """1.0 where friction pushes the mass forwards in slip, -1.0 where backwards, 0.0 in stick; shape (M,)."""
        slips = self.slips
        return np.where(slips, np.where(self.mode == NEGATIVE, 1.0, -1.0), 0.0)

    @cached_property
    def slips(self) -> Mask:
        """Where the mass slips beyond any ramp, shape (M,)."""
        return np.asarray((self.mode > STICK) & (self.mode < RAMP))


def follow(
    windows: ShootingWindows,
    curve: Curve,
    u: Array,
    local: Array,
    *,
    along: Path | None = None,
    acceleration: Array | None = None,
    belt_speed: Array | None = None,
    drag: rates.Drag = NO_DRAG,
    longest_step: float = flow.LONGEST_STEP,
) -> Path | None:
    """Follow all windows; None where the motion cannot be followed, or only in too many steps.

    ``u`` (13 runs,) are `fitting.model.parameters.Global`, with a spline LOG_F and SHAPE unused; ``local`` (cycles, 6)
    are `PerCycle`. An added acceleration (m/s^2) and belt speed (m/s), (M,), are given at the points of ``along``, an
    earlier path of the same windows, linear in time between them; ``longest_step`` is times the fastest rate.
    """
    arguments = kernel_arguments(windows, curve, u, local, along, acceleration, belt_speed, drag)
    N, rows = windows.time.size, windows.table.shape[0]
    reached = np.zeros(N, np.int64)
    first_point, first_step = np.zeros((2, rows + 1), np.int64)
    kernel = compiled(flow.follow_windows, KERNELS, _nrt=False)
    # Where an earlier path took more steps, this one takes about as many.
    earlier = 0.0 if along is None else 1.2 * along.steps.shape[0]
    size = int(max(STEPS_A_SAMPLE[bool(curve.ramp)] * N, earlier)) + 20 * rows
    most = max(size, MOST_STEPS, MOST_STEPS_A_SAMPLE * N)
    while True:
        points, kinds = np.empty((9, 2 * size)), np.empty((2, 2 * size), np.int64)
        steps, jumps = np.empty((size, 3), np.int64), np.empty((size, 3))
        status = kernel(
            *arguments,
            longest_step,
            points,
            kinds,
            steps,
            jumps,
            reached,
            first_point,
            first_step,
        )
        if status == 0:
            break
        if status > 0 or size == most:
            return None
        size = min(2 * size, most)
    M, S = int(first_point[-1]), int(first_step[-1])
    if not float(np.abs(points[flow.POSITION, :M]).max()) < FARTHEST:
        return None
    return Path(
        windows,
        curve,
        arguments[1].ravel(),
        np.array(local),
        time=points[flow.TIME, :M],
        position=points[flow.POSITION, :M],
        velocity=points[flow.VELOCITY, :M],
        belt_speed=points[flow.BELT, :M],
        level=points[flow.LEVEL, :M],
        friction=points[flow.FRICTION, :M],
        friction_slope=points[flow.SLOPE, :M],
        slip_speed=points[flow.SPEED, :M],
        damping=points[flow.RESISTANCE, :M],
        mode=kinds[0, :M],
        landed=kinds[1, :M] == 1,
        first_point=first_point,
        first_step=first_step,
        steps=steps[:S],
        jumps=jumps[:S],
        reached=reached,
    )


def kernel_arguments(
    windows: ShootingWindows,
    curve: Curve,
    u: Array,
    local: Array,
    along: Path | None,
    acceleration: Array | None,
    belt_speed: Array | None,
    drag: rates.Drag,
) -> tuple[Any, ...]:
    """Return the first arguments of a kernel that follows windows, from the parameters of `follow`."""
    spline = curve.spline
    unknowns = np.array(u, float).reshape(-1, PER_RUN)
    if spline is not None:
        unknowns[:, rates.LOG_F] = 0.0
    first, acting, force, belt = np.zeros(1, np.int64), NO_FORCES, 0, 0
    if along is not None:
        given = [part for part in (acceleration, belt_speed) if part is not None]
        first, acting = along.first_point, np.stack((along.time, *given))
        force, belt = int(acceleration is not None), 0 if belt_speed is None else len(given)
    extra = rates.Extra(first, acting, force, belt, np.stack((drag.velocity, drag.acceleration)), drag.turn)
    return (
        curve.code,
        unknowns,
        np.ascontiguousarray(local),
        windows.table,
        windows.level_epoch,
        windows.earliest_landing,
        windows.time,
        0 if spline is None else spline.knots.size,
        NO_SPLINE if spline is None else spline.table,
        int(curve.ramp),
        extra,
    )


def law_curve(code: int, ramp: bool) -> Curve:
    return Curve(code, ramp)


def spline_curve(spline: FrictionSpline, ramp: bool) -> Curve:
    """Return a spline as the curve, with or without a ramp."""
    return Curve(SPLINE, ramp, spline)


def with_coefficients(curve: Curve, coefficients: Array) -> Curve:
    """Return a spline curve with other coefficients, m/s^2."""
    if curve.spline is None:
        raise ValueError("this curve is a law's: it has no coefficients")
    return replace(curve, spline=curve.spline.with_coefficients(coefficients))
