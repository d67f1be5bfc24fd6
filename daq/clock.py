"""Host time against device time: offset by the least delay of each second, drift by the line below all delays.

The device's clock is the time axis.  A byte reaches the host late by a delay that is never negative and often large
(USB batches of 16 ms, stalls).  Host minus device is therefore a straight line, offset and drift, plus that delay:
every point lies on the line or above it.  The drift is the slope of the highest line that lies below all points
(highest at their mean: for delays without memory that is the likeliest line), an edge of their lower convex hull.
Points far below the Theil-Sen line through the least delays of each second are no delays and are left out first.

How sharp it can be is a matter of what the line saw.  A USB chip that polls in step with the host's own clock shows
every poll the same phase of the frames as long as the drift does not carry them across a poll; whole frames then tell
the drift no better than one frame period over the run.  So `events` takes the reads that ended inside a frame, too:
on a serial line of known speed each byte has its own time.

Sign: a positive drift in ppm means that the device's clock runs fast.  Not modelled: a drift that changes during
the run (temperature), and the constant part of the delay, which no one-way stream can tell from the offset.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_POINTS = 600  # the pairwise slopes of so many take 180,000 values; longer runs get wider bins
FEWEST_POINTS = 3
BELIEVABLE = 0.02  # a crystal is within 0.01 %, a ceramic resonator within 0.5 %; beyond 2 % this was no clock
TOO_EARLY_S = 0.05  # below the robust line by more than this, a stamp is wrong and not early


@dataclass(frozen=True)
class Clock:
    """How the host's clock and the device's went together.

    Attributes
    ----------
    index : (c,) int64
        The points with the least delay of their second.
    offset : (c,) float64
        Host minus device there, s.
    ppm : float or None
        Device seconds per host second, minus 1, in ppm; None where the two cannot be compared: a simulated rig that
        runs faster than real time, or too few seconds.
    """

    index: NDArray[np.int64]
    offset: NDArray[np.float64]
    ppm: float | None


def compare(host: NDArray[np.float64], device: NDArray[np.float64]) -> Clock:
    """Compare the two clocks.

    Parameters
    ----------
    host : (f,) float64
        When each frame, or part of a frame, had come in, s.
    device : (f,) float64
        The device's time when it had sent that much, s, not decreasing.
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
    if len(least) < FEWEST_POINTS or span < FEWEST_POINTS:
        return Clock(least, delay[least], None)
    robust = theil_sen(device[least], delay[least])
    rest = delay - robust * device
    # The middle of the least delays is above the line by far less than this; only a wrong stamp is below it so far.
    true = rest >= np.median(rest[least]) - TOO_EARLY_S
    kept = least[true[least]]
    slope = supporting_slope(device[true], delay[true])
    return Clock(kept, delay[kept], -1e6 * slope / (1 + slope))


def supporting_slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the slope of the line below all points that is highest at their mean x; x not decreasing, not all equal.

    An edge of the lower convex hull (monotone chain).
    """
    hull: list[tuple[float, float]] = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        if hull and point[0] == hull[-1][0]:
            if point[1] >= hull[-1][1]:
                continue
            hull.pop()
        while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    middle = float(x.mean())
    edge = next(i for i in range(1, len(hull)) if hull[i][0] >= middle or i == len(hull) - 1)
    (x0, y0), (x1, y1) = hull[edge - 1], hull[edge]
    return (y1 - y0) / (x1 - x0)


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])


def theil_sen(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the median of the slopes of all pairs; x strictly increasing, at least two points."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))
