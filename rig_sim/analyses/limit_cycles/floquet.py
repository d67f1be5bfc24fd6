"""Floquet multipliers of the periodic orbits of one mass on a belt, stable and unstable.

The stable orbit is the one that `rig_sim.analyses.limit_cycles.limit_cycle` reaches from the slip point.  Where a
stable fixed point lies inside it, an unstable orbit separates the two: on the map from one minimum of the position to
the next (`rig_sim.systems.turn`) it is the fixed point between theirs, found as a bracketed root.  An
orbit in the plane has two multipliers: 1 along the orbit, and that of the map across it.
"""

import math
from dataclasses import dataclass
from typing import Literal

from rig_sim.analyses.limit_cycles.fixed_point import fixed_point
from rig_sim.analyses.limit_cycles.limit_cycle import Orbit, cycle
from rig_sim.flow import modes
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import Frame, displacement, frame, mirror_mode, position
from rig_sim.integrate.work import new_work
from rig_sim.systems.turn import STEPS_OF_SEARCH, MinimumTurn, next_minimum

STABLE_TO = (
    1e-9  # share of the distance between the fixed point and the stable orbit: margin of the search at both ends
)
PARTS = 4.0  # by which the search divides the distance to the fixed point from one try to the next
LEAST = 4.0 * math.ulp(1.0)  # relative width of the bracket at the end


@dataclass(frozen=True)
class FloquetOrbit:
    """A periodic orbit and its multipliers, or what was found in its place.

    Attributes
    ----------
    outcome : str
        'cycle'; 'grazing'; 'no cycle' or another reason, with ``advice``.
    multipliers : tuple of float
        1 (along the orbit) and the one across it: below 1 in size for a stable orbit, 0 for one that sticks.
    period : float or None
        s.
    x_min, x_max : float or None
        Extremes of the position, m.
    sequence : str
        Letters of the phases from the minimum of the position (the maximum where the belt runs backwards).
    """

    outcome: str
    advice: str = ""
    multipliers: tuple[float, ...] = ()
    period: float | None = None
    x_min: float | None = None
    x_max: float | None = None
    sequence: str = ""


def floquet(flow: Flow, which: Literal["stable", "unstable"] = "stable", *, orbit: Orbit | None = None) -> FloquetOrbit:
    """Return the stable or the unstable periodic orbit of a flow (one mass, no drive) with its multipliers.

    ``orbit`` is the result of `rig_sim.analyses.limit_cycles.limit_cycle.cycle` for the flow, if known already.

    Not searched: a second unstable orbit between the same two attractors, and orbits that no attractor bounds.
    """
    orbit = cycle(flow) if orbit is None else orbit
    if orbit.outcome not in ("cycle", "grazing") or orbit.x_min is None or orbit.x_max is None:
        if which == "unstable" and orbit.outcome == "fixed point":
            return FloquetOrbit(
                "no cycle",
                "there is no stick-slip orbit around the fixed point, and therefore no unstable orbit between them",
            )
        return FloquetOrbit(orbit.outcome, orbit.advice)
    fr = frame(flow)
    outer = displacement(fr, orbit.x_min if fr.mirror > 0.0 else orbit.x_max)
    if which == "stable":
        turn = next_minimum(fr, outer, new_work(STEPS_OF_SEARCH))
        return make_orbit(fr, turn, 1.0 if orbit.outcome == "grazing" else turn.multiplier, orbit.outcome)
    inner = fixed_point(flow)
    if inner.x is None or not inner.stable:
        return FloquetOrbit("no cycle", "the fixed point is not stable, so no unstable orbit surrounds it")
    turn = find_separating_turn(fr, outer, displacement(fr, inner.x))
    return make_orbit(fr, turn, turn.multiplier, "cycle")


def make_orbit(fr: Frame, turn: MinimumTurn, multiplier: float, outcome: str) -> FloquetOrbit:
    """Return the orbit of a closed turn in the flow's own coordinates; or why there is none."""
    if turn.end:
        return FloquetOrbit(turn.end, turn.advice)
    x_min, x_max = sorted((position(fr, turn.p), position(fr, turn.p_max)))
    letters = "".join(modes.LETTERS[mirror_mode(fr, mode)] for mode in turn.modes)
    return FloquetOrbit(outcome, "", (1.0, multiplier), turn.duration, x_min, x_max, letters)


def find_separating_turn(fr: Frame, outer: float, inner: float) -> MinimumTurn:
    """Return the turn from the unstable orbit's minimum: between p (m) of the stable orbit's and of the fixed point."""
    # A start beyond the unstable orbit moves out, to a smaller minimum; one within it moves in.
    width = inner - outer
    low = outer + STABLE_TO * width
    step = width
    while step > STABLE_TO * width:
        step /= PARTS
        high = inner - step
        turn = next_minimum(fr, high, new_work(STEPS_OF_SEARCH))
        if turn.end not in ("", "fixed point"):
            return turn
        if turn.end or turn.p > high:
            break
        low = high
    else:
        return MinimumTurn("no cycle", "every motion outside the fixed point grows, and no unstable orbit was found")
    while high - low > LEAST * (abs(high) + abs(fr.slip)):
        middle = 0.5 * (low + high)
        turn = next_minimum(fr, middle, new_work(STEPS_OF_SEARCH))
        if turn.end not in ("", "fixed point"):
            return turn
        if turn.end or turn.p > middle:
            high = middle
        else:
            low = middle
    return next_minimum(fr, 0.5 * (low + high), new_work(STEPS_OF_SEARCH))
