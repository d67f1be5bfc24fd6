"""Lyapunov exponent of a map of an interval: the mean of log abs(f'(x)) on an orbit, per application of the map."""

import math
from dataclasses import dataclass

import numpy as np

from daq.base.compute.arrays import Array
from daq.base.compute.stages import Stages, parts, silent
from rig_sim.dynamics.analyses.basins import SAME, TRANSIENT
from rig_sim.dynamics.system.interval_map import IntervalMap, slope
from rig_sim.dynamics.system.period import period_of

BLOCKS = 20  # of the orbit, whose means give the standard error; below 20 it would itself err by more than 16 %


@dataclass(frozen=True)
class Exponent:
    """A Lyapunov exponent.

    Attributes
    ----------
    exponent, stderr : float
        Per application of the map, and its standard error by the means of `BLOCKS` blocks; exact, with 0, on a periodic
        orbit.
    events : int
        Of the orbit that it was taken over.
    period : int or None
        Of a periodic orbit.
    outcome : str
        'completed'; 'no attractor' where the orbit leaves the map's domain.
    """

    exponent: float
    stderr: float
    events: int
    period: int | None
    outcome: str


def lyapunov(f: IntervalMap, start: float, events: int, progress: Stages = silent) -> Exponent:
    """Return the exponent on the orbit that ``start`` leads to, after `TRANSIENT` applications of the map.

    ``progress`` is called with the stage and what is done of it.

    Raises
    ------
    ValueError
        Fewer events than `BLOCKS`.
    """
    if events < BLOCKS:
        raise ValueError(f"{events} events; need {BLOCKS} or more")
    orbit = np.empty(TRANSIENT + events)
    for begin, end in parts("following the motion", len(orbit), progress):
        orbit[begin:end] = f.orbit(start, end - begin)
        start = float(orbit[end - 1])
    orbit = orbit[TRANSIENT:]
    if not np.all(np.isfinite(orbit)):
        return Exponent(math.nan, math.nan, 0, None, "no attractor")
    period = period_of(orbit, SAME * (f.hi - f.lo))
    orbit = orbit if period is None else orbit[-period:]
    slopes = [slope(f, orbit[begin:end]) for begin, end in parts("slopes on its orbit", len(orbit), progress)]
    with np.errstate(divide="ignore"):  # a slope of 0: the exponent of a superstable orbit is minus infinity
        growth = np.log(np.abs(np.concatenate(slopes)))
    if period is not None:
        return Exponent(float(np.mean(growth)), 0.0, period, period, "completed")
    return mean_growth(growth)


def mean_growth(growth: Array) -> Exponent:
    """Return the exponent of an orbit that is not periodic, on which a deviation's logarithm grows so, shape (n,).

    What is not finite, beside a jump of the motion, is left out.
    """
    growth = growth[np.isfinite(growth)]
    means = [float(np.mean(block)) for block in np.array_split(growth, BLOCKS)]
    return Exponent(
        float(np.mean(growth)), float(np.std(means, ddof=1)) / math.sqrt(BLOCKS), len(growth), None, "completed"
    )
