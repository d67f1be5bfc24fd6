"""Follow a driven mass and note its passages of sections, with the growth of a small deviation: the compiled kernel.

Sections are bits of a mask, so that several can be followed at once:

    STROBE   the drive's phase is 0, once per drive period
    SLIP     break-away: a transition from stick (or ramp) to slip
    LANDING  a transition from slip to stick (or ramp)

Time is counted within the drive period and begins anew in every period, so that a motion that repeats does so bit for
bit, however long it has lasted.

A driven mass as the analyses see it: its passages of the stroboscopic section, of break-away or of landing.

The stroboscopic section is the state (x, v) at phase 0 of the drive, once per drive period; its points show how many
drive periods an attractor takes.  The slip section is the position at break-away: there the spring, the damper and the
drive balance the break-away level, so that the drive's phase alone is left of the state.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rig_sim.flow import modes
from rig_sim.flow.contact_state import force, initial_mode, transition
from rig_sim.flow.flow import Flow, validate
from rig_sim.flow.frame import Frame, displacement, frame, mirror_mode, mode_bounds, position
from rig_sim.flow.modes import FORCE_REVERSAL, NOT_FINITE, OUTCOMES, STEP_LIMIT, Outcome
from rig_sim.integrate.compiled import compiled, for_kernels
from rig_sim.integrate.phases import RAPID_ALLOWED, RAPID_TIME, increments, phase_exit
from rig_sim.integrate.work import Buffer, Work, new_record, new_work, unboxed
from rig_sim.systems.interface import Passages, StepBudget
from rig_sim.systems.variation import after_event, deviation
from stickslip.compute.arrays import Array

STROBE, SLIP, LANDING = 1, 2, 4
NO_PASSAGE = 30
ENDS = {
    **OUTCOMES,
    NO_PASSAGE: Outcome("no stick", "the mass no longer sticks within many oscillations"),
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


SECTIONS = {"poincare": STROBE, "slip": SLIP, "landing": LANDING}
# Integrator steps allowed of one call, about 0.5 us each, and of every requested passage: 3 to 30 are usual.  A drive
# period that lasts for hundreds of stick-slip cycles takes more, and ends in the outcome 'step limit'.
STEPS_OF_CALL, STEPS_OF_PASSAGE = 100_000, 300
# Integrator steps of all starts at one value of a parameter, 10 s; 200 000 are usual.
STEPS_OF_VALUE = 20_000_000
# Oscillations of the mass alone without a stick, beyond the longest stick, after which it counts as not sticking: with
# a damping of 1 % of critical a transient has fallen to 1e-5 by then.
OSCILLATIONS = 200.0
STARTS = 8  # starts in stick; fewer miss attractors with small basins


class DrivenMap:
    """A driven mass as a system: from one passage of a section to the next.

    The ``section`` whose passages are followed is 'poincare' (stroboscopic), 'slip' (break-away) or 'landing';
    ``draws`` names the one whose positions are drawn.  The phase of the flow's drive counts as 0: the section chooses
    the time's origin.
    """

    def __init__(
        self,
        flow: Flow,
        section: str = "poincare",
        draws: str = "poincare",
        *,
        budget: StepBudget | None = None,
    ) -> None:
        validate(flow)
        if flow.omega == 0.0:
            raise ValueError("drive.omega is 0, so there is no drive period; use another number")
        self.flow = flow._replace(phase=0.0)
        self.section, self.draws = SECTIONS[section], SECTIONS[draws]
        self.frame = fr = frame(for_kernels(self.flow))
        self.period = 2.0 * math.pi / abs(flow.omega)  # of the drive, s
        # The stretch at break-away with the drive's, and the belt's motion; any size where nothing moves the mass
        size = (fr.B + abs(fr.u0)) / fr.k + fr.v / fr.omega0 or 1.0
        self.scale = np.array([size, fr.omega0 * size])  # m, m/s
        self.turn = np.full(2, math.inf)  # the drive's phase is not part of the state
        self.unit = max(1, math.ceil(abs(flow.omega) / fr.omega0))
        longest_stick = 2.0 * (fr.B + abs(fr.u0)) / (fr.k * fr.v) if fr.v > 0.0 else 0.0
        patience = (OSCILLATIONS * 2.0 * math.pi / fr.omega0 + longest_stick) / self.period + OSCILLATIONS
        self.clock = Clock(self.period, patience)
        self.budget = budget or StepBudget(math.inf)

    def motion(self, start: Array) -> "DrivenMotion":
        """Return the motion from (x, v), m and m/s, at phase 0 of the drive."""
        return DrivenMotion(self, float(start[0]), float(start[1]))


class DrivenMotion:
    """A driven mass in motion; every call advances it."""

    def __init__(self, system: DrivenMap, x: float, v: float) -> None:
        self.system = system
        fr = system.frame
        self._work = new_work(compiled=True)
        self._at = new_record(DrivenState, compiled=True)
        self._at.mode = mirror_mode(fr, initial_mode(system.flow, x, v, 0.0))
        self._at.p, self._at.w = displacement(fr, x), fr.mirror * (v - system.flow.v_belt)
        self._at.dp = 1.0 / fr.omega0

    def follow(self, number: int, *, tangent: bool = False) -> Passages:
        """Return the next ``number`` passages of the section: states (x, v) in m and m/s.

        ``tangent`` also follows the growth of a deviation, for four times the time; otherwise it is NaN.
        """
        rows, outcome = self._follow_rows(number, self.system.section, tangent=tangent)
        growth = rows[:, FACTOR] if tangent else np.full(len(rows), np.nan)
        return Passages(rows[:, TIME], self._position_and_velocity(rows), growth, ENDS[outcome])

    def draw_points(self, number: int) -> Array:
        """Return positions (m) at phase 0, or of break-away, within the next ``number`` drive periods from phase 0."""
        section = self.system.draws
        rows = np.empty((0, COLUMNS))
        end = self._at.turns + number
        while self._at.turns < end:
            more, outcome = self._follow_rows(number, section | STROBE, tangent=False)
            rows = np.concatenate([rows, more])
            if outcome:
                break
        rows = rows[(rows[:, TIME] <= end) & (rows[:, SECTION] == section)]
        drawn: Array = self._position_and_velocity(rows)[:, 0]
        return drawn

    def _follow_rows(self, number: int, mask: int, *, tangent: bool) -> tuple[Array, int]:
        allowed = min(STEPS_OF_CALL + STEPS_OF_PASSAGE * number, max(self.system.budget.left, 0.0))
        number = min(number, int(allowed) + 1)  # no passage takes less than a step
        out = np.zeros(number * COLUMNS)
        self._work.steps = 0.0
        self._work.steps_allowed = allowed
        follow = compiled(list_passages, "rig_sim.systems.variation", list_passages.__module__)
        fr, clock = self.system.frame, self.system.clock
        outcome, count = follow(fr, clock, mask, int(tangent), number, self._at, out, self._work)
        self.system.budget.left -= self._work.steps
        return out.reshape(number, COLUMNS)[:count], outcome

    def _position_and_velocity(self, rows: Array) -> Array:
        """Return (x, v) of rows, shape (n, 2)."""
        fr = self.system.frame
        x = fr.x0 + fr.mirror * (fr.slip + rows[:, POSITION])
        return np.column_stack([x, fr.mirror * (rows[:, VELOCITY] + fr.v)])


def choose_starts(flow: Flow, x: float, v: float, sticking: int = STARTS) -> list[tuple[float, float]]:
    """Return starts (x, v), m and m/s, at phase 0 of the drive, that together reach the attractors.

    The given one; the mass at rest over ground, where it slides; and ``sticking`` starts in stick, spread evenly over a
    drive period when the belt carries the mass, so over all phases of break-away.
    """
    starts = [(x, v)]
    fr = frame(flow)
    if flow.v_belt != 0.0:
        mode = initial_mode(flow, x, 0.0, 0.0)
        starts.append((flow.x0 + force(flow, mode, x, -flow.v_belt, 0.0) / flow.k, 0.0))
    reach = 2.0 * fr.B / fr.k
    if fr.v > 0.0 and flow.omega != 0.0:
        reach = min(reach, fr.v * 2.0 * math.pi / abs(flow.omega))
    slip = fr.u0 / fr.k
    starts += [(position(fr, slip - reach * (i + 0.5) / sticking), flow.v_belt) for i in range(sticking)]
    return starts


def driven_map_with_starts(
    flow: Flow, x: float, v: float, draws: str, sticking: int = STARTS
) -> tuple[DrivenMap, list[Array]]:
    """Return a driven mass with `STEPS_OF_VALUE` integrator steps, and the starts (`choose_starts`) of its motions."""
    f = DrivenMap(flow, draws=draws, budget=StepBudget(STEPS_OF_VALUE))
    return f, [np.array(start) for start in choose_starts(flow, x, v, sticking)]
