"""The thesis's own method: classical Runge-Kutta of fourth order, with Henon's exchange of time and velocity at events.

Within a phase p and w advance by equal steps h of time.  When a step carries w past the edge of its mode it is taken
back, and one step of the same formulas with w as the independent variable,

    dt/dw = 1/w',     dp/dw = (w + v)/w',

lands exactly on the edge (thesis 2.2; M. Henon, Physica D 5, 412, 1982).  Stick needs no integration.  The next phase
starts from the event, so errors are those of the formulas: the event times converge as h^4.

Not seen: a visit across an edge and back within one step; grazing, where w' vanishes at the edge, loses the order.
"""

import math
from collections.abc import Callable

from rig_sim.integrate.driven import driven_stick_exit
from rig_sim.integrate.events import EventList
from rig_sim.integrate.hybrid import RAPID_ALLOWED, RAPID_TIME, seen
from rig_sim.integrate.linear import stick_exit
from rig_sim.integrate.modes import (
    COMPLETED,
    EVENT_RATE,
    FORCE_REVERSAL,
    KINDS,
    NOT_FINITE,
    OUTCOMES,
    STEP_LIMIT,
    STICK,
    Flow,
    Frame,
    classify,
    displacement,
    drive,
    drop,
    edges,
    frame,
    landing,
    line,
    position,
    validate,
)

HALVINGS = 60  # of a step whose end is outside while w' at its start points inwards

Slopes = Callable[[float, float, float], tuple[float, float]]


def rk4(slopes: Slopes, s: float, a: float, b: float, h: float) -> tuple[float, float]:
    """Return (a, b) after one classical step h of da/ds, db/ds = slopes(s, a, b)."""
    a1, b1 = slopes(s, a, b)
    a2, b2 = slopes(s + 0.5 * h, a + 0.5 * h * a1, b + 0.5 * h * b1)
    a3, b3 = slopes(s + 0.5 * h, a + 0.5 * h * a2, b + 0.5 * h * b2)
    a4, b4 = slopes(s + h, a + h * a3, b + h * b3)
    return a + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0, b + h * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0


def right_hand_side(fr: Frame, mode: int) -> Slopes:
    """Return dp/dt, dw/dt of a slip or ramp as a function of (t, p, w)."""
    C, e = line(fr, mode)

    def slopes(t: float, p: float, w: float) -> tuple[float, float]:
        return w + fr.v, (-C * w - fr.k * p + e + drop(fr, mode, w) + drive(fr, t)) / fr.m

    return slopes


def to_the_edge(slopes: Slopes, t: float, p: float, w: float, edge: float) -> tuple[float, float]:
    """Return (t, p) where w reaches ``edge``: one step with w as the independent variable."""

    def exchanged(w: float, t: float, p: float) -> tuple[float, float]:
        p_slope, w_slope = slopes(t, p, w)
        return 1.0 / w_slope, p_slope / w_slope

    return rk4(exchanged, w, t, p, edge - w)


def slide(fr: Frame, mode: int, t: float, p: float, w: float, h: float) -> tuple[int, float, float, float]:
    """Return (side, t, p, w) after a step h, or at the edge (side -1, +1) when w passes one on the way."""
    slopes = right_hand_side(fr, mode)
    lo, hi = edges(fr, mode)
    for _i in range(HALVINGS):
        p_end, w_end = rk4(slopes, t, p, w, h)
        if lo <= w_end <= hi:
            return 0, t + h, p_end, w_end
        side, edge = (1, hi) if w_end > hi else (-1, lo)
        if w == edge or side * slopes(t, p, w)[1] > 0.0:
            break
        h *= 0.5
    if w == edge:  # left at once
        return side, t, p, w
    t_edge, p_edge = to_the_edge(slopes, t, p, w, edge)
    return side, t_edge, p_edge, edge


def list_events(
    flow: Flow, x: float, v: float, t_max: float, *, step: float, t: float = 0.0, max_steps: int = 10_000_000
) -> EventList:
    """Return the events between t and t_max (s) of a motion that starts at x (m) with velocity v (m/s).

    Parameters
    ----------
    flow, x, v, t_max, t
        As for `rig_sim.integrate.events.list_events`.
    step : float
        h, s.
    max_steps : int
        Steps after which the run ends with the outcome 'step limit'.

    Raises
    ------
    ValueError
        For a flow that is not physical, or a step that is not positive.
    """
    validate(flow)
    if not (math.isfinite(step) and step > 0.0):
        raise ValueError(f"step is {step}; need a positive number")
    fr = frame(flow)
    p, w = displacement(fr, x), fr.mirror * (v - flow.v_belt)
    mode = classify(fr, p, w, t)
    found: list[tuple[float, float, str]] = []
    steps = rapid = 0
    outcome = COMPLETED
    t_before = t
    while t < t_max:
        if steps >= max_steps:
            outcome = STEP_LIMIT
            break
        steps += 1
        side, t_end, p, w = advance(fr, mode, t, p, w, min(step, t_max - t), t_max)
        if not math.isfinite(t_end + p + w):
            outcome = NOT_FINITE
            break
        t = t_end
        if side == 0 or t > t_max:
            continue
        entered = landing(fr, mode, side, p, t)
        if entered == FORCE_REVERSAL:
            outcome = FORCE_REVERSAL
            break
        found.append((t, position(fr, p), KINDS[seen(fr, 4 * mode + entered)]))
        mode = entered
        rapid = rapid + 1 if t - t_before <= RAPID_TIME / math.sqrt(fr.omega2) else 0
        t_before = t
        if rapid > RAPID_ALLOWED:
            outcome = EVENT_RATE
            break
    name, advice = OUTCOMES[outcome]
    times, places, kinds = zip(*found, strict=True) if found else ((), (), ())
    return EventList(times, places, kinds, name, advice, steps)


def advance(
    fr: Frame, mode: int, t: float, p: float, w: float, h: float, t_max: float
) -> tuple[int, float, float, float]:
    """Return (side, t, p, w) after one step h of a slip or ramp, or at the end of the whole stick."""
    if mode != STICK:
        return slide(fr, mode, t, p, w, h)
    return through_stick(fr, t, p, t_max)


def through_stick(fr: Frame, t: float, p: float, t_max: float) -> tuple[int, float, float, float]:
    """Return (side, t, p, w) at the end of a stick, or at t_max with side 0: closed form, as for the exact method."""
    rest = t_max - t
    side, tau = driven_stick_exit(fr, p, t, rest) if fr.u0 != 0.0 else stick_exit(fr, p, rest)
    return side, t + tau, p + fr.v * tau, 0.0
