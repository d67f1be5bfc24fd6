"""Taylor series of order 28 for hyperbolic slip and for driven slip, with events found on the polynomial for certain.

With the slip speed beyond the contact s and q = 1 + gamma s, the hyperbola A/q = A + D obeys D q = A (1 - q), which
gives its coefficients one after another.  Time is scaled by the phase's fastest local rate, so that no coefficient
overflows whatever gamma is; the step is where the last terms fall below rounding of the leading ones.

Where the belt droops, s is not linear in w: q - lag D/A_ is (A_ the level as an acceleration, lag = droop gamma), which
takes the term D_n of q_n to the left: D_n (1 - lag/q0^2) = -(sum + bend w_n level).

An event is the first root of w - level on the step.  Leading zero coefficients (a phase begins on its edge, often with
w' = 0) are divided out, so that the start is never found again.  Most steps stray too little from their first term to
reach the level.  Otherwise the step is searched with a bound on the second derivative: a piece is passed only when the
bound excludes a root, and a root is polished only on a piece where the bound proves w monotone; pieces are halved until
one of the two holds.
"""

import math

from rig_sim.friction.curve import HYPERBOLIC
from rig_sim.integrate.bracket import EPS, newton_step
from rig_sim.integrate.linear import LARGEST_EXPONENT
from rig_sim.integrate.modes import (
    NEGATIVE,
    ORDER,
    RAMP,
    TIME_SCALE,
    Buffer,
    Frame,
    Work,
    acceleration,
    drive,
    drop,
    line,
    slip_speed,
)

INVERSE = (0.0, *(1.0 / j for j in range(1, ORDER + 1)))
SETTLED = 64.0 * EPS  # speed and force, relative, at which a stable fixed point counts as reached
LOG_ROUNDING = math.log(0.5 * EPS)
LONGEST_STEP = 4.0  # in scaled time: beyond, terms far above their sum cancel
SHORTEST_PIECE = 1e-9  # of a step: over it a parabola stays within rounding
PIECES = 300  # three times what halving down to the shortest piece on both sides of a tangency takes


def expand(fr: Frame, mode: int, p: float, w: float, t: float, work: Work) -> float:
    """Fill ``work`` with the series of (p, w) from time t and return the step in scaled time (inf: the state rests).

    The scale (s) is left in ``work[5][TIME_SCALE]``; coefficients are those of xi = tau/scale.
    """
    cw, cp, cq, cd, cf, counters = work
    C, _ = line(fr, mode)
    a = acceleration(fr, mode, p, w, t)
    u = w + fr.v
    curved = fr.curve == HYPERBOLIC and mode != RAMP
    driven = fr.u0 != 0.0
    sign = 1.0 if mode == NEGATIVE else -1.0
    rate = math.sqrt(fr.omega2) + abs(C) / fr.m
    q0 = 1.0
    slope = 0.0
    if curved:
        s = max(-sign * w - fr.d, 0.0)
        if fr.lag != 0.0:
            s = slip_speed(fr, s)
        q0 = 1.0 + fr.gamma * s
        slope = fr.A * fr.gamma / (q0 * q0 - fr.lag)
        rate += slope / fr.m + (fr.gamma * abs(a) + math.sqrt(fr.gamma * fr.omega2 * abs(u))) / q0
    if driven:
        rate += abs(fr.omega)
    elif C >= slope and abs(u) <= SETTLED * fr.v and fr.m * abs(a) <= SETTLED * (fr.B + fr.k * abs(p)):
        # a stable fixed point, to rounding: stay
        cw[0] = w
        cp[0] = p
        for j in range(1, ORDER + 1):
            cw[j] = 0.0
            cp[j] = 0.0
        counters[TIME_SCALE] = 1.0
        return math.inf
    T = 1.0 / rate
    counters[TIME_SCALE] = T
    damping = C * T / fr.m
    stiffness = fr.k * T / fr.m
    inertia = T / fr.m
    cw[0] = w
    cp[0] = p
    cw[1] = a * T
    cp[1] = u * T
    if driven:
        turn = fr.omega * T
        cf[0] = inertia * drive(fr, t)
        cf[1] = -inertia * fr.u0 * math.sin(fr.omega * t + fr.phase) * turn
        for j in range(2, ORDER):
            cf[j] = -turn * turn * cf[j - 2] * (INVERSE[j] * INVERSE[j - 1])
    if curved and fr.lag != 0.0:
        expand_drooping(fr, mode, w, q0, damping, stiffness, inertia, T, driven, work)
    elif curved:
        # cq: q_j/q0 for j > 0; cd: D_j as an acceleration; only cq[n] -> cd[n] -> cq[n + 1] is one long chain
        bend = -sign * fr.gamma / q0
        cd[0] = inertia * drop(fr, mode, w)
        level = sign * inertia * fr.A + cd[0]
        cq[1] = bend * cw[1]
        for n in range(1, ORDER):
            total = 0.0
            whole = n - 1 - (n - 1) % 4
            for j in range(1, whole, 4):  # four terms a turn: less loop, shorter chains of sums
                total += (cq[j] * cd[n - j] + cq[j + 1] * cd[n - j - 1]) + (
                    cq[j + 2] * cd[n - j - 2] + cq[j + 3] * cd[n - j - 3]
                )
            for j in range(whole + 1, n):
                total += cq[j] * cd[n - j]
            rest = -damping * cw[n] - stiffness * cp[n]
            if driven:
                rest += cf[n]
            pull = -(total + cq[n] * level)
            following = (rest + pull) * INVERSE[n + 1]
            cd[n] = pull
            cw[n + 1] = following
            cq[n + 1] = bend * following
            cp[n + 1] = T * cw[n] * INVERSE[n + 1]
    else:
        for n in range(1, ORDER):
            rest = -damping * cw[n] - stiffness * cp[n]
            if driven:
                rest += cf[n]
            cw[n + 1] = rest * INVERSE[n + 1]
            cp[n + 1] = T * cw[n] * INVERSE[n + 1]
    return reach(cw, w, a * T)


def expand_drooping(
    fr: Frame,
    mode: int,
    w: float,
    q0: float,
    damping: float,
    stiffness: float,
    inertia: float,
    T: float,
    driven: bool,
    work: Work,
) -> None:
    """Fill in the coefficients of hyperbolic slip from the second on, for a belt that droops."""
    cw, cp, cq, cd, cf, _ = work
    sign = 1.0 if mode == NEGATIVE else -1.0
    bend = -sign * fr.gamma / q0
    cd[0] = inertia * drop(fr, mode, w)
    level = sign * inertia * fr.A + cd[0]
    hold = fr.lag / (q0 * sign * inertia * fr.A)
    gain = 1.0 / (1.0 - hold * level)
    for n in range(1, ORDER):
        straight = bend * cw[n]
        total = straight * level
        for j in range(1, n):
            total += cq[j] * cd[n - j]
        pull = -total * gain
        cd[n] = pull
        cq[n] = straight - hold * pull
        rest = -damping * cw[n] - stiffness * cp[n] + pull
        if driven:
            rest += cf[n]
        cw[n + 1] = rest * INVERSE[n + 1]
        cp[n + 1] = T * cw[n] * INVERSE[n + 1]


def reach(cw: Buffer, c0: float, c1: float) -> float:
    """Return the scaled step at which the last two terms fall below rounding of the largest of the first three."""
    size0 = math.log(abs(c0)) if c0 != 0.0 else -math.inf
    size1 = math.log(abs(c1)) if c1 != 0.0 else -math.inf
    size2 = math.log(abs(cw[2])) if cw[2] != 0.0 else -math.inf
    shortest = math.inf
    for j in range(ORDER - 1, ORDER + 1):
        if cw[j] != 0.0:
            last = math.log(abs(cw[j])) - LOG_ROUNDING
            longest = max((size0 - last) / j, (size1 - last) / (j - 1), (size2 - last) / (j - 2))
            shortest = min(shortest, longest)
    return min(math.exp(min(shortest, LARGEST_EXPONENT)), LONGEST_STEP)


def value(c: Buffer, xi: float) -> float:
    """Return the polynomial at scaled time ``xi``."""
    total = c[ORDER]
    for j in range(ORDER - 1, -1, -1):
        total = total * xi + c[j]
    return float(total)


def deflated(c: Buffer, zeros: int, level: float, xi: float) -> tuple[float, float]:
    """Return value and slope of (polynomial - level) / xi^zeros, whose ``zeros`` lowest coefficients vanish."""
    total = c[ORDER]
    slope = 0.0
    for j in range(ORDER - 1, zeros - 1, -1):
        slope = slope * xi + total
        total = total * xi + c[j]
    if zeros == 0:
        total -= level
    return total, slope


def spread(c: Buffer, zeros: int, xi: float) -> float:
    """Return a bound on how far `deflated` strays from its first term over [0, xi]."""
    total = abs(c[ORDER])
    for j in range(ORDER - 1, zeros, -1):
        total = total * xi + abs(c[j])
    return float(total * xi)


def survey(c: Buffer, zeros: int, level: float, xi: float) -> tuple[float, float, float]:
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


def first_root(c: Buffer, level: float, side: int, xi_end: float) -> float:
    """Return the first xi in [0, xi_end] where the polynomial leaves through ``level``, or -1.

    ``side`` +1: the inside is below the level, -1: above it.  A start outside, or on the level moving out, gives 0.
    """
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
    if lead > spread(c, zeros, xi_end):
        return -1.0
    rounding = EPS * (lead if zeros > 0 else max(abs(level), abs(c[0])))
    total, slope, bound = survey(c, zeros, level, xi_end)
    start = 0.0
    end = xi_end
    margin = lead
    for _i in range(PIECES):
        h = end - start
        rest = -side * total
        fall = -side * slope
        # below rounding of the polynomial its sign at the piece's end is all there is to know
        monotone = abs(fall) > bound * h or h <= SHORTEST_PIECE * xi_end or bound * h * h <= rounding
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
    # only a polynomial that hugs its level for the whole step comes here: its end decides
    total, slope = deflated(c, zeros, level, xi_end)
    return polish(c, zeros, level, side, start, xi_end) if side * total >= 0.0 else -1.0


def polish(c: Buffer, zeros: int, level: float, side: int, inside: float, outside: float) -> float:
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


def series_exit(
    fr: Frame, mode: int, p: float, w: float, t: float, lo: float, hi: float, tau_max: float, work: Work
) -> tuple[int, float]:
    """Return (side, tau) of one Taylor step: the first exit of w from [lo, hi] on it, or (0, its length)."""
    step = expand(fr, mode, p, w, t, work)
    counters = work[5]
    scale = float(counters[TIME_SCALE])
    xi_end = min(step, tau_max / scale)
    if math.isinf(step):
        return 0, tau_max
    side = 0
    end = xi_end
    if not math.isinf(hi):
        xi = first_root(work[0], hi, 1, end)
        if xi >= 0.0:
            side = 1
            end = xi
    if not math.isinf(lo):
        xi = first_root(work[0], lo, -1, end)
        if xi >= 0.0:
            side = -1
            end = xi
    return side, min(end * scale, tau_max)
