"""Follow a driven mass and note its passages of sections, with the growth of a small deviation: the compiled kernel.

Sections are bits of a mask, so that several can be followed at once:

    STROBE   the drive's phase is 0, once per drive period
    SLIP     break-away: a transition from stick (or ramp) to slip
    LANDING  a transition from slip to stick (or ramp)

Time is counted within the drive period and begins anew in every period, so that a motion that repeats does so bit for
bit, however long it has lasted.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from rig_sim.flow import modes
from rig_sim.flow.contact_state import transition
from rig_sim.flow.frame import Frame, mode_bounds
from rig_sim.flow.modes import FORCE_REVERSAL, NOT_FINITE, OUTCOMES, STEP_LIMIT, Outcome
from rig_sim.integrate.phases import RAPID_ALLOWED, RAPID_TIME, increments, phase_exit
from rig_sim.integrate.work import Buffer, Work, unboxed
from rig_sim.systems.variation import after_event, deviation

STROBE, SLIP, LANDING = 1, 2, 4
NO_PASSAGE = 30
ENDS = {
    **OUTCOMES,
    NO_PASSAGE: Outcome("no stick", "the mass does not stick within many oscillations"),
}
TIME, POSITION, VELOCITY, FACTOR, SECTION = range(5)  # columns of a passage
COLUMNS = 5


@dataclass(slots=True)
class DrivenState:
    mode: float  # in the frame
    p: float  # displacement, m
    w: float  # relative velocity, m/s
    t: float  # time within the drive period, s
    turns: float  # whole drive periods
    dp: float  # deviation of p
    dw: float  # deviation of w
    growth: float  # logarithm of the deviation's growth since the last passage
    last: float  # whole drive periods at the last passage


class Clock(NamedTuple):
    """The drive's period (s), and the number of periods without a passage that ends the motion (`NO_PASSAGE`)."""

    period: float
    patience: float


def list_passages(
    fr: Frame, clock: Clock, mask: int, tangent: int, number: int, state: DrivenState, out: Buffer, work: Work
) -> tuple[int, int]:
    """Follow the motion from ``state`` to its next ``number`` passages of the sections in ``mask``.

    ``tangent`` is 1 to follow the deviation.  Rows of ``out``: drive periods, displacement and relative velocity in the
    frame, growth, section.  Returns 0 or a key of `ENDS`, and the number of passages; ``place`` becomes the state at
    the end.
    """
    state, work = unboxed(state), unboxed(work)
    period = clock.period
    mode = int(state.mode)
    p, w, t = state.p, state.w, state.t
    dp, dw, growth = state.dp, state.dw, state.growth
    count = 0
    outcome = 0
    while count < number:
        if work.steps >= work.steps_allowed:
            outcome = STEP_LIMIT
            break
        if state.turns - state.last > clock.patience:
            outcome = NO_PASSAGE
            break
        lo, hi = mode_bounds(fr, mode)
        side = 0
        tau = 0.0
        if t < period:
            work.steps += 1.0
            side, tau = phase_exit(fr, mode, p, w, t, lo, hi, period - t, work)
        if tau > 0.0:
            if tangent == 1:
                dp, dw = deviation(fr, mode, p, w, t, tau, dp, dw, work)
                dp, dw, more = normalise(fr, dp, dw)
                growth += more
            more_p, more_w = increments(fr, mode, p, w, t, tau, work)
            p += more_p
            w += more_w
        if not math.isfinite(p + w):
            outcome = NOT_FINITE
            break
        section = 0
        if side == 0:
            if tau < period - t:
                t += tau
                work.rapid = 0.0
                continue
            section = STROBE
            t = 0.0
            state.turns += 1.0
        else:
            t += tau
            w = 0.0 if mode == modes.STICK else (hi if side > 0 else lo)
            entered = transition(fr, mode, side, p, t)
            if entered >= FORCE_REVERSAL:
                outcome = entered
                break
            if tangent == 1:
                dw = after_event(fr, mode, entered, side, p, w, t, dp, dw)
            work.rapid = work.rapid + 1.0 if tau * fr.omega0 <= RAPID_TIME else 0.0
            if work.rapid > RAPID_ALLOWED:
                outcome = modes.EVENT_RATE
                break
            if mode == modes.STICK or mode == modes.RAMP:
                section = SLIP
            elif entered == modes.STICK or entered == modes.RAMP:
                section = LANDING
            mode = entered
        if section & mask != 0:
            if tangent == 1:
                dp, dw, more = normalise(fr, dp, dw)
                growth += more
            row = count * COLUMNS
            out[row + TIME] = state.turns + t / period
            out[row + POSITION] = p
            out[row + VELOCITY] = w
            out[row + FACTOR] = growth
            out[row + SECTION] = float(section)
            growth = 0.0
            state.last = state.turns
            count += 1
    state.mode = float(mode)
    state.p, state.w, state.t = p, w, t
    state.dp, state.dw, state.growth = dp, dw, growth
    return outcome, count


def normalise(fr: Frame, dp: float, dw: float) -> tuple[float, float, float]:
    """Return a deviation of size 1, hypot(omega0 dp, dw), in the same direction, and the logarithm of its size."""
    size = math.hypot(fr.omega0 * dp, dw)
    if not size > 0.0:
        return 1.0 / fr.omega0, 0.0, -math.inf
    return dp / size, dw / size, math.log(size)
