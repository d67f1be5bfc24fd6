"""Scatter: a friction level that is drawn anew each time the mass lands on the belt."""

import random


class ScatteredLevel:
    """Draws the factor on the friction curve, one for each landing.

    sd: Standard deviation of the factor, a fraction of Fs.
    seed: The scene's; scatter has a stream of random numbers of its own.
    """

    def __init__(self, sd: float, seed: int) -> None:
        self._sd = sd
        self._draw = random.Random(f"{seed}/scatter")

    def factor(self) -> float:
        """Return 1 + sd g, g drawn from the normal distribution; may be negative: the caller sets a lower limit."""
        return 1.0 + self._draw.gauss(0.0, self._sd)
