"""Samples that a sensor got wrong: left out of the smoothing, and estimated from their neighbours."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Fault:
    """Samples ``first`` to ``last`` (both included) that are no positions.

    ``kind`` is "spike" (out of line with the samples on either side) or "frozen" (one value held while the mass moved).
    """

    first: int
    last: int
    kind: Literal["spike", "frozen"]

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return self.last - self.first + 1
