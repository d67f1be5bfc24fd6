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

How sharp it was is told beside it, and it is what the line allows, not what the residuals look like: in step with the
host they look perfect.  A read tells of both its sides: the last byte it brought had been sent, the next one had not.
So the true line lies below the one and, less the read's own way to us, above the other.  All lines between give the
interval.  What must be assumed is that of each second the read that leaves least open was at most `PROMPT_S` slower on
its way than the fastest of all; where no line is left, that is doubled until one is.

Sign: a positive drift in ppm means that the device's clock runs fast.  Not modelled: a drift that changes during
the run (temperature), and the constant part of the delay, which no one-way stream can tell from the offset.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MOST_POINTS = 600  # the pairwise slopes of so many take 180,000 values; longer runs get wider bins
FEWEST_POINTS = 3
BELIEVABLE = 0.02  # a crystal is within 0.01 %, a ceramic resonator within 0.5 %; beyond 2 % this was no clock
PROMPT_S = 2.5e-4  # a thread that waits for a read is woken within less, most of the time
LIKELY_PPM = 8.0  # wider than this, an interval tells of polls in step with the host
TOO_EARLY_S = 0.05  # below the robust line by more than this, a stamp is wrong and not early


@dataclass(frozen=True)
class Clock:
    """How the host's clock and the device's went together.

    Attributes
    ----------
    index : (c,) int64
        The points with the least delay of their second.
    offset : (c,) float64
        Host minus device there, s: of the byte that came, or, `by_bytes`, of the middle between it and the next.
    ppm : float or None
        Device seconds per host second, minus 1, in ppm; None where the two cannot be compared: a simulated rig that
        runs faster than real time, or too few seconds.
    ppm_error : float or None
        How far off the drift may be, ppm.
    offset_error : (c,) float64
        How far off each offset may be, s, but for a constant delay.  NaN where it is not known.
    """

    index: NDArray[np.int64]
    offset: NDArray[np.float64]
    ppm: float | None
    ppm_error: float | None = None
    offset_error: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


def compare(
    host: NDArray[np.float64],
    device: NDArray[np.float64],
    following: NDArray[np.float64] | None = None,
    *,
    by_bytes: bool = False,
) -> Clock:
    """Compare the two clocks.

    Parameters
    ----------
    host : (f,) float64
        When each frame, or part of a frame, had come in, s.
    device : (f,) float64
        The device's time when it had sent that much, s, not decreasing.
    following : (f,) float64, optional
        The device's time when it had sent more, of which nothing had come in yet; NaN where that is not known.
    by_bytes : bool
        Both times are those of bytes on a serial line, which come in as they are sent or at the next poll.  Then a wide
        interval means polls in step with the host, for which every line within is as likely: the middle is taken, of
        drift and offset.  Whole frames that come at once leave a wide interval, too, and there the line below is right.
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
    ppm = -1e6 * slope / (1 + slope)
    if following is None:
        return Clock(kept, delay[kept], ppm)
    # How much each read leaves open: what it lies above the line, and how long it was to what had not come.
    above = delay - slope * device
    gap = following - device
    open_s = np.where(true, gap + above - above[true].min(), np.nan)
    order = np.lexsort((open_s, bins))  # NaN goes last
    sharpest = order[np.concatenate(([True], np.diff(bins[order]) > 0))]
    sharpest = sharpest[np.isfinite(open_s[sharpest])]
    if len(sharpest) < 2:
        return Clock(kept, delay[kept], ppm)
    below = delay[sharpest] - gap[sharpest]
    prompt, (low, high) = _slopes(device[kept], delay[kept], following[sharpest], below)
    if by_bytes:
        kept = sharpest
    gap, offset_error = gap[kept], open_s[kept] + prompt
    if by_bytes:
        offset_error -= 0.5 * gap
        if 0.5e6 * (high - low) > LIKELY_PPM:
            slope = 0.5 * (low + high)
            ppm = -1e6 * slope / (1 + slope)
    error = 1e6 * max(high - slope, slope - low, 0.0)
    return Clock(kept, delay[kept] - (0.5 * gap if by_bytes else 0.0), ppm, error, offset_error)


def _slopes(
    x: NDArray[np.float64], y: NDArray[np.float64], x_below: NDArray[np.float64], y_below: NDArray[np.float64]
) -> tuple[float, tuple[float, float]]:
    """Return a prompt read's way, s, and the slopes, least and most, of all lines between two sets of points.

    Below (x, y), and above (x_below, y_below) less that way.  A line passes between when it passes between each pair
    (eliminate its height); so each pair is a bound on its slope.
    """
    apart = x[:, np.newaxis] - x_below
    prompt = PROMPT_S
    while True:
        rise = (y[:, np.newaxis] - (y_below - prompt)) / np.where(apart == 0, np.nan, apart)
        low = float(np.max(rise[apart < 0], initial=-np.inf))
        high = float(np.min(rise[apart > 0], initial=np.inf))
        if low <= high:
            return prompt, (low, high)
        prompt *= 2


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
