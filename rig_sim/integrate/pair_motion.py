"""The motion of two masses listed: their events, the motion at given times, or where the first mass turns forwards."""

import math
from collections.abc import Iterator
from typing import Any

from rig_sim.flow.frame import Frame, frame
from rig_sim.flow.modes import COMPLETED, LIST_FULL, OUTCOMES, STEP_LIMIT
from rig_sim.flow.two_mass import TwoMassFlow, validate_two_masses
from rig_sim.integrate.two_mass import CROSSING, Pair, new_pair, pair_event, place
from rig_sim.integrate.work import ORDER, Buffer, for_compiled, unboxed
from stickslip.compute.arrays import Array

EVENTS, SAMPLES, CROSSINGS = 0, 1, 2  # what is listed
WIDTH = 9  # numbers in a row: t, y1, w1, mode 1, y2, w2, mode 2, and both modes before
ROWS = 2048  # rows of one call of the kernel
INTERPRETED_STEPS = 1_000  # about 1 s of CPU time; a motion that needs more continues in compiled code
ROUNDING = 2.0**-53  # tolerance of the series


def list_motion(
    fr: Frame, a: float, b: float, times: Buffer, n: int, wanted: int, capacity: int, rows: Buffer, work: Pair
) -> tuple[int, int, int]:
    """Go on through n times (s), or until ``rows`` is full; return (outcome, rows stored, times served)."""
    work = unboxed(work)
    count = 0
    served = 0
    while served < n:
        if count == capacity:
            return LIST_FULL, count, served
        before1, before2 = work.mode1, work.mode2
        event, outcome = pair_event(fr, a, b, times[served], ORDER, ROUNDING, work)
        if outcome != 0:
            return outcome, count, served
        if event == 0:
            served += 1
        if (
            (wanted == SAMPLES and event == 0)
            or (wanted == EVENTS and event != 0)
            or (wanted == CROSSINGS and event == CROSSING)
        ):
            at = WIDTH * count
            rows[at], rows[at + 1], rows[at + 2], rows[at + 3] = work.time, work.y1[0], work.w1[0], work.mode1
            rows[at + 4], rows[at + 5], rows[at + 6] = work.y2[0], work.w2[0], work.mode2
            rows[at + 7], rows[at + 8] = before1, before2
            count += 1
    return 0, count, served


class PairMotion:
    """Two masses in motion.

    Parameters
    ----------
    flow : TwoMassFlow
        What moves.
    state : tuple of float
        x1, v1, x2, v2 at t = 0 (m, m/s).
    max_steps : int
        Integrator steps after which the motion ends with the outcome 'step limit'.
    compiled : bool
        Use numba from the start, not only after `INTERPRETED_STEPS`.

    Attributes
    ----------
    outcome : Outcome
        'completed' while the motion continues; else why it ended, and what to do.
    frame : Frame
        In which the rows are: y = mirror (x - x0), w = mirror (x' - v_belt).

    Raises
    ------
    ValueError
        Masses that are not physical, or not modelled: `rig_sim.flow.two_mass.validate_two_masses`.
    """

    def __init__(
        self, flow: TwoMassFlow, state: tuple[float, float, float, float], max_steps: int, *, compiled: bool = False
    ) -> None:
        validate_two_masses(flow)
        self.flow = flow
        self.outcome = OUTCOMES[COMPLETED]
        self.frame = fr = frame(flow.mass)
        self._max_steps = max_steps
        self._compiled = compiled
        self._work = new_pair(max_steps if compiled else min(max_steps, INTERPRETED_STEPS), compiled=compiled)
        x1, v1, x2, v2 = state
        y1, y2 = fr.mirror * (x1 - fr.x0), fr.mirror * (x2 - fr.x0)
        w1, w2 = fr.mirror * (v1 - flow.mass.v_belt), fr.mirror * (v2 - flow.mass.v_belt)
        place(fr, flow.a, flow.b, y1, w1, y2, w2, 0.0, self._work)

    @property
    def steps(self) -> int:
        """Integrator steps taken so far."""
        return int(self._work.steps)

    def rows(self, times: "list[float] | Array", wanted: int, *, most: float = math.inf) -> Iterator[list[float]]:
        """Yield a row for each event, time or crossing up to the last of ``times`` (s, increasing), or to the end.

        No more than ``most`` rows.
        """
        self._work.section = 1.0 if wanted == CROSSINGS else 0.0
        served = 0
        outcome = LIST_FULL
        while outcome == LIST_FULL and most > 0:
            outcome, listed, done = self._call(times[served:], wanted, int(min(most, ROWS)))
            served += done
            most -= len(listed)
            yield from listed
        outcome = COMPLETED if outcome == LIST_FULL else outcome
        self.outcome = OUTCOMES[outcome]

    def _call(self, times: "list[float] | Array", wanted: int, most: int) -> tuple[int, list[list[float]], int]:
        """Call the kernel once, interpreted or compiled."""
        kernel: Any = list_motion
        rows: Any = [0.0] * (WIDTH * ROWS)
        if self._compiled or self.steps >= INTERPRETED_STEPS:
            import numpy as np

            from rig_sim.integrate.compiled import compiled

            kernel = compiled(list_motion, "rig_sim.integrate.two_mass", __name__)
            times, rows = np.asarray(times, dtype=np.float64), np.zeros(WIDTH * ROWS)
            if not self._compiled:
                self._compiled, self._work = True, for_compiled(self._work)
                self._work.steps_allowed = float(self._max_steps)
        outcome, count, served = kernel(
            self.frame, self.flow.a, self.flow.b, times, len(times), wanted, most, rows, self._work
        )
        if outcome == STEP_LIMIT and self.steps < self._max_steps:
            outcome = LIST_FULL  # of the interpreted steps: the compiled kernel goes on
        return outcome, [list(rows[at : at + WIDTH]) for at in range(0, WIDTH * count, WIDTH)], served
