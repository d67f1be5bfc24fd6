"""Host time against device time: offset by the least delay of each second, drift by the line below all delays.

Model, with the times of the n-th byte on both clocks::

    host[n] = offset + (1 + drift) * device[n] + delay[n],    delay[n] >= 0

The device's clock is the time axis.  The delay of a read is never negative and often large (USB batches of 16 ms,
stalls), so host minus device lies on a straight line or above it.  The drift is the slope of the highest line that lies
below all points (highest at their mean: for delays without memory the line of maximum likelihood), an edge of their
lower convex hull.  Source: S. Moon, P. Skelly, D. Towsley, Estimation and removal of clock skew from network delay
measurements, INFOCOM 1999.  Over 60 s its error is a third of that of the Theil-Sen line through the least delays of
each second; points far below that line are no delays and are left out first.

Which points: a USB chip that polls in step with the host's own clock shows every poll the same phase of the frames as
long as the drift does not carry them across a poll; whole frames then give the drift no better than one frame period
over the run.  So `daq.finalise.clock_points` takes the reads that ended inside a frame, too: on a serial line of known
speed each byte has its own time.

Interval: it is what the line allows, not what the residuals look like, which are perfect in step with the host.  A read
bounds the line from both sides: the last byte it brought had been sent, the next one had not.  So the true line lies
below the one and, less the read's latency, above the other; all lines between give the interval.  Assumed is that in
each second the read that leaves least open had a latency at most `READ_LATENCY_S` above the least of all; where no line
is left, that is doubled until one is.

Sign: a positive drift in ppm means that the device's clock runs fast.  Not modelled: a drift that changes during
the run (temperature), and the constant part of the delay, which one-way data cannot distinguish from the offset.
"""

from dataclasses import InitVar, dataclass, field
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from daq.runfile.spill import Shelf, Spill
from stickslip.compute.arrays import joined, rows

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
    """How the host's clock and the device's went together."""

    index: NDArray[np.int64]  # (c,) samples at the points with the least delay of their second
    # (c,) host minus device there, s: of the byte that came, or, `by_bytes`, of the middle between it and the next
    offset: NDArray[np.float64]
    # device seconds per host second, minus 1, in ppm; None where the two cannot be compared: a simulated rig that runs
    # faster than real time, or too few seconds
    ppm: float | None
    ppm_error: float | None = None  # how far off the drift may be, ppm
    # (c,) how far off each offset may be, s, but for a constant delay.  NaN where it is not known.
    offset_error: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Points:
    """Readings of both clocks, k of them, and the samples that they belong to."""

    host: NDArray[np.float64]  # (k,) when each frame, or part of a frame, had come in, s
    device: NDArray[np.float64]  # (k,) the device's time when it had sent that much, s, not decreasing
    # (k,) the device's time when it had sent more, of which nothing had come in yet; NaN where that is not known
    following: NDArray[np.float64]
    sample: NDArray[np.int64]  # (k,) the sample

    @property
    def delay(self) -> NDArray[np.float64]:
        """Host minus device, s."""
        return self.host - self.device


@dataclass
class ClockPoints:
    """Readings of both clocks over a run, collected piece by piece in order of the device's clock."""

    spill: InitVar[Spill]
    n: int = 0
    first: tuple[float, float] = (0.0, 0.0)  # device and host
    last: tuple[float, float] = (0.0, 0.0)
    longest_pause_s: float = -np.inf

    def __post_init__(self, spill: Spill) -> None:
        self._shelf: Shelf[Points] = Shelf(spill)

    def append(self, points: Points) -> None:
        """Take the next points."""
        if not len(points.device):
            return
        host = points.host if self.n == 0 else np.concatenate(([self.last[1]], points.host))
        self.longest_pause_s = float(np.max(np.diff(host), initial=self.longest_pause_s))
        if self.n == 0:
            self.first = float(points.device[0]), float(points.host[0])
        self.last = float(points.device[-1]), float(points.host[-1])
        self.n += len(points.device)
        self._shelf.append(points)

    def compare(self, *, by_bytes: bool) -> ClockSync:
        """Compare the two clocks.

        by_bytes: Both times are those of bytes on a serial line, which come in as they are sent or at the next poll.
            Then a wide interval means polls in step with the host, for which every line within is as likely: the middle
            is taken, of drift and offset.  Whole frames that come at once leave a wide interval, too, and there the
            line below is right.
        """
        nothing = ClockSync(np.empty(0, dtype=np.int64), np.empty(0), None)
        if self.n < 2:
            return nothing
        span = self.last[0] - self.first[0]
        if span <= 0 or abs((self.last[1] - self.first[1]) / span - 1) > max(BELIEVABLE, 0.5 / span):
            return nothing
        bin_s = max(1.0, span / MOST_POINTS)
        # After a pause of the computer the seconds are the host's: all that was sent meanwhile comes in one of them.
        by_host = self.longest_pause_s > PAUSE_S

        def bins(points: Points) -> NDArray[np.int64]:
            clock, begun = (points.host, self.first[1]) if by_host else (points.device, self.first[0])
            return np.floor((clock - begun) / bin_s).astype(np.int64)

        chosen = _Cheapest()
        for points in self._shelf:
            chosen.take(points, bins(points), points.delay)
        least = chosen.by_number()
        if len(least.device) < FEWEST_POINTS or span < FEWEST_POINTS:
            return ClockSync(least.sample, least.delay, None)
        robust = theil_sen(least.device, least.delay)
        # The middle of the least delays is above the line by far less than this; only a wrong stamp is below it so far.
        lowest = float(np.median(least.delay - robust * least.device)) - TOO_EARLY_S

        def true(points: Points) -> NDArray[np.bool_]:
            return np.asarray(points.delay - robust * points.device >= lowest)

        kept = rows(least, true(least))
        hull = LowerHull()
        for points in self._shelf:
            here = true(points)
            hull.take(points.device[here], points.delay[here])
        slope = hull.slope()
        if abs(slope) > BELIEVABLE:  # pauses of the computer have left no line to go by
            return ClockSync(least.sample, least.delay, None)
        ppm = -1e6 * slope / (1 + slope)
        lowest_above = min(
            float(np.min((points.delay - slope * points.device)[true(points)], initial=np.inf))
            for points in self._shelf
        )

        def open_s(points: Points) -> NDArray[np.float64]:
            """Return how much each read leaves open: what it lies above the line, and how long it was to the next."""
            above = points.delay - slope * points.device
            return np.where(true(points), (points.following - points.device) + above - lowest_above, np.nan)

        chosen = _Cheapest()
        for points in self._shelf:
            chosen.take(points, bins(points), open_s(points))
        sharpest = chosen.by_bin()
        sharpest = rows(sharpest, np.isfinite(open_s(sharpest)))
        if len(sharpest.device) < 2:
            return ClockSync(kept.sample, kept.delay, ppm)
        below = sharpest.delay - (sharpest.following - sharpest.device)
        read_latency, (low, high) = _slopes(kept.device, kept.delay, sharpest.following, below)
        if by_bytes:
            kept = sharpest
        gap, offset_error = kept.following - kept.device, open_s(kept) + read_latency
        if by_bytes:
            offset_error -= 0.5 * gap
            if 0.5e6 * (high - low) > LIKELY_PPM:
                slope = 0.5 * (low + high)
                ppm = -1e6 * slope / (1 + slope)
        error = 1e6 * max(high - slope, slope - low, 0.0)
        return ClockSync(kept.sample, kept.delay - (0.5 * gap if by_bytes else 0.0), ppm, error, offset_error)


class _Cheapest:
    """Of each bin the point of the least cost, the first of equal ones; points come in order."""

    def __init__(self) -> None:
        self._best: dict[int, tuple[float, int, Points]] = {}  # best point of each bin: cost, number, point
        self._n = 0

    def take(self, points: Points, bins: NDArray[np.int64], cost: NDArray[np.float64]) -> None:
        """Take the next points; a cost of NaN is larger than any."""
        order = np.lexsort((cost, bins))
        for at in order[np.concatenate(([True], np.diff(bins[order]) > 0))].tolist():
            known = self._best.get(int(bins[at]))
            if known is None or cost[at] < known[0] or (np.isnan(known[0]) and not np.isnan(cost[at])):
                own = rows(points, np.array([at]))  # a copy: a slice would keep all of the points in memory
                self._best[int(bins[at])] = float(cost[at]), self._n + at, own
        self._n += len(bins)

    def by_bin(self) -> Points:
        """Return the points in order of their bins."""
        return joined([self._best[number][2] for number in sorted(self._best)])

    def by_number(self) -> Points:
        """Return the points in the order in which they came."""
        return joined([point for _, _, point in sorted(self._best.values(), key=itemgetter(1))])


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


class LowerHull:
    """The lower convex hull of points that come in order of x, by a monotone chain."""

    def __init__(self) -> None:
        self._hull: list[tuple[float, float]] = []
        self._sum, self._n = 0.0, 0

    def take(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        """Take the next points."""
        hull = self._hull
        for point in zip(x.tolist(), y.tolist(), strict=True):
            if hull and point[0] == hull[-1][0]:
                if point[1] >= hull[-1][1]:
                    continue
                hull.pop()
            while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        self._sum += float(x.sum())
        self._n += len(x)

    def slope(self) -> float:
        """Return the slope of the line below all points that is highest at their mean x; not all x are equal."""
        hull, middle = self._hull, self._sum / self._n
        edge = next(i for i in range(1, len(hull)) if hull[i][0] >= middle or i == len(hull) - 1)
        (x0, y0), (x1, y1) = hull[edge - 1], hull[edge]
        return (y1 - y0) / (x1 - x0)


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])


def theil_sen(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the median of the slopes of all pairs; x strictly increasing, at least two points."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))
