"""The periodic orbit of one mass on a belt: `cycle(scene)` finds it from the slip point and measures it.

A jump law restarts every slip from the same point, so one slip and one stick are the orbit, exactly.  A ramp law's
orbit is the fixed point of its return map on the edge where slip begins, found by iteration with secant steps.
Whatever the scene is, the search ends, and what was found instead of an orbit is an outcome, not an error.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from rig_sim.friction.curve import HYPERBOLIC
from rig_sim.integrate.buffer import ORDER, STEPS, STEPS_ALLOWED, TIME_SCALE, Buffer, U, W, new_work
from rig_sim.integrate.contact_state import classify, force, transition
from rig_sim.integrate.flow import Flow, validate
from rig_sim.integrate.frame import (
    Frame,
    acceleration,
    curve_deficit,
    frame,
    linear_terms,
    mirrored,
    mode_bounds,
    position,
    slip_speed,
)
from rig_sim.integrate.linear import first_extreme
from rig_sim.integrate.modes import FORCE_REVERSAL, LETTERS, NEGATIVE, NOT_FINITE, OUTCOMES, RAMP, STICK
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.phases import increments, is_series, phase_exit
from rig_sim.integrate.taylor import first_root, value

STEPS_ALLOWED_HERE = 20_000  # in the whole search: some thousand turns without an event
PHASES_PER_TURN = 200
TURNS = 300  # evaluations of the return map
NEARLY_CLOSED = (
    8  # of them closed to rounding, when the map all but touches the diagonal: there the orbit is ill-defined
)
SETTLED = 1e-3  # how small motion about a stable fixed point must be, against all that could let it leave again


class HasFlow(Protocol):
    """Anything that can say which flow it is: a scene."""

    def flow(self) -> Flow:
        """Return the flow, without its random parts."""
        ...


@dataclass(frozen=True)
class Orbit:
    """A periodic orbit, or what was found in its place.

    Parameters
    ----------
    outcome : str
        'cycle'; 'grazing' (a circle that touches the edge of stick, stick time 0: constant friction); 'fixed point'
        (the mass comes to rest at ``x_rest``); 'no cycle'; 'driven'; or how the motion ended ('force reversal' ...).
    advice : str
        What to do about it; empty for an orbit.
    period, t_stick, t_slip : float or None
        Duration of the orbit and of its parts in and out of stick (or ramp), s.
    x_slip, x_stick : float or None
        Where the mass leaves stick (ramp) and where it re-enters it for good, m.
    x_min, x_max, v_min, v_max : float or None
        Extremes over the orbit, m and m/s (velocity over ground).
    sequence : str
        Letters of the phases in order from the beginning of slip: N, P, S; empty without an orbit.
    x_rest : float or None
        Position of the fixed point, m.
    """

    outcome: str
    advice: str = ""
    period: float | None = None
    t_stick: float | None = None
    t_slip: float | None = None
    x_slip: float | None = None
    x_stick: float | None = None
    x_min: float | None = None
    x_max: float | None = None
    v_min: float | None = None
    v_max: float | None = None
    sequence: str = ""
    x_rest: float | None = None


@dataclass(frozen=True)
class Turn:
    """One passage from the beginning of slip to the next; or, with an ``end`` other than '', where it ended."""

    end: str
    advice: str
    p: float  # where slip begins again, or where the mass rests
    phases: tuple[tuple[int, float, float], ...] = ()  # mode, duration, p at its start
    extremes: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # p_min, p_max, w_min, w_max
    mode: int = STICK  # in which the mass rests


def cycle(scene: HasFlow | Flow) -> Orbit:
    """Return the periodic orbit reached from the slip point (k x = B - c v_belt, v = v_belt).

    Parameters
    ----------
    scene : Flow, or anything with ``flow()``
        Its start, the belt's start and everything random do not enter.

    Raises
    ------
    ValueError
        For a flow that is not physical: see `rig_sim.integrate.flow.validate`.

    Notes
    -----
    Not looked for: orbits that the slip point does not lead to (an unstable one, or one that never touches stick), and
    the response to a drive.
    """
    flow = scene if isinstance(scene, Flow) else scene.flow()
    validate(flow)
    fr = frame(flow)
    if fr.u0 != 0.0:
        return Orbit("driven", "a driven mass has no orbit of its own: list its events instead")
    if is_grazing(fr):
        return grazing(fr)
    work = new_work(STEPS_ALLOWED_HERE)
    if fr.d == 0.0:
        turn = follow(fr, STICK, 0.0, 0.0, work)
        if turn.end == "":
            turn = follow(fr, NEGATIVE, turn.p, 0.0, work)
    else:
        turn = converge(fr, work)
    if turn.end == "":
        return measured(fr, turn)
    resting = None
    if turn.end == "fixed point":
        resting = position(fr, turn.p)
        if turn.mode != STICK:  # where the spring holds friction alone; heavy damping has left few digits in p
            resting = flow.x0 + force(flow, mirrored(fr, turn.mode), resting, -flow.v_belt, 0.0) / flow.k
    return Orbit(turn.end, turn.advice, x_rest=resting)


def is_grazing(fr: Frame) -> bool:
    """Tell whether slip is an undamped circle about its fixed point, touching the edge of stick."""
    if fr.curve == HYPERBOLIC or fr.B != fr.A or fr.v <= fr.d:
        return False
    return linear_terms(fr, NEGATIVE)[0] == 0.0


def grazing(fr: Frame) -> Orbit:
    """Return the circle of radius v - d about the fixed point of slip (thesis 2.4, 2.5)."""
    centre = linear_terms(fr, NEGATIVE)[1] / fr.k
    speed = fr.v - fr.d
    period = 2.0 * math.pi / fr.omega0
    return Orbit(
        "grazing",
        "stick has zero length: friction that does not fall with speed keeps the mass sliding",
        period=period,
        t_stick=0.0,
        t_slip=period,
        x_slip=position(fr, centre),
        x_stick=position(fr, centre),
        x_min=position(fr, centre) - speed / fr.omega0,
        x_max=position(fr, centre) + speed / fr.omega0,
        v_min=-speed,
        v_max=speed,
        sequence=LETTERS[mirrored(fr, NEGATIVE)] + "S",
    )


def converge(fr: Frame, work: Buffer) -> Turn:
    """Return the turn of a ramp law that ends where it began: iteration, hastened by secant steps."""
    turn = follow(fr, classify(fr, 0.0, 0.0, 0.0), 0.0, 0.0, work)
    p_before = g_before = math.nan
    p = turn.p
    plain = p
    closed = 0
    for _i in range(TURNS):
        if turn.end != "":
            return turn
        turn = follow(fr, NEGATIVE, p, -fr.d, work)
        if turn.end != "" and p != plain:  # a secant step went too far
            p = plain
            turn = follow(fr, NEGATIVE, p, -fr.d, work)
        g = turn.p - p
        slope = (g - g_before) / (p - p_before) if p != p_before else -1.0
        rounding = 4.0 * EPS * (abs(p) + abs(fr.slip))
        if abs(g) <= rounding:
            closed += 1
            if closed == NEARLY_CLOSED or abs(g) <= abs(slope) * rounding:
                return turn
        p_before, g_before = p, g
        # slope + 1 is the map's multiplier: a secant step where it contracts, plain iteration elsewhere
        plain = turn.p
        p = plain
        if -1.9 < slope < -1e-12:
            step = -g / slope
            p = p_before + math.copysign(min(abs(step), 0.5 * abs(p_before)), step)
    if turn.end != "":
        return turn
    return Turn("no cycle", f"the return map did not settle within {TURNS} turns", turn.p)


def follow(fr: Frame, mode: int, p: float, w: float, work: Buffer) -> Turn:
    """Follow the motion to the next beginning of (backward) slip out of stick or ramp, noting its extremes.

    From within stick or ramp that is the way to its end.
    """
    phases: list[tuple[int, float, float]] = []
    p_seen = [p]
    w_seen = [w]
    for _i in range(PHASES_PER_TURN):
        p_start = p
        side, tau, p, w = pass_phase(fr, mode, p, w, p_seen, w_seen, work)
        if side == 0:
            if math.isinf(tau):
                if mode != STICK and linear_terms(fr, mode)[0] < 0.0:
                    return Turn("no cycle", "damping is negative: the motion grows without end", p)
                advice = "the mass comes to rest: less damping or another speed may stick"
                return Turn("fixed point", advice, rest(fr, mode, p), mode=mode)
            if not math.isfinite(p + w):
                return Turn(*OUTCOMES[NOT_FINITE], p)
            return Turn("no cycle", f"none found within {STEPS_ALLOWED_HERE} steps", p)
        phases.append((mode, tau, p_start))
        entered = transition(fr, mode, side, p, 0.0)
        if entered == FORCE_REVERSAL:
            return Turn(*OUTCOMES[FORCE_REVERSAL], p)
        if mode in (STICK, RAMP) and entered == NEGATIVE:
            return Turn("", "", p, tuple(phases), (min(p_seen), max(p_seen), min(w_seen), max(w_seen)))
        mode = entered
    return Turn(
        "no cycle", f"no end of stick within {PHASES_PER_TURN} phases: the mass swings to and fro past the belt", p
    )


def pass_phase(
    fr: Frame, mode: int, p: float, w: float, p_seen: list[float], w_seen: list[float], work: Buffer
) -> tuple[int, float, float, float]:
    """Return (side, duration, p, w) at the end of a phase; (0, inf, p, w) when it settles, (0, tau, ...) when unclear.

    Positions and velocities at which an extreme of the phase may lie are appended to ``p_seen`` and ``w_seen``.
    """
    lo, hi = mode_bounds(fr, mode)
    durations: list[float] = []
    while work[STEPS] < work[STEPS_ALLOWED]:
        work[STEPS] += 1.0
        side, tau = phase_exit(fr, mode, p, w, 0.0, lo, hi, math.inf, work)
        if math.isinf(tau):
            return 0, tau, p, w
        for at in turning_times(fr, mode, p, w, tau, work):
            dp, dw = increments(fr, mode, p, w, 0.0, at, work)
            p_seen.append(p + dp)
            w_seen.append(w + dw)
        dp, dw = increments(fr, mode, p, w, 0.0, tau, work)
        p += dp
        w += dw
        durations.append(tau)
        if not math.isfinite(p + w):
            break
        if side != 0:
            if mode == STICK:
                w = 0.0
                p = 0.0 if side > 0 else p
            else:
                w = hi if side > 0 else lo
            p_seen.append(p)
            w_seen.append(w)
            return side, math.fsum(durations), p, w
        if settles(fr, mode, p, w):
            return 0, math.inf, p, w
    return 0, math.fsum(durations), p, w


def turning_times(fr: Frame, mode: int, p: float, w: float, tau: float, work: Buffer) -> list[float]:
    """Return the local times within tau at which w = -v or w' = 0: where x and v may be extreme."""
    if mode == STICK:
        return []
    level = -fr.v
    if is_series(fr, mode):
        scale = work[TIME_SCALE]
        for j in range(ORDER):
            work[U + j] = (j + 1) * work[W + j + 1]
        work[U + ORDER] = 0.0
        found = []
        for series, target in ((W, level), (U, 0.0)):
            before, behind = work[series] - target, value(work, series, tau / scale) - target
            if before * behind < 0.0:
                found.append(scale * first_root(work, series, target, -1 if before > 0.0 else 1, tau / scale))
        return found
    C, _ = linear_terms(fr, mode)
    zeta = 0.5 * C / fr.m
    disc = (zeta - fr.omega0) * (zeta + fr.omega0)
    a = acceleration(fr, mode, p, w, 0.0)
    u = w + fr.v
    # w' = 0, and (u' + ... ) = 0: u itself obeys the same equation as w', one derivative down
    found = []
    for start, slope in ((a, -2.0 * zeta * a - fr.omega2 * u), (u, a)):
        # the first zero of a solution with this value and slope is the first extreme of its integral
        at = first_extreme(start, -(slope + 2.0 * zeta * start) / fr.omega2, zeta, fr.omega2, disc)
        while 0.0 < at < tau and len(found) < PHASES_PER_TURN:
            found.append(at)
            if disc >= 0.0:
                break
            at += math.pi / math.sqrt(-disc)
    return found


def settles(fr: Frame, mode: int, p: float, w: float) -> bool:
    """Tell whether a slip is so close to its stable fixed point, or so heavily damped, that it cannot get away.

    Close: u^2 + omega0^2 (p - p_rest)^2 only falls; it is compared with the way to the edge and the curve's own scale.
    Heavily damped: see `creeps`.
    """
    if mode != NEGATIVE:
        return False
    C, _ = linear_terms(fr, mode)
    room = fr.v - fr.d
    slope = steepest = 0.0
    if fr.curve == HYPERBOLIC:
        q = 1.0 + fr.gamma * (slip_speed(fr, room) if fr.lag != 0.0 else room)
        slope = fr.A * fr.gamma / (q * q - fr.lag)
        steepest = fr.A * fr.gamma / (1.0 - fr.lag)
        room = min(room, q / fr.gamma)
    if not C > slope:
        return False
    if creeps(fr, w + fr.v, acceleration(fr, mode, p, w, 0.0), C - steepest):
        return True
    return math.hypot(w + fr.v, fr.omega0 * (p - rest(fr, mode, p))) < SETTLED * room


def creeps(fr: Frame, u: float, a: float, damping: float) -> bool:
    """Tell whether a slip with speed u (m/s) and acceleration a (m/s^2) only slows down from here, and never stops.

    ``damping`` (N s/m) is the least, friction's slope taken off, that holds at any speed from 0 to u.  The rate
    r = -a/u obeys r' = r^2 - (C/m) r + k/m with C the damping of the moment.  With C >= ``damping`` > 2 sqrt(k m) that
    is below 0 between the two roots, so an r from 0 to the larger root stays there: u falls, and reaches neither 0 nor
    the belt's speed.
    """
    half = 0.5 * damping / fr.m
    if not (half > fr.omega0 and u > 0.0 and a <= 0.0):
        return False
    return -a / u < half + math.sqrt((half - fr.omega0) * (half + fr.omega0))


def rest(fr: Frame, mode: int, p: float) -> float:
    """Return p of the fixed point (u = 0) a phase without end settles at; in stick, where the mass stands."""
    if mode == STICK:
        return p
    C, e = linear_terms(fr, mode)
    fall = 0.0
    if fr.curve == HYPERBOLIC and mode == NEGATIVE:
        fall = curve_deficit(fr, mode, -fr.v)
    return (C * fr.v + e + fall) / fr.k


def measured(fr: Frame, turn: Turn) -> Orbit:
    """Return the orbit a closed turn amounts to."""
    sticking = [duration for mode, duration, _ in turn.phases if mode in (STICK, RAMP)]
    slipping = [duration for mode, duration, _ in turn.phases if mode not in (STICK, RAMP)]
    p_min, p_max, w_min, w_max = turn.extremes
    ends = sorted((position(fr, p_min), position(fr, p_max)))
    speeds = sorted((fr.mirror * (w_min + fr.v), fr.mirror * (w_max + fr.v)))
    return Orbit(
        "cycle",
        period=math.fsum(sticking + slipping),
        t_stick=math.fsum(sticking),
        t_slip=math.fsum(slipping),
        x_slip=position(fr, turn.p),
        x_stick=position(fr, turn.phases[-1][2]),
        x_min=ends[0],
        x_max=ends[1],
        v_min=speeds[0],
        v_max=speeds[1],
        sequence="".join(LETTERS[mirrored(fr, mode)] for mode, _, _ in turn.phases),
    )
