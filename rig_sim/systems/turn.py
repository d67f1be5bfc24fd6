"""The return map of slip: from one beginning of slip out of stick or ramp to the next, phase by phase.

Undriven flows alone, in the frame (`rig_sim.flow.frame`), where slip always begins in the same direction and at
the same relative velocity, so that the map is one-dimensional: p -> p.  Each turn ends: within `STEPS_OF_SEARCH`
steps of the integrator and `PHASES_PER_TURN` phases, in the next beginning of slip or in a named outcome.

The map from one minimum of the position to the next, and its derivative: the multiplier of a periodic orbit.

At a minimum the mass stands and turns forwards (u = x' = 0, u' > 0).  From there the motion goes through whatever
phases follow, slip, stick or ramp, back to the next minimum, so the map p -> p is one-dimensional and sees stick-slip
cycles and orbits that never stick alike.  Undriven flows alone, in the frame of `rig_sim.flow.frame`.

The derivative is that of the flow in the plane across the orbit, which for an orbit is its Floquet multiplier beside 1:

    multiplier = product over events of u'_after/u'_before  times  exp(-integral of (c - F'(w))/m dt)

by Liouville's formula and the determinants of the saltation matrices.  A landing in stick has u'_after = 0, so the
multiplier of an orbit that sticks is 0: the stick forgets where it began.
"""

import math
from dataclasses import dataclass
from functools import cache

from rig_sim.flow import modes
from rig_sim.flow.contact_state import classify, transition
from rig_sim.flow.frame import (
    Frame,
    acceleration,
    curve_deficit,
    free_acceleration,
    friction_slope,
    linear_terms,
    mode_bounds,
    slip_speed,
    steepest_slope,
)
from rig_sim.friction.curve import HYPERBOLIC, MEASURED
from rig_sim.friction.spline import about, piece_of
from rig_sim.integrate.linear import first_extreme
from rig_sim.integrate.phases import increments, is_series, phase_exit
from rig_sim.integrate.polynomial import first_root, value
from rig_sim.integrate.work import ORDER, Work

STEPS_OF_SEARCH = 20_000  # integrator steps of a whole search: about a thousand turns without an event
PHASES_PER_TURN = 200
# Size of the motion about a stable fixed point, relative to the distance to the edge and to the curve's own scale of
# speed, below which it counts as settled: small against 1, as the curve is taken as a line there.
SETTLED = 1e-3
# Change of the size of a swing within slip from one turn to the next, relative, below which it is an orbit: above
# rounding (1e-12), below the contraction of a spiral near a Hopf point (1e-6).
CLOSED = 1e-9
PURE_SLIP = -math.inf  # duration of a phase of slip that neither ends nor comes to rest


@dataclass(frozen=True)
class Turn:
    """One passage from the start of slip to the next; or, with an ``end`` other than '', where it ended."""

    end: str
    advice: str
    p: float  # at the next start of slip, or where the mass rests
    phases: tuple[tuple[int, float, float], ...] = ()  # mode, duration, p at its start
    extremes: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # p_min, p_max, w_min, w_max
    mode: int = modes.STICK  # in which the mass rests


def next_slip(fr: Frame, mode: int, p: float, w: float, work: Work, *, to_the_end: bool = True) -> Turn:
    """Follow the motion to the next start of (backward) slip out of stick or ramp, and record its extremes.

    A start in stick or ramp leads to the end of that stick.  A motion that no longer sticks is followed to where it
    settles, unless ``to_the_end`` is False: it is then called pure slip as soon as that is certain.
    """
    phases: list[tuple[int, float, float]] = []
    p_seen = [p]
    w_seen = [w]
    for _i in range(PHASES_PER_TURN):
        p_start = p
        side, tau, p, w = pass_phase(fr, mode, p, w, p_seen, w_seen, work, to_the_end=to_the_end)
        if side == 0:
            if tau == PURE_SLIP:
                return Turn(
                    "pure slip", "the mass oscillates without sticking, because it stays slower than the belt", p
                )
            if math.isinf(tau):
                if mode != modes.STICK and linear_terms(fr, mode)[0] < 0.0:
                    return Turn("no cycle", "damping is negative, so the motion grows without bound", p)
                advice = "the mass comes to rest; with less damping or another speed it may stick"
                return Turn("fixed point", advice, fixed_point(fr, mode, p), mode=mode)
            if not math.isfinite(p + w):
                return Turn(*modes.OUTCOMES[modes.NOT_FINITE], p)
            return Turn("no cycle", f"no orbit was found within {STEPS_OF_SEARCH} steps", p)
        phases.append((mode, tau, p_start))
        entered = transition(fr, mode, side, p, 0.0)
        if entered >= modes.FORCE_REVERSAL:
            return Turn(*modes.OUTCOMES[entered], p)
        if mode in (modes.STICK, modes.RAMP) and entered == modes.NEGATIVE:
            return Turn("", "", p, tuple(phases), (min(p_seen), max(p_seen), min(w_seen), max(w_seen)))
        mode = entered
    advice = (
        f"no stick ended within {PHASES_PER_TURN} phases, because the mass passes the belt's speed in both directions"
    )
    return Turn("no cycle", advice, p)


def pass_phase(
    fr: Frame,
    mode: int,
    p: float,
    w: float,
    p_seen: list[float],
    w_seen: list[float],
    work: Work,
    *,
    to_the_end: bool = True,
) -> tuple[int, float, float, float]:
    """Return (side, duration, p, w) at the end of a phase; (0, inf, p, w) when it settles, (0, tau, ...) when unclear.

    The duration is `PURE_SLIP` where the mass swings for ever: a turn of a slip that ends nearer to the fixed point
    than it began encloses all that follows (orbits in the plane do not cross), so that it never leaves slip again.

    Positions and velocities at which an extreme of the phase may lie are appended to ``p_seen`` and ``w_seen``.
    """
    lo, hi = mode_bounds(fr, mode)
    durations: list[float] = []
    turns: list[float] = []
    while work.steps < work.steps_allowed:
        work.steps += 1.0
        side, tau = phase_exit(fr, mode, p, w, 0.0, lo, hi, math.inf, work)
        if math.isinf(tau):
            return 0, tau, p, w
        falling, seen = w < -fr.v, len(p_seen)
        for turning_time in turning_times(fr, mode, p, w, tau, work):
            dp, dw = increments(fr, mode, p, w, 0.0, turning_time, work)
            p_seen.append(p + dp)
            w_seen.append(w + dw)
        dp, dw = increments(fr, mode, p, w, 0.0, tau, work)
        p += dp
        w += dw
        durations.append(tau)
        if not math.isfinite(p + w):
            break
        if side != 0:
            if mode == modes.STICK:
                w = 0.0
                p = 0.0 if side > 0 else p
            else:
                w = hi if side > 0 else lo
        p_seen.append(p)  # of every step: one may end at an extreme, as on a knot at the belt's speed
        w_seen.append(w)
        if side != 0:
            return side, math.fsum(durations), p, w
        if settles(fr, mode, p, w):
            return 0, math.inf, p, w
        if mode == modes.NEGATIVE and falling and w >= -fr.v:  # the mass has turned at its least position
            turns.append(min(p_seen[seen:], default=p))
            if (len(turns) > 1 and not to_the_end and turns[-1] > turns[-2]) or swings_on(fr, turns):
                return 0, PURE_SLIP, p, w
    return 0, math.fsum(durations), p, w


def swings_on(fr: Frame, turns: list[float]) -> bool:
    """Return whether a slip that turned at these p (m, in the frame) approaches an orbit of slip.

    The swing must have become smaller, and either the fixed point is unstable, or the change decreases: near an
    unstable orbit it is as small, but grows.
    """
    if len(turns) < 2:
        return False
    size = fixed_point(fr, modes.NEGATIVE, turns[-1]) - turns[-1]
    change = turns[-1] - turns[-2]
    if change > 0.0 and not fr.c > friction_slope(fr, modes.NEGATIVE, -fr.v):
        return True
    return len(turns) > 2 and abs(change) < CLOSED * size and abs(change) <= abs(turns[-2] - turns[-3])


def turning_times(fr: Frame, mode: int, p: float, w: float, tau: float, work: Work) -> list[float]:
    """Return the local times within tau at which w = -v or w' = 0: where x and v may be extreme."""
    if mode == modes.STICK:
        return []
    level = -fr.v
    if is_series(fr, mode):
        scale = work.time_scale
        for j in range(ORDER):
            work.u[j] = (j + 1) * work.w[j + 1]
        work.u[ORDER] = 0.0
        times = []
        for series, target in ((work.w, level), (work.u, 0.0)):
            before, after = series[0] - target, value(series, ORDER, tau / scale) - target
            if before * after < 0.0:
                side = -1 if before > 0.0 else 1
                times.append(scale * first_root(series, ORDER, target, side, tau / scale))
        return times
    C, _ = linear_terms(fr, mode)
    zeta = 0.5 * C / fr.m
    disc = (zeta - fr.omega0) * (zeta + fr.omega0)
    a = acceleration(fr, mode, p, w, 0.0)
    u = w + fr.v
    # w' = 0, and (u' + ... ) = 0: u itself obeys the same equation as w', one derivative down
    times = []
    for start, slope in ((a, -2.0 * zeta * a - fr.omega2 * u), (u, a)):
        # the first zero of a solution with this value and slope is the first extreme of its integral
        time = first_extreme(start, -(slope + 2.0 * zeta * start) / fr.omega2, zeta, fr.omega2, disc)
        while 0.0 < time < tau and len(times) < PHASES_PER_TURN:
            times.append(time)
            if disc >= 0.0:
                break
            time += math.pi / math.sqrt(-disc)
    return times


def settles(fr: Frame, mode: int, p: float, w: float) -> bool:
    """Return whether a slip is so close to its stable fixed point, or so heavily damped, that it cannot leave.

    Close: u^2 + omega0^2 (p - p_rest)^2 only falls while damping exceeds friction's slope over the whole of its swing.
    Near the Hopf point, where that swing is tiny, its size is compared with the distance to the edge and with the
    curve's own scale instead.  Heavily damped: see `creeps`.
    """
    if mode != modes.NEGATIVE or not fr.c > friction_slope(fr, mode, -fr.v):
        return False
    u = w + fr.v
    if creeps(fr, u, acceleration(fr, mode, p, w, 0.0), fr.c - steepest_slope(fr, fr.d, fr.v)):
        return True
    size = math.hypot(u, fr.omega0 * (p - fixed_point(fr, mode, p)))
    room = fr.v - fr.d
    if size < min(room, fr.s_max - fr.v) and fr.c > steepest_slope(fr, fr.v - size, fr.v + size):
        return True
    return size < SETTLED * min(room, curve_scale(fr))


def curve_scale(fr: Frame) -> float:
    """Return the change of speed (m/s) from the belt's over which friction's slope, and the damper's, may change."""
    s = fr.v - fr.d
    if fr.curve == HYPERBOLIC:
        return 1.0 / fr.gamma + (slip_speed(fr, s) if fr.lag != 0.0 else s)
    if fr.curve == MEASURED:
        _, slope, bend, _ = about(fr.table, fr.pieces, piece_of(fr.table, fr.pieces, s), s)
        if bend != 0.0:
            return (abs(slope) + fr.c / fr.A) / abs(bend)
    return math.inf


def creeps(fr: Frame, u: float, a: float, damping: float) -> bool:
    """Return whether a slip with speed u (m/s) and acceleration a (m/s^2) only slows down from here, and never stops.

    ``damping`` (N s/m) is the least, friction's slope taken off, that holds at any speed from 0 to u.  The rate
    r = -a/u obeys r' = r^2 - (C/m) r + k/m with C the damping of the moment.  With C >= ``damping`` > 2 sqrt(k m) that
    is below 0 between the two roots, so an r from 0 to the larger root stays there: u falls, and reaches neither 0 nor
    the belt's speed.
    """
    half = 0.5 * damping / fr.m
    if not (half > fr.omega0 and u > 0.0 and a <= 0.0):
        return False
    return -a / u < half + math.sqrt((half - fr.omega0) * (half + fr.omega0))


def fixed_point(fr: Frame, mode: int, p: float) -> float:
    """Return p of the fixed point (u = 0) at which a phase without end settles; in stick the present p."""
    if mode == modes.STICK:
        return p
    C, e = linear_terms(fr, mode)
    fall = 0.0
    if mode == modes.NEGATIVE:
        fall = curve_deficit(fr, mode, -fr.v)
    return (C * fr.v + e + fall) / fr.k


# Points of the Gauss-Legendre rule on every Taylor step.  A step ends at a quarter of the series' radius of
# convergence, where 8 points are right to 1e-17 of the integral.
POINTS = 8


@dataclass(frozen=True)
class MinimumTurn:
    """One passage from a minimum to the next; or, with an ``end`` other than '', where it ended."""

    end: str  # '' for a passage; 'fixed point' (the mass creeps to rest), 'no cycle', or an outcome of the integrator
    advice: str = ""
    # displacement from the slip point (m, in the frame) at the next minimum, and at the maximum between
    p: float = math.nan
    p_max: float = math.nan
    duration: float = math.nan  # s
    # derivative of the map, the multiplier of an orbit where p is its start; NaN where the motion only touches an edge
    multiplier: float = math.nan
    modes: tuple[int, ...] = ()  # of the phases in the frame, from the first


def next_minimum(fr: Frame, p: float, work: Work) -> MinimumTurn:
    """Follow the motion from a minimum at p (m, in the frame) to the next; a step limit ends one that never turns."""
    still = -fr.v  # w of a mass at rest over ground
    mode = classify(fr, p, still, 0.0)
    w, rising = still, True
    p_max = math.nan
    durations: list[float] = []
    decay = 0.0  # integral of (c - F')/m over the phases so far
    jumps = 1.0  # product of u'_after/u'_before
    visited_modes = [mode]
    while len(visited_modes) < PHASES_PER_TURN:
        lo, hi = mode_bounds(fr, mode)
        if lo <= still < hi:  # the phase is followed to where the mass turns, too
            lo, hi = (still, hi) if rising else (lo, still)
        if work.steps >= work.steps_allowed:
            return MinimumTurn(*modes.OUTCOMES[modes.STEP_LIMIT])
        work.steps += 1.0
        side, tau = phase_exit(fr, mode, p, w, 0.0, lo, hi, math.inf, work)
        if math.isinf(tau) or creeps_to_rest(fr, mode, p, w):
            return MinimumTurn("fixed point", "the mass comes to rest without turning again")
        decay += integrate_damping(fr, mode, p, w, tau, work)
        dp, dw = increments(fr, mode, p, w, 0.0, tau, work)
        p += dp
        w += dw
        durations.append(tau)
        if not math.isfinite(p + w):
            return MinimumTurn(*modes.OUTCOMES[modes.NOT_FINITE])
        if side == 0:
            continue
        w = 0.0 if mode == modes.STICK else (lo, hi)[side > 0]
        if mode != modes.STICK and w == still:
            if not rising:
                return MinimumTurn(
                    "", "", p, p_max, math.fsum(durations), jumps * math.exp(-decay), tuple(visited_modes)
                )
            p_max, rising = p, False
            continue
        entered = transition(fr, mode, side, p, 0.0)
        if entered >= modes.FORCE_REVERSAL:
            return MinimumTurn(*modes.OUTCOMES[entered])
        if entered == modes.STICK:
            jumps = 0.0
        elif mode != modes.STICK:
            before = free_acceleration(fr, mode, p, w, 0.0)
            jumps *= free_acceleration(fr, entered, p, w, 0.0) / before if before != 0.0 else math.nan
        mode = entered
        visited_modes.append(mode)
    return MinimumTurn("no cycle", f"no minimum within {PHASES_PER_TURN} phases")


def creeps_to_rest(fr: Frame, mode: int, p: float, w: float) -> bool:
    """Return whether a slip that slows down has too much damping ever to turn: see `turn.creeps`."""
    if mode != modes.NEGATIVE:
        return False
    a = free_acceleration(fr, mode, p, w, 0.0)
    return creeps(fr, w + fr.v, a, fr.c - steepest_slope(fr, fr.d, fr.v))


def integrate_damping(fr: Frame, mode: int, p: float, w: float, tau: float, work: Work) -> float:
    """Return the integral of (c - F'(w))/m over a step of ``tau`` (s) that `phase_exit` has just made; 0 in stick."""
    if mode == modes.STICK:
        return 0.0
    if not is_series(fr, mode):
        return (fr.c - friction_slope(fr, mode, w)) / fr.m * tau
    total = 0.0
    for share, weight in quadrature():
        dw = increments(fr, mode, p, w, 0.0, share * tau, work)[1]
        total += weight * (fr.c - friction_slope(fr, mode, w + dw))
    return total / fr.m * tau


@cache
def quadrature() -> tuple[tuple[float, float], ...]:
    """Return points and weights of the Gauss-Legendre rule on [0, 1]."""
    from numpy.polynomial.legendre import leggauss

    points, weights = leggauss(POINTS)
    return tuple(zip((0.5 + 0.5 * points).tolist(), (0.5 * weights).tolist(), strict=True))
