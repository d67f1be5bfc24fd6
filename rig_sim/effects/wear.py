"""Wear: friction that fades, or runs in, steadily over the run."""

from rig_sim.scenes.sections import Wear


def level_left(section: Wear, t: float) -> float:
    """Return the factor on Fs at time t (s): 1 - rate t, which may fall below 0; the caller sets the floor."""
    return 1.0 - section.rate * t
