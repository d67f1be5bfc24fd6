"""Phases of a contact with memory: a stiff integrator whose steps follow an error, interpreted or compiled.

RODAS (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, VI.4): a Rosenbrock method of order 4,
L-stable and stiffly accurate, so that a stick whose rates reach 1e20/s is followed as the balance of forces that it is.
Between the ends of a step x is the quintic through position, velocity and acceleration there.

The contact sticks from a slip slower than ``flow.edge`` until one `BREAK_AWAY` times as fast: events end their phase
as those of a law without memory do.  `rosenbrock_step` and `motion_within` know neither events nor errors: steps that
were chosen once may be repeated with other parameters, for derivatives of the motion.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from rig_sim.flow import modes
from rig_sim.flow.memory import (
    BREAK_AWAY,
    MemoryFlow,
    Vector,
    drive,
    jacobian,
    motion_of,
    rates,
    second_variable,
    slip,
    smooth_speed,
)
from rig_sim.friction.memory import BRISTLE, PAIR
from rig_sim.friction.pair import at, evaluate
from rig_sim.integrate.phases import Samples, State
from rig_sim.integrate.work import new_record, unboxed

MODULES = ("rig_sim.friction.memory", "rig_sim.friction.pair", "rig_sim.flow.memory", "rig_sim.integrate.memory")
FIRST_STEP = 1e-6  # x sqrt(m/k); the next are chosen by their errors
TRIALS = 100  # of a step, each at most half as long
# Largest errors of a step, where these are smaller than what the tolerance allows: of the bristles' deflection over
# Fc/s0, of y and of the memory of rate and state.
DEFLECTION_ERROR, FORCE_ERROR, MEMORY_ERROR = 1e-6, 1e-2, 1e-3
# Of two formulas y = 1 is three quarters of the friction, of rate and state it is a thirtieth.
PAIR_FORCE_ERROR = FORCE_ERROR / 10.0
# The deflection's error need not be smaller than these: over the tolerance, and over Fc/s0.
SMALL, SMALL_DEFLECTION = 1e-3, 1e-2
LEAST_MEMORY = 1e-300  # of two formulas, whose memory has any unit
ROUNDING = 1.0 + 1e-5  # of the largest deflection
BEYOND = 100.0  # error of a step that ends beyond it
LARGEST_CHANGE = 10.0  # of velocity and slip speed within a step, over the larger of those at its ends
BISECTIONS = 50  # of a step, for an event

# The coefficients of RODAS: of the stages, of their rates over the step, of their times and of the drive's slope.
A2 = 1.544
A3 = (0.9466785280815826, 0.2557011698983284)
A4 = (3.314825187068521, 2.896124015972201, 0.9986419139977817)
A5 = (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950)
C2 = -5.6688
C3 = (-2.430093356833875, -0.2063599157091915)
C4 = (-0.1073529058151375, -9.594562251023355, -20.47028614809616)
C5 = (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160)
C6 = (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054)
T2, T3, T4 = 0.386, 0.21, 0.63
D1, D2, D3, D4 = 0.25, -0.1043, 0.1035, -0.03620000000000023


@dataclass(slots=True)
class MemoryWork:
    """What the kernel keeps between its phases."""

    y: float  # of the last state
    z: float
    w: float  # relative velocity there; another one in a `State` means that the mass was moved
    step: float  # length of the next step, s; 0 for one of `FIRST_STEP`
    steps: float
    steps_allowed: float


def new_memory_work(max_steps: float, *, compiled: bool = False) -> MemoryWork:
    """Return the record of a contact without a past: bristles at rest, an age of D/v0."""
    work = new_record(MemoryWork, compiled=compiled)
    work.w = math.nan
    work.steps_allowed = max_steps
    return work


def initial_mode(flow: MemoryFlow, v: float) -> int:
    """Return the mode of a velocity over ground (m/s) at which a motion begins, or is moved to."""
    w = v - flow.v_belt
    if abs(w) < flow.edge:
        return modes.STICK
    return modes.NEGATIVE if w < 0.0 else modes.POSITIVE


def plus(u: Vector, size: float, k: Vector) -> Vector:
    return u[0] + size * k[0], u[1] + size * k[1], u[2] + size * k[2]


def solve(inverse: tuple[Vector, Vector, Vector], right: Vector, push: float) -> Vector:
    first, second, third = inverse
    r0, r1, r2 = right[0], right[1] + push, right[2]
    return (
        first[0] * r0 + first[1] * r1 + first[2] * r2,
        second[0] * r0 + second[1] * r1 + second[2] * r2,
        third[0] * r0 + third[1] * r1 + third[2] * r2,
    )


def invert(flow: MemoryFlow, t: float, state: Vector, h: float) -> tuple[Vector, Vector, Vector]:
    """Return the inverse of 1/(gamma h) - J, gamma = 1/4."""
    d = 4.0 / h
    (_, p, q), (y_x, y_y, y_z), (_, z_y, z_z) = jacobian(flow, t, state)
    yy, zz = d - y_y, d - z_z
    c00 = yy * zz - y_z * z_y
    c01 = y_x * zz
    c02 = y_x * z_y
    det = d * c00 - p * c01 - q * c02
    over = 1.0 / det if det != 0.0 else math.inf  # a step that is then rejected
    return (
        (c00 * over, (p * zz + q * z_y) * over, (p * y_z + q * yy) * over),
        (c01 * over, d * zz * over, (d * y_z + q * y_x) * over),
        (c02 * over, d * z_y * over, (d * yy - p * y_x) * over),
    )


def rosenbrock_step(flow: MemoryFlow, t: float, u: Vector, h: float) -> tuple[Vector, Vector]:
    """Return the state after a step of h (s), and its estimated error."""
    inverse = invert(flow, t, u, h)
    push = 0.0  # h dy'/dt of the drive
    if flow.u0 != 0.0:
        push = h * flow.u0 * flow.omega * math.sin(flow.omega * t + flow.phase) / flow.m / slip(flow, u[1], u[2])[1]
    k1 = solve(inverse, rates(flow, t, u), D1 * push)
    at = plus(u, A2, k1)
    k2 = solve(inverse, plus(rates(flow, t + T2 * h, at), C2 / h, k1), D2 * push)
    at = plus(plus(u, A3[0], k1), A3[1], k2)
    right = plus(plus(rates(flow, t + T3 * h, at), C3[0] / h, k1), C3[1] / h, k2)
    k3 = solve(inverse, right, D3 * push)
    at = plus(plus(plus(u, A4[0], k1), A4[1], k2), A4[2], k3)
    right = plus(plus(plus(rates(flow, t + T4 * h, at), C4[0] / h, k1), C4[1] / h, k2), C4[2] / h, k3)
    k4 = solve(inverse, right, D4 * push)
    at = plus(plus(plus(plus(u, A5[0], k1), A5[1], k2), A5[2], k3), A5[3], k4)
    right = plus(plus(plus(rates(flow, t + h, at), C5[0] / h, k1), C5[1] / h, k2), C5[2] / h, k3)
    k5 = solve(inverse, plus(right, C5[3] / h, k4), 0.0)
    at = plus(at, 1.0, k5)
    right = plus(plus(plus(rates(flow, t + h, at), C6[0] / h, k1), C6[1] / h, k2), C6[2] / h, k3)
    k6 = solve(inverse, plus(plus(right, C6[3] / h, k4), C6[4] / h, k5), 0.0)
    return plus(at, 1.0, k6), k6


def relative_error(flow: MemoryFlow, state: Vector, end: Vector, error: Vector) -> float:
    """Return the error of a step over the one allowed."""
    allowed = flow.tolerance
    speed = allowed * math.sqrt(flow.k / flow.m)
    if flow.law == BRISTLE:
        # In a stick, slip is so slow that a step may jump over the break-away, to bristles bent further than they can.
        presliding = flow.Fc / flow.s0
        if abs(end[2]) > max(abs(state[2]), ROUNDING * flow.factor * max(flow.Fs, flow.Fc) / flow.s0):
            return BEYOND
        least = min(SMALL * allowed, SMALL_DEFLECTION * presliding)
        deflection = min(allowed, max(DEFLECTION_ERROR * presliding, least))
        return max(abs(error[0]) / allowed, abs(error[1]) / speed, abs(error[2]) / deflection)
    steepness = max(slip(flow, state[1], state[2])[1], slip(flow, end[1], end[2])[1])
    force = max(steepness / speed, 1.0 / (PAIR_FORCE_ERROR if flow.law == PAIR else FORCE_ERROR))
    if flow.law == PAIR:
        by_z = at(
            flow.formulas,
            evaluate(flow.formulas, False, smooth_speed(flow, slip(flow, end[1], end[2])[0]), end[2], 3) + 2,
        )
        memory = max(
            flow.factor * abs(by_z) / (flow.k * allowed),
            1.0 / (MEMORY_ERROR * max(abs(state[2]), abs(end[2]), LEAST_MEMORY)),
        )
    else:
        memory = max(flow.factor * flow.b / (flow.k * allowed), 1.0 / MEMORY_ERROR)
    return max(abs(error[0]) / allowed, abs(error[1]) * force, abs(error[2]) * memory)


def motion_within(flow: MemoryFlow, h: float, s: float, start: Vector, end: Vector) -> Vector:
    """Return position, velocity and acceleration at the share s of a step, from those at its ends.

    Where the mass follows the belt, or the spring's end, its acceleration is a small difference of large forces, and
    wrong; a right one changes neither the velocity nor the slip speed by many times the larger of its two ends.
    """
    (x0, v0, a0), (x1, v1, a1) = start, end
    largest = LARGEST_CHANGE / h * min(max(abs(v0 - flow.v_belt), abs(v1 - flow.v_belt)), max(abs(v0), abs(v1)))
    a0, a1 = min(max(a0, -largest), largest), min(max(a1, -largest), largest)
    r = 1.0 - s
    rise = s * s * s * (1.0 + 3.0 * r * (1.0 + 2.0 * r))
    x = x0 + (x1 - x0) * rise
    x += h * (v0 * s * r**3 * (1.0 + 3.0 * s) - v1 * r * s**3 * (1.0 + 3.0 * r))
    x += 0.5 * h * h * r * r * s * s * (a0 * r + a1 * s)
    v = 30.0 * s * s * r * r * (x1 - x0) / h
    v += v0 * (1.0 + s * s * (-18.0 + s * (32.0 - 15.0 * s))) + v1 * s * s * (-12.0 + s * (28.0 - 15.0 * s))
    v += h * (a0 * s * (1.0 + s * (-4.5 + s * (6.0 - 2.5 * s))) + a1 * s * s * (1.5 + s * (-4.0 + 2.5 * s)))
    a = a0 * r * (1.0 - 3.0 * s) + a1 * s * (1.0 - 3.0 * r) + 6.0 * s * r * (v1 - v0) / h
    return x, v, a


def store_sample(flow: MemoryFlow, motion: Vector, samples: Samples, i: int) -> None:
    """Store a position, its velocity, and friction (N) in place of the mode."""
    x, v, a = motion
    samples.x[i] = x
    samples.v[i] = v
    samples.mode[i] = flow.m * a + flow.c * v + flow.k * (x - flow.x0) - drive(flow, samples.t[i])


def entered_mode(flow: MemoryFlow, mode: int, w: float) -> int:
    """Return the mode that a relative velocity (m/s) means for a motion that was in ``mode``."""
    if mode == modes.STICK:
        if abs(w) < BREAK_AWAY * flow.edge:
            return mode
        return modes.NEGATIVE if w < 0.0 else modes.POSITIVE
    speed = -w if mode == modes.NEGATIVE else w
    return modes.STICK if speed < flow.edge else mode


def event_share(flow: MemoryFlow, mode: int, h: float, start: Vector, end: Vector) -> float:
    inside, outside = 0.0, 1.0
    for _i in range(BISECTIONS):
        s = 0.5 * (inside + outside)
        if entered_mode(flow, mode, motion_within(flow, h, s, start, end)[1] - flow.v_belt) == mode:
            inside = s
        else:
            outside = s
    return outside


def sample_memory_phase(
    flow: MemoryFlow, state: State, t_max: float, samples: Samples, i: int, work: MemoryWork
) -> tuple[int, State, int]:
    """Continue from a state to the next event, or to t_max (s): as `rig_sim.integrate.phases.sample_phase`."""
    work = unboxed(work)
    mode, t = state.mode, state.t
    if state.w != work.w:
        work.y = second_variable(flow, state.w, work.z)
        work.step = 0.0
    u = (state.x, work.y, work.z)
    if work.step == 0.0:
        work.step = FIRST_STEP * math.sqrt(flow.m / flow.k)
    start = motion_of(flow, t, u)
    while i < samples.n and samples.t[i] <= t:
        store_sample(flow, start, samples, i)
        i += 1
    kind, trials = modes.COMPLETED, 0
    while t < t_max and kind == modes.COMPLETED:
        if work.steps >= work.steps_allowed:
            kind = modes.STEP_LIMIT
            break
        work.steps += 1.0
        h = min(work.step, t_max - t)
        after, error = rosenbrock_step(flow, t, u, h)
        size = relative_error(flow, u, after, error)
        if not size <= 1.0:
            trials += 1
            if trials > TRIALS:
                kind = modes.NOT_FINITE
            work.step = h * (max(0.2, 0.9 * size**-0.25) if size < 1e100 else 0.2)
            continue
        longer = h * min(4.0, 0.9 * max(size, 1e-10) ** -0.25)
        work.step = max(longer, work.step) if h < work.step else longer
        trials = 0
        end = motion_of(flow, t + h, after)
        entered = entered_mode(flow, mode, end[1] - flow.v_belt)
        if entered != mode:
            h *= event_share(flow, mode, h, start, end)
            after, _ = rosenbrock_step(flow, t, u, h)
            end = motion_of(flow, t + h, after)
            kind = 4 * mode + entered
            mode = entered
        while i < samples.n and samples.t[i] <= t + h:
            store_sample(flow, motion_within(flow, h, (samples.t[i] - t) / h, start, end), samples, i)
            i += 1
        t = t_max if h == t_max - t else t + h
        u, start = after, end
    work.y, work.z, work.w = u[1], u[2], -slip(flow, u[1], u[2])[0]
    return kind, State(mode, u[0], work.w, t, 0.0), i


def compile_phases(work: MemoryWork, samples: Samples) -> tuple[Callable[..., Any], MemoryWork, Samples]:
    """Return `sample_memory_phase` compiled, and what it reads and writes, which may be that of interpreted calls."""
    import numpy as np

    from rig_sim.integrate.compiled import compiled

    record = new_memory_work(work.steps_allowed, compiled=True)
    for field in fields(MemoryWork):
        setattr(record, field.name, float(getattr(work, field.name)))
    t, x, v, F = (np.array(buffer, dtype=np.float64) for buffer in samples[:4])
    return compiled(sample_memory_phase, *MODULES, inline=False), record, Samples(t, x, v, F, samples.n)
