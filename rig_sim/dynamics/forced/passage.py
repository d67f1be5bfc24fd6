"""Follow a driven mass and note its passages of sections, with the growth of a small deviation: the compiled kernel.

Sections are bits of a mask, so that several can be followed at once:

    STROBE   the drive's phase is 0, once per drive period
    SLIP     break-away: a transition from stick (or ramp) to slip
    LANDING  a transition from slip to stick (or ramp)

Time is counted within the drive period and begins anew in every period, so that a motion that repeats does so bit for
bit, however long it has lasted.
"""

import math
from collections.abc import Callable
from functools import cache

from rig_sim.dynamics.forced.variation import after_event, deviation
from rig_sim.flow import modes
from rig_sim.flow.contact_state import transition
from rig_sim.flow.frame import Frame, mode_bounds
from rig_sim.flow.modes import FORCE_REVERSAL, NOT_FINITE, OUTCOMES, STEP_LIMIT, Outcome
from rig_sim.integrate import buffer
from rig_sim.integrate.buffer import Buffer
from rig_sim.integrate.phases import RAPID_ALLOWED, RAPID_TIME, increments, phase_exit

STROBE, SLIP, LANDING = 1, 2, 4
NO_PASSAGE = 30
ENDS = {
    **OUTCOMES,
    NO_PASSAGE: Outcome("no stick", "the mass does not stick any more within the time of many oscillations"),
}
# Places in the state: mode, displacement (m) and relative velocity (m/s) in the frame, time within the drive period
# (s), whole drive periods, the deviation, the logarithm of its growth, drive periods at the last passage.
MODE, P, W, T, TURNS, DP, DW, GROWTH, LAST = range(9)
STATE = 9
TIME, POSITION, VELOCITY, FACTOR, SECTION = range(5)  # columns of a passage
COLUMNS = 5


def passages(
    fr: Frame,
    period: float,
    patience: float,
    mask: int,
    tangent: int,
    number: int,
    state: Buffer,
    out: Buffer,
    work: Buffer,
) -> tuple[int, int]:
    """Follow the motion to its next ``number`` passages of the sections in ``mask``.

    Parameters
    ----------
    period : float
        Of the drive, s.
    patience : float
        Drive periods without a passage after which the motion ends in `NO_PASSAGE`.
    tangent : int
        1 to follow the deviation, 0 to leave it as it is.
    state : (STATE,) float64
        Where the motion begins; left where it ends.
    out : (number * COLUMNS,) float64
        Row after row: drive periods, displacement and relative velocity in the frame, growth, the section.

    Returns
    -------
    (outcome, count)
        0 or a key of `ENDS`; how many passages were noted.
    """
    mode = int(state[MODE])
    p, w, t = state[P], state[W], state[T]
    dp, dw, growth = state[DP], state[DW], state[GROWTH]
    count = 0
    outcome = 0
    while count < number:
        if work[buffer.STEPS] >= work[buffer.STEPS_ALLOWED]:
            outcome = STEP_LIMIT
            break
        if state[TURNS] - state[LAST] > patience:
            outcome = NO_PASSAGE
            break
        lo, hi = mode_bounds(fr, mode)
        side = 0
        tau = 0.0
        if t < period:
            work[buffer.STEPS] += 1.0
            side, tau = phase_exit(fr, mode, p, w, t, lo, hi, period - t, work)
        if tau > 0.0:
            if tangent == 1:
                dp, dw = deviation(fr, mode, p, w, t, tau, dp, dw, work)
                dp, dw, more = normalised(fr, dp, dw)
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
                work[buffer.RAPID] = 0.0
                continue
            section = STROBE
            t = 0.0
            state[TURNS] += 1.0
        else:
            t += tau
            w = 0.0 if mode == modes.STICK else (hi if side > 0 else lo)
            entered = transition(fr, mode, side, p, t)
            if entered >= FORCE_REVERSAL:
                outcome = entered
                break
            if tangent == 1:
                dw = after_event(fr, mode, entered, side, p, w, t, dp, dw)
            work[buffer.RAPID] = work[buffer.RAPID] + 1.0 if tau * fr.omega0 <= RAPID_TIME else 0.0
            if work[buffer.RAPID] > RAPID_ALLOWED:
                outcome = modes.EVENT_RATE
                break
            if mode == modes.STICK or mode == modes.RAMP:
                section = SLIP
            elif entered == modes.STICK or entered == modes.RAMP:
                section = LANDING
            mode = entered
        if section & mask != 0:
            if tangent == 1:
                dp, dw, more = normalised(fr, dp, dw)
                growth += more
            at = count * COLUMNS
            out[at + TIME] = state[TURNS] + t / period
            out[at + POSITION] = p
            out[at + VELOCITY] = w
            out[at + FACTOR] = growth
            out[at + SECTION] = float(section)
            growth = 0.0
            state[LAST] = state[TURNS]
            count += 1
    state[MODE] = float(mode)
    state[P], state[W], state[T] = p, w, t
    state[DP], state[DW], state[GROWTH] = dp, dw, growth
    return outcome, count


def normalised(fr: Frame, dp: float, dw: float) -> tuple[float, float, float]:
    """Return a deviation of size 1, hypot(omega0 dp, dw), in the same direction, and the logarithm of its size."""
    size = math.hypot(fr.omega0 * dp, dw)
    if not size > 0.0:
        return 1.0 / fr.omega0, 0.0, -math.inf
    return dp / size, dw / size, math.log(size)


@cache
def compiled_passages() -> Callable[..., tuple[int, int]]:
    """Return `passages` as machine code."""
    from rig_sim.integrate.compiled import compiled

    return compiled(passages, "rig_sim.dynamics.forced.variation", __name__)
