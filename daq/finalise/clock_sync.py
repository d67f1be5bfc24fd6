"""Host time against device time: offset by the least delay of each second, drift by the line below all delays.

Model, with the times of the n-th byte on both clocks::

    host[n] = offset + (1 + drift) * device[n] + delay[n],    delay[n] >= 0

The device's clock is the time axis.  The delay of a read is never negative and often large (USB batches of 16 ms,
stalls), so host minus device lies on a straight line or above it.  The drift is the slope of the highest line that lies
below all points (highest at their mean: for delays without memory the line of maximum likelihood), an edge of their
lower convex hull.  Source: S. Moon, P. Skelly, D. Towsley, Estimation and removal of clock skew from network delay
measurements, INFOCOM 1999.  Points far below the Theil-Sen line through the least delays of each second are no delays
and are left out first.

Which points: a USB chip that polls in step with the host's own clock shows every poll the same phase of the frames as
long as the drift does not carry them across a poll; whole frames then give the drift no better than one frame period
over the run.  So `from_samples` takes the reads that ended inside a frame, too: on a serial line of known speed each
byte has its own time.

Interval: it is what the line allows, not what the residuals look like, which are perfect in step with the host.  A read
bounds the line from both sides: the last byte it brought had been sent, the next one had not.  So the true line lies
below the one and, less the read's latency, above the other; all lines between give the interval.  Assumed is that in
each second the read that leaves least open had a latency at most `READ_LATENCY_S` above the least of all; where no line
is left, that is doubled until one is.

Sign: a positive drift in ppm means that the device's clock runs fast.  Not modelled: a drift that changes during
the run (temperature), and the constant part of the delay, which one-way data cannot distinguish from the offset.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from daq.finalise.timeline import Samples, parts_of
from daq.protocols.link_budget import BITS_PER_BYTE
from daq.wire.decode import Stream

MOST_POINTS = 600  # the pairwise slopes of so many take 180,000 values; longer runs get wider bins
FEWEST_POINTS = 3
BELIEVABLE = 0.02  # a crystal is within 0.01 %, a ceramic resonator within 0.5 %; beyond 2 % this was no clock
# A thread that waits for a read is woken within less, most of the time.  Twice as much moves each end of the drift's
# interval by 0.25 ms over the length of the run, 4 ppm in a minute.
READ_LATENCY_S = 2.5e-4
LIKELY_PPM = 8.0  # a wider interval means polls in step with the host
PAUSE_S = 2.0  # nothing read for so long: longer than a busy computer stalls, shorter than a suspended one; not swept
TOO_EARLY_S = 0.05  # below the robust line by more than this, a stamp is wrong and not early


@dataclass(frozen=True)
class ClockSync:
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
) -> ClockSync:
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
    nothing = ClockSync(np.empty(0, dtype=np.int64), np.empty(0), None)
    if len(device) < 2:
        return nothing
    span = device[-1] - device[0]
    if span <= 0 or abs((host[-1] - host[0]) / span - 1) > max(BELIEVABLE, 0.5 / span):
        return nothing
    bin_s = max(1.0, span / MOST_POINTS)
    # After a pause of the computer the seconds are the host's: all that was sent meanwhile comes in one of them.
    clock = host if np.max(np.diff(host)) > PAUSE_S else device
    bins = np.floor((clock - clock[0]) / bin_s).astype(np.int64)
    delay = host - device
    order = np.lexsort((delay, bins))
    least = np.sort(order[np.concatenate(([True], np.diff(bins[order]) > 0))])
    if len(least) < FEWEST_POINTS or span < FEWEST_POINTS:
        return ClockSync(least, delay[least], None)
    robust = theil_sen(device[least], delay[least])
    rest = delay - robust * device
    # The middle of the least delays is above the line by far less than this; only a wrong stamp is below it so far.
    true = rest >= np.median(rest[least]) - TOO_EARLY_S
    kept = least[true[least]]
    slope = supporting_slope(device[true], delay[true])
    if abs(slope) > BELIEVABLE:  # pauses of the computer have left no line to go by
        return ClockSync(least, delay[least], None)
    ppm = -1e6 * slope / (1 + slope)
    if following is None:
        return ClockSync(kept, delay[kept], ppm)
    # How much each read leaves open: what it lies above the line, and how long it was to what had not come.
    above = delay - slope * device
    gap = following - device
    open_s = np.where(true, gap + above - above[true].min(), np.nan)
    order = np.lexsort((open_s, bins))  # NaN goes last
    sharpest = order[np.concatenate(([True], np.diff(bins[order]) > 0))]
    sharpest = sharpest[np.isfinite(open_s[sharpest])]
    if len(sharpest) < 2:
        return ClockSync(kept, delay[kept], ppm)
    below = delay[sharpest] - gap[sharpest]
    read_latency, (low, high) = _slopes(device[kept], delay[kept], following[sharpest], below)
    if by_bytes:
        kept = sharpest
    gap, offset_error = gap[kept], open_s[kept] + read_latency
    if by_bytes:
        offset_error -= 0.5 * gap
        if 0.5e6 * (high - low) > LIKELY_PPM:
            slope = 0.5 * (low + high)
            ppm = -1e6 * slope / (1 + slope)
    error = 1e6 * max(high - slope, slope - low, 0.0)
    return ClockSync(kept, delay[kept] - (0.5 * gap if by_bytes else 0.0), ppm, error, offset_error)


def _slopes(
    x: NDArray[np.float64], y: NDArray[np.float64], x_below: NDArray[np.float64], y_below: NDArray[np.float64]
) -> tuple[float, tuple[float, float]]:
    """Return the read latency that had to be allowed, s, and the least and the largest slope of a line between points.

    The line is below all (x, y), and above all (x_below, y_below) less that latency.  It is when it passes between each
    pair (eliminate its height); so each pair is a bound on its slope.
    """
    apart = x[:, np.newaxis] - x_below
    read_latency = READ_LATENCY_S
    while True:
        rise = (y[:, np.newaxis] - (y_below - read_latency)) / np.where(apart == 0, np.nan, apart)
        low = float(np.max(rise[apart < 0], initial=-np.inf))
        high = float(np.min(rise[apart > 0], initial=np.inf))
        if low <= high:
            return read_latency, (low, high)
        read_latency *= 2


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


def from_samples(samples: Samples, streams: Sequence[Stream], baud: int | None) -> ClockSync:
    """Compare the clocks over the longest part; ``index`` of the answer is the run's sample."""
    here = max((where for _, where in parts_of(samples)), key=lambda where: where.stop - where.start)
    last = here.start + np.flatnonzero(np.diff(samples.frame[here], append=-1) != 0)
    host, sample, sent_s = samples.stamp_ns[last], last, np.zeros(len(last))
    # What had not come in yet: the next frame, where another read brought it.
    following = np.append(np.where(np.diff(host) > 0, samples.time[last][1:], np.nan), np.nan)
    by_bytes = False
    if baud is not None:
        # On a serial line of known speed every byte has its time, so reads that ended inside a frame count as well.
        base = np.cumsum([0, *(len(stream.n) for stream in streams)])
        length = np.concatenate([stream.length for stream in streams])
        stamps = np.concatenate([stream.part_stamp_ns for stream in streams])
        begun = np.concatenate([at + stream.part_frame for at, stream in zip(base, streams, strict=False)])
        count = np.concatenate([stream.part_bytes for stream in streams])
        of = np.searchsorted(samples.frame[last], begun)
        known = (of < len(last)) & (samples.frame[last][np.minimum(of, len(last) - 1)] == begun)
        host = np.concatenate((host, stamps[known]))
        sample = np.concatenate((last, last[of[known]]))
        byte_s = BITS_PER_BYTE / baud
        sent_s = np.concatenate((length[samples.frame[last]], count[known])) * byte_s
        by_bytes = bool(length.any())  # of text lines the recorder does not know how long each was
        if by_bytes:
            # The next byte; behind a frame that is the first of the next one, if no byte of it had come.
            following[:-1][np.isin(samples.frame[last][1:], begun)] = np.nan
            following = np.concatenate((following, samples.time[last[of[known]]] + sent_s[len(last) :])) + byte_s
        else:
            following = np.concatenate((following, np.full(int(known.sum()), np.nan)))
    device = samples.time[sample] + sent_s
    order = np.argsort(device, kind="stable")
    host_s = (host[order] - samples.stamp_ns[0]) / 1e9
    found = compare(host_s, device[order], following[order], by_bytes=by_bytes)
    return replace(found, index=sample[order][found.index])
