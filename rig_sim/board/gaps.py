"""Gaps: samples that the board takes but never sends; their sequence numbers are missing on the wire.

A gap begins at random, ``rate`` times per second of device time that is no gap, and lasts ``duration`` seconds.  The
counters go on counting meanwhile, so the position after the gap is right as long as a 16-bit counter has advanced by
less than half its range.

Not modelled: samples that the line damages (a CRC error), a board that restarts.
"""

import random
from collections.abc import Iterable

from rig_sim.scenes.sections import Gaps


class SilentStretches:
    """Decides for each sampling instant, in order, whether its sample is sent; draws from its own random numbers."""

    def __init__(self, section: Gaps, seed: int) -> None:
        self.section = section
        self._draw = random.Random(f"{seed}/gaps")
        self._begin = self._draw.expovariate(section.rate)

    def mark_sent(self, instants: Iterable[float]) -> list[bool]:
        """Return for increasing times (s) whether each lies outside all gaps."""
        outside = []
        for t in instants:
            while t >= self._begin + self.section.duration:
                self._begin += self.section.duration + self._draw.expovariate(self.section.rate)
            outside.append(t < self._begin)
        return outside
