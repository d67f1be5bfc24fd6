"""Tangents: derivatives of the position along a path by anything that acts on the mass, the belt or the reading.

A departure or a parameter p is a column: the acceleration a_p (m/s^2) and the change of the belt's speed b_p (m/s) that
one unit of it makes at every point of a path.  With K = k/m, c/m (and the slope of a drag) and the slope
of friction f' there,

    dx'' = -K dx - (c + f') dx' + a_p + f' b_p        slip and ramp
    dx'  = b_p                                        stick
    dx'' = -K dx - (c + f') dx' + a_p + f' b_p        creep on a ramp, to first order in the acceleration dx''

by the same Runge-Kutta steps as the path.  Where the mode changes, the change comes later or earlier by what the column
does there, and dx' jumps (saltation).

Source: R. Leine, H. Nijmeijer, Dynamics and Bifurcations of Non-smooth Mechanical Systems (2004), 7.2.
"""

import numpy as np

from fitting.model.parameters import PER_RUN, Global
from fitting.sensitivity.path import KERNELS, Path
from fitting.sensitivity.rates import CREEP
from rig_sim.flow.modes import STICK
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
    own: Array,
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

    ``own`` (windows,) is K of each window's run, 1/s^2; ``acceleration`` (k, M) is contiguous.
    """
    k = out.shape[1]
    x, v = room[0], room[1]
    g0, gm, g1, late = room[2], room[3], room[4], room[5]
    for row in range(table.shape[0]):
        K = own[row]
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
