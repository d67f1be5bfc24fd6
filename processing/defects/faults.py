"""Faults of a record by the auxiliary residuals of one smoother: spikes, frozen stretches, steps and kicks.

A motion of white jerk is smoothed once.  The scores of its backward pass (`processing.kalman.motion_kernel`) give, at
every sample, the t statistic of an outlying reading, of a step of the position over one to five samples (lost counts, a
datum that moves), of a kick (a short step of the velocity), and of a corner (a step of the acceleration, as at every
landing).  A place belongs to the kind that explains it best.  It is a fault if that kind is not a corner, its statistic
exceeds the threshold, and no other kind nearby explains it as well.

The largest fault is removed first, outliers before steps; then its neighbourhood is searched again.  Faulty readings
become NaN, which the filters treat as missing.  Steps are removed; kicks are marked, and stay.

A frozen stretch is a run of equal readings that ends in a step: the sensor held its value while the mass moved.  Two
steps that cancel within a few samples, or on both sides of a run of equal readings, are a burst of outliers.  Steps
that together bring the mass back are slips of few samples, not steps of the datum.

Not found: steps and kicks in the first and last four samples of a piece and across a gap, a sensor that holds its value
while nothing moves, steps of a datum that creeps.

Source: P. de Jong and J. Penzer, J. Am. Stat. Assoc. 93 (1998) 796.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.defects import residual_kernel
from processing.defects.residual_kernel import CORNER, ENDS, KICK, OUTLIER, STEP
from processing.kalman import white_jerk
from processing.record.motion import Fault, VelocityStep
from processing.record.noise import position_noise, reading_step
from processing.record.series import PositionStep, Series, step_offsets, step_profile
from stickslip.compute.arrays import Array, Integers, Mask, runs
from stickslip.compute.compile import compiled

Segments = NDArray[np.integer]

KERNELS = ("processing.defects.residual_kernel",)

# Standard deviations that a fault must have, among the 60,000 places of each kind in a minute at 1 kHz.
THRESHOLD = {OUTLIER: 6.0, STEP: 6.0, KICK: 7.0}
NEAR_OUTLIER = 5.0  # the same for an outlier near another one, where there are few places for a chance result
BEYOND_CORNER = 12.0  # of the square of t: twice the log likelihood by which a step or a kick must beat any corner
STEP_OVER_KICK = 12.0  # of the square of t: by how much a small step must beat a kick, which can look like one
SMALL = 8.0  # counts, or sqrt(12) standard deviations of a position: smaller steps can be kicks
LEAST_COUNTS = 4.0  # counts of a step: a smaller one may be an encoder's error between two lines
SPREAD = 5  # samples of the longest step
RETURNS = (3, 4, 5, 6, 7, 8, 10, 12)  # samples after which a kick is over
SHARPEST = 1.5  # times the largest accelerations of the record (99th percentile): those that end a kick
LEARNED, PART = 2**14, 2**12  # samples that a model is learned from, and of a part of them
ZONE, GROWING = 14, 10.0  # samples around a place that belong to it, and how many more for each power of e of its t
LOOKED_AT = 24.0  # of the square of t: smaller values are neither candidates nor corners that exclude a fault nearby
LOCAL, NOISY = 64, 2.0  # samples of a block; ratio to the usual median square above which its t are scaled down
NORMAL = 0.4549  # median of the square of a standard normal number
# Standard deviations of a position: largest error of a step, else the smoother follows any motion within some ten
# samples, and landings and starts look like steps.
RESOLVED = 1.5
WIDEST = 101  # samples of the smoother's window: a longer one finds no more faults
PASSES = 64  # more than any record needs
FADED = 18.0  # natural logarithm by which the samples beyond a neighbourhood have faded: 1e-8
FROZEN, BURST, HOLE = 5, 8, 8  # samples: equal readings; between two steps of a burst; left out in a row
BLIND_SAMPLES = 3  # samples on either side of such a hole that are not searched
COMPARED_STEPS = 8  # steps on either side of a frozen stretch that must show motion
CANCELLED = 0.3  # of the smaller of the largest steps up and down: largest sum of steps that cancel
FEWEST = 40  # samples of a piece
NO_MOTION = np.empty((6, 0))  # statistics of no sample
REESTIMATE_BELOW = 0.95  # noise after removing faults, relative to before; below it, search again
WIDER_RANGE = 0.5  # of the sum of steps: largest increase of the range without them; without slips it is all of it


@dataclass(frozen=True)
class FaultModel:
    """The noise and thresholds for the faults of a record."""

    step: float  # that readings are rounded to, m; 0 without one
    noise: float  # standard deviation of a position without faults, m
    process: white_jerk.Noise  # of the smoother that finds faults, fitted without corners
    sharpest: float  # about the largest acceleration, m/s^2
    steps: bool  # whether to search for steps of the position, as steps of the datum


@dataclass(frozen=True, eq=False)
class CheckedRecord:
    """A record and its faults, in order of time."""

    series: Series  # without the steps of the position; faulty readings are NaN
    faults: tuple[Fault, ...]
    steps: tuple[PositionStep, ...]
    kicks: tuple[VelocityStep, ...]
    offset: Array  # sum of the steps before each sample, m

    @property
    def kept(self) -> Mask:
        """True for the samples that are not faulty."""
        return ~np.isnan(self.series.position)


class _Place(NamedTuple):
    """A sample with a large statistic."""

    sample: int
    kind: int
    square: float  # of t
    near: Array  # largest square of each kind nearby


@dataclass
class _Step:
    first: int
    width: int  # samples
    size: float  # m

    @property
    def last(self) -> int:
        return self.first + self.width - 1


@dataclass(frozen=True, eq=False)
class _Templates:
    """Steps and kicks as sums of scores, for `residual_kernel.find_statistics`."""

    steps: Array
    kicks: Array
    variance: Array
    durations: Integers
    resolved: bool  # whether the smoother distinguishes them from corners

    @classmethod
    def of(cls, noise: white_jerk.Noise, interval: float) -> "_Templates":
        """Return the templates of steps over 1 to `SPREAD` samples and of kicks over after `RETURNS`."""
        covariances = _step_covariances(noise, interval)
        lags = covariances[covariances.size // 2 :][: max(RETURNS)]

        def variance(weights: Array) -> float:
            distance = np.abs(np.subtract.outer(np.arange(weights.size), np.arange(weights.size)))
            return float(weights @ lags[distance] @ weights / lags[0])

        remaining = [np.maximum(1 - np.arange(1.0, max(RETURNS) + 1) / d, 0) ** 2 for d in RETURNS]  # share of the way
        kicks = -np.diff(remaining, prepend=1.0)
        return cls(
            np.array([1 / variance(np.ones(d)) for d in range(1, SPREAD + 1)]),
            kicks,
            np.array([variance(weights) for weights in kicks]),
            np.array(RETURNS),
            bool(lags[0] * noise.reading * RESOLVED**2 >= 1.0),
        )


def _step_covariances(noise: white_jerk.Noise, interval: float) -> Array:
    """Return the covariances of the scores of steps some samples apart, (n,): the scores of steps around one of 1 m."""
    n = min(2 * _samples_to_fade(noise, interval) + 1, 2**12 + 1)
    time, position = np.asarray(interval * np.arange(n), float), np.zeros(n)
    position[n // 2 :] = 1.0
    scores = np.empty((n, white_jerk.SCORES))
    white_jerk.smooth_piece(time, position, noise, n, 0, NO_MOTION, scores=scores)
    return scores[:, 2].copy()


def _samples_to_fade(noise: white_jerk.Noise, interval: float) -> int:
    return white_jerk.samples_to_fade(noise.rho(interval), FADED)


class _Search:
    """The search for faults in one piece.

    ``position`` is without the faults found so far; ``spike`` and ``frozen`` are masks of the readings left out.
    """

    def __init__(self, time: Array, position: Array, low: int, model: FaultModel, templates: _Templates) -> None:
        n = time.size
        self.time, self.reading, self.position, self.model = time, position, position.copy(), model
        self.spike, self.frozen = np.zeros(n, bool), np.zeros(n, bool)
        self.steps: list[_Step] = []
        self._low, self._templates, self._noise = low, templates, model.process
        self._interval = (time[-1] - time[0]) / (n - 1)
        self._reach = _samples_to_fade(self._noise, self._interval)
        self._scores, self._squares = np.empty((n, white_jerk.SCORES)), np.zeros((4, n))
        self._sizes, self._widths = np.zeros((3, n)), np.ones(n, np.int64)
        self._fault_places: list[_Place] | None = None
        self._score(0, n)

    @cached_property
    def _equal_runs(self) -> tuple[Integers, Integers]:
        """First and end of every run of at least `FROZEN` equal readings."""
        edges = np.flatnonzero(np.diff(self.reading)) + 1
        first, end = np.concatenate(([0], edges)), np.concatenate((edges, [self.reading.size]))
        held = end - first >= FROZEN
        return first[held], end[held]

    def find_outliers(self) -> None:
        """Find only outliers and frozen stretches."""
        for _ in range(PASSES):
            if not self._rescore(self._drop_outliers() or self._drop_frozen()):
                break

    def find_faults(self) -> None:
        """Find outliers, frozen stretches, steps and bursts, in this order, until there are no more."""
        for _ in range(PASSES):
            changed = self._drop_outliers() or self._drop_frozen() or self._remove_steps() or self._merge_bursts()
            if not self._rescore(changed):
                break
        if not self.model.steps:  # without them bursts would stay
            for step in self.steps:
                self._enlarge_step(step, -step.size)
            self._rescore([(step.first, step.last) for step in self.steps])
            self.steps = []
        for _ in range(2 if self.steps else 0):  # their sizes once more, all together
            for step in self.steps:
                self._enlarge_step(step, self._remaining_step(step))
            self._rescore([(step.first, step.last) for step in self.steps])

    def find_kicks(self) -> Iterator[tuple[int, float]]:
        """Yield samples and sizes, m/s, of the kicks."""
        for place in self._judge_places() if self._templates.resolved else ():
            if place.kind == KICK:
                yield place.sample, float(self._sizes[KICK, place.sample])

    def smooth_acceleration(self) -> Array:
        """Return the acceleration of the smoothed motion, m/s^2, without its less accurate ends."""
        n = self.time.size
        motion, end = np.empty((6, n)), min(WIDEST // 2, n // 4)
        white_jerk.smooth_piece(self.time, self.position, self._noise, white_jerk.BLOCK, self._reach, motion)
        return np.asarray(motion[2, end : n - end])

    def _score(self, first: int, end: int) -> None:
        """Smooth the samples first..end - 1 and compute their scores and statistics."""
        n = self.time.size
        low, high = max(first - self._reach, 0), min(end + self._reach, n)
        scores = self._scores if (low, high) == (0, n) else np.empty((high - low, white_jerk.SCORES))
        white_jerk.smooth_piece(
            self.time[low:high],
            self.position[low:high],
            self._noise,
            max(white_jerk.BLOCK, 4 * self._reach),
            self._reach,
            NO_MOTION,
            scores=scores,
        )
        if scores is not self._scores:
            self._scores[first:end] = scores[first - low : end - low]
        self._find_statistics(first, end)

    def _find_statistics(self, first: int, end: int) -> None:
        self._fault_places = None
        t = self._templates
        compiled(residual_kernel.find_statistics, KERNELS)(
            *(self._scores, t.steps, t.kicks, t.variance, t.durations, SHARPEST * self.model.sharpest, self._interval),
            *((first, end), self._squares, self._sizes, self._widths),
        )

    def _rescore(self, changed: list[tuple[int, int]]) -> bool:
        """Update the statistics around the changed spans, first to last sample; return whether there are any."""
        affected = np.zeros(self.time.size, bool)
        for first, last in changed:
            affected[max(first - self._reach, 0) : last + self._reach + 1] = True
        for first, end in runs(affected):
            self._score(first, end)
        return bool(changed)

    def _drop_outliers(self) -> list[tuple[int, int]]:
        """Leave out outliers; return their spans."""
        samples = [place.sample for place in self._judge_places() if place.kind == OUTLIER]
        self.spike[samples] = True
        self.position[samples] = np.nan
        return [(sample, sample) for sample in samples]

    def _drop_frozen(self) -> list[tuple[int, int]]:
        """Leave out the runs of equal readings that end in a step; return their spans."""
        changed = [
            run for place in self._judge_places() if place.kind == STEP for run in self._drop_run_before(place.sample)
        ]
        self.position[self.spike | self.frozen] = np.nan
        return changed

    def _drop_run_before(self, step: int) -> list[tuple[int, int]]:
        """Leave out the run of equal readings that ends in a step, and return its span.

        Its first reading is kept, unless the readings stepped there too: a drop-out.
        """
        first, end = self._equal_runs
        k = int(np.searchsorted(end, step - 2))
        if k == end.size or end[k] > step + 2 or first[k] >= step or self.frozen[first[k] + 1]:
            return []
        begin, stop = int(first[k]), int(end[k])
        if self.spike[begin + 1 : stop].all():
            return []
        before = np.diff(self.reading[max(begin - COMPARED_STEPS, 0) : begin + 1])
        after = np.diff(self.reading[stop : stop + COMPARED_STEPS + 1])
        if before.size and _cancel([float(before[-1]), float(self._sizes[STEP, step])]):
            self.spike[begin:stop] = True
            return [(begin, stop - 1)]
        if before.size < COMPARED_STEPS or not (np.median(np.abs(before)) or np.median(np.abs(after))):
            return []  # the record begins at rest, or the mass is at rest on either side
        self.frozen[begin + 1 : stop] = True
        return [(begin + 1, stop - 1)]

    def _remove_steps(self) -> list[tuple[int, int]]:
        """Remove the significant steps; return their spans."""
        changed = []
        for place in self._judge_places() if self._templates.resolved else ():
            if place.kind == STEP:
                i, width = place.sample, int(self._widths[place.sample])
                step = next(
                    (candidate for candidate in self.steps if (candidate.first, candidate.width) == (i, width)), None
                )
                if step is None:
                    step = _Step(i, width, 0.0)
                    self.steps.append(step)
                self._enlarge_step(step, float(self._sizes[STEP, i]))
                changed.append((step.first, step.last))
        return changed

    def _enlarge_step(self, step: _Step, more: float) -> None:
        self.position[step.first : step.last + 1] -= more * step_profile(step.width)
        self.position[step.last + 1 :] -= more
        step.size += more

    def _remaining_step(self, step: _Step) -> float:
        """Return the rest of a step that was removed, m."""
        scores = self._scores[step.first : step.last + 1]
        information = float(scores[:, 3].mean())
        share = self._templates.steps[step.width - 1] * step.width
        return float(scores[:, 2].sum()) * share / information if information > 0 else 0.0

    def _merge_bursts(self) -> list[tuple[int, int]]:
        """Leave out the samples between steps that cancel within `BURST` samples; return their spans.

        Any two of opposite sign are a burst too: the rest of their sum is searched for again.
        """
        changed, kept = [], []
        remaining = sorted(self.steps, key=lambda step: step.first)
        while remaining:
            burst = [step for step in remaining if step.first - remaining[0].first <= BURST]
            while len(burst) > 2 and not _cancel([step.size for step in burst]):
                burst.pop()
            if len(burst) < 2 or (burst[0].size * burst[1].size > 0 and len(burst) == 2):
                kept.append(remaining.pop(0))
                continue
            del remaining[: len(burst)]
            for step in burst:
                self._enlarge_step(step, -step.size)
            self.spike[burst[0].first : burst[-1].last] = True
            changed.append((burst[0].first, burst[-1].last))
        self.steps = kept
        self.position[self.spike] = np.nan
        return changed

    def _judge_places(self) -> list[_Place]:
        """Return the places that are faults, the largest first."""
        if self._fault_places is None:
            self._fault_places = [
                fault for place in self._find_places() if (fault := self._classify(place)) is not None
            ]
        return self._fault_places

    def _classify(self, place: _Place) -> _Place | None:
        """Return the fault at a place, or None; a step that could be a kick is returned as one."""
        i, kind, square, near = place
        near_outlier = kind == OUTLIER and bool(self.spike[max(i - BURST, 0) : i + BURST + 1].any())
        if kind == CORNER or square < (NEAR_OUTLIER if near_outlier else THRESHOLD[kind]) ** 2:
            return None
        if kind == OUTLIER and min(i, self.time.size - 1 - i) < ENDS:
            bend = SHARPEST * self.model.sharpest * (ENDS * self._interval) ** 2  # by a corner that is not seen there
            return place if abs(float(self._sizes[OUTLIER, i])) > bend else None
        if kind != OUTLIER and square < near[CORNER] + BEYOND_CORNER:
            return None
        if kind == STEP:
            size = abs(float(self._sizes[STEP, i]))
            small = size < SMALL * math.sqrt(12) * self.model.noise
            if square < near[KICK] + (STEP_OVER_KICK if small else 0.0):
                return _Place(i, KICK, square, near)  # not distinguished: marked, and left in the position
            if size < LEAST_COUNTS * self.model.step:
                return None
        return place

    def _find_places(self) -> list[_Place]:
        """Return the places with large statistics, the largest first, each without smaller ones nearby."""
        suspects = np.flatnonzero(self._squares.max(axis=0) > LOOKED_AT)
        suspects = suspects[~self._mask_blind()[suspects]]
        squares = self._squares[:, suspects] / self._scale(suspects)
        best = squares.max(axis=0)
        large = np.flatnonzero(best >= NEAR_OUTLIER**2)
        large = large[np.argsort(-best[large], kind="stable")]
        zones = (ZONE + GROWING * np.maximum(0.5 * np.log(best[large] / 100.0), 0.0)).astype(int)
        taken, picked = bytearray(self.time.size), []
        for k, i, zone in zip(large.tolist(), suspects[large].tolist(), zones.tolist(), strict=True):
            if not taken[i]:
                first, end = max(i - zone, 0), min(i + zone + 1, len(taken))
                taken[first:end] = b"\1" * (end - first)
                picked.append(k)
        if not picked:
            return []
        samples = suspects[picked]
        ends = np.searchsorted(suspects, samples[:, None] + np.array([-ZONE, ZONE + 1]))
        near = np.empty((samples.size, 4))
        compiled(residual_kernel.find_largest, KERNELS)(squares, ends, near)
        kinds = squares[:, picked].argmax(axis=0)
        return [_Place(*row) for row in zip(samples.tolist(), kinds.tolist(), best[picked].tolist(), near, strict=True)]

    def _scale(self, samples: Integers) -> Array:
        """Return how much larger than expected the squares of outliers are nearby, at least 1.

        Wrong times cause errors in proportion to the velocity, and bursts of noise do so anywhere.  The median of three
        blocks, each their samples' median, leaves out the block that a step disturbs.
        """
        before = self._low % LOCAL  # so that blocks begin at multiples of `LOCAL` of the record's samples
        block = 1 + (before + samples) // LOCAL
        padded = np.zeros((3 + (before + self.time.size) // LOCAL, LOCAL))
        padded.ravel()[LOCAL + before : LOCAL + before + self.time.size] = self._squares[OUTLIER]
        wanted = np.zeros(len(padded), bool)
        wanted[block[:, None] + np.arange(-1, 2)] = True
        scale = np.ones(len(padded))
        scale[wanted] = _scale_blocks(padded[wanted])
        return np.asarray(np.median([scale[block - 1], scale[block], scale[block + 1]], axis=0))

    def _mask_blind(self) -> Mask:
        """Return a mask of the samples that are not searched: those left out, and next to long holes of them."""
        gone = self.spike | self.frozen
        mask = gone.copy()
        for first, end in runs(gone) if gone.any() else ():
            if end - first >= HOLE:
                mask[max(first - BLIND_SAMPLES, 0) : end + BLIND_SAMPLES] = True
        return mask


def _scale_blocks(squares: Array) -> Array:
    """Return the medians of blocks of squares of outliers, (k, LOCAL), over the usual one; 1 where none is `NOISY`."""
    scale = np.partition(squares, LOCAL // 2, axis=1)[:, LOCAL // 2] / NORMAL
    return np.where(scale < NOISY, 1.0, scale)


def _cancel(sizes: list[float]) -> bool:
    """Return whether steps of these sizes cancel each other."""
    return abs(sum(sizes)) < CANCELLED * min(max(sizes), -min(sizes))


def learn(series: Series, segment: Segments, *, steps: bool) -> tuple[FaultModel, CheckedRecord]:
    """Learn the model of the faults of a record, and return it with the record without them.

    ``segment`` is the segment number of each sample, at whose end a step of the position ends; ``steps`` tells whether
    to search for such steps.
    """
    step, noise = reading_step(series), position_noise(series)
    parts = _pick_parts(series)
    while True:
        process = white_jerk.fit_robustly(series, noise, WIDEST)
        searches = _start_searches(series, FaultModel(step, noise, process, math.inf, steps), 0, parts)
        kept, left_out = np.zeros(series.time.size, bool), False
        for piece, search in searches:
            search.find_outliers()
            faulty = search.spike | search.frozen
            kept[piece], left_out = ~faulty, left_out or bool(faulty.any())
        before = noise
        if left_out:
            noise = position_noise(series.select(kept))
        if not noise < REESTIMATE_BELOW * before:  # else frequent spikes hid others
            break
    accelerations = [search.smooth_acceleration() for _, search in searches]
    sharpest = float(np.percentile(np.abs(np.concatenate(accelerations)), 99)) if accelerations else math.inf
    model = FaultModel(step, noise, process, sharpest, steps)
    checked = _collect_faults(series, segment, _start_searches(series, model, 0, series.pieces))
    if checked.steps and not _is_datum(series, checked):
        model = replace(model, steps=False)
        checked = _collect_faults(series, segment, _start_searches(series, model, 0, series.pieces))
    return model, checked


def _pick_parts(series: Series) -> tuple[slice, ...]:
    """Return parts of the pieces, spread evenly, of `LEARNED` samples in total, or the pieces of a shorter record."""
    stride = series.time.size // LEARNED
    if stride < 2:
        return series.pieces
    starts = [(piece, first) for piece in series.pieces for first in range(piece.start, piece.stop, PART)]
    return tuple(slice(first, min(first + PART, piece.stop)) for piece, first in starts[::stride])


def find(series: Series, segment: Segments, model: FaultModel, low: int = 0) -> CheckedRecord:
    """Find the faults of a record, or of a block of it whose first sample has number ``low``."""
    checked = _collect_faults(series, segment, _start_searches(series, model, low, series.pieces))
    if checked.steps and not _is_datum(series, checked):
        return _collect_faults(
            series, segment, _start_searches(series, replace(model, steps=False), low, series.pieces)
        )
    return checked


def _start_searches(
    series: Series, model: FaultModel, low: int, parts: tuple[slice, ...]
) -> list[tuple[slice, _Search]]:
    """Return the parts that are long enough, with a search for each."""
    templates = _Templates.of(model.process, series.interval)
    return [
        (part, _Search(series.time[part], series.position[part], low + part.start, model, templates))
        for part in parts
        if part.stop - part.start >= FEWEST
    ]


def _collect_faults(series: Series, segment: Segments, searches: list[tuple[slice, _Search]]) -> CheckedRecord:
    kept = np.ones(series.time.size, bool)
    faults: list[Fault] = []
    steps: list[PositionStep] = []
    kicks: list[VelocityStep] = []
    for piece, search in searches:
        search.find_faults()
        kept[piece] = ~(search.spike | search.frozen)
        begin = piece.start
        if not kept[piece].all():
            faults += [Fault(begin + i, begin + j - 1, "spike") for i, j in runs(search.spike)]
            faults += [Fault(begin + i, begin + j - 1, "frozen") for i, j in runs(search.frozen)]
        for step in search.steps:
            counts = round(step.size / series.pitch) if series.pitch else 0
            size = counts * series.pitch if series.pitch else step.size
            steps.append(PositionStep(begin + step.first, begin + step.last, counts, size))
        if series.pitch:
            kicks += [VelocityStep(begin + sample, size) for sample, size in search.find_kicks()]
    steps.sort(key=lambda step: step.first)
    offset = step_offsets(segment, tuple(steps))
    position = series.position - offset if steps else series.position
    if not kept.all():
        position = np.where(kept, position, np.nan)
    return CheckedRecord(
        replace(series, position=position),
        tuple(sorted(faults, key=lambda fault: fault.first)),
        tuple(steps),
        tuple(sorted(kicks, key=lambda kick: kick.sample)),
        offset,
    )


def _is_datum(series: Series, checked: CheckedRecord) -> bool:
    """Return whether steps are of the datum: without them the range of the record is hardly wider.

    A slip of few samples looks like a step, but brings the mass back: without slips the record would run away with the
    belt, by their sum.
    """
    wider = float(np.ptp(series.position - checked.offset) - np.ptp(series.position))
    return wider <= WIDER_RANGE * sum(abs(step.size) for step in checked.steps)
