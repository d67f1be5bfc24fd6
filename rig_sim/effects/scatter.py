"""Scatter: a friction level that is drawn anew each time the mass lands on the belt."""

import random


class ScatteredLevel:
    """Draws the factor on the friction curve, of standard deviation ``sd`` about 1, from its own random numbers."""

    def __init__(self, sd: float, seed: int) -> None:
        self._sd = sd
        self._draw = random.Random(f"{seed}/scatter")

    def factor(self) -> float:
        """Return 1 + sd g with g standard normal; may be negative: the caller sets a lower limit."""
        return 1.0 + self._draw.gauss(0.0, self._sd)
