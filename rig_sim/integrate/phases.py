"""The loop over phases: the next event, the motion at given times on the way there, and lists of events.

All kernels take and return the state as (mode, x, w, t): x in m, w = x' - v_belt in m/s, t in s.  They run as they
stand, with ``work = new_work()``, or compiled (`rig_sim.integrate.compiled`) with ``new_work(compiled=True)``; arrays
of times and results are then float64 (modes too), one-dimensional and contiguous.

A driver that changes the Flow between events (belt start, wear, scatter, kicks) asks for one phase at a time with
`next_event` or `sample_phase`, and classifies anew with `initial_mode` only when it moved the state or the load:

    mode = initial_mode(flow, x, v, t)
    while t < t_max:
        kind, mode, x, w, t, i = sample_phase(flow, mode, x, w, t, times, i, n, t_max, out_x, out_v, out_mode, work)
        if kind >= FORCE_REVERSAL: ...          # ended: OUTCOMES[kind] has name and advice
        if mode == STICK: flow = flow._replace(factor=...)

`kind` is COMPLETED (0) when t_max was reached first, a transition (4 old + new mode, named in KINDS), or an outcome.
"""

import math

from rig_sim.flow import modes
from rig_sim.flow.contact_state import transition
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import (
    Frame,
    displacement,
    frame,
    is_curved,
    kept_inside,
    linear_terms,
    mirrored,
    mode_bounds,
    position,
)
from rig_sim.integrate import buffer
from rig_sim.integrate.buffer import Buffer
from rig_sim.integrate.driven import driven_ramp, driven_stick_exit, is_steep, ramp_exit, ramp_state
from rig_sim.integrate.linear import FreeMotion, change, fundamental, linear_exit, stick_exit, stick_lateness
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.taylor import changes, series_exit

RAPID_ALLOWED = 100  # events in a row, each within RAPID_TIME, before the event-rate limit; not swept
RAPID_TIME = 1e-12  # x sqrt(m/k)


def is_series(fr: Frame, mode: int) -> bool:
    """Return whether a mode is stepped by series: slip on a curve; driven phases except stick and steep ramps."""
    if mode == modes.STICK:
        return False
    if fr.u0 != 0.0:
        return not is_steep(fr, mode)
    return is_curved(fr, mode)


def phase_exit(
    fr: Frame, mode: int, p: float, w: float, t: float, lo: float, hi: float, tau_max: float, work: Buffer
) -> tuple[int, float]:
    """Return (side, tau): w leaves [lo, hi] after tau at its lower (-1) or upper (+1) end, or (0, tau) passed inside.

    Without an exit, tau is ``tau_max`` but in phases stepped by series, where it may be less: call again from there.
    """
    work[buffer.LATE] = 0.0
    if mode == modes.STICK:
        if fr.u0 != 0.0:
            return driven_stick_exit(fr, p, t, tau_max)
        side, tau = stick_exit(fr, p, tau_max)
        if side > 0 and tau > 0.0:
            work[buffer.LATE] = stick_lateness(fr, p, work[buffer.P_REST], tau)
        return side, tau
    if is_series(fr, mode):
        return series_exit(fr, mode, p, w, t, lo, hi, tau_max, work)
    if fr.u0 != 0.0:
        return ramp_exit(fr, p, w, t, lo, hi, tau_max)
    C, e = linear_terms(fr, mode)
    zeta = 0.5 * C / fr.m
    disc = (zeta - fr.omega0) * (zeta + fr.omega0)
    a = kept_inside(fr, mode, w, (-C * w - fr.k * p + e) / fr.m)
    work[buffer.ZETA] = zeta
    work[buffer.START] = a
    touch = 0.0 if fr.d > 0.0 else 4.0 * EPS
    return linear_exit(FreeMotion(w, a, w + fr.v, zeta, fr.omega2, disc), lo, hi, tau_max, touch, work)


def increments(fr: Frame, mode: int, p: float, w: float, t: float, tau: float, work: Buffer) -> tuple[float, float]:
    """Return the changes of (p, w) within tau of the phase; its own `phase_exit` must have filled ``work`` last."""
    if mode == modes.STICK:
        return fr.v * tau, 0.0
    if is_series(fr, mode):
        return changes(work, tau / work[buffer.TIME_SCALE])
    if fr.u0 != 0.0:
        p_end, w_end, _ = ramp_state(driven_ramp(fr, p, w, t), tau)
        return p_end - p, w_end - w
    zeta = work[buffer.ZETA]
    if tau == work[buffer.EXIT]:
        S, E = work[buffer.EXIT_S], work[buffer.EXIT_E]
    else:
        S, E, _ = fundamental(zeta, fr.omega2, (zeta - fr.omega0) * (zeta + fr.omega0), tau)
    return change(work[buffer.START], w + fr.v, zeta, fr.omega2, S, E)


def sum_of(value: float, rest: float, increase: float) -> tuple[float, float]:
    """Return value + rest + increase as the nearest number and what that cannot hold (Neumaier)."""
    increase += rest
    total = value + increase
    return total, (value - total) + increase if abs(value) >= abs(increase) else (increase - total) + value


def phase(
    fr: Frame,
    mode: int,
    p: float,
    w: float,
    t: float,
    carry: float,
    t_max: float,
    times: Buffer,
    i: int,
    n: int,
    out_x: Buffer,
    out_v: Buffer,
    out_mode: Buffer,
    work: Buffer,
) -> tuple[int, int, float, float, float, float, int]:
    """Go to the next event or to t_max within the frame; return (kind, mode, p, w, t, carry, i).

    Results are stored for times[i], times[i + 1] ... up to there.  Time is t + carry, summed by Neumaier's rule, as are
    p and w with what ``work`` holds: many steps then lose no more than one.
    """
    lo, hi = mode_bounds(fr, mode)
    begun = t
    if not math.isfinite(p + w + (t_max - t)):
        return modes.NOT_FINITE, mode, p, w, t, carry, i
    while True:
        rest = (t_max - t) - carry
        side = 0
        tau = 0.0
        if rest > 0.0:
            if work[buffer.STEPS] >= work[buffer.STEPS_ALLOWED]:
                return modes.STEP_LIMIT, mode, p, w, t, carry, i
            work[buffer.STEPS] += 1.0
            side, tau = phase_exit(fr, mode, p, w, t, lo, hi, rest, work)
        if not math.isfinite(rest + tau):
            return modes.NOT_FINITE, mode, p, w, t, carry, i
        while i < n:
            dt = (times[i] - t) - carry
            if dt > tau:
                break
            dp, dw = (0.0, 0.0) if dt <= 0.0 else increments(fr, mode, p, w, t, dt, work)
            out_x[i] = position(fr, p + dp)
            out_v[i] = fr.mirror * (w + dw + fr.v)
            out_mode[i] = float(mirrored(fr, mode))
            i += 1
        if tau > 0.0:
            dp, dw = increments(fr, mode, p, w, t, tau, work)
            p, work[buffer.P_REST] = sum_of(p, work[buffer.P_REST], dp)
            w, work[buffer.W_REST] = sum_of(w, work[buffer.W_REST], dw)
            if not math.isfinite(p + w):
                return modes.NOT_FINITE, mode, p, w, t, carry, i
        if side == 0 and tau >= rest:
            work[buffer.RAPID] = 0.0
            return modes.COMPLETED, mode, p, w, t_max, 0.0, i
        total = t + tau
        carry += (t - total) + tau if abs(t) >= abs(tau) else (tau - total) + t
        t = total
        if side == 0:
            continue
        carry += work[buffer.LATE]
        if mode == modes.STICK:
            w = 0.0
            if side > 0 and fr.u0 == 0.0 and tau > 0.0:
                p = 0.0
        else:
            w = hi if side > 0 else lo
        work[buffer.W_REST] = 0.0
        if (
            mode == modes.STICK or mode == modes.RAMP
        ):  # so that slip begins in p alone, and a recurrence can be recognised
            work[buffer.P_REST] = 0.0
        entered = transition(fr, mode, side, p, t)
        if entered >= modes.FORCE_REVERSAL:
            return entered, mode, p, w, t, carry, i
        if (t - begun) * fr.omega0 <= RAPID_TIME:
            work[buffer.RAPID] += 1.0
            if work[buffer.RAPID] > RAPID_ALLOWED:
                return modes.EVENT_RATE, entered, p, w, t, carry, i
        else:
            work[buffer.RAPID] = 0.0
        return 4 * mode + entered, entered, p, w, t, carry, i


def unmirrored_kind(fr: Frame, kind: int) -> int:
    """Return a kind found in the frame as it is outside: transitions of a mirrored frame are mirrored."""
    if fr.mirror > 0.0 or kind == modes.COMPLETED or kind >= modes.FORCE_REVERSAL:
        return kind
    return 4 * mirrored(fr, kind // 4) + mirrored(fr, kind % 4)


def sample_phase(
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
    """Go to the next event, or to t_max, storing the motion at times[i:n] on the way.

    Parameters
    ----------
    flow, mode, x, w, t
        The flow and the state to start from (s, m, m/s).
    times, i, n
        Sorted times (s); times[i:n] are still to be served; earlier ones than t get the state at t.
    t_max : float
        Where to stop when no event comes first, s; finite.
    out_x, out_v, out_mode
        Buffers of at least n: x (m), absolute velocity (m/s), mode.
    work : list or array
        From `new_work`.

    Returns
    -------
    (kind, mode, x, w, t, i)
        ``mode`` is the one entered; ``i`` the first time not yet served (those at the event itself are).
    """
    fr = frame(flow)
    work[buffer.P_REST] = 0.0
    work[buffer.W_REST] = 0.0
    own, p, w = mirrored(fr, mode), displacement(fr, x), fr.mirror * w
    kind, own, p, w, t, carry, i = phase(fr, own, p, w, t, 0.0, t_max, times, i, n, out_x, out_v, out_mode, work)
    return unmirrored_kind(fr, kind), mirrored(fr, own), position(fr, p), fr.mirror * w, t + carry, i


def next_event(
    flow: Flow, mode: int, x: float, w: float, t: float, t_max: float, work: Buffer
) -> tuple[int, int, float, float, float]:
    """Return (kind, mode, x, w, t) at the next event, or at t_max with kind COMPLETED."""
    idle = work
    kind, mode, x, w, t, _ = sample_phase(flow, mode, x, w, t, idle, 0, 0, t_max, idle, idle, idle, work)
    return kind, mode, x, w, t


def run(
    flow: Flow,
    mode: int,
    x: float,
    w: float,
    t: float,
    t_max: float,
    capacity: int,
    out_t: Buffer,
    out_carry: Buffer,
    out_x: Buffer,
    out_kind: Buffer,
    recur: int,
    work: Buffer,
) -> tuple[int, int, int, int, float, float, float]:
    """List the events up to t_max; return (outcome, count, first, mode, x, w, t).

    Parameters
    ----------
    flow, mode, x, w, t
        The flow and the state to start from.
    t_max : float
        Where to stop, s.
    capacity : int
        Entries that the four lists hold: ``out_t`` is the time of an event, ``out_carry`` what that cannot hold of it;
        then its position and its kind.
    recur : int
        1 to stop, with the outcome RECURRED, as soon as the motion is known to repeat; 0 to step every cycle.
    work : list or array
        From `new_work`; its last buffer carries from call to call what t itself cannot hold.

    Returns
    -------
    outcome, count, first, mode, x, w, t
        LIST_FULL: store the ``count`` events and call again with the returned state.  RECURRED: the events after
        ``first`` up to the last are one cycle, and follow again and again with the time between these two added.

    Notes
    -----
    Without a drive the future of a state does not depend on the time: a state that slip began from, met again bit for
    bit, repeats for ever what followed it.  A jump law begins every slip in the same state, its first two do; a ramp
    law's return map contracts until rounding closes it, perhaps over several turns, hence Brent's search for the
    period: the state to compare with is renewed after 1, 2, 4 ... beginnings of slip.
    """
    fr = frame(flow)
    own = mirrored(fr, mode)
    p = displacement(fr, x)
    w = fr.mirror * w
    carry = float(work[buffer.CARRY])
    work[buffer.P_REST] = 0.0
    work[buffer.W_REST] = 0.0
    idle = work
    count = 0
    first = -1
    p_first = 0.0
    turns = 0
    patience = 1
    outcome = modes.LIST_FULL
    while count < capacity:
        kind, own, p, w, t, carry, _ = phase(fr, own, p, w, t, carry, t_max, idle, 0, 0, idle, idle, idle, work)
        if kind == modes.COMPLETED or kind >= modes.FORCE_REVERSAL:
            outcome = kind
            break
        total = t + carry
        out_t[count] = total
        out_carry[count] = (t - total) + carry
        out_x[count] = position(fr, p)
        out_kind[count] = float(unmirrored_kind(fr, kind))
        count += 1
        if recur == 0 or fr.u0 != 0.0 or (kind != modes.STICK_TO_NEGATIVE and kind != modes.RAMP_TO_NEGATIVE):
            continue
        # w is the edge of stick or ramp, exactly: p alone is the state
        if first >= 0 and p == p_first and (total - out_t[first]) * fr.omega0 > RAPID_ALLOWED * RAPID_TIME:
            outcome = modes.RECURRED
            break
        turns += 1
        if first < 0 or turns == patience:
            first = count - 1
            p_first = p
            turns = 0
            patience *= 2
    work[buffer.CARRY] = carry
    return outcome, count, first, mirrored(fr, own), position(fr, p), fr.mirror * w, t
