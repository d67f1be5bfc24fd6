"""The loop over phases for methods that step numerically: thesis's Runge-Kutta and scipy's solvers, for comparison.

What ends a phase, which mode follows and how a run ends are the exact method's own rules (`rig_sim.integrate.modes`,
and `rig_sim.integrate.phases.phase`, whose signature `sample_phase` has); stick is in closed form too.  A method adds
its way through one slip or ramp: a `Way`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from rig_sim.integrate import buffer, modes
from rig_sim.integrate.buffer import Buffer, new_work
from rig_sim.integrate.contact_state import initial_mode, transition
from rig_sim.integrate.driven import driven_stick_exit
from rig_sim.integrate.events import EventList
from rig_sim.integrate.flow import Flow, validate
from rig_sim.integrate.frame import Frame, curve_deficit, displacement, drive, frame, linear_terms, mirrored, position
from rig_sim.integrate.linear import stick_exit
from rig_sim.integrate.phases import RAPID_ALLOWED, RAPID_TIME, unmirrored_kind

Slopes = Callable[[float, float, float], tuple[float, float]]


class Leg(NamedTuple):
    """The way through a phase, or through as much of it as the steps allowed.

    ``end`` is COMPLETED or STEP_LIMIT; ``side`` -1, +1 at the phase's lower, upper edge, 0 elsewhere; then the state
    there; ``at`` gives (p, w) at any time from the phase's start to t.
    """

    end: int
    side: int
    t: float
    p: float
    w: float
    at: Callable[[float], tuple[float, float]]


Way = Callable[[Frame, int, float, float, float, float, Buffer], Leg]  # of frame, mode, t, p, w, t_max, work


def right_hand_side(fr: Frame, mode: int) -> Slopes:
    """Return dp/dt, dw/dt of a slip or ramp as a function of (t, p, w)."""
    C, e = linear_terms(fr, mode)

    def slopes(t: float, p: float, w: float) -> tuple[float, float]:
        return w + fr.v, (-C * w - fr.k * p + e + curve_deficit(fr, mode, w) + drive(fr, t)) / fr.m

    return slopes


def through_stick(fr: Frame, t: float, p: float, t_max: float, work: Buffer) -> Leg:
    """Return the way through a stick: closed form, as for the exact method."""
    work[buffer.STEPS] += 1.0
    rest = t_max - t
    side, tau = driven_stick_exit(fr, p, t, rest) if fr.u0 != 0.0 else stick_exit(fr, p, rest)
    t_end = t_max if side == 0 and tau >= rest else t + tau
    return Leg(modes.COMPLETED, side, t_end, p + fr.v * tau, 0.0, lambda t_at: (p + fr.v * (t_at - t), 0.0))


def phase(
    way: Way,
    fr: Frame,
    mode: int,
    p: float,
    w: float,
    t: float,
    t_max: float,
    times: Buffer,
    i: int,
    n: int,
    out_x: Buffer,
    out_v: Buffer,
    out_mode: Buffer,
    work: Buffer,
) -> tuple[int, int, float, float, float, int]:
    """Go to the next event or to t_max within the frame; return (kind, mode, p, w, t, i).

    Results are stored for times[i], times[i + 1] ... up to there.
    """
    begun = t
    while True:
        if not math.isfinite(p + w + t_max - t):
            return modes.NOT_FINITE, mode, p, w, t, i
        if t < t_max:
            if work[buffer.STEPS] >= work[buffer.STEPS_ALLOWED]:
                return modes.STEP_LIMIT, mode, p, w, t, i
            go = through_stick(fr, t, p, t_max, work) if mode == modes.STICK else way(fr, mode, t, p, w, t_max, work)
            if not math.isfinite(go.t + go.p + go.w):
                return modes.NOT_FINITE, mode, p, w, t, i
        else:
            go = Leg(modes.COMPLETED, 0, t, p, w, lambda _, here=(p, w): here)  # type: ignore[misc]
        while i < n and times[i] <= go.t:
            p_at, w_at = (p, w) if times[i] <= t else go.at(times[i])
            out_x[i] = position(fr, p_at)
            out_v[i] = fr.mirror * (w_at + fr.v)
            out_mode[i] = float(mirrored(fr, mode))
            i += 1
        p, w, t = go.p, go.w, go.t
        if go.end != modes.COMPLETED:
            return go.end, mode, p, w, t, i
        if go.side == 0:
            if t >= t_max:
                work[buffer.RAPID] = 0.0
                return modes.COMPLETED, mode, p, w, t, i
            continue
        entered = transition(fr, mode, go.side, p, t)
        if entered == modes.FORCE_REVERSAL:
            return modes.FORCE_REVERSAL, mode, p, w, t, i
        work[buffer.RAPID] = work[buffer.RAPID] + 1.0 if (t - begun) * fr.omega0 <= RAPID_TIME else 0.0
        if work[buffer.RAPID] > RAPID_ALLOWED:
            return modes.EVENT_RATE, entered, p, w, t, i
        return 4 * mode + entered, entered, p, w, t, i


def sample_phase(
    way: Way,
    flow: Flow,
    mode: int,
    x: float,
    w: float,
    t: float,
    times: Buffer,
    i: int,
    n: int,
    t_max: float,
    out_x: Buffer,
    out_v: Buffer,
    out_mode: Buffer,
    work: Buffer,
) -> tuple[int, int, float, float, float, int]:
    """Go to the next event, or to t_max, storing the motion at times[i:n]: as `rig_sim.integrate.phases.sample_phase`.

    Parameters
    ----------
    way : Way
        The method.
    flow, mode, x, w, t, times, i, n, t_max, out_x, out_v, out_mode, work
        As there; ``work`` counts the method's steps, or its evaluations of the right-hand side.

    Returns
    -------
    (kind, mode, x, w, t, i)
        As there.
    """
    fr = frame(flow)
    kind, own, p, w, t, i = phase(
        way,
        fr,
        mirrored(fr, mode),
        displacement(fr, x),
        fr.mirror * w,
        t,
        t_max,
        times,
        i,
        n,
        out_x,
        out_v,
        out_mode,
        work,
    )
    return unmirrored_kind(fr, kind), mirrored(fr, own), position(fr, p), fr.mirror * w, t, i


def list_events(
    way: Way, flow: Flow, x: float, v: float, t_max: float, *, t: float = 0.0, max_steps: int = 1_000_000
) -> EventList:
    """Return the events between t and t_max (s) of a motion that starts at x (m) with velocity v (m/s).

    Parameters
    ----------
    way : Way
        The method.
    flow, x, v, t_max, t
        As for `rig_sim.integrate.events.list_events`.
    max_steps : int
        Steps, or evaluations, after which the run ends with the outcome 'step limit'.

    Raises
    ------
    ValueError
        For a flow that is not physical.
    """
    validate(flow)
    fr = frame(flow)
    work = new_work(max_steps)
    idle = work
    p, w = displacement(fr, x), fr.mirror * (v - flow.v_belt)
    mode = mirrored(fr, initial_mode(flow, x, v, t))
    found: list[tuple[float, float, str]] = []
    outcome = LISTING = -1
    while outcome == LISTING:
        kind, mode, p, w, t, _ = phase(way, fr, mode, p, w, t, t_max, idle, 0, 0, idle, idle, idle, work)
        if kind == modes.COMPLETED or kind >= modes.FORCE_REVERSAL:
            outcome = kind
        else:
            found.append((t, position(fr, p), modes.KINDS[unmirrored_kind(fr, kind)]))
    name, advice = modes.OUTCOMES[outcome]
    times, places, kinds = zip(*found, strict=True) if found else ((), (), ())
    return EventList(times, places, kinds, name, advice, int(work[buffer.STEPS]))
