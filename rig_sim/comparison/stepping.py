"""The loop over phases for methods that step numerically: thesis's Runge-Kutta and scipy's solvers, for comparison.

What ends a phase, which mode follows and how a run ends are the exact method's own rules (`rig_sim.flow.modes`,
and `rig_sim.integrate.phases.sample_phase`, whose signature `sample_phase` has); stick is in closed form too.  A method
adds how it goes through one slip or ramp: a `PhaseSolver`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from rig_sim.flow import modes
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import Frame, curve_deficit, drive, frame, linear_terms, mirror_mode, position
from rig_sim.integrate.driven import driven_stick_exit
from rig_sim.integrate.linear import stick_exit
from rig_sim.integrate.phases import Samples, State, enter_frame, leave_frame, pass_edge, unmirrored_kind
from rig_sim.integrate.work import Work

Slopes = Callable[[float, float, float], tuple[float, float]]


class PhaseResult(NamedTuple):
    """A phase, or as much of it as the steps allowed."""

    end: int  # COMPLETED, STEP_LIMIT or NOT_FINITE
    side: int  # -1, +1 at the phase's lower, upper edge, 0 elsewhere
    t: float  # of the end, with the state there
    p: float
    w: float
    state_at: Callable[[float], tuple[float, float]]  # (p, w) at any time from the phase's start to t


PhaseSolver = Callable[[Frame, int, float, float, float, float, Work], PhaseResult]
"""Called with frame, mode, t, p, w, t_max, work."""


def right_hand_side(fr: Frame, mode: int) -> Slopes:
    """Return dp/dt, dw/dt of a slip or ramp as a function of (t, p, w)."""
    C, e = linear_terms(fr, mode)

    def slopes(t: float, p: float, w: float) -> tuple[float, float]:
        return w + fr.v, (-C * w - fr.k * p + e + curve_deficit(fr, mode, w) + drive(fr, t)) / fr.m

    return slopes


def solve_stick(fr: Frame, t: float, p: float, t_max: float, work: Work) -> PhaseResult:
    work.steps += 1.0
    rest = t_max - t
    side, tau = driven_stick_exit(fr, p, t, rest) if fr.u0 != 0.0 else stick_exit(fr, p, rest)
    t_end = t_max if side == 0 and tau >= rest else t + tau
    return PhaseResult(modes.COMPLETED, side, t_end, p + fr.v * tau, 0.0, lambda t_at: (p + fr.v * (t_at - t), 0.0))


def solve_checked(
    solver: PhaseSolver, fr: Frame, mode: int, t: float, p: float, w: float, t_max: float, work: Work
) -> PhaseResult:
    """Return the phase from (t, p, w) to its end, to t_max or to where the solver stops."""
    start = PhaseResult(modes.COMPLETED, 0, t, p, w, lambda _: (p, w))
    if not math.isfinite(p + w + t_max - t):
        return start._replace(end=modes.NOT_FINITE)
    if t >= t_max:
        return start
    if work.steps >= work.steps_allowed:
        return start._replace(end=modes.STEP_LIMIT)
    result = solve_stick(fr, t, p, t_max, work) if mode == modes.STICK else solver(fr, mode, t, p, w, t_max, work)
    return result if math.isfinite(result.t + result.p + result.w) else start._replace(end=modes.NOT_FINITE)


def sample_phase(
    solver: PhaseSolver, flow: Flow, state: State, t_max: float, samples: Samples, i: int, work: Work
) -> tuple[int, State, int]:
    """Continue to the next event, or to t_max, storing the motion: as `rig_sim.integrate.phases.sample_phase`.

    ``work`` counts the method's steps, or its evaluations of the right-hand side.
    """
    fr = frame(flow)
    mode, p, w, t, _ = enter_frame(fr, state)
    phase_start, kind = t, -1
    while kind < 0:
        result = solve_checked(solver, fr, mode, t, p, w, t_max, work)
        while result.end != modes.NOT_FINITE and i < samples.n and samples.t[i] <= result.t:
            p_at, w_at = (p, w) if samples.t[i] <= t else result.state_at(samples.t[i])
            samples.x[i] = position(fr, p_at)
            samples.v[i] = fr.mirror * (w_at + fr.v)
            samples.mode[i] = float(mirror_mode(fr, mode))
            i += 1
        p, w, t = result.p, result.w, result.t
        if result.end != modes.COMPLETED:
            kind = result.end
        elif result.side != 0:
            kind, mode = pass_edge(fr, mode, result.side, p, t, phase_start, work)
        elif t >= t_max:
            work.rapid = 0.0
            kind = modes.COMPLETED
    return unmirrored_kind(fr, kind), leave_frame(fr, State(mode, p, w, t)), i
