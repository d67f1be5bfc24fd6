"""Series of a slip in one flat buffer, as the kernels by hand use them: step, changes, first root on a level.

The algorithm is the engine's (`rig_sim.integrate.taylor`, `rig_sim.integrate.polynomial`), which explains it; the
series of w begins at 0.
"""

import math

from rig_sim.integrate.newton import EPS, newton_step

ORDER = 28
SIZE = ORDER + 2
INVERSE = (0.0, *(1.0 / j for j in range(1, ORDER + 1)))
P = SIZE
Q = 2 * SIZE
D = 3 * SIZE
U = 4 * SIZE


def reach(work):
    """Return the scaled step at which the last two terms of w fall below rounding of the largest of its first three."""
    size0 = math.log2(abs(work[0])) if work[0] != 0.0 else -1e6
    size1 = math.log2(abs(work[1])) if work[1] != 0.0 else -1e6
    size2 = math.log2(abs(work[2])) if work[2] != 0.0 else -1e6
    shortest = 2.0
    for j in range(ORDER - 1, ORDER + 1):
        if work[j] != 0.0:
            edge = math.log2(abs(work[j])) + 53.0
            longest = max((size0 - edge) * INVERSE[j], (size1 - edge) * INVERSE[j - 1], (size2 - edge) * INVERSE[j - 2])
            shortest = min(shortest, longest)
    return math.exp(0.6931471805599453 * shortest)


def changes(work, xi):
    """Return by how much (p, w) have changed at scaled time xi."""
    w = work[ORDER]
    p = work[P + ORDER]
    for j in range(ORDER - 1, 0, -1):
        w = w * xi + work[j]
        p = p * xi + work[P + j]
    return p * xi, w * xi


def deflated(c, zeros, level, xi):
    """Return value and slope of (w - level) / xi^zeros."""
    total = c[ORDER]
    slope = 0.0
    for j in range(ORDER - 1, zeros - 1, -1):
        slope = slope * xi + total
        total = total * xi + c[j]
    if zeros == 0:
        total -= level
    return total, slope


def survey(c, zeros, level, xi):
    """Return what `deflated` does, and a bound on the second derivative over [0, xi]."""
    total = c[ORDER]
    slope = 0.0
    n = ORDER - zeros
    bound = n * (n - 1.0) * abs(total)
    for j in range(ORDER - 1, zeros + 1, -1):
        n = j - zeros
        slope = slope * xi + total
        total = total * xi + c[j]
        bound = bound * xi + n * (n - 1.0) * abs(c[j])
    for j in range(zeros + 1, zeros - 1, -1):
        slope = slope * xi + total
        total = total * xi + c[j]
    if zeros == 0:
        total -= level
    return total, slope, bound


def first_root(c, level, side, xi_end):
    """Return the first xi in [0, xi_end] where w leaves through ``level`` upwards (+1) or downwards (-1), or -1."""
    zeros = 0
    lead = side * (level - c[0])
    if lead < 0.0:
        return 0.0
    if lead == 0.0:
        zeros = 1
        while zeros < 4 and c[zeros] == 0.0:
            zeros += 1
        lead = -side * c[zeros]
        if lead < 0.0:
            return 0.0
        if lead == 0.0:
            return -1.0
    stray = abs(c[ORDER])
    for j in range(ORDER - 1, zeros, -1):
        stray = stray * xi_end + abs(c[j])
    if lead > stray * xi_end:
        return -1.0
    rounding = EPS * (lead if zeros > 0 else max(abs(level), abs(c[0])))
    total, slope, bound = survey(c, zeros, level, xi_end)
    start = 0.0
    end = xi_end
    margin = lead
    for _i in range(300):
        h = end - start
        rest = -side * total
        fall = -side * slope
        monotone = abs(fall) > bound * h or h <= 1e-9 * xi_end or bound * h * h <= rounding
        if rest <= 0.0 and monotone:
            return polish(c, zeros, level, side, start, end)
        if rest > 0.0 and (monotone or min(rest, margin) > 0.125 * bound * h * h):
            if end >= xi_end:
                return -1.0
            start = end
            end = min(end + 2.0 * h, xi_end)
            margin = rest
        else:
            end = start + 0.5 * h
        total, slope = deflated(c, zeros, level, end)
    total, slope = deflated(c, zeros, level, xi_end)
    return polish(c, zeros, level, side, start, xi_end) if side * total >= 0.0 else -1.0


def polish(c, zeros, level, side, inside, outside):
    """Return the root between ``inside`` and ``outside``: Newton kept in its bracket."""
    xi = 0.5 * (inside + outside)
    for _i in range(100):
        total, slope = deflated(c, zeros, level, xi)
        if total == 0.0:
            return xi
        if side * total > 0.0:
            outside = xi
        else:
            inside = xi
        xi, settled = newton_step(xi, total, slope, inside, outside)
        if settled:
            return xi
    return xi
