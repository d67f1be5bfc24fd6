"""Host time against device time: offset by the least delay of each second, drift by a robust line.

The device's clock is the time axis.  A byte reaches the host late by a delay that is never negative and often large
(USB batches of 16 ms, stalls), so the least host-minus-device difference of each second lies close to the true offset,
and a Theil-Sen line (median of all pairwise slopes) through those is not moved by seconds in which every frame was
late.

Sign: a positive drift in ppm means that the device's clock runs fast.  Not modelled: a drift that changes during
the run (temperature), and the constant part of the delay, which no one-way stream can tell from the offset.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_POINTS = 600  # the pairwise slopes of so many take 180,000 values; longer runs get wider bins
FEWEST_POINTS = 3
BELIEVABLE = 0.02  # a crystal is within 0.01 %, a ceramic resonator within 0.5 %; beyond 2 % this was no clock


@dataclass(frozen=True)
class Clock:
    """How the host's clock and the device's went together.

    Attributes
    ----------
    frame : (c,) int64
        The frames with the least delay of their second.
    offset : (c,) float64
        Host minus device there, s.
    ppm : float or None
        Device seconds per host second, minus 1, in ppm; None where the two cannot be compared: a simulated rig that
        runs faster than real time, or too few seconds.
    """

    frame: NDArray[np.int64]
    offset: NDArray[np.float64]
    ppm: float | None


def compare(host: NDArray[np.float64], device: NDArray[np.float64]) -> Clock:
    """Compare the two clocks.

    Parameters
    ----------
    host : (f,) float64
        When each frame had come in, s.
    device : (f,) float64
        The device's time of its last sample, s, increasing.
    """
    nothing = Clock(np.empty(0, dtype=np.int64), np.empty(0), None)
    if len(device) < 2:
        return nothing
    span = device[-1] - device[0]
    if span <= 0 or abs((host[-1] - host[0]) / span - 1) > max(BELIEVABLE, 0.5 / span):
        return nothing
    bin_s = max(1.0, span / MOST_POINTS)
    bins = np.floor((device - device[0]) / bin_s).astype(np.int64)
    delay = host - device
    order = np.lexsort((delay, bins))
    least = order[np.concatenate(([True], np.diff(bins[order]) > 0))]
    offset = delay[least]
    if len(least) < FEWEST_POINTS or span < FEWEST_POINTS:
        return Clock(least, offset, None)
    slope = theil_sen(device[least], offset)
    return Clock(least, offset, -1e6 * slope / (1 + slope))


def theil_sen(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the median of the slopes of all pairs; x strictly increasing, at least two points."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))
