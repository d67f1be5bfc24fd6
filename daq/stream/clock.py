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
over the run.  So `PartClock` takes the reads that ended inside a frame, too: on a serial line of known
speed each byte has its own time.

Interval: it follows from the lines that the reads allow, not from the residuals, which are perfect in step with the
host.  A read bounds the line from both sides: its last byte had been sent, the next one had not.  So the true line lies
below the first and, less the read's latency, above the second; all lines between give the interval.  It is assumed that
in each second the read with the least uncertainty had a latency at most `READ_LATENCY_S` above the least of all; if no
line is possible, that is doubled until one is.

Sign: a positive drift in ppm means that the device's clock runs fast.  Not modelled: a drift that changes during
the run (temperature), and the constant part of the delay, which one-way data cannot distinguish from the offset.
"""

from dataclasses import dataclass, field, replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from daq.protocols.link_budget import BITS_PER_BYTE
from daq.runfile.spill import Shelf, Spill
from daq.stream.timeline import Piece, split_parts
from stickslip.compute.arrays import joined, rows

MOST_POINTS = 600  # the pairwise slopes of so many take 180,000 values; longer runs get wider bins
FEWEST_POINTS = 3
BELIEVABLE = 0.02  # largest drift of a clock: a crystal is within 0.01 %, a ceramic resonator within 0.5 %
# A thread that waits for a read is usually woken within less than this, s.
READ_LATENCY_S = 2.5e-4
LIKELY_PPM = 8.0  # a wider interval means polls in step with the host
PAUSE_S = 2.0  # without a read: longer than a busy computer stalls, shorter than a suspended one
TOO_EARLY_S = 0.05  # below the robust line by more than this, a stamp is wrong and not early


@dataclass(frozen=True)
class ClockSync:
    """Comparison of the host's clock and the device's."""

    index: NDArray[np.int64]  # (c,) samples at the points with the least delay of their second
    # (c,) host minus device there, s: of the byte that arrived, or, `by_bytes`, of the middle between it and the next
    offset: NDArray[np.float64]
    # device seconds per host second, minus 1, in ppm; None where the two cannot be compared: a simulated rig that runs
    # faster than real time, or too few seconds
    ppm: float | None
    ppm_error: float | None = None  # uncertainty of the drift, ppm
    # (c,) uncertainty of each offset, s, apart from a constant delay; NaN where it is unknown
    offset_error: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Points:
    """Readings of both clocks, k of them, and the samples that they belong to."""

    host: NDArray[np.float64]  # (k,) time at which each frame, or part of a frame, had arrived, s
    device: NDArray[np.float64]  # (k,) the device's time when it had sent that much, s, not decreasing
    # (k,) the device's time when it had sent more, none of which had arrived yet; NaN where it is unknown
    following: NDArray[np.float64]
    sample: NDArray[np.int64]  # (k,)

    @property
    def delay(self) -> NDArray[np.float64]:
        """Host minus device, s."""
        return self.host - self.device


def compare_clocks(shelf: Shelf[Points], *, by_bytes: bool) -> ClockSync:
    """Compare the two clocks by their readings over a run, in order of the device's clock.

    ``by_bytes``: both times are those of bytes on a serial line, which arrive as they are sent or at the next poll.
    Then a wide interval means polls in step with the host, and every line within is as likely: the middle is used, of
    drift and offset.  Whole frames that arrive at once also give a wide interval, but there the line below is right.
    """
    first = last = (np.nan, np.nan)  # device and host
    pause_s = -np.inf  # the longest
    for number, points in enumerate(shelf):
        first = first if number else (float(points.device[0]), float(points.host[0]))
        pause_s = float(np.max(np.diff(points.host, prepend=last[1] if number else first[1]), initial=pause_s))
        last = float(points.device[-1]), float(points.host[-1])
    span = last[0] - first[0]
    if not span > 0 or abs((last[1] - first[1]) / span - 1) > max(BELIEVABLE, 0.5 / span):
        return ClockSync(np.empty(0, dtype=np.int64), np.empty(0), None)
    bin_s = max(1.0, span / MOST_POINTS)
    # After a pause of the computer the seconds are the host's: all that was sent meanwhile arrives in one of them.
    by_host = pause_s > PAUSE_S

    def number_bins(points: Points) -> NDArray[np.int64]:
        clock, begin = (points.host, first[1]) if by_host else (points.device, first[0])
        return np.floor((clock - begin) / bin_s).astype(np.int64)

    minima = _BinMinimum()
    for points in shelf:
        minima.take(points, number_bins(points), points.delay)
    least = minima.by_number()
    if len(least.device) < FEWEST_POINTS or span < FEWEST_POINTS:
        return ClockSync(least.sample, least.delay, None)
    robust = theil_sen(least.device, least.delay)
    # The middle of the least delays is above the line by far less than this; only a wrong stamp is below it so far.
    lowest = float(np.median(least.delay - robust * least.device)) - TOO_EARLY_S

    def is_plausible(points: Points) -> NDArray[np.bool_]:
        return np.asarray(points.delay - robust * points.device >= lowest)

    points_kept = rows(least, is_plausible(least))
    hull = LowerHull()
    for points in shelf:
        plausible = is_plausible(points)
        hull.take(points.device[plausible], points.delay[plausible])
    slope = hull.fit_slope()
    if abs(slope) > BELIEVABLE:  # no line fits because of pauses of the computer
        return ClockSync(least.sample, least.delay, None)
    ppm = -1e6 * slope / (1 + slope)
    lowest_above = min(
        float(np.min((points.delay - slope * points.device)[is_plausible(points)], initial=np.inf)) for points in shelf
    )

    def uncertainty_s(points: Points) -> NDArray[np.float64]:
        """Return the uncertainty of each read: its height above the line, and the time to the next one."""
        above = points.delay - slope * points.device
        return np.where(is_plausible(points), (points.following - points.device) + above - lowest_above, np.nan)

    minima = _BinMinimum()
    for points in shelf:
        minima.take(points, number_bins(points), uncertainty_s(points))
    sharpest = minima.by_bin()
    sharpest = rows(sharpest, np.isfinite(uncertainty_s(sharpest)))
    if len(sharpest.device) < 2:
        return ClockSync(points_kept.sample, points_kept.delay, ppm)
    below = sharpest.delay - (sharpest.following - sharpest.device)
    read_latency, (low, high) = _bound_slopes(points_kept.device, points_kept.delay, sharpest.following, below)
    if by_bytes:
        points_kept = sharpest
    gap, offset_error = points_kept.following - points_kept.device, uncertainty_s(points_kept) + read_latency
    if by_bytes:
        offset_error -= 0.5 * gap
        if 0.5e6 * (high - low) > LIKELY_PPM:
            slope = 0.5 * (low + high)
            ppm = -1e6 * slope / (1 + slope)
    error = 1e6 * max(high - slope, slope - low, 0.0)
    return ClockSync(points_kept.sample, points_kept.delay - (0.5 * gap if by_bytes else 0.0), ppm, error, offset_error)


class _BinMinimum:
    """The point of least cost in each bin, the first of equal ones; points come in order."""

    def __init__(self) -> None:
        self._best: dict[int, tuple[float, int, Points]] = {}  # best point of each bin: cost, number, point
        self._n = 0

    def take(self, points: Points, bins: NDArray[np.int64], cost: NDArray[np.float64]) -> None:
        """Add the next points; a cost of NaN is larger than any other."""
        order = np.lexsort((cost, bins))
        for index in order[np.concatenate(([True], np.diff(bins[order]) > 0))].tolist():
            best = self._best.get(int(bins[index]))
            if best is None or cost[index] < best[0] or (np.isnan(best[0]) and not np.isnan(cost[index])):
                point = rows(points, np.array([index]))  # a copy: a slice would keep all of the points in memory
                self._best[int(bins[index])] = float(cost[index]), self._n + index, point
        self._n += len(bins)

    def by_bin(self) -> Points:
        return joined([self._best[number][2] for number in sorted(self._best)])

    def by_number(self) -> Points:
        """Return the points in order of arrival."""
        return joined([point for _, _, point in sorted(self._best.values(), key=itemgetter(1))])


def _bound_slopes(
    x: NDArray[np.float64], y: NDArray[np.float64], x_below: NDArray[np.float64], y_below: NDArray[np.float64]
) -> tuple[float, tuple[float, float]]:
    """Return the read latency that was needed, s, and the least and the largest slope of a line between points.

    The line is below all (x, y), and above all (x_below, y_below) less that latency.  It is if it passes between each
    pair (eliminate its height); so each pair is a bound on its slope.
    """
    distance = x[:, np.newaxis] - x_below
    read_latency = READ_LATENCY_S
    while True:
        rise = (y[:, np.newaxis] - (y_below - read_latency)) / np.where(distance == 0, np.nan, distance)
        low = float(np.max(rise[distance < 0], initial=-np.inf))
        high = float(np.min(rise[distance > 0], initial=np.inf))
        if low <= high:
            return read_latency, (low, high)
        read_latency *= 2


class LowerHull:
    """The lower convex hull of points that come in order of x, by a monotone chain."""

    def __init__(self) -> None:
        self._hull: list[tuple[float, float]] = []
        self._sum, self._n = 0.0, 0

    def take(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
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

    def fit_slope(self) -> float:
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


@dataclass(frozen=True)
class _FrameEnds:
    """Ends of frames, or of parts of them: stamp, last sample and its time, time of the bytes, (f,) each."""

    host_ns: NDArray[np.int64]
    time: NDArray[np.float64]
    frame: NDArray[np.int64]
    sample: NDArray[np.int64]
    sent_s: NDArray[np.float64]


class PartClock:
    """The clocks over one part of a run, whose pieces come in order.

    part: The part: the longest one of the run.
    baud: On a serial line of known speed every byte has its time, so reads that ended inside a frame count as well.
    by_bytes: Whether the length of the frames is known: not for text lines.
    spill: Storage of the points.
    """

    def __init__(self, part: int, baud: int | None, by_bytes: bool, spill: Spill) -> None:
        self._part = part
        self._byte_s = 0.0 if baud is None else BITS_PER_BYTE / baud
        self._reads = baud is not None
        self._by_bytes = by_bytes and self._reads
        self._points: Shelf[Points] = Shelf(spill)
        self._first_ns = 0
        self._samples = 0
        self._last: _FrameEnds | None = None  # the last frame, whose next frame has not come
        self._held = Points(np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.int64))  # not yet in order
        self._held_kind = np.empty(0, dtype=np.int8)

    def take(self, piece: Piece) -> None:
        samples = piece.samples
        if not self._samples and len(samples):
            self._first_ns = int(samples.stamp_ns[0])
        for part, span in split_parts(samples):
            if part == self._part:
                self._take_part(piece, span)
        self._samples += len(samples)

    def compare(self) -> ClockSync:
        """Return the comparison of the clocks; ``index`` is the run's sample."""
        if self._last is not None:
            self._hold(self._last, np.array([np.nan]))
            self._release(np.inf)
        return compare_clocks(self._points, by_bytes=self._by_bytes)

    def _take_part(self, piece: Piece, span: slice) -> None:
        samples, frames = piece
        last = span.start + np.flatnonzero(np.diff(samples.frame[span], append=-1) != 0)
        frame = samples.frame[last]
        sent_s = np.zeros(len(last))
        if self._reads:
            sent_s = frames.length[frame - frames.first] * self._byte_s
        ends = _FrameEnds(samples.stamp_ns[last], samples.time[last], frame, self._samples + last, sent_s)
        cut_frames = frames.first + frames.part_frame if self._reads else np.empty(0, dtype=np.int64)
        ends_index = np.searchsorted(frame, cut_frames)
        has_samples = (ends_index < len(frame)) & (frame[np.minimum(ends_index, len(frame) - 1)] == cut_frames)
        with_last = ends if self._last is None else joined([self._last, ends])
        # What had not arrived yet: the next frame, if another read brought it.
        following = np.where(np.diff(with_last.host_ns) > 0, with_last.time[1:], np.nan)
        if self._by_bytes:
            # The next byte; after a frame, the first of the next one, if no byte of it had arrived.
            following[np.isin(with_last.frame[1:], cut_frames)] = np.nan
            following += self._byte_s
        self._hold(rows(with_last, slice(-1)), following)
        if has_samples.any():
            part_s = frames.part_bytes[has_samples] * self._byte_s
            inside = replace(
                rows(ends, ends_index[has_samples]), host_ns=frames.part_stamp_ns[has_samples], sent_s=part_s
            )
            after = inside.time + part_s + self._byte_s if self._by_bytes else np.full(len(part_s), np.nan)
            self._hold(inside, after, kind=1)
        self._last = rows(with_last, slice(-1, None))
        self._release(float(self._last.time[0]))

    def _hold(self, ends: "_FrameEnds", following: NDArray[np.float64], kind: int = 0) -> None:
        new = Points((ends.host_ns - self._first_ns) / 1e9, ends.time + ends.sent_s, following, ends.sample)
        self._held = joined([self._held, new])
        self._held_kind = np.concatenate((self._held_kind, np.full(len(following), kind, dtype=np.int8)))

    def _release(self, before_s: float) -> None:
        """Pass on the points before a time that no later one precedes: in order, frames before parts of them."""
        order = np.lexsort((self._held_kind, self._held.device))
        done = self._held.device[order] < before_s
        if done.any():
            self._points.append(rows(self._held, order[done]))
        self._held, self._held_kind = rows(self._held, order[~done]), self._held_kind[order[~done]]
