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

from rig_sim.integrate.bracket import newton_step
from rig_sim.integrate.modes import Frame

LARGEST_EXPONENT = 700.0  # exp stays finite; growth that far is beyond every edge


def fundamental(zeta: float, omega2: float, disc: float, tau: float) -> tuple[float, float, float]:
    """Return (S, E, I) at local time ``tau`` (s); ``disc`` = zeta^2 - omega0^2."""
    reach = (2.0 * abs(zeta) + math.sqrt(omega2)) * tau
    if reach < 0.5:  # by series: E and I keep their relative accuracy
        previous = 0.0
        term = tau
        S = tau
        I = 0.5 * tau * tau  # noqa: E741  # the integral's usual letter
        for j in range(2, 15):
            following = -(2.0 * zeta * tau * (j - 1) * term + omega2 * tau * tau * previous) / (j * (j - 1))
            previous = term
            term = following
            S += term
            I += term * tau / (j + 1)  # noqa: E741
        return S, omega2 * I, I
    if disc < 0.0:
        Omega = math.sqrt(-disc)
        decay = math.exp(min(-zeta * tau, LARGEST_EXPONENT))
        S = decay * math.sin(Omega * tau) / Omega
        half = math.sin(0.5 * Omega * tau)
        E = -math.expm1(min(-zeta * tau, LARGEST_EXPONENT)) + 2.0 * decay * half * half - zeta * S
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


def velocity(w: float, a: float, u: float, zeta: float, omega2: float, disc: float, tau: float) -> float:
    """Return w(tau) from the phase's start."""
    S, E, _ = fundamental(zeta, omega2, disc, tau)
    return w + a * S - u * E


def state(
    p: float, w: float, a: float, u: float, zeta: float, omega2: float, disc: float, tau: float
) -> tuple[float, float]:
    """Return (p, w) at ``tau`` from the phase's start."""
    S, E, I = fundamental(zeta, omega2, disc, tau)  # noqa: E741
    return p + u * (S + 2.0 * zeta * I) + a * I, w + a * S - u * E


def root(
    w: float,
    a: float,
    u: float,
    zeta: float,
    omega2: float,
    disc: float,
    level: float,
    inside: float,
    outside: float,
    guess: float,
) -> float:
    """Return where w crosses ``level`` in [inside, outside], on which it is monotone: bracketed Newton."""
    S, E, _ = fundamental(zeta, omega2, disc, outside)
    rising = w + a * S - u * E > level
    tau = guess if inside < guess < outside else 0.5 * (inside + outside)
    for _i in range(100):
        S, E, _ = fundamental(zeta, omega2, disc, tau)
        error = (w - level) + (a * S - u * E)
        if error == 0.0:
            return tau
        if (error > 0.0) == rising:
            outside = tau
        else:
            inside = tau
        slope = a * (1.0 - E - 2.0 * zeta * S) - omega2 * u * S
        tau, settled = newton_step(tau, error, slope, inside, outside)
        if settled:
            return tau
    return tau


def linear_exit(
    w: float,
    a: float,
    u: float,
    zeta: float,
    omega2: float,
    disc: float,
    lo: float,
    hi: float,
    tau_max: float,
    touch: float,
) -> tuple[int, float]:
    """Return (side, tau): the first exit of w from [lo, hi], side -1 or +1; (0, tau_max) when it stays inside.

    An extreme within ``touch`` x abs(u) (relative) of an edge counts as reaching it: grazing.
    """
    if w >= hi and (a > 0.0 or (a == 0.0 and u < 0.0)):
        return 1, 0.0
    if w <= lo and (a < 0.0 or (a == 0.0 and u > 0.0)):
        return -1, 0.0
    if a == 0.0 and u == 0.0:
        return 0, tau_max
    if disc < 0.0:
        return oscillating_exit(w, a, u, zeta, omega2, disc, lo, hi, tau_max, touch)
    return creeping_exit(w, a, u, zeta, omega2, disc, lo, hi, tau_max)


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
    w: float,
    a: float,
    u: float,
    zeta: float,
    omega2: float,
    disc: float,
    lo: float,
    hi: float,
    tau_max: float,
    touch: float,
) -> tuple[int, float]:
    """Return (side, tau) of `linear_exit` for complex roots: walk from extreme to extreme."""
    half = math.pi / math.sqrt(-disc)
    first = first_extreme(a, u, zeta, omega2, disc)
    v = u - w
    i = 0
    for _i in range(70):
        start = max(0.0, first + (i - 1) * half)
        if start >= tau_max:
            return 0, tau_max
        extreme = first + i * half
        end = min(extreme, tau_max)
        value = velocity(w, a, u, zeta, omega2, disc, end)
        if value > hi:
            return 1, root(w, a, u, zeta, omega2, disc, hi, start, end, -1.0)
        if value < lo:
            return -1, root(w, a, u, zeta, omega2, disc, lo, start, end, -1.0)
        if end == extreme and touch > 0.0:
            if hi - value <= touch * abs(value + v):
                return 1, end
            if value - lo <= touch * abs(value + v):
                return -1, end
        i += 1
        if i == 3:
            if zeta >= 0.0:
                return 0, tau_max
            size = abs(velocity(w, a, u, zeta, omega2, disc, first) + v)
            if size == 0.0:
                return 0, tau_max
            least = math.inf
            if 0.0 < hi + v < math.inf:
                least = math.log((hi + v) / size)
            if 0.0 < -(lo + v) < math.inf:
                least = min(least, math.log(-(lo + v) / size))
            halves = least / (-zeta * half)
            if not halves * half <= tau_max:
                return 0, tau_max
            i = max(3, int(halves) - 2)
    return 0, tau_max


def creeping_exit(
    w: float,
    a: float,
    u: float,
    zeta: float,
    omega2: float,
    disc: float,
    lo: float,
    hi: float,
    tau_max: float,
) -> tuple[int, float]:
    """Return (side, tau) of `linear_exit` for real roots: one extreme at most, then monotone for ever."""
    v = u - w
    start = 0.0
    extreme = first_extreme(a, u, zeta, omega2, disc)
    if extreme > 0.0:
        end = min(extreme, tau_max)
        value = velocity(w, a, u, zeta, omega2, disc, end)
        if value > hi:
            return 1, root(w, a, u, zeta, omega2, disc, hi, 0.0, end, -1.0)
        if value < lo:
            return -1, root(w, a, u, zeta, omega2, disc, lo, 0.0, end, -1.0)
        start = end
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
    # the slow root alone reaches the level at `guess`; exact once the fast one has died
    guess = 0.0
    if zeta > 0.0 and abs(gap) > 1e-3 * zeta:
        slow = (a - lambda1 * u) / -gap
        rest = (level - (a - lambda1 * w - lambda2 * v) / -gap) / slow if slow != 0.0 else -1.0
        if rest > -1.0:
            guess = math.log1p(rest) / lambda2
    step = max(guess - start, 0.0) * (1.0 + 1e-9)
    if step == 0.0:
        step = 1.0 / abs(lambda1)
    inside = start
    for _i in range(2100):
        outside = min(inside + step, tau_max)
        value = velocity(w, a, u, zeta, omega2, disc, outside)
        if (value > level) if side > 0 else (value < level):
            return side, root(w, a, u, zeta, omega2, disc, level, inside, outside, guess)
        if outside >= tau_max:
            return 0, tau_max
        inside = outside
        step *= 2.0
    return 0, tau_max


def stick_exit(fr: Frame, p: float, tau_max: float) -> tuple[int, float]:
    """Return (side, tau) of an undriven stick: +1 at the slip point p = 0, -1 (at once) below the other one."""
    if fr.k * p < -2.0 * fr.B:
        return -1, 0.0
    if p > 0.0:
        return 1, 0.0
    if fr.v > 0.0 and -p <= fr.v * tau_max:
        return 1, -p / fr.v
    return 0, tau_max
