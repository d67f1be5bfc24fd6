"""Corners of a motion that sticks and slips, in order of time, and how they part a record.

Kinds of corners and labels of the parts between them are those of `processing.kalman.stick_slip`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing.kalman import white_jerk
from processing.kalman.corner_kernel import BETWEEN
from processing.kalman.stick_slip import LAND, LEAVE, MEET, REST, RIDE, SLIP, START, STICK, STOP
from processing.record.motion import Phase
from processing.record.series import Series
from stickslip.compute.arrays import Array, Integers, Mask

Labels = NDArray[np.uint8]

KERNELS = ("processing.kalman.motion_kernel", "processing.kalman.stick_slip", "processing.kalman.corner_kernel")
TIED = 1e-6  # sample intervals: a corner nearer to a sample is on it
# Samples the noise levels are fitted to: about a dozen slips of the bench.  With half and twice the laws found are the
# same on 26 records; with half the parameters of one move by 1.4 standard errors, with twice none by more than 0.2.
FIT_SAMPLES = 9_000


@dataclass(frozen=True, eq=False)
class SwitchingTimes:
    """Corners in order of time: when (s), how uncertain (s), what (of `processing.kalman.stick_slip`), (c,) each.

    ``first`` is the label that every piece begins with, ``unit`` the usual length of a slip, s.
    """

    at: Array
    sd: Array
    kind: Labels
    first: tuple[int, ...]
    unit: float

    def is_as(self, other: "SwitchingTimes") -> bool:
        """Return whether these are the same numbers."""
        pairs = (self.at, other.at), (self.sd, other.sd), (self.kind, other.kind)
        alike = all(np.array_equal(one, two) for one, two in pairs)
        return alike and self.first == other.first and self.unit == other.unit


@dataclass(frozen=True, eq=False)
class FilterStretch:
    """Samples filtered in one go, the label they begin with, and the corners among them."""

    own: slice
    first: int
    corners: slice


def initial_switching_times(series: Series, phases: Sequence[Phase]) -> SwitchingTimes:
    """Return the corners of the phases: those that begin and end within a piece."""
    at: list[float] = []
    kind: list[int] = []
    first = []
    lengths, rides = [], []
    time = series.time
    for piece in series.pieces:
        begin, end = time[piece.start], time[piece.stop - 1]
        inside = [phase for phase in phases if begin <= phase.start and phase.end <= end]
        begins = SLIP
        if inside and inside[0].kind == "stick" and inside[0].start <= begin:
            begins = STICK
        if inside and inside[0].start > begin + 4 * series.interval:
            begins = REST
            at.append(inside[0].start)
            kind.append(START)
            if inside[0].kind == "stick":
                at.append(inside[0].start + 2 * series.interval)
                kind.append(LAND)
        for phase in inside:
            if phase.kind == "slip":
                if phase is not inside[-1] and (phase is not inside[0] or begins == REST):
                    lengths.append(phase.duration)  # whole: no slip that the record cuts off
                continue
            rides.append(phase.duration)
            if phase.start > begin and phase is not inside[0]:
                at.append(phase.start)
                kind.append(LAND)
            if phase.end < end:
                at.append(phase.end)
                kind.append(LEAVE)
        if inside and inside[-1].end < end - 4 * series.interval and inside[-1].kind == "slip":
            at.append(inside[-1].end)
            kind.append(STOP)
        first.append(begins)
    unit = float(np.median(lengths or rides or [(time[-1] - time[0]) / 4]))
    order = np.argsort(at, kind="stable")
    ordered = np.array(at, float)[order]
    behind = np.clip(np.searchsorted(time, ordered), 1, time.size - 1)
    apart = np.minimum(np.abs(time[behind] - ordered), np.abs(time[behind - 1] - ordered))
    ordered[apart < TIED * series.interval] -= BETWEEN * series.interval
    return SwitchingTimes(
        ordered, np.full(ordered.size, series.interval), np.array(kind, np.uint8)[order], tuple(first), unit
    )


def stretches(series: Series, times: SwitchingTimes) -> list[FilterStretch]:
    """Return the pieces, with their corners."""
    made = []
    for piece, first in zip(series.pieces, times.first, strict=True):
        ends = np.searchsorted(times.at, (series.time[piece.start], series.time[piece.stop - 1]), side="right")
        made.append(FilterStretch(piece, first, slice(int(ends[0]), int(ends[1]))))
    return [own for own in made if own.own.stop - own.own.start >= white_jerk.SHORT]


def state_after(kind: int) -> int:
    """Return the label of the part behind a corner."""
    return {LAND: STICK, MEET: RIDE, STOP: REST}.get(kind, SLIP)


def fit_stretches(series: Series, times: SwitchingTimes) -> list[FilterStretch]:
    """Return the stretches that noise is learned from: of a long record a dozen slips and their surroundings."""
    whole = stretches(series, times)
    if sum(own.own.stop - own.own.start for own in whole) <= FIT_SAMPLES:
        return whole
    around = []
    for stretch in whole:
        at, kinds = times.at[stretch.corners], times.kind[stretch.corners]
        for k, kind in enumerate(kinds.tolist()):
            if kind in (LAND, MEET, STOP):
                begun = at[k - 1] if k else series.time[stretch.own.start]
                around.append((stretch, max(begun, at[k] - 3 * times.unit) - times.unit / 4, at[k] + times.unit / 4))
    if not around:
        return whole
    most = max(int(FIT_SAMPLES * series.interval / (1.5 * times.unit)), 3)
    picked = [around[i] for i in np.unique(np.linspace(0, len(around) - 1, most).astype(int))]
    made = []
    for stretch, begin, end in picked:
        own = series.time[stretch.own]
        i, j = stretch.own.start + np.searchsorted(own, (begin, end))
        if j - i < 2 * white_jerk.SHORT:
            continue
        c, d = np.searchsorted(times.at, (series.time[i], series.time[j - 1]), side="right")
        first = state_after(int(times.kind[c - 1])) if c > stretch.corners.start else stretch.first
        made.append(FilterStretch(slice(int(i), int(j)), first, slice(int(c), int(d))))
    return made


def without(times: SwitchingTimes, gone: Mask) -> SwitchingTimes:
    """Return the switching times without those that are ``gone`` (c,); what they parted is slip."""
    return replace(
        times,
        at=times.at[~gone],
        sd=times.sd[~gone],
        kind=times.kind[~gone],
        first=tuple(SLIP for _ in times.first) if gone.all() else times.first,
    )


def sticks_of(times: SwitchingTimes) -> list[list[int]]:
    """Return the corners of every stick and ride: the one it begins with and the one it ends with, where it has any."""
    found: list[list[int]] = []
    for k, kind in enumerate(times.kind.tolist()):
        if kind in (LAND, MEET):
            ends = k + 1 < times.kind.size and times.kind[k + 1] == LEAVE
            found.append([k, k + 1] if ends else [k])
        elif kind == LEAVE and (k == 0 or times.kind[k - 1] not in (LAND, MEET)):
            found.append([k])
    return found


def spans_of(series: Series, times: SwitchingTimes, sticks: list[list[int]]) -> Integers:
    """Return the samples by which each stick is judged, its own and some to either side; and last, all: (s + 1, 2)."""
    spans = []
    for stick in sticks:
        begin = times.at[stick[0]] if times.kind[stick[0]] != LEAVE else times.at[stick[0]] - times.unit
        end = times.at[stick[-1]] if times.kind[stick[-1]] == LEAVE else times.at[stick[-1]] + times.unit
        spans.append(np.searchsorted(series.time, (begin - times.unit / 16, end + times.unit / 8)))
    return np.array([*spans, (0, series.time.size)], np.int64)
