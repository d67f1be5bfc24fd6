"""The motion along the windows of a fit, and a friction curve as a cubic B-spline of the slip speed.

`follow` returns a path: the motion at the stage points of the integration of tangents.  `positions` stores nothing for
tangents, and its steps are independent of the samples: within a step positions are interpolated by Hermite's cubic.  A
search needs positions three times as often as tangents.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fitting.least_squares.normal_equations import scaled_inverse
from fitting.model import flow
from fitting.model.flow import (
    CREEP,
    LOG_F,
    LONGEST_STEP,
    MOST_EVENTS,
    SPLINE,
    Drag,
    Extra,
    Window,
    at_level,
    bound_velocity,
    can_creep,
    fastest_rate,
    first_mode,
    mode_at_edge,
    step_to_edge,
    turning_step,
    window_at,
)
from fitting.model.unknowns import PER_RUN
from fitting.model.windows import ShootingWindows
from rig_sim.flow.modes import NEGATIVE, RAMP, STICK
from rig_sim.friction.spline import piece_of
from stickslip.compute.arrays import Array, Integers, Mask
from stickslip.compute.compile import compiled

DEGREE = 3  # degree of the pieces: slopes and curvatures are continuous


@dataclass(frozen=True, eq=False)
class FrictionSpline:
    knots: Array  # (n + 1,) slip speeds from 0, m/s, increasing
    # (n + 3,) friction per unit mass, m/s^2; the first is that at s = 0, the last that at the last knot
    coefficients: Array
    # (4, n, 4) polynomials of the four basis functions on each piece: powers from 0 of the distance to the knot below
    basis_pieces: Array

    @classmethod
    def over(cls, knots: Array, coefficients: Array | None = None) -> "FrictionSpline":
        """Return a spline over knots (n + 1,), with coefficients (n + 3,) 0 unless given."""
        values = np.zeros(knots.size + DEGREE - 1) if coefficients is None else coefficients
        return cls(knots, values, _basis_pieces(knots))

    def with_coefficients(self, coefficients: Array) -> "FrictionSpline":
        return FrictionSpline(self.knots, coefficients, self.basis_pieces)

    def nearest(self, s: Array, values: Array) -> "FrictionSpline":
        """Return the least-squares spline with the same knots for values (k,) at speeds s (k,).

        Every piece must contain at least four of the speeds, and none may be outside the knots.
        """
        best = np.zeros(self.coefficients.size)
        fit = compiled(fill_nearest, ("rig_sim.friction.spline", __name__), _nrt=False)
        fit(self.knots, self.basis_pieces, s, values, np.zeros((best.size, DEGREE + 1)), np.empty(DEGREE + 1), best)
        return self.with_coefficients(best)

    @cached_property
    def pieces(self) -> Array:
        """The spline's polynomials, shape (n, 4), as in `basis_pieces`."""
        on_piece = np.lib.stride_tricks.sliding_window_view(self.coefficients, DEGREE + 1)
        return np.ascontiguousarray(np.einsum("ij,jik->ik", on_piece, self.basis_pieces))

    @cached_property
    def table(self) -> Array:
        """The spline as kernels read it (`rig_sim.friction.spline`), without its last two numbers, shape (5 n + 5,)."""
        c0, c1, c2, c3 = self.pieces[-1]
        z = self.knots[-1] - self.knots[-2]
        line = c0 + z * (c1 + z * (c2 + z * c3)), c1 + z * (2.0 * c2 + z * 3.0 * c3), 0.0, 0.0
        return np.concatenate((self.knots, self.pieces.ravel(), line))

    def basis(self, s: Array) -> Array:
        """Return the basis functions at slip speeds s (k,), shape (k, n + 3)."""
        return np.ascontiguousarray(self.basis_along(s, np.eye(self.coefficients.size)).T)

    def basis_along(self, s: Array, directions: Array, factor: Array | float = 1.0) -> Array:
        """Return the basis at slip speeds s (k,) along directions (n + 3, m) times ``factor`` (k,), shape (m, k).

        Continued with a constant slope beyond the last knot; below 0 by the first polynomial.
        """
        basis = np.zeros((directions.shape[1], s.size))
        fill = compiled(fill_basis, ("rig_sim.friction.spline", __name__), _nrt=False)
        each = np.broadcast_to(factor, s.shape).copy()
        fill(self.knots, self.basis_pieces, np.ascontiguousarray(s), each, np.ascontiguousarray(directions), basis)
        return basis

    def projection(self, s: Array) -> Array:
        """Return the matrix (n + 3, k) from values at speeds s (k,) to the coefficients of the nearest spline."""
        basis = self.basis(s)
        square = np.einsum("ki,kj->ij", basis, basis)
        scale, inverse = scaled_inverse(square, np.diag(square))
        return np.asarray(np.einsum("ij,kj->ik", inverse * scale[:, None] * scale, basis))

    def __call__(self, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,), m/s."""
        return np.asarray(self.basis_along(np.asarray(s, float), self.coefficients[:, None])[0])


def _basis_pieces(knots: Array) -> Array:
    """Return the polynomials (4, n, 4) of the basis functions over knots (n + 1,), as `basis_pieces`.

    By the recurrence of C. de Boor, A Practical Guide to Splines (2001), X, on all pieces at once.
    """
    t = np.concatenate(([knots[0]] * DEGREE, knots, [knots[-1]] * DEGREE))
    n = knots.size - 1
    piece = np.arange(n)
    # the four functions that are not 0 on a piece, in powers of s - t_i with i = piece + 3; the last row is 0
    functions = np.zeros((DEGREE + 2, n, DEGREE + 1))
    functions[DEGREE, :, 0] = 1.0
    below = t[piece + DEGREE]
    for k in range(1, DEGREE + 1):
        for row in range(DEGREE - k, DEGREE + 1):
            j = piece + row
            total = np.zeros((n, DEGREE + 1))
            if row > DEGREE - k:
                rise = (below - t[j])[:, None] * functions[row] + np.roll(functions[row], 1, axis=1)
                total += rise / (t[j + k] - t[j])[:, None]
            if row < DEGREE:
                fall = (t[j + k + 1] - below)[:, None] * functions[row + 1] - np.roll(functions[row + 1], 1, axis=1)
                total += fall / (t[j + k + 1] - t[j + 1])[:, None]
            functions[row] = total
    return functions[: DEGREE + 1].copy()


def fill_basis(knots: Array, pieces: Array, s: Array, factor: Array, directions: Array, out: Array) -> None:
    """Add ``factor`` (k,) times the basis at s (k,) along directions (n + 3, m) to ``out`` (m, k); a kernel."""
    last = knots[knots.size - 1]
    for column in range(s.size):
        if factor[column] == 0.0:
            continue
        i = piece_of(knots, knots.size - 1, s[column])
        beyond = max(s[column] - last, 0.0)
        z = s[column] - beyond - knots[i]
        for j in range(i, i + DEGREE + 1):  # the others are 0 on this piece
            c = pieces[j - i, i]
            rate = c[1] + z * (2.0 * c[2] + z * 3.0 * c[3])
            acting = factor[column] * (c[0] + z * (c[1] + z * (c[2] + z * c[3])) + beyond * rate)
            for m in range(out.shape[0]):
                out[m, column] += acting * directions[j, m]


def fill_nearest(
    knots: Array, pieces: Array, s: Array, values: Array, band: Array, acting: Array, coefficients: Array
) -> None:
    """Store the coefficients (n + 3,) of the spline nearest to values (k,) at speeds s (k,); a kernel.

    By normal equations with a band of four, as good as an orthogonal factorisation to 1e-13 where each piece holds
    several speeds. ``band`` (n + 3, 4) and ``coefficients`` are 0 at first, ``acting`` (4,) is scratch. Source: G.
    Golub, C. Van Loan, Matrix Computations, 4th ed., 4.3.5 (band Cholesky).
    """
    n = coefficients.size
    for row in range(s.size):
        i = piece_of(knots, knots.size - 1, s[row])
        z = s[row] - knots[i]
        for p in range(DEGREE + 1):
            c = pieces[p, i]
            acting[p] = c[0] + z * (c[1] + z * (c[2] + z * c[3]))
            coefficients[i + p] += acting[p] * values[row]
            for q in range(p + 1):
                band[i + p, p - q] += acting[p] * acting[q]
    for j in range(n):
        for i in range(j, min(j + DEGREE + 1, n)):
            for m in range(max(0, i - DEGREE), j):
                band[i, i - j] -= band[i, i - m] * band[j, j - m]
            if i == j:
                band[j, 0] = math.sqrt(band[j, 0])
            else:
                band[i, i - j] /= band[j, 0]
    for i in range(n):
        for m in range(max(0, i - DEGREE), i):
            coefficients[i] -= band[i, i - m] * coefficients[m]
        coefficients[i] /= band[i, 0]
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, min(i + DEGREE + 1, n)):
            coefficients[i] -= band[m, m - i] * coefficients[m]
        coefficients[i] /= band[i, 0]


KERNELS = ("rig_sim.friction.curve", "rig_sim.friction.spline", "fitting.model.flow")
# Limit on the steps of a motion, of 230 bytes each.  Trial splines that were too steep took 1200 a sample, and 21 GB of
# memory; motions that a fit accepted took at most 16 a sample.
MOST_STEPS, MOST_STEPS_A_SAMPLE = 1_000_000, 32
# Steps a sample for which memory is allocated at first, on a jump and on a ramp; if more are needed, the integration is
# repeated with more.  At 1 kHz jumps take 1.0, ramps of the rig scene 1.3 to 1.8.
STEPS_A_SAMPLE = 1.2, 2.2
# m: limit on the positions of a motion.  Trials of a search went to 1e110 m, where the force of a hard spring
# overflows.
FARTHEST = 1e9
NO_SPLINE, NOTHING, NO_FORCES = np.zeros(1), np.zeros(0), np.zeros((1, 0))
NO_DRAG = Drag(NOTHING, NOTHING, 0.0)


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
    u: Array  # (13 runs,) the unknowns of the motion
    local: Array
    time: Array  # (M,) s, m, m/s
    position: Array
    velocity: Array
    belt_speed: Array  # (M,) of the unloaded belt, m/s
    level: Array  # (M,) the cycle's friction level over F, faded
    # (M,) m/s^2 and 1/s: friction on the mass per unit mass, level included, positive along x, and its derivative by
    # the relative speed; in stick the force that holds the mass, and 0
    friction: Array
    friction_slope: Array
    slip_speed: Array  # (M,) m/s; the argument of the curve, >= 0; 0 on a ramp and in stick
    # (M,) derivative of the deceleration by the mass's velocity, 1/s: c/m, and that of a drag
    damping: Array
    mode: Integers  # (M,) `rig_sim.flow.modes`, or CREEP (`fitting.model.flow`)
    landed: Mask  # (M,) whether the cycle's next level applies: after the landing of a slip window
    first_point: Integers  # (windows + 1,) where each window's points and steps begin
    first_step: Integers
    steps: Integers  # (S, 3) first of a step's three points, its window, the sample at its end or -1
    jumps: Array  # (S, 3) effect of a change of mode at a step's end on tangents (`flow.crossing`)
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
    def run(self) -> Integers:
        """Run of each point, shape (M,)."""
        return np.asarray(self.windows.table[self.window, 5])

    @property
    def stuck(self) -> Mask:
        """Where the mass moves with the belt or creeps on it, without its own acceleration, shape (M,)."""
        return np.asarray((self.mode == STICK) | (self.mode == CREEP))

    @cached_property
    def side(self) -> Array:
        """1.0 where friction pushes the mass forwards in slip, -1.0 where backwards, 0.0 in stick; shape (M,)."""
        return np.where(self.slips, np.where(self.mode == NEGATIVE, 1.0, -1.0), 0.0)

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
    drag: Drag = NO_DRAG,
    longest_step: float = LONGEST_STEP,
) -> Path | None:
    """Follow all windows; None if the motion cannot be followed, or takes too many steps.

    ``u`` (13 runs,) are `fitting.model.unknowns.Global`, with a spline LOG_F and SHAPE unused; ``local`` (cycles, 6)
    are `PerCycle`. An added acceleration (m/s^2) and belt speed (m/s), (M,), are given at the points of ``along``, an
    earlier path of the same windows, linear in time between them; ``longest_step`` is times the fastest rate.
    """
    arguments = kernel_arguments(windows, curve, u, local, along, acceleration, belt_speed, drag)
    N, rows = windows.time.size, windows.table.shape[0]
    reached = np.zeros(N, np.int64)
    first_point, first_step = np.zeros((2, rows + 1), np.int64)
    kernel = compiled(flow.follow_windows, KERNELS, _nrt=False)
    # If an earlier path took more steps, this one takes about as many.
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
    drag: Drag,
) -> tuple[Any, ...]:
    """Return the first arguments of a kernel that follows windows, from the parameters of `follow`."""
    spline = curve.spline
    unknowns = np.array(u, float).reshape(-1, PER_RUN)
    if spline is not None:
        unknowns[:, LOG_F] = 0.0
    first, acting, force, belt = np.zeros(1, np.int64), NO_FORCES, 0, 0
    if along is not None:
        effects = [effect for effect in (acceleration, belt_speed) if effect is not None]
        first, acting = along.first_point, np.stack((along.time, *effects))
        force, belt = int(acceleration is not None), 0 if belt_speed is None else len(effects)
    extra = Extra(first, acting, force, belt, np.stack((drag.velocity, drag.acceleration)), drag.turn)
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


def spline_curve(spline: FrictionSpline, ramp: bool) -> Curve:
    return Curve(SPLINE, ramp, spline)


# Longest step over that of a path.  The error of the cubic is of fourth order: 1e-9 m in slips of the rig scene, at
# twice this 2e-8 m, as of a path at 100 Hz; at half this the integration takes twice the time.
VALUE_STEP = 0.4


def positions(
    windows: ShootingWindows,
    curve: Curve,
    u: Array,
    local: Array,
    *,
    along: Path | None = None,
    acceleration: Array | None = None,
    belt_speed: Array | None = None,
    drag: Drag = NO_DRAG,
    longest_step: float = LONGEST_STEP,
) -> Array | None:
    """Return the position at every sample, m, shape (N,); None where it cannot be followed.  Arguments of `follow`."""
    out = np.empty(windows.time.size)
    kernel = compiled(follow_values, (*KERNELS, __name__), _nrt=False)
    arguments = kernel_arguments(windows, curve, u, local, along, acceleration, belt_speed, drag)
    status = kernel(*arguments, longest_step, max(MOST_STEPS, MOST_STEPS_A_SAMPLE * out.size), out)
    return out if status == 0 and float(np.abs(out).max()) < FARTHEST else None


def window_values(
    w: Window,
    stick: bool,
    x: float,
    v: float,
    earliest: float,
    overtakes: bool,
    next_level: float,
    longest: float,
    times: Array,
    out: Array,
    most: int,
) -> int:
    """Fill ``out`` (n,) with the positions of one window; return the number of steps, or -1.

    It fails where the motion is not finite, stays on an edge, or takes more than ``most`` steps.
    """
    t, end = times[0], times[times.size - 1]
    lasts, landed = stick, stick
    mode, v = first_mode(w, stick, t, x, v)
    out[0] = x
    i, events, since, steps = 1, 0, t, 0
    while i < times.size:
        if steps == most:
            return -1
        steps += 1
        if mode == RAMP and can_creep(w, lasts, t, x, since, longest):
            mode = CREEP
            v = bound_velocity(w, mode, t, x)
        # The error of a long step on a ramp decays with its transient.
        step = longest if mode == RAMP else VALUE_STEP * longest
        rate = fastest_rate(w, mode, t, v)
        h = step / rate if rate * (end - t) > step else end - t
        h = min(h, turning_step(w, mode, t, x, v))
        last = h >= end - t
        x1, v1, h, ends = step_to_edge(w, mode, lasts, t, x, v, h)
        if not math.isfinite(x1 + v1):
            return -1
        step_end = end if last and not ends else t + h
        while i < times.size and times[i] <= step_end:
            r = (times[i] - t) / h if h > 0.0 else 1.0
            out[i] = x + r * r * (3.0 - 2.0 * r) * (x1 - x) + h * r * (1.0 - r) * ((1.0 - r) * v - r * v1)
            i += 1
        t, x, v = step_end, x1, v1
        if ends:
            events += 1
            if events > MOST_EVENTS:
                return -1
            mode, lasts, landed, level = mode_at_edge(w, mode, lasts, landed, overtakes, earliest, next_level, t, x, v)
            w = at_level(w, level)
            if mode == STICK or mode == CREEP:
                v = bound_velocity(w, mode, t, x)
            since = t
    return steps


def follow_values(
    curve: int,
    u: Array,
    local: Array,
    table: Integers,
    epoch: Array,
    earliest: Array,
    time: Array,
    pieces: int,
    spline: Array,
    ramp: int,
    extra: Extra,
    longest: float,
    most: int,
    out: Array,
) -> int:
    """Fill ``out`` (N,) along all windows in ``most`` steps; return 0, or 1 + the window that cannot be followed.

    Other arguments are those of `fitting.model.flow.follow_windows`.
    """
    for row in range(table.shape[0]):
        first, n = table[row, 2], table[row, 3]
        w, x, v, next_level = window_at(row, curve, u, local, table, epoch, pieces, spline, ramp, extra)
        steps = window_values(
            w,
            table[row, 1] == 1,
            x,
            v,
            earliest[row],
            table[row, 4] == 1,
            next_level,
            longest,
            time[first : first + n],
            out[first : first + n],
            most,
        )
        if steps < 0:
            return 1 + row
        most -= steps
    return 0
