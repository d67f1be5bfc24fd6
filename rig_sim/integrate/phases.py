"""The loop over phases: the next event, the motion at given times on the way there, and lists of events.

A motion is a `State`: mode, x in m, w = x' - v_belt in m/s, t in s.  Kernels run as they stand, with ``work =
new_work()``, or compiled (`rig_sim.integrate.compiled`) with ``new_work(compiled=True)``; arrays of times and results
are then float64 (modes too), one-dimensional and contiguous.

A driver that changes the Flow between events (belt start, wear, scatter, kicks) asks for one phase at a time with
`next_event` or `sample_phase`, and classifies anew with `initial_mode` only when it moved the state or the load:

    at = State(initial_mode(flow, x, v, t), x, v - flow.v_belt, t)
    while at.t < t_max:
        kind, at, i = sample_phase(flow, at, t_max, samples, i, work)
        if kind >= FORCE_REVERSAL: ...          # ended: OUTCOMES[kind] has name and advice
        if at.mode == STICK: flow = flow._replace(factor=...)

`kind` is COMPLETED (0) when t_max was reached first, a transition (4 old + new mode, named in KINDS), or an outcome.
"""

import math
from typing import NamedTuple

from rig_sim.flow import modes
from rig_sim.flow.contact_state import transition
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import (
    Frame,
    displacement,
    frame,
    is_curved,
    keep_inside,
    linear_terms,
    mirror_mode,
    mode_bounds,
    position,
)
from rig_sim.integrate.driven import driven_ramp, driven_stick_exit, is_steep, ramp_exit, ramp_state
from rig_sim.integrate.linear import FreeMotion, change, fundamental, linear_exit, stick_exit, stick_lateness
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.taylor import changes, series_exit
from rig_sim.integrate.work import Buffer, Work, unboxed

RAPID_ALLOWED = 100  # events in a row, each within RAPID_TIME, before the event-rate limit
RAPID_TIME = 1e-12  # x sqrt(m/k)


class State(NamedTuple):
    """A motion: mode, position (m), relative velocity (m/s), time (s), and the part of t below its last digit (s).

    Within the frame ``x`` is the displacement p, and w and the mode are mirrored.
    """

    mode: int
    x: float
    w: float
    t: float
    carry: float = 0.0


class Samples(NamedTuple):
    """``n`` sorted times (s), and the motion stored there: x (m), velocity over ground (m/s), mode.

    Times earlier than the motion get its first state.
    """

    t: Buffer
    x: Buffer
    v: Buffer
    mode: Buffer
    n: int


class Lists(NamedTuple):
    """The lists of up to ``capacity`` events: time (s), the part of it below its last digit, position (m), kind."""

    t: Buffer
    carry: Buffer
    x: Buffer
    kind: Buffer
    capacity: int


def is_series(fr: Frame, mode: int) -> bool:
    """Return whether a mode is stepped by series: slip on a curve; driven phases except stick and steep ramps."""
    if mode == modes.STICK:
        return False
    if fr.u0 != 0.0:
        return not is_steep(fr, mode)
    return is_curved(fr, mode)


def phase_exit(
    fr: Frame, mode: int, p: float, w: float, t: float, lo: float, hi: float, tau_max: float, work: Work
) -> tuple[int, float]:
    """Return (side, tau): w leaves [lo, hi] after tau at its lower (-1) or upper (+1) end, or (0, tau) stays inside.

    Without an exit, tau is ``tau_max`` except in phases stepped by series, where it may be less: call again from there.
    """
    work.late = 0.0
    if mode == modes.STICK:
        if fr.u0 != 0.0:
            return driven_stick_exit(fr, p, t, tau_max)
        side, tau = stick_exit(fr, p, tau_max)
        if side > 0 and tau > 0.0:
            work.late = stick_lateness(fr, p, work.p_rest, tau)
        return side, tau
    if is_series(fr, mode):
        return series_exit(fr, mode, p, w, t, lo, hi, tau_max, work)
    if fr.u0 != 0.0:
        return ramp_exit(fr, p, w, t, lo, hi, tau_max)
    C, e = linear_terms(fr, mode)
    zeta = 0.5 * C / fr.m
    disc = (zeta - fr.omega0) * (zeta + fr.omega0)
    a = keep_inside(fr, mode, w, (-C * w - fr.k * p + e) / fr.m)
    work.zeta = zeta
    work.start = a
    touch = 0.0 if fr.d > 0.0 else 4.0 * EPS
    return linear_exit(FreeMotion(w, a, w + fr.v, zeta, fr.omega2, disc), lo, hi, tau_max, touch, work)


def increments(fr: Frame, mode: int, p: float, w: float, t: float, tau: float, work: Work) -> tuple[float, float]:
    """Return the changes of (p, w) within tau of the phase; its own `phase_exit` must have filled ``work`` last."""
    if mode == modes.STICK:
        return fr.v * tau, 0.0
    if is_series(fr, mode):
        return changes(work, tau / work.time_scale)
    if fr.u0 != 0.0:
        p_end, w_end, _ = ramp_state(driven_ramp(fr, p, w, t), tau)
        return p_end - p, w_end - w
    zeta = work.zeta
    if tau == work.exit:
        S, E = work.exit_s, work.exit_e
    else:
        S, E, _ = fundamental(zeta, fr.omega2, (zeta - fr.omega0) * (zeta + fr.omega0), tau)
    return change(work.start, w + fr.v, zeta, fr.omega2, S, E)


def sum_of(value: float, rest: float, increase: float) -> tuple[float, float]:
    """Return value + rest + increase as the nearest number and its rounding error (Neumaier)."""
    increase += rest
    total = value + increase
    return total, (value - total) + increase if abs(value) >= abs(increase) else (increase - total) + value


def run_phase(fr: Frame, state: State, t_max: float, samples: Samples, i: int, work: Work) -> tuple[int, State, int]:
    """Continue to the next event or to t_max in the frame, storing samples from the i-th on; return (kind, state, i).

    p, w and t are summed by Neumaier's rule with the rests in ``work`` and ``carry``: many steps lose no more than one.
    """
    mode, p, w, t, carry = state
    lo, hi = mode_bounds(fr, mode)
    if not math.isfinite(p + w + (t_max - t)):
        return modes.NOT_FINITE, state, i
    while True:
        rest = (t_max - t) - carry
        side = 0
        tau = 0.0
        if rest > 0.0:
            if work.steps >= work.steps_allowed:
                return modes.STEP_LIMIT, State(mode, p, w, t, carry), i
            work.steps += 1.0
            side, tau = phase_exit(fr, mode, p, w, t, lo, hi, rest, work)
        if not math.isfinite(rest + tau):
            return modes.NOT_FINITE, State(mode, p, w, t, carry), i
        if i < samples.n:
            i = store_samples(fr, State(mode, p, w, t, carry), tau, samples, i, work)
        if tau > 0.0:
            dp, dw = increments(fr, mode, p, w, t, tau, work)
            p, work.p_rest = sum_of(p, work.p_rest, dp)
            w, work.w_rest = sum_of(w, work.w_rest, dw)
            if not math.isfinite(p + w):
                return modes.NOT_FINITE, State(mode, p, w, t, carry), i
        if side == 0 and tau >= rest:
            work.rapid = 0.0
            return modes.COMPLETED, State(mode, p, w, t_max, 0.0), i
        total = t + tau
        carry += (t - total) + tau if abs(t) >= abs(tau) else (tau - total) + t
        t = total
        if side != 0:
            carry += work.late
            if mode == modes.STICK and side > 0 and fr.u0 == 0.0 and tau > 0.0:
                p = 0.0
            w = 0.0 if mode == modes.STICK else (hi if side > 0 else lo)
            kind, entered = pass_edge(fr, mode, side, p, t, state.t, work)
            return kind, State(entered, p, w, t, carry), i


def store_samples(fr: Frame, state: State, tau: float, samples: Samples, i: int, work: Work) -> int:
    """Store the samples within ``tau`` of a step, from the i-th on; return the first one beyond."""
    mode, p, w, t, carry = state
    while i < samples.n:
        dt = (samples.t[i] - t) - carry
        if dt > tau:
            break
        dp, dw = (0.0, 0.0) if dt <= 0.0 else increments(fr, mode, p, w, t, dt, work)
        samples.x[i] = position(fr, p + dp)
        samples.v[i] = fr.mirror * (w + dw + fr.v)
        samples.mode[i] = float(mirror_mode(fr, mode))
        i += 1
    return i


def pass_edge(fr: Frame, mode: int, side: int, p: float, t: float, phase_start: float, work: Work) -> tuple[int, int]:
    """Return the kind of the event by which ``mode`` is left, and the mode entered; an outcome where motion ends."""
    work.w_rest = 0.0
    if mode == modes.STICK or mode == modes.RAMP:  # so that slip starts in p alone, and a recurrence can be recognised
        work.p_rest = 0.0
    entered = transition(fr, mode, side, p, t)
    if entered >= modes.FORCE_REVERSAL:
        return entered, mode
    if (t - phase_start) * fr.omega0 > RAPID_TIME:
        work.rapid = 0.0
        return 4 * mode + entered, entered
    work.rapid += 1.0
    return (modes.EVENT_RATE if work.rapid > RAPID_ALLOWED else 4 * mode + entered), entered


def unmirrored_kind(fr: Frame, kind: int) -> int:
    """Return the kind outside a mirrored frame of a kind within it."""
    if fr.mirror > 0.0 or kind == modes.COMPLETED or kind >= modes.FORCE_REVERSAL:
        return kind
    return 4 * mirror_mode(fr, kind // 4) + mirror_mode(fr, kind % 4)


def enter_frame(fr: Frame, state: State) -> State:
    return State(mirror_mode(fr, state.mode), displacement(fr, state.x), fr.mirror * state.w, state.t, state.carry)


def leave_frame(fr: Frame, state: State) -> State:
    return State(mirror_mode(fr, state.mode), position(fr, state.x), fr.mirror * state.w, state.t, state.carry)


def sample_phase(
    flow: Flow, state: State, t_max: float, samples: Samples, i: int, work: Work
) -> tuple[int, State, int]:
    """Continue from a state to the next event, or to t_max (s, finite), storing samples from the i-th on.

    The state's carry counts as 0.  Returns the kind, the state entered, with carry 0, and the first sample not yet
    reached (those at the event itself are).
    """
    fr = frame(flow)
    work.p_rest = 0.0
    work.w_rest = 0.0
    kind, end, i = run_phase(
        fr, enter_frame(fr, State(state.mode, state.x, state.w, state.t, 0.0)), t_max, samples, i, work
    )
    mode, x, w, t, carry = leave_frame(fr, end)
    return unmirrored_kind(fr, kind), State(mode, x, w, t + carry, 0.0), i


def next_event(flow: Flow, state: State, t_max: float, work: Work) -> tuple[int, State]:
    """Return the kind and the state of the next event, or of t_max with the kind COMPLETED."""
    none = work.w
    kind, state, _ = sample_phase(flow, state, t_max, Samples(none, none, none, none, 0), 0, work)
    return kind, state


def run(flow: Flow, state: State, t_max: float, lists: Lists, recur: int, work: Work) -> tuple[int, int, int, State]:
    """List the events up to t_max (s) into ``lists``; return (outcome, count, first, state).

    With ``recur`` 1 the outcome is RECURRED as soon as the motion is known to repeat: the events after ``first`` up to
    the last are one cycle, and repeat with the time between these two added.  With LIST_FULL, store the ``count``
    events and call again with the returned state.

    Without a drive the future of a state does not depend on the time: a state from which slip started, met again bit
    for bit, repeats its future.  A jump law starts every slip in the same state, already its first two; a ramp law's
    return map contracts until rounding closes it, perhaps over several turns, hence Brent's search for the period: the
    state to compare with is renewed after 1, 2, 4 ... starts of slip.
    """
    work = unboxed(work)
    fr = frame(flow)
    state = enter_frame(fr, state)
    work.p_rest = 0.0
    work.w_rest = 0.0
    none = work.w
    unsampled = Samples(none, none, none, none, 0)
    count = 0
    first = -1
    p_first = 0.0
    turns = 0
    patience = 1
    outcome = modes.LIST_FULL
    times, carries, positions, kinds, capacity = lists
    while count < capacity:
        kind, state, _ = run_phase(fr, state, t_max, unsampled, 0, work)
        if kind == modes.COMPLETED or kind >= modes.FORCE_REVERSAL:
            outcome = kind
            break
        _, p, _, t, carry = state
        total = t + carry
        times[count] = total
        carries[count] = (t - total) + carry
        positions[count] = position(fr, p)
        kinds[count] = float(unmirrored_kind(fr, kind))
        count += 1
        if recur == 0 or fr.u0 != 0.0 or (kind != modes.STICK_TO_NEGATIVE and kind != modes.RAMP_TO_NEGATIVE):
            continue
        # w is the edge of stick or ramp, exactly: p alone is the state
        if first >= 0 and p == p_first and (total - times[first]) * fr.omega0 > RAPID_ALLOWED * RAPID_TIME:
            outcome = modes.RECURRED
            break
        turns += 1
        if first < 0 or turns == patience:
            first = count - 1
            p_first = p
            turns = 0
            patience *= 2
    return outcome, count, first, leave_frame(fr, state)
