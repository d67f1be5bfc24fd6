"""The motion of a contact with memory along the windows of a fit, and its derivatives by the unknowns.

Steps of the simulator's stiff integrator (`rig_sim.integrate.memory`) are chosen by their errors.  The friction level
changes where the model itself lands: where its slip speed falls to a share of the belt's.

With the rates f of a state u and their Jacobian J, derivatives d by an unknown follow d' = J d + df/dunknown: by the
method Radau IIA of two stages, of order 3 and L-stable, over the same steps.  At a landing they change by what the two
levels' rates differ, times how much later it comes.

Columns of the derivatives: `SHARED`, the n parameters of the law, and the five unknowns of a cycle.
"""

import math

from fitting.model.unknowns import Global, PerCycle
from rig_sim.flow import modes
from rig_sim.flow.memory import (
    LANDING,
    MemoryFlow,
    Vector,
    jacobian,
    memory_rate,
    motion_of,
    net_acceleration,
    rates,
    second_variable,
    slip,
    smooth_speed,
)
from rig_sim.friction.memory import AGEING, BRISTLE, PAIR, SLIP
from rig_sim.friction.pair import STICK_SPEED, at, evaluate, set_parameters, steady_state
from rig_sim.integrate.memory import TRIALS, event_share, motion_within, relative_error, rosenbrock_step
from stickslip.compute.arrays import Array, Integers

FIRST_STEP = 1e-3  # x sqrt(m/k)
MOST_STEPS = 2000  # of a window; usual ones take 100 to 300
# Of rate and state, over the belt's speed: slip below which friction balances the load, and from which it ends to.
CREEP_BEGINS, CREEP_ENDS = 1e-4, 1e-9
SHORTEST_CREEP = 1e-4  # x sqrt(m/k)
LANDING_STEPS = 3  # Newton steps to the end of the step that lands
DIFFERENCE, LEAST_SIZE = 1e-6, 1e-3  # of an unknown over its size, where a window begins; and the least size
SHARED = (Global.K, Global.V_DR, Global.DATUM, Global.DAMPING)
BRISTLES, RATE_AND_STATE = ("s0", "s1", "Fc", "Fs", "v_s"), ("F0", "a", "b", "D", "v0")
K, V_DR, DATUM, DAMPING = range(4)  # columns
P0, P1, P2, P3, P4 = range(4, 9)  # columns of the law's parameters
X, V, LEVEL, NEXT_LEVEL, MEMORY = (int(column) for column in tuple(PerCycle)[:5])
PER_WINDOW = 5  # unknowns of a cycle, the last columns
Matrix = tuple[Vector, Vector, Vector]


def flow_of(law: int, p: Array, level: float, tolerance: float, formulas: Array | None) -> MemoryFlow:
    """Return the flow of p, `SHARED` and the law's parameters, per unit mass, at the log of a friction level."""
    s0 = s1 = Fc = Fs = F0 = a = b = D = v0 = 0.0
    v_s = 1.0
    if law == BRISTLE:
        s0, s1, Fc, Fs, v_s = p[P0], p[P1], p[P2], p[P3], p[P4]
    elif law == PAIR:
        set_parameters(formulas, p, P0)
        v0 = at(formulas, STICK_SPEED)
    else:
        F0, a, b, D, v0 = p[P0], p[P1], p[P2], p[P3], p[P4]
    edge, factor = LANDING * p[V_DR], math.exp(level)
    shared = (1.0, p[K], p[DATUM], p[DAMPING], p[V_DR], factor, 0.0, 0.0, 0.0, 0.0, law, edge, tolerance, formulas)
    return MemoryFlow(*shared, s0, s1, 0.0, Fc, Fs, v_s, F0, a, b, D, v0)


def steady_memory(flow: MemoryFlow, e: float) -> float:
    """Return the memory of steady slip at a speed e > 0 (m/s)."""
    if flow.law == BRISTLE:
        g = flow.Fc + (flow.Fs - flow.Fc) * math.exp(-((e / flow.v_s) ** 2))
        return flow.factor * float(g / flow.s0)
    return steady_state(flow.formulas, e) if flow.law == PAIR else math.log(flow.v0 / e)


def first_state(law: int, p: Array, own: Array, spread: float, formulas: Array | None) -> Vector:
    """Return the state at which a window begins, of the unknowns of its cycle ``own``."""
    flow, v = flow_of(law, p, own[LEVEL], 0.0, formulas), own[V]
    z = steady_memory(flow, max(p[V_DR] - v, 1e-6 * p[V_DR]))
    change = own[MEMORY] / spread
    z = z + change if law == AGEING or law == SLIP else z * math.exp(change)
    return own[X], second_variable(flow, v - p[V_DR], z), z


def first_derivatives(law: int, p: Array, own: Array, spread: float, d: Array, formulas: Array | None) -> None:
    """Set d to the derivatives of `first_state`, by differences."""
    u = first_state(law, p, own, spread, formulas)
    for j in range(d.shape[0]):
        unknowns, place = (own, j - p.size) if j >= p.size else (p, j)
        held = unknowns[place]
        size = DIFFERENCE * max(abs(held), LEAST_SIZE)
        unknowns[place] = held + size
        there = first_state(law, p, own, spread, formulas)
        unknowns[place] = held
        for i in range(3):
            d[j, i] = (there[i] - u[i]) / size


def explicit_derivatives(flow: MemoryFlow, state: Vector, landed: bool, f: Array) -> None:
    """Set f (n, 3) to the derivatives of the rates of a state by the unknowns."""
    x, y, z = state
    e, e_y, _ = slip(flow, y, z)
    dz, z_e, _ = memory_rate(flow, e, z)
    level = f.shape[0] - PER_WINDOW + (NEXT_LEVEL if landed else LEVEL)
    for j in range(f.shape[0]):
        f[j, 0] = f[j, 1] = f[j, 2] = 0.0
    f[K, 1] = (x - flow.x0) / e_y
    f[V_DR, 0], f[V_DR, 1] = 1.0, flow.c / e_y
    f[DATUM, 1] = -flow.k / e_y
    f[DAMPING, 1] = (flow.v_belt - e) / e_y
    if flow.law == BRISTLE:
        u = e / flow.v_s
        peak = math.exp(-u * u)
        fall = (flow.Fs - flow.Fc) * peak
        g = flow.factor * (flow.Fc + fall)
        by_g = flow.s0 * abs(e) * z / (g * g)
        f[P0, 2] = -abs(e) * z / g
        f[P2, 2] = by_g * flow.factor * (1.0 - peak)
        f[P3, 2] = by_g * flow.factor * peak
        f[P4, 2] = by_g * flow.factor * fall * 2.0 * u * u / flow.v_s
        f[level, 2] = by_g * g
        for j in (P0, P2, P3, P4, level):
            f[j, 1] = flow.s1 * f[j, 2]
        f[P0, 1] += z
        f[P1, 1] = dz
        return
    if flow.law == PAIR:
        s, share, count = smooth_speed(flow, e), flow.factor * math.tanh(y) / e_y, f.shape[0] - PER_WINDOW - P0
        friction = evaluate(flow.formulas, False, s, z, 3 + count)
        rate = evaluate(flow.formulas, True, s, z, 3 + count)
        for j in range(count):
            f[P0 + j, 1] = -share * at(flow.formulas, friction + 3 + j)
            f[P0 + j, 2] = at(flow.formulas, rate + 3 + j)
        f[level, 1] = -share * at(flow.formulas, friction)
        return
    ratio, share = flow.b / flow.a, e / e_y
    pull = net_acceleration(flow, 0.0, state, e, dz) / e_y
    q = (flow.F0 + flow.b * z) / flow.a
    q_y, q_z = flow.c * share - pull - ratio * share * z_e * e, -z_e * e
    for j, by in ((P0, 1.0 / flow.a), (P1, -q / flow.a), (P2, z / flow.a), (P4, -1.0 / flow.v0)):
        f[j, 0], f[j, 1], f[j, 2] = by * e, by * q_y, by * q_z
    f[P1, 1] -= ratio / flow.a * share * dz + flow.factor * y / e_y
    f[P2, 1] += share * dz / flow.a
    f[P3, 2] = -dz / flow.D
    f[P3, 1] = ratio * share * f[P3, 2]
    growth = (dz + abs(e) / flow.D if flow.law == AGEING else abs(e) / flow.D) / flow.v0
    f[P4, 1] += ratio * share * growth
    f[P4, 2] += growth
    f[level, 1] = -flow.factor * flow.a * y / e_y


def inverse(shift: float, J: Matrix, other: Matrix, times: float) -> Matrix:
    """Return the inverse of shift - J + times x other, of matrices (3, 3)."""
    a, b, c = shift - J[0][0] + times * other[0][0], times * other[0][1] - J[0][1], times * other[0][2] - J[0][2]
    d, e, f = times * other[1][0] - J[1][0], shift - J[1][1] + times * other[1][1], times * other[1][2] - J[1][2]
    g, h, i = times * other[2][0] - J[2][0], times * other[2][1] - J[2][1], shift - J[2][2] + times * other[2][2]
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    over = 1.0 / (a * A + b * B + c * C)
    return (
        (A * over, (c * h - b * i) * over, (b * f - c * e) * over),
        (B * over, (a * i - c * g) * over, (c * d - a * f) * over),
        (C * over, (b * g - a * h) * over, (a * e - b * d) * over),
    )


def times(matrix: Matrix, x: float, y: float, z: float) -> Vector:
    p, q, r = matrix
    return (
        p[0] * x + p[1] * y + p[2] * z,
        q[0] * x + q[1] * y + q[2] * z,
        r[0] * x + r[1] * y + r[2] * z,
    )


def follow_derivatives(
    flow: MemoryFlow, t: float, h: float, u: Vector, after: Vector, landed: bool, d: Array, f: Array, speed: Array
) -> None:
    """Follow d (n, 3) over a step h; set column 1 of ``speed`` (n, 3) to those of the velocity there."""
    third, _ = rosenbrock_step(flow, t, u, h / 3.0)
    early, late = jacobian(flow, t, third), jacobian(flow, t, after)
    explicit_derivatives(flow, third, landed, f[0])
    explicit_derivatives(flow, after, landed, f[1])
    nothing = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    first = inverse(1.5 / h, early, nothing, 0.0)
    last = inverse(2.5 / h, late, first, 2.25 / (h * h))
    for j in range(d.shape[0]):
        x, y, z = d[j, 0], d[j, 1], d[j, 2]
        a, b, c = times(early, x, y, z)
        a, b, c = times(first, a + f[0, j, 0], b + f[0, j, 1], c + f[0, j, 2])
        p, q, r = times(late, x, y, z)
        share = 4.5 / h
        a, b, c = times(last, p + f[1, j, 0] + share * a, q + f[1, j, 1] + share * b, r + f[1, j, 2] + share * c)
        d[j, 0], d[j, 1], d[j, 2] = x + a, y + b, z + c
        speed[j, 1] = late[0][1] * d[j, 1] + late[0][2] * d[j, 2] + f[1, j, 0]


def set_speed(flow: MemoryFlow, u: Vector, landed: bool, d: Array, f: Array, speed: Array) -> None:
    """Set column 0 of ``speed`` to the derivatives of the velocity of a state."""
    explicit_derivatives(flow, u, landed, f[1])
    row = jacobian(flow, 0.0, u)[0]
    for j in range(d.shape[0]):
        speed[j, 0] = row[1] * d[j, 1] + row[2] * d[j, 2] + f[1, j, 0]


def land(flow: MemoryFlow, other: MemoryFlow, t: float, u: Vector, a: float, d: Array, speed: Array) -> None:
    """Change d where a landing at an acceleration a leads from one level to an ``other``."""
    before, after = rates(flow, t, u), rates(other, t, u)
    for j in range(d.shape[0]):
        later = ((1.0 - LANDING if j == V_DR else 0.0) - speed[j, 1]) / a
        for i in range(3):
            d[j, i] += (before[i] - after[i]) * later


def balanced(flow: MemoryFlow, x: float) -> float:
    """Return y of a mass that moves with the belt, at a position."""
    return (flow.k * (x - flow.x0) + flow.c * flow.v_belt) / (flow.factor * flow.a)


def creep(flow: MemoryFlow, u: Vector, h: float, fastest: float) -> Vector:
    """Return the state after a time h bound to the belt; u where slip would be above ``fastest`` of its speed.

    As friction balances the load, slip falls by e-folds in 1e-20 s and less, which no step can follow.
    """
    x, z = u[0] + flow.v_belt * h, u[2]
    if flow.law == AGEING:
        z += math.log1p(flow.v0 / flow.D * h * math.exp(-z))
    y = balanced(flow, x)
    if y - (flow.F0 + flow.b * z) / flow.a > math.log(fastest * flow.v_belt / flow.v0):
        return u
    return x, y, z


def creep_derivatives(flow: MemoryFlow, z: float, h: float, d: Array) -> None:
    """Follow d over a time h bound to the belt, from a memory z."""
    growth = flow.v0 / flow.D * h * math.exp(-z) if flow.law == AGEING else 0.0
    d[V_DR, 0] += h
    d[P3, 2] -= growth / flow.D
    d[P4, 2] += growth / flow.v0
    for j in range(d.shape[0]):
        d[j, 2] /= 1.0 + growth


def balance_derivatives(flow: MemoryFlow, u: Vector, landed: bool, d: Array) -> None:
    """Set the derivatives of y to those of `balanced`."""
    load = flow.factor * flow.a
    for j in range(d.shape[0]):
        d[j, 1] = flow.k * d[j, 0] / load
    d[K, 1] += (u[0] - flow.x0) / load
    d[V_DR, 1] += flow.c / load
    d[DATUM, 1] -= flow.k / load
    d[DAMPING, 1] += flow.v_belt / load
    d[P1, 1] -= u[1] / flow.a
    d[d.shape[0] - PER_WINDOW + (NEXT_LEVEL if landed else LEVEL), 1] -= u[1]


def store(flow: MemoryFlow, motion: Vector, x: Array, i: int) -> None:
    """Store a position, its velocity, and the friction over its level that its acceleration shows."""
    position, v, a = motion
    x[0, i], x[1, i] = position, v
    x[2, i] = (a + flow.c * v + flow.k * (position - flow.x0)) / flow.factor


def follow_window(
    law: int, p: Array, own: Array, scale: Array, time: Array, x: Array, dx: Array, work: Array, formulas: Array | None
) -> bool:
    """Follow one window to x (3, n) at ``time`` (n,), s; return whether that is possible.

    ``scale`` are the spread of the memory, the tolerance, and the error of a step over that of the simulator.
    Rows of x are position, velocity, and friction over its level; ``dx`` are the derivatives (n, columns) of
    the positions, or empty; ``work`` (4, columns, 3) is overwritten; ``formulas`` is that of `rig_sim.friction.pair`.
    """
    d, f, speed = work[0], work[1:3], work[3]
    spread, tolerance, looser = scale[0], scale[1], scale[2]
    derive, landed, creeping = dx.size > 0, False, False
    if derive:
        first_derivatives(law, p, own, spread, d, formulas)
    u = first_state(law, p, own, spread, formulas)
    flow = flow_of(law, p, own[LEVEL], tolerance, formulas)
    start = motion_of(flow, 0.0, u)
    if derive:
        set_speed(flow, u, landed, d, f, speed)
    t, end = time[0], time[time.size - 1]
    step = FIRST_STEP / math.sqrt(p[0])
    n, i, trials = 0, 0, 0
    while t < end:
        h = min(step, end - t)
        if creeping:
            while h > SHORTEST_CREEP / math.sqrt(p[0]) and creep(flow, u, h, CREEP_ENDS) == u:
                h *= 0.5
            if creep(flow, u, h, CREEP_ENDS) == u:
                creeping, step = False, h
                u = (u[0], balanced(flow, u[0]), u[2])
                start = motion_of(flow, t, u)
                if derive:
                    balance_derivatives(flow, u, landed, d)
                    set_speed(flow, u, landed, d, f, speed)
        if n == MOST_STEPS:
            return False
        if creeping:
            while i < time.size and time[i] <= t + h:
                store(flow, (u[0] + p[1] * (time[i] - t), p[1], 0.0), x, i)
                for j in range(d.shape[0] if derive else 0):
                    dx[i, j] = d[j, 0]
                if derive:
                    dx[i, V_DR] += time[i] - t
                i += 1
            if derive:
                creep_derivatives(flow, u[2], h, d)
            u = creep(flow, u, h, math.inf)
            step = 2.0 * h
            t = end if h == end - t else t + h
            start = (u[0], p[1], 0.0)
            n += 1
            continue
        after, error = rosenbrock_step(flow, t, u, h)
        size = relative_error(flow, u, after, error) / looser
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
        lands = not landed and p[1] - stop[1] < flow.edge
        if lands:
            h *= event_share(flow, modes.NEGATIVE, h, start, stop)
            after, error = rosenbrock_step(flow, t, u, h)
            stop = motion_of(flow, t + h, after)
            for _i in range(LANDING_STEPS):
                h += (slip(flow, after[1], after[2])[0] - flow.edge) / stop[2]
                after, error = rosenbrock_step(flow, t, u, h)
                stop = motion_of(flow, t + h, after)
        if not (math.isfinite(stop[0]) and math.isfinite(stop[1]) and math.isfinite(after[2])):
            return False
        first = i
        while i < time.size and time[i] <= t + h:
            store(flow, motion_within(flow, h, (time[i] - t) / h, start, stop), x, i)
            i += 1
        if derive:
            for j in range(d.shape[0]):
                speed[j, 2] = d[j, 0]
            follow_derivatives(flow, t, h, u, after, landed, d, f, speed)
            for k in range(first, i):
                s = (time[k] - t) / h
                r = 1.0 - s
                for j in range(d.shape[0]):
                    bent = h * (r * speed[j, 0] - s * speed[j, 1])
                    ends = r * r * (1.0 + 2.0 * s) * speed[j, 2] + s * s * (1.0 + 2.0 * r) * d[j, 0]
                    dx[k, j] = ends + s * r * bent
            for j in range(d.shape[0]):
                speed[j, 0] = speed[j, 1]
        t = end if h == end - t else t + h
        u, start = after, stop
        if lands:
            landed, before = True, flow
            flow = flow_of(law, p, own[NEXT_LEVEL], tolerance, formulas)
            start = motion_of(flow, t, u)
            if derive:
                land(before, flow, t, u, stop[2], d, speed)
                set_speed(flow, u, landed, d, f, speed)
        if (law == AGEING or law == SLIP) and p[1] - start[1] < CREEP_BEGINS * p[1]:
            creeping = creep(flow, u, SHORTEST_CREEP / math.sqrt(p[0]), CREEP_ENDS) != u
        n += 1
    while i < time.size:
        store(flow, (start[0] + start[1] * (time[i] - t), start[1], start[2]), x, i)
        for j in range(d.shape[0] if derive else 0):
            dx[i, j] = d[j, 0] + speed[j, 0] * (time[i] - t)
        i += 1
    return True


def follow_windows(
    law: int,
    p: Array,
    local: Array,
    table: Integers,
    scale: Array,
    time: Array,
    x: Array,
    dx: Array,
    work: Array,
    formulas: Array | None,
) -> bool:
    """Follow windows (w, 6) of runs with `SHARED` and the law's parameters p (runs, 4 + n) and ``scale`` (runs, 3)."""
    for w in range(table.shape[0]):
        run, begin, stop = table[w, 5], table[w, 2], table[w, 2] + table[w, 3]
        own = dx[begin:stop] if dx.size > 0 else dx
        if not follow_window(
            law, p[run], local[w], scale[run], time[begin:stop], x[:, begin:stop], own, work, formulas
        ):
            return False
    return True
