"""Wear: friction that fades, or runs in, steadily over the run."""


def wear_factor(rate: float, t: float) -> float:
    """Return the factor on Fs at time t (s): 1 - rate t, ``rate`` in 1/s; the caller sets a lower limit."""
    return 1.0 - rate * t
