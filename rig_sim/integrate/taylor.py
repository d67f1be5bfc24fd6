"""Taylor series of order 28 for slip on the hyperbola or on a measured curve, and for driven slip.

With the slip speed beyond the contact s and q = 1 + gamma s, the hyperbola A/q = A + D obeys D q = A (1 - q), which
gives its coefficients one after another.  Time is scaled by the phase's fastest local rate, so that no coefficient
overflows whatever gamma is; the step is where the last terms fall below rounding of the leading ones.

Where the belt droops, s is not linear in w: q - lag D/A_ is (A_ the level as an acceleration, lag = droop gamma), which
takes the term D_n of q_n to the left: D_n (1 - lag/q0^2) = -(sum + bend w_n level).

A measured curve is one cubic in w on each of its pieces, and a step ends where w leaves the piece: each step is exact.
Steps over pieces are short, and need fewer terms.

An event is the first root of w - level on the step (`rig_sim.integrate.polynomial`).
"""

import math

from rig_sim.flow.frame import Frame, curve_deficit, drive, is_curved, keep_inside, linear_terms, slip_speed
from rig_sim.flow.modes import NEGATIVE
from rig_sim.friction.curve import MEASURED
from rig_sim.friction.spline import about, piece_of
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.polynomial import first_root
from rig_sim.integrate.work import ORDER, Work

INVERSE = (0.0, *(1.0 / j for j in range(1, ORDER + 1)))
SETTLED = 64.0 * EPS  # speed and force, relative, at which a stable fixed point counts as reached
ROUNDING_SIZE = -53.0  # log2 of half an ulp
LOG_2 = math.log(2.0)
LARGEST_STEP_SIZE = 2.0  # log2 of the longest step in scaled time: beyond, terms far above their sum cancel
# Terms of the series on a measured curve: few where they reach the end of the piece.
FEW_TERMS, MANY_TERMS = 14, 22
THIRD = 1.0 / 3.0
AT_KNOT = 16.0 * EPS  # share of the speeds: a slip speed as near to a knot is on it
OFF_KNOT = (
    1e-3  # share of the scaled time: w, which turns there, changes by about 1e-6, and friction by its third power
)
NO_SIZE = -1e6  # in place of log2 of 0
SMALLEST = 2.0**-1022  # the smallest number of full precision


def expand(fr: Frame, mode: int, p: float, w: float, t: float, work: Work) -> float:
    """Fill ``work`` with the series of (p, w) from time t and return the step in scaled time (inf: the state rests).

    The scale (s) is left in ``work.time_scale``; coefficients are those of xi = tau/scale.
    """
    C, e = linear_terms(fr, mode)
    fall = curve_deficit(fr, mode, w)
    driven = fr.u0 != 0.0
    push = drive(fr, t) if driven else 0.0
    a = keep_inside(fr, mode, w, (-C * w - fr.k * p + e + fall + push) / fr.m)
    u = w + fr.v
    curved = is_curved(fr, mode)
    measured = curved and fr.curve == MEASURED
    sign = 1.0 if mode == NEGATIVE else -1.0
    rate = fr.omega0 + abs(C) / fr.m
    q0 = 1.0
    slope = 0.0
    cubic = (0.0, 0.0, 0.0, 0.0)
    if measured:
        s = -sign * w - fr.d
        i = find_entered_piece(fr, s, -sign * a, sign * fr.k * u)
        cubic = about(fr.table, fr.pieces, i, s)
        work.piece = float(i)
        slope = -fr.A * cubic[1]
        pace = fr.A / fr.m
        bend = abs(pace * cubic[2])
        rate += abs(slope) / fr.m + math.sqrt(bend * abs(a)) + (abs(pace * cubic[3]) * a * a) ** THIRD
    elif curved:
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
        for j in range(1, ORDER + 1):
            work.w[j] = 0.0
            work.p[j] = 0.0
        work.w[0] = w
        work.p[0] = p
        work.time_scale = 1.0
        return math.inf
    T = 1.0 / rate
    inertia = T / fr.m
    damping = C * inertia
    stiffness = fr.k * inertia
    work.time_scale = T
    work.w[0] = w
    work.p[0] = p
    work.w[1] = a * T
    work.p[1] = u * T
    if driven:
        turn = fr.omega * T
        work.u[0] = inertia * push
        work.u[1] = -inertia * fr.u0 * math.sin(fr.omega * t + fr.phase) * turn
        for j in range(2, ORDER):
            work.u[j] = -turn * turn * work.u[j - 2] * (INVERSE[j] * INVERSE[j - 1])
    if measured:
        work.q[1] = 0.0
        force = inertia * fr.A
        square, cube, damping = sign * force * cubic[2], -force * cubic[3], damping - inertia * slope
        i = int(work.piece)
        room = math.inf
        if sign * a > 0.0:
            room = s - fr.table[i]
        elif i + 1 < fr.pieces:
            room = fr.table[i + 1] - s
        expand_measured(1, FEW_TERMS, square, cube, damping, stiffness, T, driven, work)
        step = reach(work, w, a * T, FEW_TERMS)
        degree = FEW_TERMS
        if abs(step * (work.w[1] + step * work.w[2])) < room:
            expand_measured(FEW_TERMS, MANY_TERMS, square, cube, damping, stiffness, T, driven, work)
            step = reach(work, w, a * T, MANY_TERMS)
            degree = MANY_TERMS
        work.degree = float(degree)
        for j in range(degree + 1, ORDER + 1):
            work.p[j] = 0.0
            work.w[j] = 0.0
        return step
    if curved and fr.lag != 0.0:
        expand_drooping(fr, mode, w, q0, damping, stiffness, inertia, T, driven, work)
    elif curved:
        # Q: q_j/q0 for j > 0; D: D_j as an acceleration; only Q[n] -> D[n] -> Q[n + 1] is one long chain
        bend = -sign * fr.gamma / q0
        work.d[0] = inertia * fall
        level = sign * inertia * fr.A + inertia * fall
        w_n = a * T
        p_n = u * T
        q_n = bend * w_n
        work.q[1] = q_n
        for n in range(1, ORDER):
            # four terms a turn, then the rest: less loop, shorter chains of sums
            total = 0.0
            i = n - 1
            more = (n - 1) % 4
            unrolled = n - more
            for j in range(1, unrolled, 4):
                total += (work.q[j] * work.d[i] + work.q[j + 1] * work.d[i - 1]) + (
                    work.q[j + 2] * work.d[i - 2] + work.q[j + 3] * work.d[i - 3]
                )
                i -= 4
            if more > 0:
                total += work.q[unrolled] * work.d[i]
                if more > 1:
                    total += work.q[unrolled + 1] * work.d[i - 1]
                    if more > 2:
                        total += work.q[unrolled + 2] * work.d[i - 2]
            following = n + 1
            share = INVERSE[following]
            pull = -(total + q_n * level)
            work.d[n] = pull
            rest = pull - damping * w_n - stiffness * p_n
            if driven:
                rest += work.u[n]
            p_n = T * w_n * share
            w_n = rest * share
            q_n = bend * w_n
            work.p[following] = p_n
            work.w[following] = w_n
            work.q[following] = q_n
    else:
        w_n = a * T
        p_n = u * T
        for n in range(2, ORDER + 1):
            share = INVERSE[n]
            rest = -damping * w_n - stiffness * p_n
            if driven:
                rest += work.u[n - 1]
            p_n = T * w_n * share
            w_n = rest * share
            work.p[n] = p_n
            work.w[n] = w_n
    return reach(work, w, a * T, ORDER)


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
    sign = 1.0 if mode == NEGATIVE else -1.0
    bend = -sign * fr.gamma / q0
    work.d[0] = inertia * curve_deficit(fr, mode, w)
    level = sign * inertia * fr.A + work.d[0]
    hold = fr.lag / (q0 * sign * inertia * fr.A)
    gain = 1.0 / (1.0 - hold * level)
    for n in range(1, ORDER):
        straight = bend * work.w[n]
        total = straight * level
        i = n - 1
        unrolled = n - (n - 1) % 4
        for j in range(1, unrolled, 4):  # as in `expand`
            total += (work.q[j] * work.d[i] + work.q[j + 1] * work.d[i - 1]) + (
                work.q[j + 2] * work.d[i - 2] + work.q[j + 3] * work.d[i - 3]
            )
            i -= 4
        for j in range(unrolled, n):
            total += work.q[j] * work.d[i]
            i -= 1
        pull = -total * gain
        work.d[n] = pull
        work.q[n] = straight - hold * pull
        rest = -damping * work.w[n] - stiffness * work.p[n] + pull
        if driven:
            rest += work.u[n]
        work.w[n + 1] = rest * INVERSE[n + 1]
        work.p[n + 1] = T * work.w[n] * INVERSE[n + 1]


def find_entered_piece(fr: Frame, s: float, rate: float, turn: float) -> int:
    """Return the piece of a measured curve that contains the slip speed s (m/s) or, from between two, is entered.

    ``rate`` is s' (m/s^2), and ``turn`` has the sign of s'' where s' is 0.
    """
    i = piece_of(fr.table, fr.pieces, s)
    near = AT_KNOT * (fr.v + abs(s))
    falling = rate < 0.0 or (rate == 0.0 and turn < 0.0)
    if falling and i > 0 and s - fr.table[i] <= near:
        return i - 1
    if not falling and i + 1 < fr.pieces and fr.table[i + 1] - s <= near:
        return i + 1
    return i


def expand_measured(
    done: int,
    degree: int,
    square: float,
    cube: float,
    damping: float,
    stiffness: float,
    T: float,
    driven: bool,
    work: Work,
) -> None:
    """Fill in the coefficients of slip on one piece of a measured curve, after those that are ``done``.

    w' (in scaled time) is ``square`` and ``cube`` times the second and third power of w - w(0), less ``damping`` times
    it and ``stiffness`` times p.  The square's coefficients are kept in Q.
    """
    w_n = work.w[done]
    p_n = work.p[done]
    for n in range(done, degree):
        rest = -damping * w_n - stiffness * p_n
        if n > 1:
            # the powers of w - w(0): its series begins at 1, that of its square at 2
            twice = 0.0
            half = (n - 1) // 2
            for j in range(1, half + 1):
                twice += work.w[j] * work.w[n - j]
            twice += twice
            if n % 2 == 0:
                twice += work.w[n // 2] * work.w[n // 2]
            work.q[n] = twice
            rest += square * twice
            if cube != 0.0:
                total = 0.0
                for j in range(2, n):
                    total += work.q[j] * work.w[n - j]
                rest += cube * total
        if driven:
            rest += work.u[n]
        share = INVERSE[n + 1]
        p_n = T * w_n * share
        w_n = rest * share
        work.p[n + 1] = p_n
        work.w[n + 1] = w_n


def reach(work: Work, c0: float, c1: float, degree: int) -> float:
    """Return the scaled step at which the last two terms of w fall below rounding of the largest of its first three."""
    c2 = work.w[2]
    unit = max(abs(c0), abs(c1), abs(c2), SMALLEST)  # of the sizes, which then are the same at any scale of w
    size0 = math.log2(abs(c0) / unit) if c0 != 0.0 else NO_SIZE
    size1 = math.log2(abs(c1) / unit) if c1 != 0.0 else NO_SIZE
    size2 = math.log2(abs(c2) / unit) if c2 != 0.0 else NO_SIZE
    shortest = LARGEST_STEP_SIZE
    for j in range(degree - 1, degree + 1):
        last = abs(work.w[j]) / unit
        if last > 0.0:
            edge = math.log2(last) - ROUNDING_SIZE
            longest = max((size0 - edge) * INVERSE[j], (size1 - edge) * INVERSE[j - 1], (size2 - edge) * INVERSE[j - 2])
            shortest = min(shortest, longest)
    return math.exp(LOG_2 * shortest)


def changes(work: Work, xi: float) -> tuple[float, float]:
    """Return the change of (p, w) at scaled time ``xi``: two chains that do not wait for each other."""
    w = work.w[ORDER]
    p = work.p[ORDER]
    for j in range(ORDER - 1, 0, -1):
        w = w * xi + work.w[j]
        p = p * xi + work.p[j]
    return p * xi, w * xi


def series_exit(
    fr: Frame, mode: int, p: float, w: float, t: float, lo: float, hi: float, tau_max: float, work: Work
) -> tuple[int, float]:
    """Return (side, tau) of one Taylor step: the first exit of w from [lo, hi] on it, or (0, its length)."""
    step = expand(fr, mode, p, w, t, work)
    scale = float(work.time_scale)
    if not scale > 0.0:  # the rate overflowed: `run_phase` calls that not finite
        return 0, math.inf
    xi_max = tau_max / scale
    xi_end = min(step, xi_max)
    if math.isinf(step):
        return 0, tau_max
    degree = ORDER
    above, below = 1, -1
    if fr.curve == MEASURED and is_curved(fr, mode):
        degree = int(work.degree)
        sign = 1.0 if mode == NEGATIVE else -1.0
        i = int(work.piece)
        for knot in (i, i + 1):
            if 0 < knot < fr.pieces:
                level = -sign * (fr.table[knot] + fr.d)
                # a start on the knot, to rounding, is on it
                if (knot == i) == (mode == NEGATIVE):
                    if level < hi:
                        hi = max(level, w)
                        above = 0
                elif level > lo:
                    lo = min(level, w)
                    below = 0
    side = 0
    end = xi_end
    if not math.isinf(hi):
        xi = first_root(work.w, degree, hi, 1, end)
        if xi >= 0.0:
            side = above
            end = xi
    if not math.isinf(lo):
        xi = first_root(work.w, degree, lo, -1, end)
        if xi >= 0.0:
            side = below
            end = xi
    if side == 0 and end == 0.0:  # w turns on a knot: off it on this step
        end = min(xi_end, OFF_KNOT)
    if side == 0 and end == xi_max:  # xi_max * scale may be an ulp below tau_max, again and again
        return 0, tau_max
    return side, min(end * scale, tau_max)
