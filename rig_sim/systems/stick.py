"""The map of two coupled masses from one global stick to the next: d = x2 - x1 -> f(d).

While both masses stick, d is all that decides what follows.  An event runs from there, one mass breaking away or both,
to the next global stick; its word lists which mass broke away, in order: '2', '21', '212'.  Every event ends within a
number of integrator steps or in a named outcome.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from rig_sim.flow.frame import Frame, frame
from rig_sim.flow.modes import NOT_FINITE, OUTCOMES, STEP_LIMIT, STICK, Outcome
from rig_sim.flow.two_mass import TwoMassFlow, largest_stretch, validate_two_masses
from rig_sim.integrate.two_mass import Pair, new_pair, pair_event, set_state
from rig_sim.integrate.work import ORDER, Buffer, unboxed
from rig_sim.systems.interface import IntervalMotion, StepBudget, StepLimitError, growth_at
from stickslip.compute.arrays import Array

# Steps allowed for one event, and more per unit of the fastest frequency, sqrt(1 + 2 a), up to a limit, above which the
# coupling (a above 1.9e6) is refused.  The thesis's events take 20 to 60 steps, 0.3 us each.
STEPS_OF_EVENT, STEPS_PER_FREQUENCY, MOST_STEPS = 2_000, 100.0, 200_000
# Steps of all events together, 25 s; a basin of the thesis takes 10^6.
STEPS_IN_ALL = 50_000_000
INTERPRETED_STEPS = 200  # of an event, about 0.3 s; a longer one is restarted in compiled code
WORD = 64  # letters of a word that are stored
NO_STICK = 30
ENDS = {
    **OUTCOMES,
    NO_STICK: Outcome(
        "no global stick",
        "both masses did not stick at once within the allowed steps; list the events instead, or use a slower belt",
    ),
}


class Precision(NamedTuple):
    """Degree and tolerance of the series."""

    degree: int
    tolerance: float


# Rounding; errors of the map below 1e-9; below 1e-5 (measured by benchmarks/dynamics.py)
EXACT, FINE, COARSE = Precision(ORDER, 2.0**-53), Precision(14, 1e-9), Precision(11, 2.5e-5)


class Applied(NamedTuple):
    """The map applied to starts: the next d (m), the duration (s) and the outcome of each; the last one's word."""

    d: Buffer
    duration: Buffer
    outcome: Buffer
    word: Buffer


def next_stick(
    fr: Frame, a: float, b: float, y1: float, y2: float, precision: Precision, work: Pair, word: Buffer
) -> tuple[int, float, float, int]:
    """Follow an event from the end of a global stick at (y1, y2), m, in the frame.

    Returns 0 or a key of `ENDS`; the next d (m); the time to the next global stick (s); how many letters (1 and 2)
    ``word`` holds.
    """
    set_state(fr, a, b, y1, 0.0, y2, 0.0, 0.0, work)
    work.steps = 0.0
    letters = 0
    while True:
        stuck1, stuck2 = work.mode1 == STICK, work.mode2 == STICK
        if stuck1 and stuck2 and letters > 0:
            return 0, work.y2[0] - work.y1[0], work.time, letters
        event, outcome = pair_event(fr, a, b, math.inf, precision.degree, precision.tolerance, work)
        if outcome != 0 or event == 0:
            return (NO_STICK if work.steps >= work.steps_allowed else outcome), math.nan, math.nan, letters
        broke1 = stuck1 and work.mode1 != STICK
        if broke1 or (stuck2 and work.mode2 != STICK):
            if letters < len(word):
                word[letters] = 1.0 if broke1 else 2.0
            letters += 1


def apply_map(
    fr: Frame,
    a: float,
    b: float,
    starts: Buffer,
    times: int,
    chained: int,
    precision: Precision,
    steps_left: float,
    out: Applied,
    work: Pair,
) -> tuple[int, float]:
    """Apply the map ``times`` times to each of the starts (d in the frame).

    With ``chained`` 1 only the first start counts, and every result is the next start.  Returns how many letters the
    last word has, and the rest of the ``steps_left`` allowed in all.
    """
    work = unboxed(work)
    letters = 0
    d = 0.0
    for i in range(len(starts)):
        if chained == 0 or i == 0:
            d = starts[i]
        duration = 0.0
        outcome = 0
        for _j in range(times):
            if math.isnan(d):
                outcome = NOT_FINITE
                break
            if steps_left <= 0.0:
                outcome = STEP_LIMIT
                break
            first = (fr.B - fr.c * fr.v) / fr.k + a * d
            second = (b * fr.B - fr.c * fr.v) / fr.k - (1.0 + a) * d
            y1 = min(first, second)
            outcome, d, duration, letters = next_stick(fr, a, b, y1, y1 + d, precision, work, out.word)
            steps_left -= work.steps
            if outcome != 0:
                break
        out.d[i] = d
        out.duration[i] = duration
        out.outcome[i] = float(outcome)
    return letters, steps_left


@dataclass(frozen=True)
class StickEvent:
    d: float  # x2 - x1 in the global stick that follows, m; NaN without one
    word: str  # which mass broke away, in order
    duration: float  # from the first break-away to the next global stick, s
    outcome: str  # 'completed', or how the event ended instead
    advice: str


class StickMap:
    """The map d -> f(d) of two masses, on the interval of every d that a global stick can have.

    ``precision`` is `EXACT`, `FINE` or `COARSE`.  Beyond the budget of integrator steps the map raises
    `StepLimitError`, and so does a coupling so stiff that one event takes more steps than are allowed.
    """

    def __init__(self, flow: TwoMassFlow, precision: Precision = EXACT, *, budget: StepBudget | None = None) -> None:
        validate_two_masses(flow)
        if flow.mass.v_belt == 0.0:
            raise ValueError("on a belt at rest no stick ends; set a belt speed")
        self._steps_of_event = STEPS_OF_EVENT + STEPS_PER_FREQUENCY * math.sqrt(1.0 + 2.0 * flow.a)
        if self._steps_of_event > MOST_STEPS:
            largest = ((MOST_STEPS - STEPS_OF_EVENT) / STEPS_PER_FREQUENCY) ** 2 / 2.0
            problem = (
                f"step limit: with a coupling of {flow.a:.4g} one event takes more than {MOST_STEPS} integrator steps"
            )
            raise StepLimitError(problem, "map of two masses", f"use a coupling.a of {largest:.2g} or less")
        self.flow = flow
        self.hi = largest_stretch(flow)  # m
        self.lo = -self.hi
        self.scale, self.turn, self.unit = np.array([self.hi - self.lo]), np.array([math.inf]), 1
        self._frame = frame(flow.mass)
        self._precision = precision
        self._work = new_pair(int(self._steps_of_event), compiled=True)
        self._budget = budget or StepBudget(STEPS_IN_ALL)

    def images(self, x: Array, times: int = 1) -> Array:
        """Return f(x), or the ``times``-th iterate, shape (n,): NaN where x is outside or no global stick follows.

        Uses compiled code.
        """
        results: Array = self._follow(np.asarray(x, dtype=np.float64), times, compiled=True)[0]
        return results

    def survey(self, x: Array, times: int = 1) -> Array:
        """Return the same as `images` with the precision `FINE`: 2.5 times as fast, right to 1e-9 of d."""
        return StickMap(self.flow, FINE, budget=self._budget).images(x, times)

    def growth_at(self, x: Array) -> Array:
        return growth_at(self, x)

    def motion(self, start: Array) -> IntervalMotion:
        """Return the motion from the stretch ``start``, (1,)."""
        return IntervalMotion(self, start)

    def orbit(self, start: float, number: int) -> Array:
        """Return f(start), f(f(start)) ..., shape (number,); NaN from where no global stick follows."""
        results: Array = self._follow(np.full(number, start), 1, compiled=True, chained=1)[0]
        return results

    def event(self, d: float, *, compiled: bool = False) -> StickEvent:
        """Return the event that follows the global stick with stretch ``d`` (m); a long one uses compiled code."""
        if not abs(d) <= self.hi:
            advice = f"both masses can stick only with abs(d) up to {self.hi:.6g}"
            return StickEvent(math.nan, "", math.nan, "outside", advice)
        results, durations, outcomes, word = self._follow(np.array([d]), 1, compiled=compiled)
        if outcomes[0] == NO_STICK and not compiled:
            results, durations, outcomes, word = self._follow(np.array([d]), 1, compiled=True)
        outcome = ENDS[int(outcomes[0])]
        return StickEvent(float(results[0]), word, float(durations[0]), outcome.name, outcome.advice)

    def _follow(
        self, starts: Array, times: int, *, compiled: bool, chained: int = 0
    ) -> tuple[Array, Array, Array, str]:
        fr = self._frame
        work = self._work if compiled else new_pair(INTERPRETED_STEPS)
        starts = np.where(np.abs(starts) <= self.hi, fr.mirror * starts, np.nan)
        d, durations, outcomes = np.zeros((3, len(starts)))
        out = Applied(d, durations, outcomes, np.zeros(WORD))
        kernel = compiled_events() if compiled else apply_map
        a, b = self.flow.a, self.flow.b
        letters, self._budget.left = kernel(
            fr, a, b, starts, times, chained, self._precision, float(self._budget.left), out, work
        )
        if np.any(out.outcome == STEP_LIMIT):
            do = "use a smaller coupling.a, or fewer cells, values or events"
            raise self._budget.limit_error("map of two masses", do)
        text = "".join(str(int(letter)) for letter in out.word[: min(letters, WORD)]) + "..." * (letters > WORD)
        return fr.mirror * out.d, out.duration, out.outcome, text


@cache
def compiled_events() -> Callable[..., tuple[int, float]]:
    from rig_sim.integrate.compiled import compiled

    return compiled(apply_map, "rig_sim.integrate.two_mass", __name__)
