"""Tangents: derivatives of the position along a path by effects on the mass, the belt or the reading.

`tangents` integrates any columns; the other functions compute the columns of a fit's unknowns: shared, the cycles', a
spline's.

A departure or a parameter p is a column: the acceleration a_p (m/s^2) and the change of the belt's speed b_p (m/s) that
one unit of it makes at every point of a path.  With K = k/m, c/m (and the slope of a drag) and the slope
of friction f' there,

    dx'' = -K dx - (c + f') dx' + a_p + f' b_p        slip and ramp
    dx'  = b_p                                        stick
    dx'' = -K dx - (c + f') dx' + a_p + f' b_p        creep on a ramp, to first order in the acceleration dx''

by the same Runge-Kutta steps as the path.  At a change of mode the column shifts the time of the change, and dx' jumps
(saltation).

Source: R. Leine, H. Nijmeijer, Dynamics and Bifurcations of Non-smooth Mechanical Systems (2004), 7.2.
"""

from collections.abc import Sequence

import numpy as np

from fitting.model import unknowns
from fitting.model.flow import CREEP
from fitting.model.path import KERNELS, Path
from fitting.model.unknowns import PER_CYCLE, PER_RUN, Global, PerCycle
from rig_sim.flow.modes import STICK
from rig_sim.friction.curve import shape_slope
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import compiled

NO_COLUMNS = np.zeros((0, 0))
NOTHING_MOVES = np.zeros(0, np.int64)


def tangents(
    path: Path,
    acceleration: Array,
    *,
    belt_speed: Array | None = None,
    moving: Integers | None = None,
    edge: Array | None = None,
    start: tuple[Array, Array] | None = None,
    position: Array | None = None,
) -> Array:
    """Return the derivatives of the positions at all N samples, shape (N, k).

    One unit of a column adds ``acceleration`` (M, k) at fixed position, velocity and belt speed, m/s^2; ``belt_speed``
    (M, n), m/s, in the columns ``moving`` (n,) (default all); ``edge`` (windows, k) to the half-width of the ramp, m/s;
    ``start`` to position (m) and velocity (m/s) of each window; and ``position`` (N, k) to the reading, m.
    """
    k = acceleration.shape[1]
    none = np.zeros((path.windows.table.shape[0], k))
    x, v = start if start is not None else (none, none)
    if belt_speed is None:
        belt_speed, moving = NO_COLUMNS, NOTHING_MOVES
    elif moving is None:
        moving = np.arange(k)
    rows = path.u.reshape(-1, PER_RUN)[path.windows.table[:, 5]]
    out = np.empty((path.reached.size, k))
    compiled(integrate, KERNELS, _nrt=False)(
        path.first_step,
        path.windows.table,
        np.ascontiguousarray(rows[:, Global.K]),
        path.steps,
        path.jumps,
        path.mode,
        path.time,
        path.damping,
        path.friction_slope,
        np.ascontiguousarray(acceleration.T),
        np.ascontiguousarray(belt_speed),
        moving,
        none if edge is None else np.ascontiguousarray(edge),
        np.ascontiguousarray(x),
        np.ascontiguousarray(v),
        out,
        np.empty((6, k)),
    )
    return out if position is None else out + position


def integrate(
    first_step: Integers,
    table: Integers,
    stiffness: Array,
    steps: Integers,
    jumps: Array,
    mode: Integers,
    time: Array,
    damping: Array,
    slope: Array,
    acceleration: Array,
    belt: Array,
    moving: Integers,
    edge: Array,
    start_x: Array,
    start_v: Array,
    out: Array,
    room: Array,
) -> None:
    """Integrate all columns through all windows; fill ``out`` (N, k).  ``room`` (6, k) is scratch space.

    ``stiffness`` (windows,) is K of each window's run, 1/s^2; ``acceleration`` (k, M) is contiguous.
    """
    k = out.shape[1]
    x, v = room[0], room[1]
    g0, gm, g1, late = room[2], room[3], room[4], room[5]
    for row in range(table.shape[0]):
        K = stiffness[row]
        first = table[row, 2]
        for j in range(k):
            x[j], v[j] = start_x[row, j], start_v[row, j]
            out[first, j] = x[j]
        for s in range(first_step[row], first_step[row + 1]):
            a = steps[s, 0]
            h = time[a + 2] - time[a]
            if mode[a] == STICK:
                for j in range(k):
                    v[j] = 0.0
                for n in range(moving.size):
                    x[moving[n]] += h / 6.0 * (belt[a, n] + 4.0 * belt[a + 1, n] + belt[a + 2, n])
                    v[moving[n]] = belt[a + 2, n]
            else:
                e0, em, e1 = damping[a] + slope[a], damping[a + 1] + slope[a + 1], damping[a + 2] + slope[a + 2]
                for j in range(k):
                    g0[j], gm[j], g1[j] = acceleration[j, a], acceleration[j, a + 1], acceleration[j, a + 2]
                for n in range(moving.size):
                    j = moving[n]
                    g0[j] += slope[a] * belt[a, n]
                    gm[j] += slope[a + 1] * belt[a + 1, n]
                    g1[j] += slope[a + 2] * belt[a + 2, n]
                if mode[a] == CREEP:
                    # dx'' is the rate of (a - K dx)/e, with a and e as in the equation above; that of a by a parabola
                    for j in range(k if h > 0.0 else 0):
                        rate, bend = (g1[j] - g0[j]) / (h * em), 2.0 * (g1[j] - 2.0 * gm[j] + g0[j]) / (h * em)
                        g0[j], gm[j], g1[j] = g0[j] - rate + bend, gm[j] - rate, g1[j] - rate - bend
                    e0, em, e1 = e0 / (1.0 + K / e0**2), em / (1.0 + K / em**2), e1 / (1.0 + K / e1**2)
                    for j in range(k):
                        k1 = (g0[j] - K * x[j]) / e0
                        k2 = (gm[j] - K * (x[j] + 0.5 * h * k1)) / em
                        k3 = (gm[j] - K * (x[j] + 0.5 * h * k2)) / em
                        k4 = (g1[j] - K * (x[j] + h * k3)) / e1
                        x[j] += h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
                        v[j] = (g1[j] - K * x[j]) / e1
                else:
                    half = 0.5 * h
                    for j in range(k):
                        a1 = g0[j] - K * x[j] - e0 * v[j]
                        v2 = v[j] + half * a1
                        a2 = gm[j] - K * (x[j] + half * v[j]) - em * v2
                        v3 = v[j] + half * a2
                        a3 = gm[j] - K * (x[j] + half * v2) - em * v3
                        v4 = v[j] + h * a3
                        a4 = g1[j] - K * (x[j] + h * v3) - e1 * v4
                        x[j] += h / 6.0 * (v[j] + 2.0 * (v2 + v3) + v4)
                        v[j] += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            if steps[s, 2] >= 0:
                for j in range(k):
                    out[steps[s, 2], j] = x[j]
            if jumps[s, 0] != 0.0 or jumps[s, 1] != 0.0:
                for j in range(k):
                    late[j] = -v[j] - jumps[s, 2] * edge[row, j]
                for n in range(moving.size):
                    late[moving[n]] += belt[a + 2, n]
                for j in range(k):
                    x[j] += jumps[s, 0] * late[j]
                    v[j] += jumps[s, 1] * late[j]


BELT = (Global.V_DR, Global.COSINE, Global.SINE, Global.OMEGA)


def local_tangents(path: Path) -> Array:
    """Return the derivatives of the positions by each cycle's own unknowns, shape (N, 6); 0 in another cycle."""
    table = path.windows.table
    stick = table[:, 1] == 1
    acceleration = np.zeros((PER_CYCLE, path.time.size)).T  # each column without gaps
    acts = path.mode != STICK
    acceleration[:, PerCycle.LEVEL] = np.where(acts & ~(path.landed & ~stick[path.window]), path.friction, 0.0)
    acceleration[:, PerCycle.NEXT_LEVEL] = np.where(acts & path.landed & ~stick[path.window], path.friction, 0.0)
    x, v = np.zeros((2, stick.size, PER_CYCLE))
    x[:, PerCycle.X_SLIP], x[:, PerCycle.X_STICK] = ~stick, stick
    v[:, PerCycle.V_SLIP], v[:, PerCycle.V_STICK] = ~stick, stick
    # a window that starts in stick does not depend on its start velocity
    v[path.stuck[path.first_point[:-1]]] = 0.0
    return tangents(path, acceleration, start=(x, v))


def shared_tangents(path: Path, places: Sequence[int]) -> Array:
    """Return the derivatives (N, p) of the positions by shared unknowns; with a spline LOG_F and SHAPE give 0."""
    runs = path.u.size // PER_RUN
    slots = [place % PER_RUN for place in places] if runs == 1 else sorted({place % PER_RUN for place in places})
    acceleration, edge = parameter_forces(path, slots)
    moving = np.array([j for j, slot in enumerate(slots) if slot in BELT], np.int64)
    belt = belt_columns(path, [slots[j] for j in moving]) if moving.size else None
    columns = tangents(path, acceleration, belt_speed=belt, moving=moving, edge=edge)
    if runs == 1:
        return columns
    out = np.zeros((path.reached.size, len(places)))
    run = path.run[path.reached]
    for r, row in enumerate(unknowns.columns(places, runs)):
        of_run = run == r
        for j in np.flatnonzero(row >= 0):
            out[of_run, j] = columns[of_run, slots.index(row[j])]
    return out


def spline_tangents(path: Path, directions: Array) -> Array:
    """Return the derivatives of the positions along ``directions`` (n + 3, k) of the spline's coefficients, (N, k)."""
    spline = path.curve.spline
    if spline is None:
        raise ValueError("this path follows a law's curve: there are no coefficients")
    in_slip, in_stick, edge = friction_effect(path)
    used = np.flatnonzero(directions.any(axis=0))
    along = np.ascontiguousarray(directions[:, used])
    forces = spline.basis_along(path.slip_speed, along, in_slip)
    forces += in_stick * along[0][:, None]
    columns = np.zeros((path.reached.size, directions.shape[1]))
    columns[:, used] = tangents(path, forces.T, edge=edge[:, None] * along[0])
    return columns


def friction_effect(path: Path) -> tuple[Array, Array, Array]:
    """Return the effects of a unit of friction per unit mass of a spline.

    These are the effect on the acceleration of friction at each point's slip speed, and the effects of friction at rest
    on the acceleration on a ramp and on the ramp's edge.
    """
    d, q, at_rest = _contact(path)
    in_slip = np.broadcast_to(path.level * path.side * _yielding(path), path.time.shape)
    in_stick = np.zeros(path.time.size)
    if path.curve.ramp or np.any(q):
        ramp = ~path.slips & (path.mode != STICK)
        in_stick[ramp] = (path.friction / at_rest * (d / np.maximum(d + q * at_rest, 1e-300)))[ramp]
    return in_slip, in_stick, np.broadcast_to(q, path.time.shape)[path.first_point[:-1]]


def parameter_forces(path: Path, slots: Sequence[int]) -> tuple[Array, Array]:
    """Return the effect of each slot on the acceleration, (M, slots), and on the ramp's edge, (windows, slots).

    0 for those that move the belt, which act through its speed alone (`belt_columns`).
    """
    K, F, compliance = path.unknown(Global.K), np.exp(path.unknown(Global.LOG_F)), path.unknown(Global.COMPLIANCE)
    _, q, at_rest = _contact(path)
    slips, friction, bound = path.slips, path.friction, path.mode == STICK
    # derivatives by q, the speed that the belt loses under the load F, at a given relative speed; and of q by the slots
    by_q_of: dict[int, Array | float] = {}
    if Global.COMPLIANCE in slots or np.any(compliance):
        n = np.abs(friction) / np.maximum(path.level * F, 1e-300)  # friction may vanish in a search
        by_q = _by_width(path) * np.where(slips, n, at_rest)
        by_q_of = {Global.K: -compliance * F / K**2, Global.LOG_F: q, Global.COMPLIANCE: F / K}
    forces = np.zeros((len(slots), path.time.size))
    edge = np.zeros((path.windows.table.shape[0], len(slots)))
    first = path.first_point[:-1]
    for j, slot in enumerate(slots):
        if slot == Global.K:
            forces[j] = path.unknown(Global.DATUM) - path.position
        elif slot == Global.LOG_F:
            forces[j] = np.where(bound, 0.0, friction)
        elif slot == Global.SHAPE and path.curve.spline is None:
            shape = path.unknown(Global.SHAPE)
            rate = shape_slope(path.curve.code, path.slip_speed, path.level * F, shape)  # type: ignore[arg-type]
            forces[j] = np.where(slips, path.side * rate * _yielding(path), 0.0)
        elif slot == Global.D:
            forces[j], edge[:, j] = _by_width(path), 1.0
        elif slot == Global.DATUM:
            forces[j] = K
        elif slot == Global.DAMPING:
            forces[j] = -path.velocity
        elif slot == Global.FADE:
            epoch = path.windows.level_epoch[path.window]
            fade = path.unknown(Global.FADE)
            change = (epoch - path.time) / ((1.0 - fade * path.time) * (1.0 - fade * epoch))  # of the level's logarithm
            forces[j] = np.where(bound, 0.0, change * friction)
        elif slot == Global.STATIC:
            forces[j] = np.where(slips | bound | (q != 0.0), 0.0, friction / path.unknown(Global.STATIC))
        if slot in by_q_of:
            forces[j] += by_q * by_q_of[slot]
            edge[:, j] += np.broadcast_to(at_rest * by_q_of[slot], path.time.shape)[first]
    return forces.T, edge


def _by_width(path: Path) -> Array:
    """Return the effect of the ramp's half-width d on the acceleration at fixed relative speed, 1/s, (M,)."""
    d, q, at_rest = _contact(path)
    ramp = ~path.slips & (path.mode != STICK)
    effect = np.where(path.slips, -path.side * path.friction_slope, 0.0)
    width = np.broadcast_to(np.maximum(d + q * at_rest, 1e-300), ramp.shape)
    effect[ramp] = -path.friction[ramp] / width[ramp]
    return effect


def belt_columns(path: Path, slots: Sequence[int]) -> Array:
    """Return the effect of each slot on the belt's speed, m/s, shape (M, slots)."""
    columns = np.ones((path.time.size, len(slots)))
    if any(slot != Global.V_DR for slot in slots):
        turn = path.unknown(Global.OMEGA) * path.time
        cosine, sine = np.cos(turn), np.sin(turn)
        rate = path.time * (path.unknown(Global.SINE) * cosine - path.unknown(Global.COSINE) * sine)
        of = {Global.V_DR: np.ones(turn.size), Global.COSINE: cosine, Global.SINE: sine, Global.OMEGA: rate}
        for j, slot in enumerate(slots):
            columns[:, j] = of[Global(slot)]
    return columns


def _contact(path: Path) -> tuple[Array | float, Array | float, float]:
    """Return d (m/s), q (m/s) and n(0), each (M,) or one number."""
    spline = path.curve.spline
    d = path.unknown(Global.D) if path.curve.ramp else 0.0
    return d, _loss(path), 1.0 if spline is None else float(spline.coefficients[0])


def _loss(path: Path) -> Array | float:
    """Return q, the speed that a compliant belt loses under the load F, m/s."""
    return path.unknown(Global.COMPLIANCE) * np.exp(path.unknown(Global.LOG_F)) / path.unknown(Global.K)


def _yielding(path: Path) -> Array | float:
    """Return 1/(1 + q n'), the factor by which a compliant belt reduces the effect of the curve; 1 on a stiff belt."""
    q = _loss(path)
    if not np.any(q):
        return 1.0
    return np.asarray(1 - q * path.friction_slope / (path.level * np.exp(path.unknown(Global.LOG_F))))
