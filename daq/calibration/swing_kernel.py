"""Kernel: the nodes of a damped swing against friction, exact between them where friction does not change with speed.

The equation of motion is that of `daq.calibration.ring_down`.  Runs as written or compiled
(`stickslip.compute.compile`).
"""

import math

from stickslip.compute.arrays import Array


def follow(
    end: float,
    step: float,
    w: float,
    zeta: float,
    a: float,
    g: float,
    rest: float,
    times: Array,
    xs: Array,
    vs: Array,
) -> int:
    """Continue the motion from node 0 of ``times`` (s), ``xs`` (u), ``vs`` (u/s) to ``end`` s; return how many nodes.

    ``step`` (s) is the longest time between two nodes; every turning point is a node.  Stops where the arrays end.  A
    mass at rest by friction gets one more node, after ``end``.
    """
    beta = zeta * w
    wd = w * math.sqrt(max(1e-12, 1 - zeta * zeta))
    decay, c, s = math.exp(-beta * step), math.cos(wd * step), math.sin(wd * step)
    now, x, v, n = times[0], xs[0], vs[0], 1
    turns = 0  # consecutive turns without time passing; at the second, only rounding keeps the mass beyond a
    sign = math.copysign(1.0, v) if v != 0.0 else math.copysign(1.0, rest - x)
    while now < end and n < len(times):
        if v == 0 and (turns > 1 or abs(x - rest) <= a):
            times[n], xs[n], vs[n] = end + 1.0, x, 0.0
            return n + 1
        slowing = sign * a / (1 + g * abs(v))
        middle = v - 0.5 * step * (w * w * (x - rest + slowing) + 2 * beta * v)
        pull = rest - sign * a / (1 + g * abs(middle))
        y = x - pull
        x_next = pull + decay * (y * c + (v + beta * y) / wd * s)
        v_next = decay * (v * c - (w * w * y + beta * v) / wd * s)
        if v_next * sign > 0:
            x, v, now = x_next, v_next, now + step
        else:  # it turns within this step, where tan(wd t) is:
            turn = (math.atan2(v * wd, w * w * y + beta * v) % math.pi) / wd
            x = pull + math.exp(-beta * turn) * (y * math.cos(wd * turn) + (v + beta * y) / wd * math.sin(wd * turn))
            v, now, sign = 0.0, now + turn, -sign
            if turn == 0.0:
                turns += 1
                continue
        turns = 0
        times[n], xs[n], vs[n] = now, x, v
        n += 1
    return n
