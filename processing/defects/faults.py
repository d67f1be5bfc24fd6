"""Faults of a record by the auxiliary residuals of one smoother: spikes, frozen stretches, steps and kicks.

A motion of white jerk is smoothed once.  What it cannot explain shows in the scores of its backward pass
(`processing.kalman.motion_kernel`): at every sample the t statistic of an outlying reading, of a step of the position
over one to five samples (lost counts, a datum that moves), of a kick (a step of the velocity, soon over), and of a
corner (a step of the acceleration, as at every landing).  A place belongs to the kind that explains it best.  It is a
fault where that is no corner, beyond the threshold of its kind, and better than any other kind nearby.

The largest fault goes first, outliers before steps; then the neighbourhood is looked at again.  Readings that are no
positions become NaN: the filters take them as missing.  Steps are taken out; kicks are marked, and stay.

A frozen stretch is a run of equal readings that ends in a step: the sensor held its value while the mass moved.  Two
steps that undo each other within a few samples, or on both sides of a run of equal readings, are a burst of outliers.
Steps that together bring the mass back are slips of few samples, none of the datum.

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
from processing.record.position_steps import PositionStep, step_offsets, step_profile, without_steps
from processing.record.series import Series
from stickslip.compute.arrays import Array, Integers, Mask, runs
from stickslip.compute.compile import compiled

Segments = NDArray[np.integer]

KERNELS = ("processing.defects.residual_kernel",)

# Standard deviations that a fault must have: a record of a minute at 1 kHz has 60,000 places of each kind.
THRESHOLD = {OUTLIER: 6.0, STEP: 6.0, KICK: 7.0}
# Those of an outlier beside one: among the few places there chance makes one as seldom as among all, by 4.5 already.
BESIDE_OUTLIER = 5.0
BEYOND_CORNER = 12.0  # of the square of t: twice the log likelihood by which a step or a kick must beat any corner
APART = 12.0  # likewise between a small step and a kick, which is a step where it is over in a few samples
SMALL = 8.0  # counts, or sqrt(12) standard deviations of a position: with 10, a third of the steps of 10 are kicks
LEAST_COUNTS = 4.0  # a smaller step may be an encoder's error between two lines; one of 5 may come out 1 too small
SPREAD = 5  # samples that a step takes at most
RETURNS = (3, 4, 5, 6, 7, 8, 10, 12)  # samples after which a kick is over
SHARPEST = 1.5  # times the largest accelerations of the record (99th percentile): those by which kicks are over
# Samples that a model is learned from, and of a part of them.  Half and twice of the first smooth 26 records alike.
LEARNED, PART = 2**14, 2**12
ZONE, GROWING = 14, 10.0  # samples around a place that belong to it: more by so many for each power of e of its t
LOOKED_AT = 24.0  # of the square of t: places below are no candidates, and no corner of theirs forbids a fault nearby
LOCAL, LOUD = 64, 2.0  # samples of a block; times the usual median square beyond which its t are scaled down
NORMAL = 0.4549  # median of the square of a standard normal number
# Standard deviations of a position to which a step is known, at most: where the smoother follows any motion within
# some ten samples, as in slips of 30 samples and less, a landing and a start look like steps.
RESOLVED = 1.5
WIDEST = 101  # samples of the smoother's window: with more it finds no more, and what it cannot explain reaches farther
PASSES = 64  # more than any record needs, whose places are redone alone
FADED = 18.0  # natural logarithm of how far what lies beyond a neighbourhood has faded: 1e-8
FROZEN, BURST, HOLE = 5, 8, 8  # samples: equal readings; between two steps of a burst; left out in a row
BLIND = 3  # samples beside such a hole at which nothing is looked for
BESIDE = 8  # steps on either side of a frozen stretch, of which most on one side are some
UNDONE = 0.3  # of the smaller of the largest steps up and down: the most that is left of steps that undo each other
FEWEST = 40  # samples of a piece
NO_MOTION = np.empty((6, 0))  # statistics of no sample
LESS = 0.95  # of the noise before: where it falls below that without the faults, more of them show
SLACK = 0.5  # of the sum of steps: by how much a record may be wider without them; without slips it is by all of it


@dataclass(frozen=True)
class FaultModel:
    """What the faults of a record are judged by."""

    step: float  # that readings are rounded to, m; 0 where there is none
    noise: float  # standard deviation of a position that is no fault, m
    process: white_jerk.Noise  # of the smoother by which faults are found: without the corners of the motion
    sharpest: float  # about the largest acceleration, m/s^2
    steps: bool  # whether steps of the position are looked for, and are of the datum


@dataclass(frozen=True, eq=False)
class CheckedRecord:
    """A record of n samples and its faults, in order of time.

    ``series`` is the record without the steps of the position; readings that are no positions are NaN.  ``offset`` (n,)
    is the sum of the steps before each sample, m.
    """

    series: Series
    faults: tuple[Fault, ...]
    steps: tuple[PositionStep, ...]
    kicks: tuple[VelocityStep, ...]
    offset: Array

    @property
    def kept(self) -> Mask:
        """True for the samples that are positions, (n,)."""
        return ~np.isnan(self.series.position)


class _Place(NamedTuple):
    """Where something is out of line: sample, kind, square of t there, and those of each kind nearby."""

    sample: int
    kind: int
    square: float
    near: Array


@dataclass
class _Step:
    """A step of the position by ``size``, m, over ``width`` samples from ``first`` on."""

    first: int
    width: int
    size: float

    @property
    def last(self) -> int:
        """The last sample of the step."""
        return self.first + self.width - 1


@dataclass(frozen=True, eq=False)
class _Templates:
    """Steps and kicks as sums of scores, as `residual_kernel.find_statistics` takes them.

    ``resolved`` tells whether the smoother tells them from corners, ``beside`` is the scores of readings around a step
    of 1 m, in the middle of as many samples before as behind.
    """

    steps: Array
    kicks: Array
    variance: Array
    durations: Integers
    resolved: bool
    beside: Array

    @classmethod
    def of(cls, noise: white_jerk.Noise, interval: float) -> "_Templates":
        """Return steps over 1 to `SPREAD` samples, and kicks that are over after `RETURNS`."""
        beside, covariances = _scores_of_step(noise, interval)
        lags = covariances[covariances.size // 2 :][: max(RETURNS)]

        def variance(weights: Array) -> float:
            apart = np.abs(np.subtract.outer(np.arange(weights.size), np.arange(weights.size)))
            return float(weights @ lags[apart] @ weights / lags[0])

        left = [np.maximum(1 - np.arange(1.0, max(RETURNS) + 1) / d, 0) ** 2 for d in RETURNS]  # of the way, as a share
        kicks = -np.diff(left, prepend=1.0)
        return cls(
            np.array([1 / variance(np.ones(d)) for d in range(1, SPREAD + 1)]),
            kicks,
            np.array([variance(own) for own in kicks]),
            np.array(RETURNS),
            bool(lags[0] * noise.reading * RESOLVED**2 >= 1.0),
            beside,
        )

    def readings_beside(self, apart: Integers, width: int) -> Array:
        """Return the scores of readings so many samples behind the first of the ``width`` samples of a step of 1 m."""
        middle = self.beside.size // 2
        at = np.clip(apart + middle - np.arange(width)[:, None], 0, self.beside.size - 1)
        return np.asarray(self.beside[at].mean(axis=0))


def _scores_of_step(noise: white_jerk.Noise, interval: float) -> tuple[Array, Array]:
    """Return what a step of 1 m in the middle of some samples makes of the scores of readings, and of steps, (n,) each.

    The latter are the covariances of the scores of steps some samples apart.
    """
    n = min(2 * _fading(noise, interval) + 1, 2**12 + 1)
    time, position = np.asarray(interval * np.arange(n), float), np.zeros(n)
    position[n // 2 :] = 1.0
    scores = np.empty((n, white_jerk.SCORES))
    white_jerk.smooth_piece(time, position, noise, n, 0, NO_MOTION, scores=scores)
    return scores[:, 0].copy(), scores[:, 2].copy()


def _fading(noise: white_jerk.Noise, interval: float) -> int:
    return white_jerk.reach(noise.rho(interval), FADED)


class _Search:
    """The search for faults in one piece of n samples.

    ``position`` (n,) is without what was found so far, ``spike`` and ``frozen`` (n,) are the readings left out.
    """

    def __init__(self, time: Array, position: Array, low: int, model: FaultModel, templates: _Templates) -> None:
        n = time.size
        self.time, self.reading, self.position, self.model = time, position, position.copy(), model
        self.spike, self.frozen = np.zeros(n, bool), np.zeros(n, bool)
        self.steps: list[_Step] = []
        self._low, self._templates, self._noise = low, templates, model.process
        self._interval = (time[-1] - time[0]) / (n - 1)
        self._reach = _fading(self._noise, self._interval)
        self._scores, self._squares = np.empty((n, white_jerk.SCORES)), np.zeros((4, n))
        self._sizes, self._widths = np.zeros((3, n)), np.ones(n, np.int64)
        self._found: list[_Place] | None = None
        self._look(0, n)

    @cached_property
    def _held(self) -> tuple[Integers, Integers]:
        """First and end of every run of equal readings."""
        edges = np.flatnonzero(np.diff(self.reading)) + 1
        first, end = np.concatenate(([0], edges)), np.concatenate((edges, [self.reading.size]))
        held = end - first >= FROZEN
        return first[held], end[held]

    def leave_out(self) -> None:
        """Find the outliers, and the frozen stretches."""
        for _ in range(PASSES):
            if not self._look_again(self._leave_out() or self._leave_out_frozen()):
                break

    def run(self) -> None:
        """Find the outliers, the frozen stretches and the steps, one after the other."""
        for _ in range(PASSES):
            found = self._leave_out() or self._leave_out_frozen() or self._take_out() or self._merge_bursts()
            if not self._look_again(found):
                break
        if not self.model.steps:  # without them bursts would stay
            for step in self.steps:
                self._change(step, -step.size)
            self._look_again([(step.first, step.last) for step in self.steps])
            self.steps = []
        for _ in range(2 if self.steps else 0):  # their sizes once more, all together
            for step in self.steps:
                self._change(step, self._left_of(step))
            self._look_again([(step.first, step.last) for step in self.steps])

    def kicks(self) -> Iterator[tuple[int, float]]:
        """Yield samples and sizes, m/s, of the kicks that are left."""
        for place in self._faults() if self._templates.resolved else ():
            if place.kind == KICK:
                yield place.sample, float(self._sizes[KICK, place.sample])

    def acceleration(self) -> Array:
        """Return the acceleration of the smoothed motion, m/s^2, but for its ends, where it is known worse."""
        n = self.time.size
        motion, end = np.empty((6, n)), min(WIDEST // 2, n // 4)
        white_jerk.smooth_piece(self.time, self.position, self._noise, white_jerk.BLOCK, self._reach, motion)
        return np.asarray(motion[2, end : n - end])

    def _look(self, first: int, end: int) -> None:
        """Smooth the samples first..end - 1, and judge them."""
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
        self._judge(first, end)

    def _judge(self, first: int, end: int) -> None:
        """Find the statistics of the samples first..end - 1."""
        self._found = None
        t = self._templates
        compiled(residual_kernel.find_statistics, KERNELS)(
            *(self._scores, t.steps, t.kicks, t.variance, t.durations, SHARPEST * self.model.sharpest, self._interval),
            *((first, end), self._squares, self._sizes, self._widths),
        )

    def _look_again(self, changed: list[tuple[int, int]]) -> bool:
        """Find the statistics around the samples that were changed, first to last each; tell whether there are any."""
        near = np.zeros(self.time.size, bool)
        for first, last in changed:
            near[max(first - self._reach, 0) : last + self._reach + 1] = True
        for first, end in runs(near):
            self._look(first, end)
        return bool(changed)

    def _leave_out(self) -> list[tuple[int, int]]:
        """Leave out the readings that stand out; return them."""
        found = [place.sample for place in self._faults() if place.kind == OUTLIER]
        self.spike[found] = True
        self.position[found] = np.nan
        return [(sample, sample) for sample in found]

    def _leave_out_frozen(self) -> list[tuple[int, int]]:
        """Leave out the runs of equal readings that end in a step; return them."""
        found = [held for place in self._faults() if place.kind == STEP for held in self._held_before(place.sample)]
        self.position[self.spike | self.frozen] = np.nan
        return found

    def _held_before(self, step: int) -> list[tuple[int, int]]:
        """Leave out the run of equal readings that ends in a step, and return it.

        Its first reading is sound, unless the readings stepped there too: a drop-out.
        """
        first, end = self._held
        k = int(np.searchsorted(end, step - 2))
        if k == end.size or end[k] > step + 2 or first[k] >= step or self.frozen[first[k] + 1]:
            return []
        begin, stop = int(first[k]), int(end[k])
        if self.spike[begin + 1 : stop].all():
            return []
        before = np.diff(self.reading[max(begin - BESIDE, 0) : begin + 1])
        behind = np.diff(self.reading[stop : stop + BESIDE + 1])
        if before.size and _undo([float(before[-1]), float(self._sizes[STEP, step])]):
            self.spike[begin:stop] = True
            return [(begin, stop - 1)]
        if before.size < BESIDE or not (np.median(np.abs(before)) or np.median(np.abs(behind))):
            return []  # the record begins at rest, or the mass is at rest on either side
        self.frozen[begin + 1 : stop] = True
        return [(begin + 1, stop - 1)]

    def _take_out(self) -> list[tuple[int, int]]:
        """Take out the steps that stand out; return them."""
        found = []
        for place in self._faults() if self._templates.resolved else ():
            if place.kind == STEP:
                i, width = place.sample, int(self._widths[place.sample])
                step = next((own for own in self.steps if (own.first, own.width) == (i, width)), None)
                if step is None:
                    step = _Step(i, width, 0.0)
                    self.steps.append(step)
                self._change(step, float(self._sizes[STEP, i]))
                found.append((step.first, step.last))
        return found

    def _change(self, step: _Step, more: float) -> None:
        """Make a step larger by ``more``, m."""
        self.position[step.first : step.last + 1] -= more * step_profile(step.width)
        self.position[step.last + 1 :] -= more
        step.size += more

    def _left_of(self, step: _Step) -> float:
        """Return what is left of a step that was taken out, m."""
        own = self._scores[step.first : step.last + 1]
        information = float(own[:, 3].mean())
        share = self._templates.steps[step.width - 1] * step.width
        return float(own[:, 2].sum()) * share / information if information > 0 else 0.0

    def _merge_bursts(self) -> list[tuple[int, int]]:
        """Leave out what lies between steps that undo each other within `BURST` samples; return it.

        Two of opposite sign are a burst too: what they leave of each other is looked for again.
        """
        found, kept = [], []
        left = sorted(self.steps, key=lambda step: step.first)
        while left:
            burst = [step for step in left if step.first - left[0].first <= BURST]
            while len(burst) > 2 and not _undo([step.size for step in burst]):
                burst.pop()
            if len(burst) < 2 or (burst[0].size * burst[1].size > 0 and len(burst) == 2):
                kept.append(left.pop(0))
                continue
            del left[: len(burst)]
            for step in burst:
                self._change(step, -step.size)
            self.spike[burst[0].first : burst[-1].last] = True
            found.append((burst[0].first, burst[-1].last))
        self.steps = kept
        self.position[self.spike] = np.nan
        return found

    def _faults(self) -> list[_Place]:
        """Return the places that are faults, the largest first."""
        if self._found is None:
            found = [fault for place in self._places() if (fault := self._judged(place)) is not None]
            if not any(fault.kind == OUTLIER for fault in found):  # they go first
                steps = [fault.sample for fault in found if fault.kind == STEP]
                hidden = [step for step in self._hidden_steps() if all(abs(step.sample - at) > ZONE for at in steps)]
                own = [step.sample for step in hidden]
                found = [fault for fault in found if all(abs(fault.sample - at) > ZONE for at in own)] + hidden
            self._found = found
        return self._found

    def _hidden_steps(self) -> list[_Place]:
        """Return the steps that are faults by what readings err by nearby without them."""
        places = self._places(but_for_steps=True)
        return [fault for place in places if (fault := self._judged(place)) is not None and fault.kind == STEP]

    def _judged(self, place: _Place) -> _Place | None:
        """Return the fault that a place is, if it is one."""
        i, kind, square, near = place
        beside = kind == OUTLIER and bool(self.spike[max(i - BURST, 0) : i + BURST + 1].any())
        if kind == CORNER or square < (BESIDE_OUTLIER if beside else THRESHOLD[kind]) ** 2:
            return None
        if kind == OUTLIER and min(i, self.time.size - 1 - i) < ENDS:
            bend = SHARPEST * self.model.sharpest * (ENDS * self._interval) ** 2  # by a corner that is not seen there
            return place if abs(float(self._sizes[OUTLIER, i])) > bend else None
        if kind != OUTLIER and square < near[CORNER] + BEYOND_CORNER:
            return None
        if kind == STEP:
            size = abs(float(self._sizes[STEP, i]))
            small = size < SMALL * math.sqrt(12) * self.model.noise
            if square < near[KICK] + (APART if small else 0.0):
                return _Place(i, KICK, square, near)  # not told apart: marked, and left in the position
            if size < LEAST_COUNTS * self.model.step:
                return None
        return place

    def _places(self, *, but_for_steps: bool = False) -> list[_Place]:
        """Return the places that are out of line, the largest first; what is near a larger one belongs to that."""
        suspects = np.flatnonzero(self._squares.max(axis=0) > LOOKED_AT)
        suspects = suspects[~self._blind()[suspects]]
        squares = self._squares[:, suspects]
        squares = squares / (self._scale_but_for_steps(suspects, squares) if but_for_steps else self._scale(suspects))
        best = squares.max(axis=0)
        large = np.flatnonzero(best >= BESIDE_OUTLIER**2)
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
        at = suspects[picked]
        ends = np.searchsorted(suspects, at[:, None] + np.array([-ZONE, ZONE + 1]))
        near = np.empty((at.size, 4))
        compiled(residual_kernel.find_largest, KERNELS)(squares, ends, near)
        kinds = squares[:, picked].argmax(axis=0)
        return [_Place(*row) for row in zip(at.tolist(), kinds.tolist(), best[picked].tolist(), near, strict=True)]

    def _scale_but_for_steps(self, suspects: Integers, squares: Array) -> Array:
        """Return the `_scale` of samples, and near a step the one that there is without it, if that is less.

        Around a step of the position most readings are out of line, and it would hide itself.
        """
        scale = self._scale(suspects)
        step = (scale > 1.0) & (squares.argmax(axis=0) == STEP) & (squares[STEP] >= THRESHOLD[STEP] ** 2)
        left = np.flatnonzero(step)
        while left.size:
            i = int(suspects[left[np.argmax(squares[STEP, left])]])
            near = slice(*np.searchsorted(suspects, (i - ZONE, i + ZONE + 1)))
            scale[near] = np.minimum(scale[near], self._scale_without(i))
            left = left[np.abs(suspects[left] - i) > ZONE]
        return scale

    def _scale_without(self, step: int) -> float:
        """Return the scale near a step, without what this makes of the readings there."""
        before, n = self._low % LOCAL, self.time.size
        begin = (before + step) // LOCAL * LOCAL - LOCAL - before
        first, end = max(begin, 0), min(begin + 3 * LOCAL, n)
        made = self._templates.readings_beside(np.arange(first, end) - step, int(self._widths[step]))
        score, variance = self._scores[first:end, :2].T
        left = score - float(self._sizes[STEP, step]) * made
        squares = np.zeros(3 * LOCAL)
        np.divide(left**2, variance, out=squares[first - begin : end - begin], where=variance > 0)
        return float(_local_scale(squares.reshape(3, LOCAL)).max())

    def _scale(self, samples: Integers) -> Array:
        """Return how much larger than expected the squares of outliers are nearby: medians of blocks, at least 1.

        Times that are not true put readings off in proportion to the velocity; a burst of noise does so anywhere.
        """
        before = self._low % LOCAL  # so that blocks begin at multiples of `LOCAL` of the record's samples
        block = 1 + (before + samples) // LOCAL
        padded = np.zeros((3 + (before + self.time.size) // LOCAL, LOCAL))
        padded.ravel()[LOCAL + before : LOCAL + before + self.time.size] = self._squares[OUTLIER]
        wanted = np.zeros(len(padded), bool)
        wanted[block[:, None] + np.arange(-1, 2)] = True
        scale = np.ones(len(padded))
        scale[wanted] = _local_scale(padded[wanted])
        return np.maximum(scale[block], np.maximum(scale[block - 1], scale[block + 1]))

    def _blind(self) -> Mask:
        """Return where nothing is looked for: at samples left out, and beside long holes of them."""
        gone = self.spike | self.frozen
        mask = gone.copy()
        for first, end in runs(gone) if gone.any() else ():
            if end - first >= HOLE:
                mask[max(first - BLIND, 0) : end + BLIND] = True
        return mask


def _local_scale(squares: Array) -> Array:
    """Return the medians of blocks of squares of outliers, (k, LOCAL), over the usual one; 1 where none is `LOUD`."""
    scale = np.partition(squares, LOCAL // 2, axis=1)[:, LOCAL // 2] / NORMAL
    return np.where(scale < LOUD, 1.0, scale)


def _undo(sizes: list[float]) -> bool:
    """Return whether steps of these sizes undo each other."""
    return abs(sum(sizes)) < UNDONE * min(max(sizes), -min(sizes))


def learn(series: Series, segment: Segments, *, steps: bool) -> tuple[FaultModel, CheckedRecord]:
    """Return what the faults of a record are judged by, and the record without them.

    series: The record, n samples.
    segment: Number of the segment of each sample: a step of the position lasts to the end of its own.
    steps: Whether to look for steps of the position.
    """
    step, noise = reading_step(series), position_noise(series)
    some = _spread(series)
    while True:
        process = white_jerk.robust_fit(series, noise, WIDEST)
        searches = _searches(series, FaultModel(step, noise, process, math.inf, steps), 0, some)
        kept, left_out = np.zeros(series.time.size, bool), False
        for piece, search in searches:
            search.leave_out()
            gone = search.spike | search.frozen
            kept[piece], left_out = ~gone, left_out or bool(gone.any())
        before = noise
        if left_out:
            noise = position_noise(series.taken(kept))
        if not noise < LESS * before:  # else frequent spikes hid others
            break
    accelerations = [search.acceleration() for _, search in searches]
    sharpest = float(np.percentile(np.abs(np.concatenate(accelerations)), 99)) if accelerations else math.inf
    model = FaultModel(step, noise, process, sharpest, steps)
    found = _found(series, segment, _searches(series, model, 0, series.pieces))
    if found.steps and not _is_datum(series, found):
        model = replace(model, steps=False)
        found = _found(series, segment, _searches(series, model, 0, series.pieces))
    return model, found


def _spread(series: Series) -> tuple[slice, ...]:
    """Return parts of the pieces, spread evenly, of `LEARNED` samples together, or the pieces of a shorter record."""
    every = series.time.size // LEARNED
    if every < 2:
        return series.pieces
    starts = [(piece, first) for piece in series.pieces for first in range(piece.start, piece.stop, PART)]
    return tuple(slice(first, min(first + PART, piece.stop)) for piece, first in starts[::every])


def find(series: Series, segment: Segments, model: FaultModel, low: int = 0) -> CheckedRecord:
    """Find the faults of a record, or of a block of it whose first sample has the number ``low``."""
    found = _found(series, segment, _searches(series, model, low, series.pieces))
    if found.steps and not _is_datum(series, found):
        return _found(series, segment, _searches(series, replace(model, steps=False), low, series.pieces))
    return found


def _searches(series: Series, model: FaultModel, low: int, parts: tuple[slice, ...]) -> list[tuple[slice, _Search]]:
    """Return the parts that are long enough, and a search in each."""
    templates = _Templates.of(model.process, series.interval)
    return [
        (own, _Search(series.time[own], series.position[own], low + own.start, model, templates))
        for own in parts
        if own.stop - own.start >= FEWEST
    ]


def _found(series: Series, segment: Segments, searches: list[tuple[slice, _Search]]) -> CheckedRecord:
    """Find the faults by these searches."""
    kept = np.ones(series.time.size, bool)
    faults: list[Fault] = []
    steps: list[PositionStep] = []
    kicks: list[VelocityStep] = []
    for piece, search in searches:
        search.run()
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
            kicks += [VelocityStep(begin + sample, size) for sample, size in search.kicks()]
    steps.sort(key=lambda step: step.first)
    offset = step_offsets(segment, tuple(steps))
    position = without_steps(series, offset).position
    if not kept.all():
        position = np.where(kept, position, np.nan)
    return CheckedRecord(
        replace(series, position=position),
        tuple(sorted(faults, key=lambda fault: fault.first)),
        tuple(steps),
        tuple(sorted(kicks, key=lambda kick: kick.sample)),
        offset,
    )


def _is_datum(series: Series, found: CheckedRecord) -> bool:
    """Return whether steps are of the datum: without them the record has hardly a wider range.

    A slip that is over within a few samples looks like a step, but brings the mass back: without slips the record leads
    away with the belt, by the sum of them.
    """
    wider = float(np.ptp(series.position - found.offset) - np.ptp(series.position))
    return wider <= SLACK * sum(abs(step.size) for step in found.steps)
