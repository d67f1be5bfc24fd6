"""Driven phases in closed form: stick, and the steep ramp, in which a Taylor series would need very short steps.

Drive u0 cos(omega t + phase).  In stick the load's margin g = k p - drive (between -2B and 0) is monotone between
extremes known in closed form, and rises by k v T per period, so the right period is computed, not searched.  In an
overdamped ramp the answer is the undriven solution plus Re(W e^{i omega tau}); events are searched with a bound on w''
that falls as the fast root dies.
"""

import math
from typing import NamedTuple

from rig_sim.flow.frame import Frame, acceleration, linear_terms
from rig_sim.flow.modes import RAMP
from rig_sim.integrate.linear import LARGEST_EXPONENT, fundamental, roots
from rig_sim.integrate.newton import EPS, polish_step

PIECES = 500  # searched in one step of a driven ramp; the caller continues from there
STEEP = 4.0  # ratio of the ramp's fast root to the other rates above which the closed form is the cheaper one


def is_steep(fr: Frame, mode: int) -> bool:
    """Return whether a driven ramp is solved in closed form."""
    if mode != RAMP:
        return False
    C, _ = linear_terms(fr, mode)
    return C / fr.m > STEEP * (fr.omega0 + abs(fr.omega))


class DrivenRamp(NamedTuple):
    """A driven ramp from its start: the undriven part u, a and the driven part Re(W e^{i omega tau}), both of x'."""

    p: float  # displacement at the start, m
    w: float  # relative velocity there, m/s
    start_a: float  # w' there, m/s^2
    zeta: float  # C/2m, 1/s
    omega2: float
    disc: float  # zeta^2 - omega0^2
    u: float
    a: float
    W_re: float
    W_im: float
    omega: float


def driven_ramp(fr: Frame, p: float, w: float, t: float) -> DrivenRamp:
    C, _ = linear_terms(fr, RAMP)
    zeta = 0.5 * C / fr.m
    a = acceleration(fr, RAMP, p, w, t)
    theta = fr.omega * t + fr.phase
    # (omega0^2 - omega^2 + 2 i zeta omega) W = i omega (u0/m) e^{i theta}
    re = fr.omega2 - fr.omega * fr.omega
    im = 2.0 * zeta * fr.omega
    size = fr.u0 / fr.m * fr.omega
    below = re * re + im * im
    top_re = -size * math.sin(theta)
    top_im = size * math.cos(theta)
    W_re = (top_re * re + top_im * im) / below
    W_im = (top_im * re - top_re * im) / below
    disc = zeta * zeta - fr.omega2
    return DrivenRamp(p, w, a, zeta, fr.omega2, disc, w + fr.v - W_re, a + fr.omega * W_im, W_re, W_im, fr.omega)


def ramp_state(ramp: DrivenRamp, tau: float) -> tuple[float, float, float]:
    """Return (p, w, w') of a driven ramp at local time tau."""
    p, w, _, zeta, omega2, disc, u, a, W_re, W_im, omega = ramp
    S, E, I = fundamental(zeta, omega2, disc, tau)  # noqa: E741
    sine = math.sin(omega * tau)
    half = math.sin(0.5 * omega * tau)
    fall = -2.0 * half * half  # cos - 1
    p_end = p + u * (S + 2.0 * zeta * I) + a * I
    if omega != 0.0:
        p_end += (W_re * sine + W_im * fall) / omega
    w_end = w + a * S - u * E + (W_re * fall - W_im * sine)
    a_end = a * (1.0 - E - 2.0 * zeta * S) - omega2 * u * S
    a_end -= omega * (W_re * sine + W_im * (1.0 + fall))
    return p_end, w_end, a_end


def ramp_exit(fr: Frame, p: float, w: float, t: float, lo: float, hi: float, tau_max: float) -> tuple[int, float]:
    """Return (side, tau): the first exit of w from [lo, hi] in a driven ramp, (0, tau reached) when there is none."""
    ramp = driven_ramp(fr, p, w, t)
    u, a, omega, start_a = ramp.u, ramp.a, ramp.omega, ramp.start_a
    lambda1, lambda2, gap = roots(ramp.zeta, ramp.omega2, ramp.disc)
    fast = abs((a - lambda2 * u) / gap) * lambda1 * lambda1
    slow = abs((a - lambda1 * u) / gap) * lambda2 * lambda2
    swing = math.hypot(ramp.W_re, ramp.W_im) * omega * omega
    if w >= hi and start_a > 0.0:
        return 1, 0.0
    if w <= lo and start_a < 0.0:
        return -1, 0.0
    start = 0.0
    value = w
    shortest = 1e-9 / abs(lambda1)
    step = min(tau_max, 1.0 / abs(lambda1))
    for _i in range(PIECES):
        if start >= tau_max:
            return 0, tau_max
        end = min(start + step, tau_max)
        h = end - start
        bound = fast * math.exp(max(lambda1 * start, -LARGEST_EXPONENT)) + slow + swing
        _, after, slope = ramp_state(ramp, end)
        sag = 0.125 * bound * h * h
        inside = lo < after < hi
        if inside and max(value, after) + sag < hi and min(value, after) - sag > lo:
            start = end
            value = after
            step = 2.0 * h
        elif abs(slope) > bound * h or h <= max(shortest, 4.0 * EPS * end):  # monotone
            if after >= hi:
                return 1, ramp_root(ramp, hi, 1, start, end)
            if after <= lo:
                return -1, ramp_root(ramp, lo, -1, start, end)
            start = end
            value = after
            step = 2.0 * h
        else:
            step = 0.5 * h
    return 0, start


def ramp_root(ramp: DrivenRamp, level: float, side: int, inside: float, outside: float) -> float:
    """Return where w crosses ``level`` between ``inside`` and ``outside``: Newton kept in its bracket."""
    tau = 0.5 * (inside + outside)
    for _i in range(100):
        _, value, slope = ramp_state(ramp, tau)
        tau, settled, inside, outside = polish_step(tau, value - level, slope, side, inside, outside)
        if settled:
            return tau
    return tau


class StickLoad(NamedTuple):
    """The terms of a driven stick's margin k (p + v tau) - size cos(theta + omega tau), from the stick's start."""

    k: float
    v: float
    p: float
    size: float
    omega: float
    theta: float


def margin(load: StickLoad, tau: float) -> float:
    """Return g = k p - drive (N) at local time ``tau`` (s) within a stick."""
    return load.k * (load.p + load.v * tau) - load.size * math.cos(load.theta + load.omega * tau)


def margin_root(load: StickLoad, level: float, side: int, inside: float, outside: float) -> float:
    """Return where the margin crosses ``level`` on a monotone piece: Newton kept in its bracket."""
    tau = 0.5 * (inside + outside)
    for _i in range(100):
        error = margin(load, tau) - level
        slope = load.k * load.v + load.size * load.omega * math.sin(load.theta + load.omega * tau)
        tau, settled, inside, outside = polish_step(tau, error, slope, side, inside, outside)
        if settled:
            return tau
    return tau


def driven_stick_exit(fr: Frame, p: float, t: float, tau_max: float) -> tuple[int, float]:
    """Return (side, tau): where the margin of a driven stick rises above 0 (+1) or falls below -2B (-1)."""
    size = abs(fr.u0)
    omega = abs(fr.omega)
    theta = fr.omega * t + fr.phase
    if fr.omega < 0.0:
        theta = -theta
    if fr.u0 < 0.0:
        theta += math.pi
    load = StickLoad(fr.k, fr.v, p, size, omega, theta)
    floor = -2.0 * fr.B
    rise = fr.k * fr.v
    start = margin(load, 0.0)
    slope = rise + size * omega * math.sin(theta)
    if start < floor or (start == floor and slope < 0.0):
        return -1, 0.0
    rounding = 8.0 * EPS * (fr.B + size)
    if start > rounding or (start >= 0.0 and slope > 0.0):
        return 1, 0.0
    if size * omega <= rise:  # the belt always wins: monotone
        if fr.v == 0.0:
            return 0, tau_max
        end = max((size / fr.k - p) / fr.v * (1.0 + 4.0 * EPS), 0.0) + 4.0 * EPS * size / rise
        tau = margin_root(load, 0.0, 1, 0.0, end)
        return (1, tau) if tau <= tau_max else (0, tau_max)
    period = 2.0 * math.pi / omega
    tilt = math.asin(rise / (size * omega))
    highest = (math.pi + tilt - theta) / omega
    highest -= math.floor(highest / period) * period  # first maximum, in [0, period)
    lowest = (-tilt - theta) / omega
    lowest -= math.floor(lowest / period) * period
    falling = (math.pi - 2.0 * tilt) / omega
    climb = period - falling
    # the first maximum, when the margin rises at first
    top = margin(load, highest)
    if highest < lowest and top > 0.0:
        tau = margin_root(load, 0.0, 1, 0.0, highest)
        return (1, tau) if tau <= tau_max else (0, tau_max)
    # the lower edge is met before the first minimum or never: the minima rise
    if margin(load, lowest) < floor:
        tau = margin_root(load, floor, -1, max(0.0, lowest - falling), lowest)
        return (-1, tau) if tau <= tau_max else (0, tau_max)
    if rise == 0.0:
        if top <= 0.0:
            return 0, tau_max
        turns = 0.0
    else:
        turns = max(0.0, math.ceil(-top / (rise * period)) - 1.0)
    for _i in range(4):
        peak = highest + turns * period
        if margin(load, peak) > 0.0:
            if peak - climb > tau_max:
                return 0, tau_max
            tau = margin_root(load, 0.0, 1, max(0.0, peak - climb), peak)
            return (1, tau) if tau <= tau_max else (0, tau_max)
        turns += 1.0
    return 0, min(tau_max, highest + turns * period)
