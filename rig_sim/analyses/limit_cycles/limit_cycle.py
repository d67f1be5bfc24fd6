"""The periodic orbit of one mass on a belt: `cycle(scene)` finds it from the slip point and measures it.

A jump law restarts every slip from the same point, so one slip and one stick are the orbit, exactly.  A ramp law's
orbit is the fixed point of its return map on the edge where slip begins, found by iteration with secant steps.
The search ends within `TURNS` evaluations of the return map and 20 000 integrator steps.  What was found instead of
an orbit is an outcome, not an error.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from rig_sim.flow import modes
from rig_sim.flow.contact_state import classify, force
from rig_sim.flow.flow import Flow, validate
from rig_sim.flow.frame import Frame, frame, is_curved, linear_terms, mirror_mode, position
from rig_sim.integrate.newton import EPS
from rig_sim.integrate.work import Work, new_work
from rig_sim.systems.turn import STEPS_OF_SEARCH, Turn, next_slip

TURNS = 300  # evaluations of the return map
# Turns closed to rounding after which the search ends, where the map almost touches the diagonal and rounding decides
# on p.
NEARLY_CLOSED = 8


class HasFlow(Protocol):
    def flow(self) -> Flow: ...


@dataclass(frozen=True)
class Orbit:
    """A periodic orbit, or what was found in its place.

    Parameters
    ----------
    outcome : str
        'cycle'; 'grazing' (a circle that touches the edge of stick, stick time 0: constant friction); 'fixed point'
        (the mass comes to rest at ``x_rest``); 'pure slip' (it swings without ever sticking); 'no cycle'; 'driven'; or
        how the motion ended ('force reversal' ...).
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


def cycle(scene: HasFlow | Flow) -> Orbit:
    """Return the periodic orbit reached from the slip point (k x = B - c v_belt, v = v_belt).

    The scene's start, the belt's start and random sections are ignored.  Not searched: orbits that the slip point does
    not lead to (an unstable one, or one that never touches stick), and the response to a drive.
    """
    flow = scene if isinstance(scene, Flow) else scene.flow()
    validate(flow)
    fr = frame(flow)
    if fr.u0 != 0.0:
        return Orbit("driven", "this analysis does not apply to a driven mass; list its events instead")
    if is_grazing(fr):
        return make_grazing_orbit(fr)
    work = new_work(STEPS_OF_SEARCH)
    if fr.d == 0.0:
        turn = next_slip(fr, modes.STICK, 0.0, 0.0, work)
        if turn.end == "":
            turn = next_slip(fr, modes.NEGATIVE, turn.p, 0.0, work)
    else:
        turn = find_closed_turn(fr, work)
    if turn.end == "":
        return make_orbit(fr, turn)
    x_rest = None
    if turn.end == "fixed point":
        x_rest = position(fr, turn.p)
        if turn.mode != modes.STICK:  # where the spring holds friction alone; heavy damping leaves few digits in p
            x_rest = flow.x0 + force(flow, mirror_mode(fr, turn.mode), x_rest, -flow.v_belt, 0.0) / flow.k
    return Orbit(turn.end, turn.advice, x_rest=x_rest)


def has_stick_slip_orbit(flow: Flow) -> bool:
    """Return whether `cycle` finds an orbit that sticks, faster under a jump law: it stops where slip lasts."""
    fr = frame(flow)
    if fr.d > 0.0 or fr.u0 != 0.0 or is_grazing(fr):
        return cycle(flow).outcome == "cycle"
    validate(flow)
    work = new_work(STEPS_OF_SEARCH)
    turn = next_slip(fr, modes.STICK, 0.0, 0.0, work)
    return turn.end == "" and next_slip(fr, modes.NEGATIVE, turn.p, 0.0, work, to_the_end=False).end == ""


def is_grazing(fr: Frame) -> bool:
    """Return whether slip is an undamped circle about its fixed point that touches the edge of stick."""
    if is_curved(fr, modes.NEGATIVE) or fr.B != fr.A or fr.v <= fr.d:
        return False
    return linear_terms(fr, modes.NEGATIVE)[0] == 0.0


def make_grazing_orbit(fr: Frame) -> Orbit:
    """Return the circle of radius v - d about the fixed point of slip (thesis 2.4, 2.5)."""
    centre = linear_terms(fr, modes.NEGATIVE)[1] / fr.k
    speed = fr.v - fr.d
    period = 2.0 * math.pi / fr.omega0
    return Orbit(
        "grazing",
        "the stick has zero length, because friction that does not decrease with speed keeps the mass sliding",
        period=period,
        t_stick=0.0,
        t_slip=period,
        x_slip=position(fr, centre),
        x_stick=position(fr, centre),
        x_min=position(fr, centre) - speed / fr.omega0,
        x_max=position(fr, centre) + speed / fr.omega0,
        v_min=-speed,
        v_max=speed,
        sequence=modes.LETTERS[mirror_mode(fr, modes.NEGATIVE)] + "S",
    )


def find_closed_turn(fr: Frame, work: Work) -> Turn:
    """Return the closed turn of a ramp law: plain iteration of the return map and secant steps."""
    turn = next_slip(fr, classify(fr, 0.0, 0.0, 0.0), 0.0, 0.0, work)
    p_before = g_before = math.nan
    p = turn.p
    iterate = p
    closed = 0
    for _i in range(TURNS):
        if turn.end != "":
            return turn
        turn = next_slip(fr, modes.NEGATIVE, p, -fr.d, work)
        if turn.end != "" and p != iterate:  # a secant step went too far
            p = iterate
            turn = next_slip(fr, modes.NEGATIVE, p, -fr.d, work)
        g = turn.p - p
        slope = (g - g_before) / (p - p_before) if p != p_before else -1.0
        rounding = 4.0 * EPS * (abs(p) + abs(fr.slip))
        if abs(g) <= rounding:
            closed += 1
            if closed == NEARLY_CLOSED or abs(g) <= abs(slope) * rounding:
                return turn
        p_before, g_before = p, g
        # slope + 1 is the map's multiplier: a secant step where it contracts, plain iteration elsewhere
        iterate = turn.p
        p = iterate
        if -1.9 < slope < -1e-12:
            step = -g / slope
            p = p_before + math.copysign(min(abs(step), 0.5 * abs(p_before)), step)
    if turn.end != "":
        return turn
    return Turn("no cycle", f"the return map did not settle within {TURNS} turns", turn.p)


def make_orbit(fr: Frame, turn: Turn) -> Orbit:
    """Return the orbit of a closed turn in the flow's own coordinates."""
    sticking = [duration for mode, duration, _ in turn.phases if mode in (modes.STICK, modes.RAMP)]
    slipping = [duration for mode, duration, _ in turn.phases if mode not in (modes.STICK, modes.RAMP)]
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
        sequence="".join(modes.LETTERS[mirror_mode(fr, mode)] for mode, _, _ in turn.phases),
    )
