"""General solvers at the same task, for comparison only: scipy's DOP853, Radau and LSODA with event functions.

Each smooth phase of slip or ramp is one call of `scipy.integrate.solve_ivp` with a terminal event at the edge; stick
needs no integration.  This is the favourable way to use them: they never step across a jump of the force.
"""

import math
from typing import Any

from scipy.integrate import solve_ivp

from rig_sim.integrate.events import EventList
from rig_sim.integrate.hybrid import RAPID_ALLOWED, RAPID_TIME, seen
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
    edges,
    frame,
    landing,
    position,
    validate,
)
from rig_sim.integrate.rk4_henon import right_hand_side, through_stick

SOLVERS = {"dop853": "DOP853", "radau": "Radau", "lsoda": "LSODA"}


class _TooManyEvaluations(Exception):  # noqa: N818  # becomes the outcome `step limit`
    pass


def list_events(
    flow: Flow, x: float, v: float, t_max: float, *, method: str, rtol: float, max_evaluations: int = 2_000_000
) -> EventList:
    """Return the events between 0 and t_max (s) of a motion that starts at x (m) with velocity v (m/s).

    Parameters
    ----------
    flow, x, v, t_max
        As for `rig_sim.integrate.events.list_events`.
    method : str
        A key of `SOLVERS`.
    rtol : float
        Relative tolerance; the absolute one is the same number, in the scene's units.
    max_evaluations : int
        Of the right-hand side, after which the run ends with the outcome 'step limit'.  An explicit method in a steep
        ramp gets there: its steps shrink with the ramp.

    Returns
    -------
    EventList
        ``steps`` counts evaluations of the right-hand side.

    Raises
    ------
    ValueError
        For a flow that is not physical, or an unknown method.
    """
    validate(flow)
    if method not in SOLVERS:
        raise ValueError(f"method is {method!r}; need one of {', '.join(SOLVERS)}")
    fr = frame(flow)
    counter = [0, max_evaluations]
    t, p, w = 0.0, displacement(fr, x), fr.mirror * (v - flow.v_belt)
    mode = classify(fr, p, w, t)
    found: list[tuple[float, float, str]] = []
    outcome = COMPLETED
    rapid = 0
    while t < t_max:
        t_before = t
        try:
            side, t, p, w = _pass(fr, mode, t, p, w, t_max, SOLVERS[method], rtol, counter)
        except _TooManyEvaluations:
            outcome = STEP_LIMIT
            break
        if not math.isfinite(t + p + w):
            outcome = NOT_FINITE
            break
        if side == 0 or t > t_max:
            break
        entered = landing(fr, mode, side, p, t)
        if entered == FORCE_REVERSAL:
            outcome = FORCE_REVERSAL
            break
        found.append((t, position(fr, p), KINDS[seen(fr, 4 * mode + entered)]))
        mode = entered
        rapid = rapid + 1 if t - t_before <= RAPID_TIME / math.sqrt(fr.omega2) else 0
        if rapid > RAPID_ALLOWED:
            outcome = EVENT_RATE
            break
    name, advice = OUTCOMES[outcome]
    times, places, kinds = zip(*found, strict=True) if found else ((), (), ())
    return EventList(times, places, kinds, name, advice, counter[0])


def _pass(
    fr: Frame, mode: int, t: float, p: float, w: float, t_max: float, solver: str, rtol: float, counter: list[int]
) -> tuple[int, float, float, float]:
    """Return (side, t, p, w) at the end of a phase, or at t_max with side 0."""
    if mode == STICK:
        return through_stick(fr, t, p, t_max)
    slopes = right_hand_side(fr, mode)

    def rates(tau: float, y: Any) -> tuple[float, float]:
        counter[0] += 1
        if counter[0] > counter[1]:
            raise _TooManyEvaluations
        return slopes(t + tau, float(y[0]), float(y[1]))

    def distance(edge: float, direction: float) -> Any:
        def event(tau: float, y: Any) -> float:
            return float(y[1]) - edge

        event.terminal = True  # type: ignore[attr-defined]
        event.direction = direction  # type: ignore[attr-defined]
        return event

    lo, hi = edges(fr, mode)
    ends = [(side, edge) for side, edge in ((-1, lo), (1, hi)) if math.isfinite(edge)]
    found = solve_ivp(  # type: ignore[call-overload]  # the solver is named by a variable
        rates,
        (0.0, t_max - t),
        (p, w),
        method=solver,
        rtol=rtol,
        atol=rtol,
        events=[distance(edge, side) for side, edge in ends],
    )
    for (side, edge), times, states in zip(ends, found.t_events, found.y_events, strict=True):
        if len(times):
            return side, t + float(times[0]), float(states[0][0]), edge
    if found.status != 0:
        return 0, math.nan, math.nan, math.nan
    return 0, t_max, float(found.y[0][-1]), float(found.y[1][-1])
