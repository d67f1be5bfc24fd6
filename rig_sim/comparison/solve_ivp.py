"""General solvers, for comparison only: scipy's DOP853, Radau and LSODA with event functions.

Each smooth phase of slip or ramp is one call of `scipy.integrate.solve_ivp` with a terminal event at the edge; stick
needs no integration.  This favours them: they never step across a jump of the force.  Between
steps the motion is the solver's own interpolant.
"""

import math
from functools import partial
from typing import Any

from scipy.integrate import solve_ivp

from rig_sim.comparison.stepping import PhaseResult, PhaseSolver, right_hand_side
from rig_sim.flow import modes
from rig_sim.flow.frame import Frame, mode_bounds
from rig_sim.integrate.work import Work

SOLVERS = {"dop853": "DOP853", "radau": "Radau", "lsoda": "LSODA"}


class _TooManyEvaluations(Exception):  # noqa: N818  # becomes the outcome `step limit`
    pass


def solve_phase(
    solver: str,
    rtol: float,
    dense: bool,
    fr: Frame,
    mode: int,
    t: float,
    p: float,
    w: float,
    t_max: float,
    work: Work,
) -> PhaseResult:
    """Follow a slip or ramp in one call of the solver; ``work`` counts evaluations."""
    slopes = right_hand_side(fr, mode)

    def rates(tau: float, y: Any) -> tuple[float, float]:
        if work.steps >= work.steps_allowed:
            raise _TooManyEvaluations
        work.steps += 1.0
        return slopes(t + tau, float(y[0]), float(y[1]))

    def distance(edge: float, direction: float) -> Any:
        def event(tau: float, y: Any) -> float:
            return float(y[1]) - edge

        event.terminal = True  # type: ignore[attr-defined]
        event.direction = direction  # type: ignore[attr-defined]
        return event

    lo, hi = mode_bounds(fr, mode)
    ends = [(side, edge) for side, edge in ((-1, lo), (1, hi)) if math.isfinite(edge)]
    try:
        solution = solve_ivp(  # type: ignore[call-overload]  # the solver is named by a variable
            rates,
            (0.0, t_max - t),
            (p, w),
            method=solver,
            rtol=rtol,
            atol=rtol,
            events=[distance(edge, side) for side, edge in ends],
            dense_output=dense,
        )
    except _TooManyEvaluations:
        return PhaseResult(modes.STEP_LIMIT, 0, t, p, w, lambda _: (p, w))

    def at(t_at: float) -> tuple[float, float]:
        p_at, w_at = (
            solution.sol(t_at - t) if solution.sol is not None else solution.y[:, -1]
        )  # without it only the end is requested
        return float(p_at), float(w_at)

    for (side, edge), times, states in zip(ends, solution.t_events, solution.y_events, strict=True):
        if len(times):
            return PhaseResult(modes.COMPLETED, side, t + float(times[0]), float(states[0][0]), edge, at)
    if solution.status != 0:
        return PhaseResult(modes.COMPLETED, 0, math.nan, math.nan, math.nan, at)
    return PhaseResult(modes.COMPLETED, 0, t_max, float(solution.y[0][-1]), float(solution.y[1][-1]), at)


def make_ivp_solver(method: str, rtol: float, *, dense: bool) -> PhaseSolver:
    """Return the method: a key of `SOLVERS` at relative tolerance ``rtol``; ``dense`` for states at times between."""
    if method not in SOLVERS:
        raise ValueError(f"method must be one of {', '.join(SOLVERS)}, not {method!r}")
    if not (math.isfinite(rtol) and rtol > 0.0):
        raise ValueError(f"rtol must be a positive number, not {rtol}")
    return partial(solve_phase, SOLVERS[method], rtol, dense)
