"""The thesis's own method: classical Runge-Kutta of fourth order, with Henon's exchange of time and velocity at events.

Within a phase p and w advance by equal steps h of time.  When a step takes w past the edge of its mode it is
undone, and one step of the same formulas with w as the independent variable,

    dt/dw = 1/w',     dp/dw = (w + v)/w',

lands exactly on the edge (thesis 2.2; M. Henon, Physica D 5, 412, 1982).  Stick needs no integration.  The next phase
starts from the event, so errors are those of the formulas: the event times converge as h^4.  Where w' nearly vanishes
before the edge the exchange leads out of the step; then the length of the step that ends there is bisected.
Between steps the motion is one shorter step from the previous one: it converges as h^4 too.

Not seen: a visit across an edge and back within one step; grazing, where w' vanishes at the edge, loses the order.
"""

import math
from bisect import bisect_right
from functools import partial

from rig_sim.comparison.stepping import PhaseResult, PhaseSolver, Slopes, right_hand_side
from rig_sim.flow import modes
from rig_sim.flow.frame import Frame, mode_bounds
from rig_sim.integrate.work import Work

HALVINGS = 60  # of a step whose end is outside while w' at its start points inwards


def rk4(slopes: Slopes, s: float, a: float, b: float, h: float) -> tuple[float, float]:
    """Return (a, b) after one classical step h of da/ds, db/ds = slopes(s, a, b)."""
    a1, b1 = slopes(s, a, b)
    a2, b2 = slopes(s + 0.5 * h, a + 0.5 * h * a1, b + 0.5 * h * b1)
    a3, b3 = slopes(s + 0.5 * h, a + 0.5 * h * a2, b + 0.5 * h * b2)
    a4, b4 = slopes(s + h, a + h * a3, b + h * b3)
    return a + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0, b + h * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0


def step_to_edge(slopes: Slopes, t: float, p: float, w: float, edge: float, h: float) -> tuple[float, float]:
    """Return (t, p) where w reaches ``edge`` within the step h: one step with w as the independent variable."""

    def exchanged(w: float, t: float, p: float) -> tuple[float, float]:
        p_slope, w_slope = slopes(t, p, w)
        return (1.0 / w_slope, p_slope / w_slope) if w_slope != 0.0 else (math.nan, math.nan)

    t_edge, p_edge = rk4(exchanged, w, t, p, edge - w)
    if t <= t_edge <= t + h:
        return t_edge, p_edge
    inside, outside = 0.0, h
    for _i in range(HALVINGS):
        middle = 0.5 * (inside + outside)
        if (rk4(slopes, t, p, w, middle)[1] < edge) == (w < edge):
            inside = middle
        else:
            outside = middle
    return t + outside, rk4(slopes, t, p, w, outside)[0]


def slide(
    slopes: Slopes, lo: float, hi: float, t: float, p: float, w: float, h: float
) -> tuple[int, float, float, float]:
    """Return (side, t, p, w) after a step h, or at the edge (side -1, +1) when w passes one on the way."""
    for _i in range(HALVINGS):
        p_end, w_end = rk4(slopes, t, p, w, h)
        if lo <= w_end <= hi:
            return 0, t + h, p_end, w_end
        side, edge = (1, hi) if w_end > hi else (-1, lo)
        if w == edge or side * slopes(t, p, w)[1] > 0.0 or not math.isfinite(w_end):
            break
        h *= 0.5
    if w == edge:  # left at once
        return side, t, p, w
    t_edge, p_edge = step_to_edge(slopes, t, p, w, edge, h)
    return side, t_edge, p_edge, edge


def solve_phase(
    step: float, fr: Frame, mode: int, t: float, p: float, w: float, t_max: float, work: Work
) -> PhaseResult:
    """Follow a slip or ramp by steps of ``step`` (s)."""
    slopes = right_hand_side(fr, mode)
    lo, hi = mode_bounds(fr, mode)
    grid = [t]
    states = [(p, w)]

    def at(t_at: float) -> tuple[float, float]:
        i = bisect_right(grid, t_at) - 1
        return rk4(slopes, grid[i], *states[i], t_at - grid[i])

    while True:
        h = t_max - t
        last = h <= step
        side, t, p, w = slide(slopes, lo, hi, t, p, w, h if last else step)
        work.steps += 1.0
        if side == 0 and last and t >= t_max * (1.0 - 1e-15):
            t = t_max
        if side != 0 or t >= t_max or not math.isfinite(t + p + w):
            return PhaseResult(modes.COMPLETED, side, t, p, w, at)
        if work.steps >= work.steps_allowed:
            return PhaseResult(modes.STEP_LIMIT, 0, t, p, w, at)
        grid.append(t)
        states.append((p, w))


def make_rk4_solver(step: float) -> PhaseSolver:
    if not (math.isfinite(step) and step > 0.0):
        raise ValueError(f"step must be a positive number, not {step}")
    return partial(solve_phase, step)
