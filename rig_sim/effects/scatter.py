"""Scatter: friction that is another each time the mass lands on the belt."""

import random

from rig_sim.scenes.sections import Scatter


class ScatteredLevel:
    """Draws the factor on the friction curve, one for each landing.

    Parameters
    ----------
    section : Scatter
        The scene's scatter section.
    seed : int
        The scene's; scatter has a stream of random numbers of its own.
    """

    def __init__(self, section: Scatter, seed: int) -> None:
        self._sd = section.Fs
        self._draw = random.Random(f"{seed}/scatter")

    def factor(self) -> float:
        """Return 1 + Fs g, g drawn from the normal distribution; it may be negative, the caller sets the floor."""
        return 1.0 + self._draw.gauss(0.0, self._sd)
