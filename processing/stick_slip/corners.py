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
FIT_SAMPLES = 9_000  # samples that the noise levels are fitted to: about a dozen slips of the bench


@dataclass(frozen=True, eq=False)
class SwitchingTimes:
    """Corners in order of time, arrays of shape (c,)."""

    time: Array  # s
    sd: Array  # standard deviation of the time, s
    kind: Labels  # of `processing.kalman.stick_slip`
    first: tuple[int, ...]  # label that each piece begins with
    unit: float  # usual length of a slip, s


@dataclass(frozen=True, eq=False)
class FilterStretch:
    """Samples that are filtered in one go."""

    samples: slice
    first: int  # label that they begin with
    corners: slice  # among them


def initial_switching_times(series: Series, phases: Sequence[Phase]) -> SwitchingTimes:
    """Return the corners of the phases that begin and end within a piece."""
    corner_times: list[float] = []
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
            corner_times.append(inside[0].start)
            kind.append(START)
            if inside[0].kind == "stick":
                corner_times.append(inside[0].start + 2 * series.interval)
                kind.append(LAND)
        for phase in inside:
            if phase.kind == "slip":
                if phase is not inside[-1] and (phase is not inside[0] or begins == REST):
                    lengths.append(phase.duration)  # whole: no slip that the record cuts off
                continue
            rides.append(phase.duration)
            if phase.start > begin and phase is not inside[0]:
                corner_times.append(phase.start)
                kind.append(LAND)
            if phase.end < end:
                corner_times.append(phase.end)
                kind.append(LEAVE)
        if inside and inside[-1].end < end - 4 * series.interval and inside[-1].kind == "slip":
            corner_times.append(inside[-1].end)
            kind.append(STOP)
        first.append(begins)
    unit = float(np.median(lengths or rides or [(time[-1] - time[0]) / 4]))
    order = np.argsort(corner_times, kind="stable")
    ordered = np.array(corner_times, float)[order]
    next_sample = np.clip(np.searchsorted(time, ordered), 1, time.size - 1)
    distance = np.minimum(np.abs(time[next_sample] - ordered), np.abs(time[next_sample - 1] - ordered))
    ordered[distance < TIED * series.interval] -= BETWEEN * series.interval
    return SwitchingTimes(
        ordered, np.full(ordered.size, series.interval), np.array(kind, np.uint8)[order], tuple(first), unit
    )


def split_stretches(series: Series, times: SwitchingTimes) -> list[FilterStretch]:
    """Return the pieces with their corners, without those too short to filter."""
    parts = []
    for piece, first in zip(series.pieces, times.first, strict=True):
        ends = np.searchsorted(times.time, (series.time[piece.start], series.time[piece.stop - 1]), side="right")
        parts.append(FilterStretch(piece, first, slice(int(ends[0]), int(ends[1]))))
    return [stretch for stretch in parts if stretch.samples.stop - stretch.samples.start >= white_jerk.SHORT]


def label_after(kind: int) -> int:
    """Return the label of the part after a corner."""
    return {LAND: STICK, MEET: RIDE, STOP: REST}.get(kind, SLIP)


def pick_fit_stretches(series: Series, times: SwitchingTimes) -> list[FilterStretch]:
    """Return the stretches that noise is fitted to: about a dozen slips of a long record, with their surroundings."""
    all_stretches = split_stretches(series, times)
    if sum(stretch.samples.stop - stretch.samples.start for stretch in all_stretches) <= FIT_SAMPLES:
        return all_stretches
    landings = []
    for stretch in all_stretches:
        corner_times, kinds = times.time[stretch.corners], times.kind[stretch.corners]
        for k, kind in enumerate(kinds.tolist()):
            if kind in (LAND, MEET, STOP):
                slip_start = corner_times[k - 1] if k else series.time[stretch.samples.start]
                landings.append(
                    (
                        stretch,
                        max(slip_start, corner_times[k] - 3 * times.unit) - times.unit / 4,
                        corner_times[k] + times.unit / 4,
                    )
                )
    if not landings:
        return all_stretches
    most = max(int(FIT_SAMPLES * series.interval / (1.5 * times.unit)), 3)
    picked = [landings[i] for i in np.unique(np.linspace(0, len(landings) - 1, most).astype(int))]
    parts = []
    for stretch, begin, end in picked:
        time = series.time[stretch.samples]
        i, j = stretch.samples.start + np.searchsorted(time, (begin, end))
        if j - i < 2 * white_jerk.SHORT:
            continue
        c, d = np.searchsorted(times.time, (series.time[i], series.time[j - 1]), side="right")
        first = label_after(int(times.kind[c - 1])) if c > stretch.corners.start else stretch.first
        parts.append(FilterStretch(slice(int(i), int(j)), first, slice(int(c), int(d))))
    return parts


def drop_corners(times: SwitchingTimes, gone: Mask) -> SwitchingTimes:
    """Return the switching times without the ``gone`` ones, (c,); if all are gone, everything is slip."""
    return replace(
        times,
        time=times.time[~gone],
        sd=times.sd[~gone],
        kind=times.kind[~gone],
        first=tuple(SLIP for _ in times.first) if gone.all() else times.first,
    )


def group_by_stick(times: SwitchingTimes) -> list[list[int]]:
    """Return the indices of the corners of every stick and ride: that of its start and of its end, if it has both."""
    sticks: list[list[int]] = []
    for k, kind in enumerate(times.kind.tolist()):
        if kind in (LAND, MEET):
            complete = k + 1 < times.kind.size and times.kind[k + 1] == LEAVE
            sticks.append([k, k + 1] if complete else [k])
        elif kind == LEAVE and (k == 0 or times.kind[k - 1] not in (LAND, MEET)):
            sticks.append([k])
    return sticks


def span_sticks(series: Series, times: SwitchingTimes, sticks: list[list[int]]) -> Integers:
    """Return the spans of samples, (s + 1, 2), that decide on each stick, with some on either side, and on all.

    The latter leaves out the last slip's length of the record, where a stick can be too short to be seen.
    """
    spans = []
    for stick in sticks:
        begin = times.time[stick[0]] if times.kind[stick[0]] != LEAVE else times.time[stick[0]] - times.unit
        end = times.time[stick[-1]] if times.kind[stick[-1]] == LEAVE else times.time[stick[-1]] + times.unit
        spans.append(np.searchsorted(series.time, (begin - times.unit / 16, end + times.unit / 8)))
    end = np.searchsorted(series.time, series.time[-1] - times.unit)
    return np.array([*spans, (0, end)], np.int64)
