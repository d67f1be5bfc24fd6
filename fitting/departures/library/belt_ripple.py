"""A belt whose speed ripples at one more frequency than the fit has: v_b + r sin(2 pi f t + phase).

r in m/s.  Where the sticks show one strong ripple it is fitted with the laws (`fitting.data.ripple`); this is a second
one, or one too weak for that.  Its frequency is looked for in what the fit leaves in the sticks, where the mass moves
as the belt does: the highest peaks of a periodogram, the mean of each stick taken off.  Source: N. R. Lomb,
Astrophys. Space Sci. 39 (1976) 447.
"""

import math

import numpy as np

from daq.base.compute.arrays import Array
from fitting.forces.departure import Departure, Forcing, harmonic
from fitting.forces.fitted_motion import FittedMotion

# Periods in a slip (`MeasuredMotion.slip_s`): slower, it may be wear or a drift; faster, smoothing has taken it away.
SLOWEST, FASTEST = 0.1, 12.5
GRID = 50.0  # averages of the residuals a slip
FINER = 4  # times the transform's own grid of frequencies
FEWEST = 4  # sticks
PEAKS = 8  # gaps between the sticks make false peaks beside the true one, two or three strong ones


def forcing(trajectory: FittedMotion, hertz: float) -> Forcing:
    """Return sine and cosine of the ripple."""
    return Forcing(belt_speed=harmonic(2 * math.pi * hertz * trajectory.time))


def frequencies(trajectory: FittedMotion) -> Array:
    """Return the strongest frequencies of the residuals in stick, Hz, each between its neighbours."""
    window, time = trajectory.window[trajectory.samples], trajectory.time[trajectory.samples]
    slip_s = trajectory.slip_s
    bins, left = [], []
    for own in np.flatnonzero(trajectory.sticks):
        part = window == own
        bins.append(((time[part] - time[0]) * (GRID / slip_s)).astype(np.int64))
        left.append(trajectory.residual[part] - trajectory.residual[part].mean())
    if len(bins) < FEWEST:
        return np.empty(0)
    grid = np.bincount(np.concatenate(bins), weights=np.concatenate(left))
    size = grid.size
    hertz = np.fft.rfftfreq(FINER * size, slip_s / GRID)
    power = np.abs(np.fft.rfft(grid, FINER * size)) ** 2
    power[(hertz < SLOWEST / slip_s) | (hertz > FASTEST / slip_s)] = 0.0
    found: list[int] = []
    while len(found) < PEAKS and power.any():
        top = int(np.argmax(power))
        found.append(top)
        power[max(top - FINER, 0) : top + FINER + 1] = 0.0
    beside = np.unique(np.add.outer(np.array(found, np.int64), (-1, 0, 1)))
    return np.asarray(hertz[beside[(beside > 0) & (beside < hertz.size)]])


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
