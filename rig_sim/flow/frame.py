"""Frame: the coordinates the kernels work in, and the equation of motion written in them."""

import math
from typing import NamedTuple

from rig_sim.flow import modes
from rig_sim.flow.flow import Flow
from rig_sim.friction.curve import CONSTANT, HYPERBOLIC, LINEAR, MEASURED, reversal_speed
from rig_sim.friction.spline import Table, about, piece_of, steepest_fall_between


class Frame(NamedTuple):
    """A Flow in the form of the kernels: belt forwards, slip point and levels computed, the curve simplified."""

    mirror: float  # -1 when the belt runs backwards (x, velocities, drive and modes are mirrored), else 1
    x0: float
    slip: float  # x_slip - x0, m, mirrored
    m: float
    k: float
    c: float
    v: float
    curve: int
    A: float  # kinetic friction level, N
    B: float  # break-away friction level, N
    G: float  # slope of the linear curve with the scatter, N s/m
    gamma: float
    d: float  # m/s; 0 for a jump
    s_max: float  # relative speed of force reversal, or where the curve ends, m/s
    u0: float
    omega: float
    phase: float
    omega2: float  # k/m, 1/s^2
    omega0: float  # sqrt(k/m), 1/s
    lag: float  # droop gamma on the hyperbola, else 0
    pieces: int  # of a curve of cubics, with its table
    table: Table


def frame(flow: Flow) -> Frame:
    mirror = -1.0 if flow.v_belt < 0.0 else 1.0
    v = abs(flow.v_belt)
    A = flow.factor * flow.Fs
    B = flow.static * A
    G = flow.factor * flow.G_slip
    d = flow.d if flow.ramp == 1 else 0.0
    curve = flow.curve
    if curve == LINEAR and G == 0.0:
        curve = CONSTANT
    elif curve == HYPERBOLIC and (A == 0.0 or flow.gamma == 0.0):
        curve = CONSTANT
    reversal = reversal_speed(curve, A, G)
    if curve == MEASURED:
        reversal = min(flow.table[5 * flow.pieces], flow.table[5 * flow.pieces + 1])
    lag = 0.0
    if flow.droop > 0.0:
        d += flow.droop
        if curve == LINEAR:
            G /= 1.0 - flow.droop * flow.G_slip / flow.Fs
        elif curve == HYPERBOLIC:
            lag = flow.droop * flow.gamma
    return Frame(
        mirror,
        flow.x0,
        (B - flow.c * v) / flow.k,
        flow.m,
        flow.k,
        flow.c,
        v,
        curve,
        A,
        B,
        G,
        flow.gamma,
        d,
        d + reversal,
        mirror * flow.u0,
        flow.omega,
        flow.phase,
        flow.k / flow.m,
        math.sqrt(flow.k / flow.m),
        lag,
        flow.pieces,
        flow.table,
    )


def displacement(fr: Frame, x: float) -> float:
    """Return p, the mirrored displacement from the slip point (m)."""
    return fr.mirror * (x - fr.x0) - fr.slip


def position(fr: Frame, p: float) -> float:
    """Return x (m) from the displacement p."""
    return fr.x0 + fr.mirror * (fr.slip + p)


def mirror_mode(fr: Frame, mode: int) -> int:
    """Exchange NEGATIVE and POSITIVE when the frame is mirrored; its own inverse."""
    if fr.mirror < 0.0 and (mode == modes.NEGATIVE or mode == modes.POSITIVE):
        return modes.NEGATIVE + modes.POSITIVE - mode
    return mode


def drive(fr: Frame, t: float) -> float:
    """Return the driving force at time t (N, mirrored)."""
    if fr.u0 == 0.0:
        return 0.0
    return fr.u0 * math.cos(fr.omega * t + fr.phase)


def linear_terms(fr: Frame, mode: int) -> tuple[float, float]:
    """Return (C, e), N s/m and N, of m w' = -C w - k p + e + D + drive in a slip or ramp; D: see `curve_deficit`.

    The linear curve and the ramp are part of C; e is what remains at w = 0, relative to the slip point.
    """
    if mode == modes.RAMP:
        return fr.c + fr.B / fr.d, -fr.B
    sign = 1.0 if mode == modes.NEGATIVE else -1.0
    e = sign * fr.A - fr.B
    if fr.curve == LINEAR:
        return fr.c - fr.G, e + sign * fr.G * fr.d
    return fr.c, e


def slip_speed(fr: Frame, r: float) -> float:
    """Return the slip speed s on a compliant belt from r = s - lag s/(1 + gamma s), the speed beyond the edge (m/s)."""
    # gamma s^2 + (1 - lag - gamma r) s - r = 0, by the root formula that does not cancel
    linear = 1.0 - fr.lag - fr.gamma * r
    # negative only far before the edge, where a trial step of a general solver may go
    root = math.sqrt(max(0.0, linear * linear + 4.0 * fr.gamma * r))
    return 2.0 * r / (root + linear) if linear > 0.0 else (root - linear) / (2.0 * fr.gamma)


def is_curved(fr: Frame, mode: int) -> bool:
    """Return whether friction is not linear in w in this mode: slip on the hyperbola or on a measured curve."""
    return (fr.curve == HYPERBOLIC or fr.curve == MEASURED) and mode != modes.RAMP and mode != modes.STICK


def curve_deficit(fr: Frame, mode: int, w: float) -> float:
    """Return D (N): a curve that is not linear less its level at rest, with the sign of the force in slip; else 0."""
    if not is_curved(fr, mode):
        return 0.0
    s = -w - fr.d if mode == modes.NEGATIVE else w - fr.d
    if fr.curve == MEASURED:
        fall = fr.A * (about(fr.table, fr.pieces, piece_of(fr.table, fr.pieces, s), s)[0] - 1.0)
        return fall if mode == modes.NEGATIVE else -fall
    if fr.lag != 0.0:
        s = slip_speed(fr, s)
    fall = -fr.A * fr.gamma * s / (1.0 + fr.gamma * s)
    return fall if mode == modes.NEGATIVE else -fall


def friction_slope(fr: Frame, mode: int, w: float) -> float:
    """Return dF/dw (N s/m) at w in a slip or ramp: above 0 where friction falls with the slip speed."""
    slope = fr.c - linear_terms(fr, mode)[0]
    if not is_curved(fr, mode):
        return slope
    s = abs(w) - fr.d
    if fr.curve == MEASURED:
        return slope - fr.A * about(fr.table, fr.pieces, piece_of(fr.table, fr.pieces, s), s)[1]
    if fr.lag != 0.0:
        s = slip_speed(fr, s)
    q = 1.0 + fr.gamma * s
    return slope + fr.A * fr.gamma / (q * q - fr.lag)


def steepest_slope(fr: Frame, low: float, high: float) -> float:
    """Return the largest dF/dw (N s/m) of slip at relative speeds from low to high (m/s, beyond the contact's edge)."""
    if fr.curve == MEASURED:
        return fr.A * steepest_fall_between(fr.table, fr.pieces, max(low - fr.d, 0.0), max(high - fr.d, 0.0))
    # the hyperbola is steepest at its start; the other curves are straight
    return friction_slope(fr, modes.NEGATIVE, -max(low, fr.d))


def mode_bounds(fr: Frame, mode: int) -> tuple[float, float]:
    """Return the interval (lo, hi) of w, m/s, of a slip or ramp mode."""
    if mode == modes.NEGATIVE:
        return -fr.s_max, -fr.d
    if mode == modes.POSITIVE:
        return fr.d, fr.s_max
    return -fr.d, fr.d


def acceleration(fr: Frame, mode: int, p: float, w: float, t: float) -> float:
    """Return w' (m/s^2) in the given mode; on the mode's edge it never points out of the mode."""
    if mode == modes.STICK:
        return 0.0
    return keep_inside(fr, mode, w, free_acceleration(fr, mode, p, w, t))


def free_acceleration(fr: Frame, mode: int, p: float, w: float, t: float) -> float:
    """Return w' (m/s^2) by the equation of a slip or ramp, whichever way it points."""
    C, e = linear_terms(fr, mode)
    return (-C * w - fr.k * p + e + curve_deficit(fr, mode, w) + drive(fr, t)) / fr.m


def keep_inside(fr: Frame, mode: int, w: float, a: float) -> float:
    """Return the acceleration ``a``, or 0 where it would leave the mode from the mode's own edge."""
    lo, hi = mode_bounds(fr, mode)
    if w == hi and mode != modes.POSITIVE:
        return min(a, 0.0)
    if w == lo and mode != modes.NEGATIVE:
        return max(a, 0.0)
    return a
