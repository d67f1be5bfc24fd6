"""Closed form of the undriven linear phases (constant and linear slip, ramp) and of stick, with their events.

With u = w + v (velocity over ground), zeta = C/2m and omega0^2 = k/m the phase obeys u'' + 2 zeta u' + omega0^2 u = 0.
Its fundamental solution S (S(0) = 0, S'(0) = 1), E = omega0^2 I and I = integral of S give, from u0 and a0 = w'(0),

    w = w0 + a0 S - u0 E,     p = p0 + u0 (S + 2 zeta I) + a0 I

in which no large numbers cancel, however steep a ramp is: E = 1 - S' - 2 zeta S is formed by expm1, and the slow root
as lambda2 = omega0^2/lambda1.  Events: w is monotone between its extremes, and these are known, so the first exit is
bracketed for certain.  A decaying oscillation that did not leave within its first extremes never does; a growing one is
taken to the right extreme by a logarithm: no loop depends on how long the phase lasts.
"""

import math
from typing import NamedTuple

from rig_sim.flow.frame import Frame
from rig_sim.integrate.newton import EPS, newton_step
from rig_sim.integrate.work import Work

LARGEST_EXPONENT = 700.0  # below 709, so that exp stays finite; growth by e^700 is beyond every edge
INVERSE = (0.0, *(1.0 / j for j in range(1, 16)))
SPLITTER = 2.0**27 + 1.0  # splits a double into halves of 26 digits (Dekker 1971)
SMALLEST_TERM = 1e-18
NEAR_EXTREME = 1e-9  # relative distance of an extreme from an edge below which it is computed from the full solution


class FreeMotion(NamedTuple):
    """An undriven linear phase from its start."""

    w: float  # relative velocity at the start, m/s
    a: float  # w' there, m/s^2
    u: float  # velocity over ground there, m/s
    zeta: float  # C/2m, 1/s
    omega2: float  # k/m, 1/s^2
    disc: float  # zeta^2 - omega2


def fundamental(zeta: float, omega2: float, disc: float, tau: float) -> tuple[float, float, float]:
    """Return (S, E, I) at local time ``tau`` (s); ``disc`` = zeta^2 - omega0^2."""
    reach = (2.0 * abs(zeta) + math.sqrt(omega2)) * tau
    if reach < 0.5:  # by series: E and I keep their relative accuracy
        previous = 0.0
        term = tau
        S = tau
        I = 0.5 * tau * tau  # noqa: E741  # the integral's usual letter
        damping = 2.0 * zeta * tau
        stiffness = omega2 * tau * tau
        for j in range(2, 15):
            following = -(damping * term + stiffness * (previous * INVERSE[j - 1])) * INVERSE[j]
            previous = term
            term = following
            S += term
            I += term * (tau * INVERSE[j + 1])  # noqa: E741
            if abs(previous) + abs(term) < SMALLEST_TERM * tau:
                break
        return S, omega2 * I, I
    if disc < 0.0:
        Omega = math.sqrt(-disc)
        growth = math.expm1(min(-zeta * tau, LARGEST_EXPONENT)) if zeta != 0.0 else 0.0
        half = math.sin(0.5 * Omega * tau)
        twice = 2.0 * (1.0 + growth) * half
        S = twice * math.cos(0.5 * Omega * tau) / Omega
        E = twice * half - growth - zeta * S
        return S, E, E / omega2
    _, lambda2, gap = roots(zeta, omega2, disc)
    slow = math.exp(min(lambda2 * tau, LARGEST_EXPONENT))
    S = slow * tau if gap == 0.0 else slow * math.expm1(min(gap * tau, LARGEST_EXPONENT)) / gap
    E = -math.expm1(min(lambda2 * tau, LARGEST_EXPONENT)) + lambda2 * S
    return S, E, E / omega2


def roots(zeta: float, omega2: float, disc: float) -> tuple[float, float, float]:
    """Return the real roots (1/s): the faster one, the slower one, and faster minus slower."""
    R = math.sqrt(disc)
    lambda1 = -(zeta + R) if zeta >= 0.0 else R - zeta
    return lambda1, omega2 / lambda1, (-2.0 * R if zeta >= 0.0 else 2.0 * R)


def velocity(free: FreeMotion, tau: float) -> float:
    S, E, _ = fundamental(free.zeta, free.omega2, free.disc, tau)
    return free.w + free.a * S - free.u * E


def change(a: float, u: float, zeta: float, omega2: float, S: float, E: float) -> tuple[float, float]:
    """Return the change of (p, w) where the phase's fundamental solution is S and E."""
    I = E / omega2  # noqa: E741
    return u * (S + 2.0 * zeta * I) + a * I, a * S - u * E


def shift_solution(S: float, E: float, zeta: float, omega2: float, step: float) -> tuple[float, float]:
    """Return S and E a small step later, to second order."""
    slope = 1.0 - E - 2.0 * zeta * S  # S'
    later = S + step * (slope - step * (zeta * slope + 0.5 * omega2 * S))
    return later, E + omega2 * step * (S + 0.5 * step * slope)


def root(free: FreeMotion, level: float, side: int, inside: float, outside: float, guess: float, work: Work) -> float:
    """Return where w crosses ``level`` in [inside, outside], on which it is monotone: bracketed Halley from ``guess``.

    The closed form there is stored in ``work`` for the calculations after the exit.
    w leaves through the level upwards (``side`` +1) or downwards (-1); ``outside`` may be infinite where it does so for
    certain, with a guess beyond ``inside``.  u'' = -2 zeta u' - omega0^2 u gives the second
    and third derivatives at no cost, so that the remaining error of a step is known before it.
    """
    w, a, u, zeta, omega2, disc = free
    tau = guess if inside < guess < outside else 0.5 * (inside + outside)
    for _i in range(100):
        S, E, _ = fundamental(zeta, omega2, disc, tau)
        increase = a * S - u * E
        error = (w - level) + increase
        if error == 0.0:
            work.exit, work.exit_s, work.exit_e = tau, S, E
            return tau
        if side * error > 0.0:
            outside = tau
        else:
            inside = tau
        slope = a * (1.0 - E - 2.0 * zeta * S) - omega2 * u * S
        if math.isinf(outside) and not side * slope > 0.0:
            tau *= 2.0
            continue
        if slope != 0.0:
            bend = -2.0 * zeta - omega2 * (u + increase) / slope
            step = error / slope
            shrink = 1.0 - 0.5 * step * bend
            if shrink > 0.5:  # else far off: Newton
                step /= shrink
                following = tau - step
                remainder = (0.25 * bend * bend + (2.0 * abs(zeta * bend) + omega2) / 6.0) * abs(step * step * step)
                if inside < following < outside and remainder <= 0.5 * EPS * following:
                    work.exit = following
                    work.late = (tau - following) - step
                    work.exit_s, work.exit_e = shift_solution(S, E, zeta, omega2, -step)
                    return following
                slope *= shrink
        if math.isinf(outside) and tau - error / slope > 4.0 * tau:
            tau *= 4.0
            continue
        tau, settled = newton_step(tau, error, slope, inside, outside)
        if settled:
            return tau
    return tau


def linear_exit(free: FreeMotion, lo: float, hi: float, tau_max: float, touch: float, work: Work) -> tuple[int, float]:
    """Return (side, tau): the first exit of w from [lo, hi], side -1 or +1; (0, tau_max) when it stays inside.

    An extreme within ``touch`` x abs(u) (relative) of an edge counts as reaching it: grazing.
    """
    w, a, u = free.w, free.a, free.u
    work.exit = -1.0
    if w >= hi and (a > 0.0 or (a == 0.0 and u < 0.0)):
        return 1, 0.0
    if w <= lo and (a < 0.0 or (a == 0.0 and u > 0.0)):
        return -1, 0.0
    if a == 0.0 and u == 0.0:
        return 0, tau_max
    if free.disc < 0.0:
        return oscillating_exit(free, lo, hi, tau_max, touch, work)
    return creeping_exit(free, lo, hi, tau_max, work)


def first_extreme(a: float, u: float, zeta: float, omega2: float, disc: float) -> float:
    """Return the first tau > 0 where w' = 0, or -1 when there is none (real roots have at most one)."""
    if disc < 0.0:
        Omega = math.sqrt(-disc)
        tau = math.atan2(a, (omega2 * u + zeta * a) / Omega) / Omega
        return tau if tau > 0.0 else tau + math.pi / Omega
    lambda1, lambda2, gap = roots(zeta, omega2, disc)
    fast = lambda1 * (a - lambda2 * u)
    if fast == 0.0:
        return -1.0
    g = a / fast
    if gap == 0.0:
        return -g
    if -gap * g <= -1.0:
        return -1.0
    return math.log1p(-gap * g) / gap


def oscillating_exit(
    free: FreeMotion, lo: float, hi: float, tau_max: float, touch: float, work: Work
) -> tuple[int, float]:
    """Return (side, tau) of `linear_exit` for complex roots: walk from extreme to extreme.

    Where u' = 0, abs(u) is the oscillation's size there times Omega/omega0, its sign that of the maximum or minimum.
    """
    w, a, u, zeta, omega2, disc = free
    Omega = math.sqrt(-disc)
    half = math.pi / Omega
    first = first_extreme(a, u, zeta, omega2, disc)
    v = u - w
    rise = (a + zeta * u) / Omega
    size = math.sqrt((u * u + rise * rise) * (1.0 - zeta * zeta / omega2))
    if a < 0.0 or (a == 0.0 and u > 0.0):
        size = -size  # the first extreme is a minimum
    i = 0
    for _i in range(70):
        start = max(0.0, first + (i - 1) * half)
        if start >= tau_max:
            return 0, tau_max
        extreme = first + i * half
        sign = 1.0 if i % 2 == 0 else -1.0
        peak = sign * size * math.exp(min(-zeta * extreme, LARGEST_EXPONENT)) if zeta != 0.0 else sign * size
        w_end = peak - v
        near = NEAR_EXTREME * (abs(peak) + v)
        if abs(w_end - hi) <= near or abs(w_end - lo) <= near:
            w_end = velocity(free, extreme)
        side = 0
        if w_end > hi:
            side = 1
        elif w_end < lo:
            side = -1
        if side != 0:
            level = hi if side > 0 else lo
            before = -peak * math.exp(min(zeta * half, LARGEST_EXPONENT)) if zeta != 0.0 else -peak
            share = (2.0 * (level + v) - before - peak) / (before - peak)
            guess = extreme - half + math.acos(min(1.0, max(-1.0, share))) / Omega
            if extreme > tau_max:
                w_end = velocity(free, tau_max)
                if lo <= w_end <= hi:
                    return 0, tau_max
                extreme = tau_max
            return side, root(free, level, side, start, extreme, guess, work)
        if extreme <= tau_max and touch > 0.0:
            if hi - w_end <= touch * abs(w_end + v):
                return 1, extreme
            if w_end - lo <= touch * abs(w_end + v):
                return -1, extreme
        i += 1
        if i == 3:
            if zeta >= 0.0 or peak == 0.0:
                return 0, tau_max
            scale = abs(size) * math.exp(min(-zeta * first, LARGEST_EXPONENT))
            least = math.inf
            if 0.0 < hi + v < math.inf:
                least = math.log((hi + v) / scale)
            if 0.0 < -(lo + v) < math.inf:
                least = min(least, math.log(-(lo + v) / scale))
            halves = least / (-zeta * half)
            if not halves * half <= tau_max:
                return 0, tau_max
            i = max(3, int(halves) - 2)
    return 0, tau_max


def creeping_exit(free: FreeMotion, lo: float, hi: float, tau_max: float, work: Work) -> tuple[int, float]:
    """Return (side, tau) of `linear_exit` for real roots: one extreme at most, then monotone for ever."""
    w, a, u, zeta, omega2, disc = free
    v = u - w
    start = 0.0
    w_start = w
    extreme = first_extreme(a, u, zeta, omega2, disc)
    if extreme > 0.0:
        end = min(extreme, tau_max)
        value = velocity(free, end)
        if value > hi:
            return 1, root(free, hi, 1, 0.0, end, -1.0, work)
        if value < lo:
            return -1, root(free, lo, -1, 0.0, end, -1.0, work)
        start = end
        w_start = value
    if start >= tau_max:
        return 0, tau_max
    lambda1, lambda2, gap = roots(zeta, omega2, disc)
    if zeta > 0.0:  # ends at u = 0
        if -v > hi:
            level = hi
        elif -v < lo:
            level = lo
        else:
            return 0, tau_max
    else:
        later = start + 1.0 / lambda1
        S, E, _ = fundamental(zeta, omega2, disc, later)
        level = hi if a * (1.0 - E - 2.0 * zeta * S) - omega2 * u * S > 0.0 else lo
        if math.isinf(level):
            return 0, tau_max
    side = 1 if level == hi else -1
    guess = start
    if start > 0.0 and (w_start - level) * (w_start + v) > 0.0:  # the parabola there, as u'' = -omega0^2 u
        guess += math.sqrt(2.0 * (w_start - level) / (omega2 * (w_start + v)))
    if zeta > 0.0 and abs(gap) > 1e-3 * zeta and not 0.0 < (guess - start) * abs(lambda1) < 1.0:
        # the slow root alone: exact once the fast one has died
        slow = (a - lambda1 * u) / -gap
        rest = (level - (a - lambda1 * w - lambda2 * v) / -gap) / slow if slow != 0.0 else -1.0
        if rest > -1.0:
            guess = math.log1p(rest) / lambda2
    if not guess > start:
        guess = start + 1.0 / abs(lambda1)
    tau = root(free, level, side, start, math.inf, guess, work)
    return (side, tau) if tau <= tau_max else (0, tau_max)


def stick_exit(fr: Frame, p: float, tau_max: float) -> tuple[int, float]:
    """Return (side, tau) of an undriven stick: +1 at the slip point p = 0, -1 (at once) below the other one."""
    if fr.k * p < -2.0 * fr.B:
        return -1, 0.0
    if p > 0.0:
        return 1, 0.0
    if fr.v > 0.0 and -p <= fr.v * tau_max:
        return 1, -p / fr.v
    return 0, tau_max


def stick_lateness(fr: Frame, p: float, rest: float, tau: float) -> float:
    """Return how much later than ``tau`` an undriven stick reaches the slip point from p + rest (s)."""
    return ((-p - fr.v * tau) - product_error(fr.v, tau) - rest) / fr.v


def product_error(a: float, b: float) -> float:
    """Return a b - fl(a b), exactly (Dekker)."""
    a_high = a * SPLITTER
    a_high -= a_high - a
    b_high = b * SPLITTER
    b_high -= b_high - b
    a_low = a - a_high
    b_low = b - b_high
    return ((a_high * b_high - a * b) + a_high * b_low + a_low * b_high) + a_low * b_low
