"""The variational equation of one mass, exact through stick, slip and ramp, and its jumps at events.

A deviation (dp, dw) of displacement (m) and relative velocity (m/s), at a fixed time, obeys within a phase

    dp' = dw,     m dw' = -(c - F'(w)) dw - k dp      (stick: dp' = 0, dw = 0)

and at an event, where the deviating motion changes its phase a little earlier or later,

    slip to stick           dw = 0: the deviating mass then lies beside the other one on the belt
    stick to slip           dw = w'_after k dp/g', with g' the rate at which the load's margin g = k p - drive grows:
                            0 but for friction that drops at break-away (static above 1)
    between other phases    dw is multiplied by w'_after/w'_before

(saltation).  dp never jumps: the velocity does not.  So after a stick one number is left of a deviation, and the motion
is a map of one number, the landing's phase; ramps, and masses that never stick, keep both.
"""

import math

from rig_sim.flow import modes
from rig_sim.flow.frame import Frame, free_acceleration, friction_slope, linear_terms
from rig_sim.friction.curve import CONSTANT, LINEAR
from rig_sim.integrate.linear import fundamental
from rig_sim.integrate.phases import increments
from rig_sim.integrate.work import Work

# Gauss-Legendre collocation with three stages, order 6, on pieces of a Taylor step.  A Taylor step ends at about a
# quarter of the series' radius of convergence; with a piece at most `PIECE` of the phase's own unit of time the
# exponent per landing is right to 1e-9 (half as long pieces: 64 times less error, 1.5 times the time).
ROOT15 = math.sqrt(15.0)
NODE1, NODE2, NODE3 = 0.5 - ROOT15 / 10.0, 0.5, 0.5 + ROOT15 / 10.0
PIECE = 0.125
ITERATIONS = 40  # iterations of the stages, which converge by a factor of 20 each


def deviation(
    fr: Frame, mode: int, p: float, w: float, t: float, tau: float, dp: float, dw: float, work: Work
) -> tuple[float, float]:
    """Return (dp, dw) after a step of ``tau`` (s) that `phase_exit` has just made from (p, w) at time t."""
    if mode == modes.STICK:
        return dp, 0.0
    if mode == modes.RAMP or fr.curve == CONSTANT or fr.curve == LINEAR:
        C, _ = linear_terms(fr, mode)
        zeta = 0.5 * C / fr.m
        S, E, I = fundamental(zeta, fr.omega2, (zeta - fr.omega0) * (zeta + fr.omega0), tau)  # noqa: E741
        a = -2.0 * zeta * dw - fr.omega2 * dp
        return dp + dw * (S + 2.0 * zeta * I) + a * I, dw + a * S - dw * E
    pieces = math.ceil(tau / (PIECE * work.time_scale))
    h = tau / pieces
    for i in range(pieces):
        start = i * h
        r1 = damping(fr, mode, p, w, t, start + NODE1 * h, work)
        r2 = damping(fr, mode, p, w, t, start + NODE2 * h, work)
        r3 = damping(fr, mode, p, w, t, start + NODE3 * h, work)
        dp, dw = step_by_collocation(fr.omega2, r1, r2, r3, h, dp, dw)
    return dp, dw


def damping(fr: Frame, mode: int, p: float, w: float, t: float, tau: float, work: Work) -> float:
    """Return (c - F'(w))/m at local time ``tau`` of the step in ``work``."""
    _, dw = increments(fr, mode, p, w, t, tau, work)
    return (fr.c - friction_slope(fr, mode, w + dw)) / fr.m


def step_by_collocation(
    omega2: float, r1: float, r2: float, r3: float, h: float, dp: float, dw: float
) -> tuple[float, float]:
    """Return (dp, dw) a piece ``h`` later, with the dampings ``r1``, ``r2``, ``r3`` at the nodes."""
    v1 = v2 = v3 = dw
    a1 = -r1 * dw - omega2 * dp
    a2 = -r2 * dw - omega2 * dp
    a3 = -r3 * dw - omega2 * dp
    for _i in range(ITERATIONS):
        before = a1 + a2 + a3
        x1 = dp + h * (5.0 / 36.0 * v1 + (2.0 / 9.0 - ROOT15 / 15.0) * v2 + (5.0 / 36.0 - ROOT15 / 30.0) * v3)
        x2 = dp + h * ((5.0 / 36.0 + ROOT15 / 24.0) * v1 + 2.0 / 9.0 * v2 + (5.0 / 36.0 - ROOT15 / 24.0) * v3)
        x3 = dp + h * ((5.0 / 36.0 + ROOT15 / 30.0) * v1 + (2.0 / 9.0 + ROOT15 / 15.0) * v2 + 5.0 / 36.0 * v3)
        v1 = dw + h * (5.0 / 36.0 * a1 + (2.0 / 9.0 - ROOT15 / 15.0) * a2 + (5.0 / 36.0 - ROOT15 / 30.0) * a3)
        v2 = dw + h * ((5.0 / 36.0 + ROOT15 / 24.0) * a1 + 2.0 / 9.0 * a2 + (5.0 / 36.0 - ROOT15 / 24.0) * a3)
        v3 = dw + h * ((5.0 / 36.0 + ROOT15 / 30.0) * a1 + (2.0 / 9.0 + ROOT15 / 15.0) * a2 + 5.0 / 36.0 * a3)
        a1 = -r1 * v1 - omega2 * x1
        a2 = -r2 * v2 - omega2 * x2
        a3 = -r3 * v3 - omega2 * x3
        if abs(a1 + a2 + a3 - before) <= 1e-15 * (abs(a1) + abs(a2) + abs(a3)):
            break
    return dp + h * (5.0 * v1 + 8.0 * v2 + 5.0 * v3) / 18.0, dw + h * (5.0 * a1 + 8.0 * a2 + 5.0 * a3) / 18.0


def after_event(
    fr: Frame, mode: int, entered: int, side: int, p: float, w: float, t: float, dp: float, dw: float
) -> float:
    """Return dw after the event in which ``mode`` was left at its lower (-1) or upper (+1) edge."""
    if entered == modes.STICK:
        return 0.0
    if mode == modes.STICK:
        after = side * (fr.A - fr.B) / fr.m
        if after == 0.0:
            return 0.0
        return after * fr.k * dp / (fr.k * fr.v + fr.u0 * fr.omega * math.sin(fr.omega * t + fr.phase))
    before = free_acceleration(fr, mode, p, w, t)
    after = free_acceleration(fr, entered, p, w, t)
    return dw if after == before else dw * (after / before)
