"""A belt whose speed ripples at one more frequency than the fit has: v_b + r sin(2 pi f t + phase).

r in m/s.  Where the sticks show one strong ripple it is fitted with the laws (`fitting.data.ripple`); this is a second
one, or one too weak for that.  Its frequency is looked for in what the fit leaves in the sticks, where the mass moves
as the belt does: the highest peaks of a periodogram, the mean of each stick taken off.  Source: N. R. Lomb,
Astrophys. Space Sci. 39 (1976) 447.
"""

import math

import numpy as np

from fitting.data.ripple import FEWEST_LONG_STICKS, SLOWEST_OF_FEW, strongest_frequencies
from fitting.forces.departure import Departure, Forcing, harmonic
from fitting.forces.fitted_motion import FittedMotion
from stickslip.compute.arrays import Array

MOST_PEAKS = 8  # gaps between the sticks make false peaks beside the true one, two or three strong ones


def forcing(trajectory: FittedMotion, hertz: float) -> Forcing:
    return Forcing(belt_speed=harmonic(2 * math.pi * hertz * trajectory.time))


def frequencies(trajectory: FittedMotion) -> Array:
    """Return the strongest frequencies of the residuals in stick, Hz, each with its neighbours as bounds."""
    window, time = trajectory.window[trajectory.samples], trajectory.time[trajectory.samples]
    times, left = [], []
    for stick in np.flatnonzero(trajectory.sticks):
        part = window == stick
        times.append(time[part])
        left.append(trajectory.residual[part] - trajectory.residual[part].mean())
    if len(times) < FEWEST_LONG_STICKS:
        return np.empty(0)
    slip_s = trajectory.slip_s
    peaks, apart = strongest_frequencies(
        np.concatenate(times), np.concatenate(left), slip_s, SLOWEST_OF_FEW / slip_s, MOST_PEAKS
    )
    beside = np.unique(np.add.outer(peaks, apart * np.arange(-1, 2)).ravel())
    return np.asarray(beside[beside > 0])


DEPARTURE = Departure(
    name="belt-ripple",
    text="a belt whose speed ripples at another frequency",
    parameter="r",
    unit="m/s",
    columns=2,
    scale="frequency",
    scale_unit="Hz",
    scales=frequencies,
    forcing=forcing,
)
