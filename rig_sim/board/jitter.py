"""Jitter: sampling instants that miss their grid; the board records the true instant, to its tick."""

import random

import numpy as np
from numpy.typing import NDArray

from rig_sim.scenes.sections import Jitter

LARGEST = 0.45  # share of a sampling period, either way: from 0.5 on, samples could change their order
SELDOM = 3  # standard deviations: where the limit is farther out, at most 0.3 % of the draws are clipped


class JitteringClock:
    """Draws the offset of each sampling instant from its grid; draws from its own random numbers."""

    def __init__(self, section: Jitter, seed: int) -> None:
        self._rms = section.rms
        self._draw = random.Random(f"{seed}/jitter")

    def draw_offsets(self, count: int, period: float, *, first: bool) -> NDArray[np.float64]:
        """Return ``count`` offsets (s), normal and clipped; the ``first`` is 0, as it starts the clock."""
        noise = np.array([self._draw.gauss(0.0, self._rms) for _ in range(count)])
        if first:
            noise[0] = 0.0
        limit = self.limit(period)
        offsets: NDArray[np.float64] = np.clip(noise, -limit, limit)
        return offsets

    def limit(self, period: float) -> float:
        """Return the offset (s) at which offsets are clipped."""
        return LARGEST * period

    def is_clipped(self, period: float) -> bool:
        """Return whether more than 0.3 % of the offsets are clipped."""
        return SELDOM * self._rms > self.limit(period)
