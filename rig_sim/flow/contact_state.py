"""The contact of a state: which mode it is in, which mode follows at an edge, and the force there."""

from rig_sim.flow import modes
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import Frame, curve_deficit, displacement, drive, frame, linear_terms, mirror_mode
from rig_sim.friction.curve import MEASURED


def classify(fr: Frame, p: float, w: float, t: float) -> int:
    """Return the mode of the state (p m, w m/s) at time t (s) in the frame."""
    if fr.d > 0.0:
        if w < -fr.d:
            return modes.NEGATIVE
        if w > fr.d:
            return modes.POSITIVE
        if abs(w) < fr.d:
            return modes.RAMP
        C, e = linear_terms(fr, modes.RAMP)
        a = -C * w - fr.k * p + e + drive(fr, t)
        turn = -fr.k * (w + fr.v)  # m w'' on an undriven edge where w' = 0
        if w < 0.0:
            return modes.NEGATIVE if a < 0.0 or (a == 0.0 and turn < 0.0) else modes.RAMP
        return modes.POSITIVE if a > 0.0 or (a == 0.0 and turn > 0.0) else modes.RAMP
    if w < 0.0:
        return modes.NEGATIVE
    if w > 0.0:
        return modes.POSITIVE
    excess = fr.k * p - drive(fr, t)  # L - B
    if excess > 0.0:
        return modes.NEGATIVE
    if excess < -2.0 * fr.B:
        return modes.POSITIVE
    return modes.STICK


def transition(fr: Frame, mode: int, side: int, p: float, t: float) -> int:
    """Return the mode entered, or the outcome, when w leaves ``mode`` at its lower (-1) or upper (+1) edge."""
    if mode == modes.RAMP:
        return modes.NEGATIVE if side < 0 else modes.POSITIVE
    if mode == modes.STICK:
        return modes.NEGATIVE if side > 0 else modes.POSITIVE
    if (mode == modes.NEGATIVE) != (side > 0):
        if fr.curve == MEASURED and fr.table[5 * fr.pieces + 1] < fr.table[5 * fr.pieces]:
            return modes.CURVE_END
        return modes.FORCE_REVERSAL
    if fr.d > 0.0:
        return modes.RAMP
    excess = fr.k * p - drive(fr, t)
    if mode == modes.NEGATIVE:
        return modes.POSITIVE if excess < -2.0 * fr.B else modes.STICK
    return modes.NEGATIVE if excess > 0.0 else modes.STICK


def initial_mode(flow: Flow, x: float, v: float, t: float) -> int:
    """Return the mode of the state (x m, v m/s absolute velocity) at time t (s).

    A jump law sticks where v equals the belt's velocity exactly and the load is within the break-away level; on the
    slip point itself it sticks for zero time.
    """
    fr = frame(flow)
    return mirror_mode(fr, classify(fr, displacement(fr, x), fr.mirror * (v - flow.v_belt), t))


def force(flow: Flow, mode: int, x: float, w: float, t: float) -> float:
    """Return the friction force on the mass (N, along x) in the given mode; in stick the force that holds it."""
    fr = frame(flow)
    p = displacement(fr, x)
    frame_mode = mirror_mode(fr, mode)
    if frame_mode == modes.STICK:
        return fr.mirror * (fr.B + fr.k * p - drive(fr, t))
    sliding = fr.mirror * w
    C, e = linear_terms(fr, frame_mode)
    # m w' = -c v - k x + F + drive: F is what the two terms add to -c w, relative to the slip point's B
    return fr.mirror * (-(C - fr.c) * sliding + e + fr.B + curve_deficit(fr, frame_mode, sliding))
