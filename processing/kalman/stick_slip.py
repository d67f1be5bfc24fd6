"""A motion of white snap that sticks and slips: its parts, its corners, and the noise of both.

The motion is that of `processing.kalman.motion_kernel` with x, v, a and j (jerk): between samples the snap is a mean u
(m/s^4) and white noise of density q (m^2/s^7), a reading is x + noise of variance r, and all change with the part of
the motion a sample lies in (its label).  In sticks on an even belt and at rest a = j = 0, without noise.  Between
samples lie corners:

    LAND    onto a belt that runs evenly: x and v go on, a and j become 0
    LEAVE   the belt: x and v go on, a and j change by an unknown step of variance reset[0], reset[1]
    MEET    a belt that does not run evenly: as LEAVE, of variance reset[2], reset[3]
    KICK    v, a and j all step: reset[4], reset[5], reset[6]
    START   from rest: as LEAVE, of variance reset[7], reset[8]
    STOP    to rest: as LAND
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from processing.kalman.motion_kernel import Process, stored_size
from stickslip.compute.arrays import Array

Labels = NDArray[np.uint8]

SNAP = (0.0, 0.0, 0.0, 0.0)  # order of the motion: x, v, a, j (`motion_kernel`)
STORED = stored_size(len(SNAP))
LAND, LEAVE, MEET, KICK, START, STOP = 1, 2, 3, 4, 5, 6
STICK, LANDING, SLIP, ONSET, RIDE, MET, LEAVING, REST = 0, 1, 5, 6, 10, 11, 12, 13  # LANDING and ONSET: four each
CUT = 14  # four: where a slip is cut off
LABELS = 18  # all of them
NEAR_LANDING = (1 / 128, 1 / 48, 1 / 24, 1 / 8)  # of a slip's length: where its parts near a landing begin
NEAR_ONSET = (1 / 32, 1 / 16, 1 / 8, 1 / 4)  # of a slip's length: where its parts near a break-away end
KINDS = STOP + 1  # of corners
JUMPS = 9  # variances: LEAVE a j, MEET a j, KICK v a j, START a j
JUMP_KIND = np.array([LEAVE, LEAVE, MEET, MEET, KICK, KICK, KICK, START, START])
JUMP_DERIVATIVE = np.array([2, 3, 2, 3, 1, 2, 3, 2, 3])  # of x: which derivative jumps


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """Noise of each part of the motion, by its label, and of the resets at corners."""

    process_density: Array  # density of the snap, m^2/s^7
    mean_snap: Array  # m/s^4
    reading_variance: Array  # m^2
    reset_variance: Array  # (JUMPS,) of steps at corners, in (m/s)^2, (m/s^2)^2, (m/s^3)^2
    peak: float  # about the largest acceleration, m/s^2

    @cached_property
    def process(self) -> Process:
        """The same for `processing.kalman.motion_kernel`."""
        alive, keep = np.full(LABELS, len(SNAP)), np.full(KINDS, len(SNAP))
        alive[[STICK, REST]] = 2
        keep[[LAND, STOP]] = 2
        jump = np.zeros((KINDS, len(SNAP)))
        jump[JUMP_KIND, JUMP_DERIVATIVE] = self.reset_variance
        return Process(self.process_density, self.mean_snap, self.reading_variance, alive, keep, jump)
