"""The motion of two masses listed: their events, the motion at given times, or where the first mass turns forwards."""

import math
from collections.abc import Iterator
from typing import Any

from rig_sim.flow.frame import Frame, frame
from rig_sim.flow.modes import COMPLETED, LIST_FULL, OUTCOMES, STEP_LIMIT
from rig_sim.flow.two_mass import TwoMassFlow, validate_two_masses
from rig_sim.integrate.two_mass import CROSSING, Pair, new_pair, pair_event, set_state
from rig_sim.integrate.work import ORDER, Buffer, copy_for_compiled, unboxed
from stickslip.compute.arrays import Array

EVENTS, SAMPLES, CROSSINGS = 0, 1, 2  # kinds of rows
WIDTH = 9  # numbers in a row: t, y1, w1, mode 1, y2, w2, mode 2, and both previous modes
ROWS = 2048  # rows of one call of the kernel
INTERPRETED_STEPS = 1_000  # about 1 s of CPU time; a motion that takes more continues in compiled code
ROUNDING = 2.0**-53  # tolerance of the series


def list_motion(
    fr: Frame, a: float, b: float, times: Buffer, n: int, kind: int, capacity: int, rows: Buffer, work: Pair
) -> tuple[int, int, int]:
    """Continue through n times (s), or until ``rows`` is full; return (outcome, rows stored, times reached)."""
    work = unboxed(work)
    count = 0
    reached = 0
    while reached < n:
        if count == capacity:
            return LIST_FULL, count, reached
        before1, before2 = work.mode1, work.mode2
        event, outcome = pair_event(fr, a, b, times[reached], ORDER, ROUNDING, work)
        if outcome != 0:
            return outcome, count, reached
        if event == 0:
            reached += 1
        if (
            (kind == SAMPLES and event == 0)
            or (kind == EVENTS and event != 0)
            or (kind == CROSSINGS and event == CROSSING)
        ):
            row = WIDTH * count
            rows[row], rows[row + 1], rows[row + 2], rows[row + 3] = work.time, work.y1[0], work.w1[0], work.mode1
            rows[row + 4], rows[row + 5], rows[row + 6] = work.y2[0], work.w2[0], work.mode2
            rows[row + 7], rows[row + 8] = before1, before2
            count += 1
    return 0, count, reached


class PairMotion:
    """Two masses in motion, from x1, v1, x2, v2 (m, m/s) at t = 0.

    Uses numba from the start with ``compiled``, otherwise only after `INTERPRETED_STEPS`.
    """

    def __init__(
        self, flow: TwoMassFlow, state: tuple[float, float, float, float], max_steps: int, *, compiled: bool = False
    ) -> None:
        validate_two_masses(flow)
        self.flow = flow
        self.outcome = OUTCOMES[COMPLETED]
        self.frame = fr = frame(flow.mass)  # of the rows: y = mirror (x - x0), w = mirror (x' - v_belt)
        self._max_steps = max_steps
        self._compiled = compiled
        self._work = new_pair(max_steps if compiled else min(max_steps, INTERPRETED_STEPS), compiled=compiled)
        x1, v1, x2, v2 = state
        y1, y2 = fr.mirror * (x1 - fr.x0), fr.mirror * (x2 - fr.x0)
        w1, w2 = fr.mirror * (v1 - flow.mass.v_belt), fr.mirror * (v2 - flow.mass.v_belt)
        set_state(fr, flow.a, flow.b, y1, w1, y2, w2, 0.0, self._work)

    @property
    def steps(self) -> int:
        return int(self._work.steps)

    def rows(self, times: "list[float] | Array", kind: int, *, most: float = math.inf) -> Iterator[list[float]]:
        """Yield at most ``most`` rows of a kind (`EVENTS` ...) up to the last of ``times`` (s), or to the end."""
        self._work.section = 1.0 if kind == CROSSINGS else 0.0
        reached = 0
        outcome = LIST_FULL
        while outcome == LIST_FULL and most > 0:
            outcome, rows, n_reached = self._call_kernel(times[reached:], kind, int(min(most, ROWS)))
            reached += n_reached
            most -= len(rows)
            yield from rows
        outcome = COMPLETED if outcome == LIST_FULL else outcome
        self.outcome = OUTCOMES[outcome]

    def _call_kernel(self, times: "list[float] | Array", kind: int, most: int) -> tuple[int, list[list[float]], int]:
        """Call the kernel once, interpreted or compiled."""
        kernel: Any = list_motion
        rows: Any = [0.0] * (WIDTH * ROWS)
        if self._compiled or self.steps >= INTERPRETED_STEPS:
            import numpy as np

            from rig_sim.integrate.compiled import compiled

            kernel = compiled(list_motion, "rig_sim.integrate.two_mass", __name__)
            times, rows = np.asarray(times, dtype=np.float64), np.zeros(WIDTH * ROWS)
            if not self._compiled:
                self._compiled, self._work = True, copy_for_compiled(self._work)
                self._work.steps_allowed = float(self._max_steps)
        outcome, count, reached = kernel(
            self.frame, self.flow.a, self.flow.b, times, len(times), kind, most, rows, self._work
        )
        if outcome == STEP_LIMIT and self.steps < self._max_steps:
            outcome = LIST_FULL  # of the interpreted steps: the compiled kernel continues
        return outcome, [list(rows[start : start + WIDTH]) for start in range(0, WIDTH * count, WIDTH)], reached
