"""Taylor series of order 28 for hyperbolic slip and for driven slip.

With the slip speed beyond the contact s and q = 1 + gamma s, the hyperbola A/q = A + D obeys D q = A (1 - q), which
gives its coefficients one after another.  Time is scaled by the phase's fastest local rate, so that no coefficient
overflows whatever gamma is; the step is where the last terms fall below rounding of the leading ones.

Where the belt droops, s is not linear in w: q - lag D/A_ is (A_ the level as an acceleration, lag = droop gamma), which
takes the term D_n of q_n to the left: D_n (1 - lag/q0^2) = -(sum + bend w_n level).

An event is the first root of w - level on the step (`rig_sim.integrate.polynomial`).
"""

import math

from rig_sim.flow.frame import Frame, curve_deficit, drive, kept_inside, linear_terms, slip_speed
from rig_sim.flow.modes import NEGATIVE, RAMP
from rig_sim.friction.curve import HYPERBOLIC
from rig_sim.integrate.buffer import ORDER, TIME_SCALE, Buffer, D, P, Q, U, W
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.polynomial import first_root

INVERSE = (0.0, *(1.0 / j for j in range(1, ORDER + 1)))
SETTLED = 64.0 * EPS  # speed and force, relative, at which a stable fixed point counts as reached
ROUNDING_SIZE = -53.0  # log2 of half an ulp
LOG_2 = math.log(2.0)
LARGEST_STEP_SIZE = 2.0  # log2 of the longest step in scaled time: beyond, terms far above their sum cancel
NO_SIZE = -1e6  # stands for log2 of 0


def expand(fr: Frame, mode: int, p: float, w: float, t: float, work: Buffer) -> float:
    """Fill ``work`` with the series of (p, w) from time t and return the step in scaled time (inf: the state rests).

    The scale (s) is left in ``work[TIME_SCALE]``; coefficients are those of xi = tau/scale.
    """
    C, e = linear_terms(fr, mode)
    fall = curve_deficit(fr, mode, w)
    driven = fr.u0 != 0.0
    push = drive(fr, t) if driven else 0.0
    a = kept_inside(fr, mode, w, (-C * w - fr.k * p + e + fall + push) / fr.m)
    u = w + fr.v
    curved = fr.curve == HYPERBOLIC and mode != RAMP
    sign = 1.0 if mode == NEGATIVE else -1.0
    rate = fr.omega0 + abs(C) / fr.m
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
        for j in range(1, ORDER + 1):
            work[W + j] = 0.0
            work[P + j] = 0.0
        work[W] = w
        work[P] = p
        work[TIME_SCALE] = 1.0
        return math.inf
    T = 1.0 / rate
    inertia = T / fr.m
    damping = C * inertia
    stiffness = fr.k * inertia
    work[TIME_SCALE] = T
    work[W] = w
    work[P] = p
    work[W + 1] = a * T
    work[P + 1] = u * T
    if driven:
        turn = fr.omega * T
        work[U] = inertia * push
        work[U + 1] = -inertia * fr.u0 * math.sin(fr.omega * t + fr.phase) * turn
        for j in range(2, ORDER):
            work[U + j] = -turn * turn * work[U + j - 2] * (INVERSE[j] * INVERSE[j - 1])
    if curved and fr.lag != 0.0:
        expand_drooping(fr, mode, w, q0, damping, stiffness, inertia, T, driven, work)
    elif curved:
        # Q: q_j/q0 for j > 0; D: D_j as an acceleration; only Q[n] -> D[n] -> Q[n + 1] is one long chain
        bend = -sign * fr.gamma / q0
        work[D] = inertia * fall
        level = sign * inertia * fr.A + inertia * fall
        w_n = a * T
        p_n = u * T
        q_n = bend * w_n
        work[Q + 1] = q_n
        for n in range(1, ORDER):
            # four terms a turn, then the rest: less loop, shorter chains of sums
            total = 0.0
            i = D + n - 1
            more = (n - 1) % 4
            whole = Q + n - more
            for j in range(Q + 1, whole, 4):
                total += (work[j] * work[i] + work[j + 1] * work[i - 1]) + (
                    work[j + 2] * work[i - 2] + work[j + 3] * work[i - 3]
                )
                i -= 4
            if more > 0:
                total += work[whole] * work[i]
                if more > 1:
                    total += work[whole + 1] * work[i - 1]
                    if more > 2:
                        total += work[whole + 2] * work[i - 2]
            following = n + 1
            share = INVERSE[following]
            pull = -(total + q_n * level)
            work[D + n] = pull
            rest = pull - damping * w_n - stiffness * p_n
            if driven:
                rest += work[U + n]
            p_n = T * w_n * share
            w_n = rest * share
            q_n = bend * w_n
            work[P + following] = p_n
            work[W + following] = w_n
            work[Q + following] = q_n
    else:
        w_n = a * T
        p_n = u * T
        for n in range(2, ORDER + 1):
            share = INVERSE[n]
            rest = -damping * w_n - stiffness * p_n
            if driven:
                rest += work[U + n - 1]
            p_n = T * w_n * share
            w_n = rest * share
            work[P + n] = p_n
            work[W + n] = w_n
    return reach(work, w, a * T)


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
    work: Buffer,
) -> None:
    """Fill in the coefficients of hyperbolic slip from the second on, for a belt that droops."""
    sign = 1.0 if mode == NEGATIVE else -1.0
    bend = -sign * fr.gamma / q0
    work[D] = inertia * curve_deficit(fr, mode, w)
    level = sign * inertia * fr.A + work[D]
    hold = fr.lag / (q0 * sign * inertia * fr.A)
    gain = 1.0 / (1.0 - hold * level)
    for n in range(1, ORDER):
        straight = bend * work[W + n]
        total = straight * level
        i = D + n - 1
        whole = Q + n - (n - 1) % 4
        for j in range(Q + 1, whole, 4):  # as in `expand`
            total += (work[j] * work[i] + work[j + 1] * work[i - 1]) + (
                work[j + 2] * work[i - 2] + work[j + 3] * work[i - 3]
            )
            i -= 4
        for j in range(whole, Q + n):
            total += work[j] * work[i]
            i -= 1
        pull = -total * gain
        work[D + n] = pull
        work[Q + n] = straight - hold * pull
        rest = -damping * work[W + n] - stiffness * work[P + n] + pull
        if driven:
            rest += work[U + n]
        work[W + n + 1] = rest * INVERSE[n + 1]
        work[P + n + 1] = T * work[W + n] * INVERSE[n + 1]


def reach(work: Buffer, c0: float, c1: float) -> float:
    """Return the scaled step at which the last two terms of w fall below rounding of the largest of its first three."""
    c2 = work[W + 2]
    size0 = math.log2(abs(c0)) if c0 != 0.0 else NO_SIZE
    size1 = math.log2(abs(c1)) if c1 != 0.0 else NO_SIZE
    size2 = math.log2(abs(c2)) if c2 != 0.0 else NO_SIZE
    shortest = LARGEST_STEP_SIZE
    for j in range(ORDER - 1, ORDER + 1):
        last = work[W + j]
        if last != 0.0:
            edge = math.log2(abs(last)) - ROUNDING_SIZE
            longest = max((size0 - edge) * INVERSE[j], (size1 - edge) * INVERSE[j - 1], (size2 - edge) * INVERSE[j - 2])
            shortest = min(shortest, longest)
    return math.exp(LOG_2 * shortest)


def changes(work: Buffer, xi: float) -> tuple[float, float]:
    """Return by how much (p, w) have changed at scaled time ``xi``: two chains that do not wait for each other."""
    w = work[W + ORDER]
    p = work[P + ORDER]
    for j in range(ORDER - 1, 0, -1):
        w = w * xi + work[W + j]
        p = p * xi + work[P + j]
    return p * xi, w * xi


def series_exit(
    fr: Frame, mode: int, p: float, w: float, t: float, lo: float, hi: float, tau_max: float, work: Buffer
) -> tuple[int, float]:
    """Return (side, tau) of one Taylor step: the first exit of w from [lo, hi] on it, or (0, its length)."""
    step = expand(fr, mode, p, w, t, work)
    scale = float(work[TIME_SCALE])
    if not scale > 0.0:  # the rate overflowed: `phase` calls that not finite
        return 0, math.inf
    xi_end = min(step, tau_max / scale)
    if math.isinf(step):
        return 0, tau_max
    side = 0
    end = xi_end
    if not math.isinf(hi):
        xi = first_root(work, W, ORDER, hi, 1, end)
        if xi >= 0.0:
            side = 1
            end = xi
    if not math.isinf(lo):
        xi = first_root(work, W, ORDER, lo, -1, end)
        if xi >= 0.0:
            side = -1
            end = xi
    return side, min(end * scale, tau_max)
