"""The gate: a stick is kept only if it makes the record more likely by 1.5 ln n for each of its corners.

Where two in three pass, the others are kept if they make it more likely at all; where most fail, all go.  What a stick
is held against is a motion of white jerk or of white snap all through, whichever does better.
"""

import math
from dataclasses import replace

import numpy as np

from daq.compute.arrays import Array, Integers, Mask
from daq.compute.compile import compiled
from processing.kalman import corner_kernel, jerk_kernel, white_jerk
from processing.kalman.snap_kernel import LABELS, LAND, LEAVE, MEET, RIDE, SLIP, STICK
from processing.record.series import Series
from processing.segmentation.noise_levels import Levels, Room, filtered, learned, merged, without_corners
from processing.segmentation.switching_estimate import placed
from processing.segmentation.switching_times import KERNELS, Layout, Stretch, spans_of, sticks_of, stretches, without

GATE = 1.5  # times ln n: what a corner has to gain in log likelihood


def passed(
    series: Series, room: Room, layout: Layout, levels: Levels, noise: white_jerk.Noise, begun: Layout
) -> tuple[Layout, Levels] | None:
    """Keep the sticks that make the record more likely, each on the belt that does: even, or not.

    Without the sticks, the record is held to be white jerk or white snap all through, whichever does better.
    """
    sticks = sticks_of(layout)
    if not sticks:
        return None
    bare = without(layout, np.ones(layout.at.size, bool))
    snap = without_corners(levels)
    for _ in range(3):
        snap = learned(series, room, layout, snap, 1, bare=True)
    spans = spans_of(series, layout, sticks)
    plain = _jerk_gains(series, noise, room, spans)
    smooth = _gains(series, bare, snap, room, spans)
    even = _gains(series, layout, levels, room, spans)
    needed = GATE * math.log(series.time.size)
    corners = np.array([len(stick) for stick in sticks])
    ridden = np.zeros(len(sticks), bool)
    other_way = np.maximum(plain, smooth)
    gained = (even - other_way)[:-1]
    if (gained < needed * corners).any():
        even = _better_rounded(series, layout, levels, room, spans, even)
        gained = (even - other_way)[:-1]
    uneven = levels.r[STICK] > 1.3 * levels.r[SLIP]
    if uneven or (gained < needed * corners).any():
        kinds = np.where(begun.kind == LAND, MEET, begun.kind).astype(np.uint8)
        firsts = tuple(RIDE if first == STICK else first for first in begun.first)
        other = replace(begun, kind=kinds, first=firsts)
        riding = replace(levels, u=np.zeros(LABELS), r=np.full(LABELS, levels.r[SLIP]))
        for width in (1.0, 0.25):
            riding = learned(series, room, other, riding, 2)
            other = placed(series, room, other, riding, width)
        riding = learned(series, room, other, riding, 2)
        rides = _gains(series, other, riding, room, spans)
        ridden = (rides > even + needed)[:-1]
        gained = np.maximum(gained, (rides - other_way)[:-1])
        if ridden.any():
            levels = riding if ridden.all() else merged(levels, riding)
            taken = np.array([k for stick, ride in zip(sticks, ridden, strict=True) if ride for k in stick])
            at, sd = layout.at.copy(), layout.sd.copy()
            at[taken], sd[taken] = other.at[taken], other.sd[taken]
            if (np.diff(at) > 0).all():
                layout = replace(layout, at=at, sd=sd)
    dropped = gained < needed * corners
    if dropped.mean() < 1 / 3:  # where most sticks are beyond doubt, the others need only help
        dropped = gained < 0
    if dropped.mean() > 1 / 2:
        return None
    if dropped.any() or ridden.any():
        layout, levels = _rebuilt(series, room, layout, levels, sticks, dropped, ridden)
        even = _gains(series, layout, levels, room, spans)
        even = _better_rounded(series, layout, levels, room, spans, even)
    # What the sticks that are left gain must not be lost where the others were dropped.
    return (layout, levels) if even[-1] - max(plain[-1], smooth[-1]) > needed * layout.at.size else None


def _gains(series: Series, layout: Layout, levels: Levels, room: Room, spans: Integers) -> Array:
    """Return the log likelihood of the samples of every span given those before, up to a constant."""
    total = np.zeros(len(spans))
    for stretch in stretches(series, layout):
        stored = filtered(series, layout, levels, stretch, room)[1]
        total += _summed(stored, 14, stretch, spans)
    return total


def _better_rounded(series: Series, layout: Layout, levels: Levels, room: Room, spans: Integers, even: Array) -> Array:
    """Return the likelihoods of even sticks, each with the reading variance of all sticks or of the slips.

    A belt that moves a round number of counts in a sample is rounded alike throughout a stick: by nothing in most, by
    half a count at every other sample in some.  One variance does not suit both.
    """
    r = levels.r.copy()
    r[STICK] = r[SLIP]
    more = np.maximum(_gains(series, layout, replace(levels, r=r), room, spans) - even, 0.0)
    more[-1] = more[:-1].sum()
    return even + more


def _jerk_gains(series: Series, noise: white_jerk.Noise, room: Room, spans: Integers) -> Array:
    """As `_gains`, for the motion of white jerk."""
    total = np.zeros(len(spans))
    for piece in series.pieces:
        if piece.stop - piece.start < white_jerk.SHORT:
            continue
        time, position = series.time[piece], series.position[piece]
        state, stored = np.empty(jerk_kernel.STATE), room.stored(time.size, jerk_kernel.STORED)
        compiled(jerk_kernel.start, white_jerk.KERNELS)(time, position, noise.reading, state)
        compiled(jerk_kernel.forward, white_jerk.KERNELS)(time, position, noise.jerk, noise.reading, state, stored)
        total += _summed(stored, 9, Stretch(piece, SLIP, slice(0, 0)), spans)
    return total


def _summed(stored: Array, surprise: int, stretch: Stretch, spans: Integers) -> Array:
    inside = np.clip(spans - stretch.own.start, 0, stretch.own.stop - stretch.own.start)
    gain = np.zeros(len(spans))
    compiled(corner_kernel.gains, KERNELS)(stored, surprise, inside, gain)
    return gain


def _rebuilt(
    series: Series,
    room: Room,
    layout: Layout,
    levels: Levels,
    sticks: list[list[int]],
    dropped: Mask,
    ridden: Mask,
) -> tuple[Layout, Levels]:
    """Return the layout after the gate's verdict, its corners placed and its levels learned again."""
    kind = layout.kind.copy()
    first = list(layout.first)
    gone = np.zeros(kind.size, bool)
    starts = [series.time[piece.start] for piece in series.pieces]
    for stick, drop, ride in zip(sticks, dropped, ridden, strict=True):
        if drop:
            gone[stick] = True
        if kind[stick[0]] == LEAVE:  # it begins with its piece
            piece = int(np.searchsorted(starts, layout.at[stick[0]], side="right")) - 1
            first[piece] = SLIP if drop else RIDE if ride else first[piece]
        elif ride:
            kind[stick[0]] = MEET
    kept = ~gone
    layout = replace(layout, at=layout.at[kept], sd=layout.sd[kept], kind=kind[kept], first=tuple(first))
    for _ in range(2):
        levels = learned(series, room, layout, levels, 2)
        layout = placed(series, room, layout, levels, 0.25)
    return layout, levels
