"""Smoothing that knows sticks from slips: corners fitted to the record, the roughness of each part by likelihood.

A stick on an even belt is a straight line; a slip is a motion of white snap (`processing.snap_filter`), rougher near
its ends, where friction changes fast, than in its middle.  The parts meet in corners: at a landing x and v go on and
the acceleration drops to 0, at an onset the jerk jumps (the acceleration too, where the break-away level differs).
A belt that does not run evenly is ridden, smoothly, instead of stuck to.

1. A first motion (`processing.rts`) shows sticks (`processing.phases`), and rest before the belt starts.
2. Noise levels and corners are made more likely in turns: each corner's time by its likelihood, each noise level by
   the fixed point of its own.
3. A gate keeps a stick only if it makes the record more likely by 1.5 ln n per corner than a smoother without it.
   Where two in three pass, the others are kept if they make it more likely at all; where most fail, all go.
4. The motion is averaged over what the record leaves open of the corners' times (three nodes of Gauss and Hermite
   each), and so are its errors.
5. In a stick on an even belt velocity and error are those of a straight line through at most a third of a slip's
   length: a belt is not trusted to keep its speed for longer.

Not modelled: corners within a slip other than kicks, and counts that hardly change.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled
from processing import jerk_filter, line_fit, phases, rts, snap_filter
from processing.methods import Corner, Motion, Setting
from processing.phases import Found
from processing.series import Series
from processing.snap_filter import (
    KICK,
    LABELS,
    LAND,
    LANDING,
    LEAVE,
    LEAVING,
    MEET,
    MET,
    NEAR_LANDING,
    NEAR_ONSET,
    ONSET,
    REST,
    RIDE,
    SLIP,
    START,
    STICK,
    STOP,
)

Array = NDArray[np.float64]
Labels = NDArray[np.uint8]

KERNELS = ("processing.snap_filter",)
WHAT = {LAND: "land", MEET: "land", LEAVE: "leave", KICK: "kick", START: "start", STOP: "stop"}
LINES = ("processing.line_fit",)
ORDER = 7  # of the spline
GATE = 1.5  # times ln n: what a corner has to gain in log likelihood
FITTED = 9_000  # samples the noise levels are fitted to
WIDTHS = (0.25,)
SHARP = 1.5  # times the spread of a landing's likelihood: the levels it is taken at were learned with it
LINE = 1 / 3  # of a slip: the longest straight line through a stick


@dataclass(frozen=True, eq=False)
class Layout:
    """Corners in order of time: when (s), how uncertain (s), what (of `processing.snap_filter`), (c,) each.

    ``first`` is the label that every piece begins with, ``unit`` the usual length of a slip, s.
    """

    at: Array
    sd: Array
    kind: Labels
    first: tuple[int, ...]
    unit: float


@dataclass(frozen=True, eq=False)
class Levels:
    """Density of the white snap and variance of a reading per label, and the variances of steps at corners."""

    q: Array
    r: Array
    jump: Array


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples filtered in one go, the label they begin with, and the corners among them."""

    own: slice
    first: int
    corners: slice


def estimate(series: Series, setting: Setting) -> Motion:
    """Smooth the record, taking every stick that shows for one.

    Parameters
    ----------
    series : Series
        The record.
    setting : Setting
        Must name no window and no order; its belt speed, if any, is the one that sticks have.

    Returns
    -------
    Motion
        With its corners.  Without a stick it is the motion of `processing.rts`.

    Raises
    ------
    InputError
        When a window or an order was asked for.
    """
    rts.refuse_window(setting, "segment")
    noise = rts.fit(series)
    smooth = rts.smooth(series, noise)
    found = segmented(series, noise, smooth, setting, gated=False)
    return replace(smooth, method="segment", corners=()) if found is None else found


def segmented(series: Series, noise: rts.Noise, pilot: Motion, setting: Setting, *, gated: bool) -> Motion | None:
    """Return the motion by segments, or None when there is no stick (or none that passes the gate)."""
    found = phases.find(series, pilot, None, "auto" if setting.belt_speed is None else setting.belt_speed)
    layout = _layout(series, found)
    if not layout.at.size:
        return None
    room = Room()
    begun, levels = layout, _first_levels(series, noise, pilot, layout.unit)
    layout = _placed(series, room, layout, levels, 1.0)
    for width in WIDTHS:
        levels = _learned(series, room, layout, levels, 2)
        layout = _placed(series, room, layout, levels, width)
    if gated:
        kept = _gate(series, room, layout, levels, noise, begun)
        if kept is None:
            return None
        layout, levels = kept
    return _averaged(series, room, layout, levels, pilot.window)


def _layout(series: Series, found: Found) -> Layout:
    """Return the corners of the phases found: those that begin and end within a piece."""
    at: list[float] = []
    kind: list[int] = []
    first = []
    lengths, rides = [], []
    time = series.time
    for piece in series.pieces:
        begin, end = time[piece.start], time[piece.stop - 1]
        inside = [phase for phase in found.phases if begin <= phase.start and phase.end <= end]
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
    times = np.array(at, float)[order]
    return Layout(times, np.full(times.size, series.interval), np.array(kind, np.uint8)[order], tuple(first), unit)


def _first_levels(series: Series, noise: rts.Noise, pilot: Motion, unit: float) -> Levels:
    """Guess the levels: as rough as the first motion near a landing, ever smoother away from it."""
    rate = (noise.jerk / (noise.reading * series.interval)) ** (1 / 6)
    rough = noise.jerk * rate**2
    q = np.full(LABELS, rough * math.exp(-6))
    q[LANDING : LANDING + 4] = rough * np.exp([0.0, -1.0, -3.0, -5.0])
    q[ONSET : ONSET + 4] = rough * math.exp(-5)
    q[MET] = rough
    q[LEAVING] = rough * math.exp(-5)
    q[STICK] = q[REST] = 0.0
    stride = max(series.time.size // 2**14, 1)
    peak = float(np.percentile(np.abs(pilot.acceleration[::stride]), 99))
    kick = 0.1 * float(np.percentile(np.abs(pilot.velocity[::stride]), 99))
    step = [0.01 * peak, peak / unit, peak, 8 * peak / unit, kick, peak, 8 * peak / unit, peak, 8 * peak / unit]
    return Levels(q, np.full(LABELS, noise.reading), np.array(step) ** 2)


def _stretches(series: Series, layout: Layout) -> list[Stretch]:
    """Return the pieces, with their corners."""
    made = []
    for piece, first in zip(series.pieces, layout.first, strict=True):
        ends = np.searchsorted(layout.at, (series.time[piece.start], series.time[piece.stop - 1]), side="right")
        made.append(Stretch(piece, first, slice(int(ends[0]), int(ends[1]))))
    return [own for own in made if own.own.stop - own.own.start >= rts.SHORT]


def _state_after(kind: int) -> int:
    return {LAND: STICK, MEET: RIDE, STOP: REST}.get(kind, SLIP)


def _looked_at(series: Series, layout: Layout) -> list[Stretch]:
    """Return the stretches that noise is learned from: of a long record a dozen slips and their surroundings."""
    whole = _stretches(series, layout)
    if sum(own.own.stop - own.own.start for own in whole) <= FITTED:
        return whole
    around = []
    for stretch in whole:
        times, kinds = layout.at[stretch.corners], layout.kind[stretch.corners]
        for k, kind in enumerate(kinds.tolist()):
            if kind in (LAND, MEET, STOP):
                begun = times[k - 1] if k else series.time[stretch.own.start]
                around.append(
                    (stretch, max(begun, times[k] - 3 * layout.unit) - layout.unit / 4, times[k] + layout.unit / 4)
                )
    if not around:
        return whole
    most = max(int(FITTED * series.interval / (1.5 * layout.unit)), 3)
    picked = [around[i] for i in np.unique(np.linspace(0, len(around) - 1, most).astype(int))]
    made = []
    for stretch, begin, end in picked:
        own = series.time[stretch.own]
        i, j = stretch.own.start + np.searchsorted(own, (begin, end))
        if j - i < 2 * rts.SHORT:
            continue
        c, d = np.searchsorted(layout.at, (series.time[i], series.time[j - 1]), side="right")
        first = _state_after(int(layout.kind[c - 1])) if c > stretch.corners.start else stretch.first
        made.append(Stretch(slice(int(i), int(j)), first, slice(int(c), int(d))))
    return made


def _labels(series: Series, layout: Layout, stretch: Stretch) -> Labels:
    time = series.time[stretch.own]
    label = np.empty(time.size, np.uint8)
    compiled(snap_filter.label_samples, KERNELS)(
        time, layout.at[stretch.corners], layout.kind[stretch.corners], stretch.first, layout.unit, label
    )
    return label


class Room:
    """Memory for what the filters write down, used again and again: fresh pages cost more than filtering."""

    def __init__(self) -> None:
        self._held = np.empty(0)

    def stored(self, n: int, columns: int) -> Array:
        """Return an array (n, columns); what it held before is gone."""
        if self._held.size < n * columns:
            self._held = np.empty(n * columns)
        return self._held[: n * columns].reshape(n, columns)


def _filtered(series: Series, layout: Layout, levels: Levels, stretch: Stretch, room: Room) -> tuple[Labels, Array]:
    """Filter a stretch; return its labels and what was expected of each sample."""
    time, position = series.time[stretch.own], series.position[stretch.own]
    label = _labels(series, layout, stretch)
    state = np.empty(snap_filter.STATE)
    stored = room.stored(time.size, snap_filter.STORED)
    still = stretch.first in (STICK, REST)
    compiled(snap_filter.start, KERNELS)(time, position, float(levels.r[stretch.first]), still, state)
    compiled(snap_filter.forward, KERNELS)(
        time,
        position,
        label,
        layout.at[stretch.corners],
        layout.kind[stretch.corners],
        levels.q,
        levels.r,
        levels.jump,
        state,
        stored,
    )
    return label, stored


def _learned(series: Series, room: Room, layout: Layout, levels: Levels, times: int, *, bare: bool = False) -> Levels:
    """Return noise levels under which the record is more likely; ``bare``: as if it had no corners."""
    back = compiled(snap_filter.backward, KERNELS)
    stretches = _looked_at(series, layout)
    if bare:
        layout = _without(layout, np.ones(layout.at.size, bool))
        stretches = [Stretch(own.own, SLIP, slice(0, 0)) for own in stretches]
    least = 0.25 * rts.least_variance(series)
    for _ in range(times):
        noise, steps = np.zeros((LABELS, 4)), np.zeros((snap_filter.JUMPS, 2))
        for stretch in stretches:
            label, stored = _filtered(series, layout, levels, stretch, room)
            at, kind = layout.at[stretch.corners], layout.kind[stretch.corners]
            back(series.time[stretch.own], label, at, kind, stored, False, np.empty((6, 0)), noise, steps)
        q = levels.q * _ratio(levels.q, noise[:, 0], noise[:, 1])
        jump = levels.jump * _ratio(levels.jump, steps[:, 0], steps[:, 1])
        r = levels.r.copy()
        slipping = np.ones(LABELS, bool)
        slipping[[STICK, RIDE, MET, LEAVING, REST]] = False
        for group in (slipping, np.isin(np.arange(LABELS), (STICK,)), np.isin(np.arange(LABELS), (RIDE, MET, LEAVING))):
            if noise[group, 3].any():
                r[group] = max(r[group][0] * noise[group, 2].sum() / noise[group, 3].sum(), least)
        levels = Levels(q, r, jump)
    return levels


def _ratio(level: Array, square: Array, expected: Array) -> Array:
    """Return what brings a level nearer to its greatest likelihood; half a degree of freedom says leave it."""
    ratio = (level * square + 0.5) / (level * expected + 0.5)
    return np.asarray(np.clip(ratio, 1e-4, 1e4))


def _placed(series: Series, room: Room, layout: Layout, levels: Levels, width: float) -> Layout:
    """Return the layout with each corner where it is most likely; ``width`` scales how far away it may lie."""
    place = compiled(snap_filter.place, KERNELS)
    unit = layout.unit
    finest = series.interval / 4 if width >= 1 else 0.0
    at, sd = layout.at.copy(), layout.sd.copy()
    near, far = unit * np.array(NEAR_LANDING), unit * np.array(NEAR_ONSET)
    landing = [SLIP, LANDING + 3, LANDING + 2, LANDING + 1, LANDING]
    onset = [ONSET, ONSET + 1, ONSET + 2, ONSET + 3, SLIP]
    for stretch in _stretches(series, layout):
        if stretch.corners.start == stretch.corners.stop:
            continue
        time, position = series.time[stretch.own], series.position[stretch.own]
        _, stored = _filtered(series, layout, levels, stretch, room)
        now, kinds = layout.at[stretch.corners], layout.kind[stretch.corners]
        before = np.concatenate(([time[0]], now[:-1]))
        behind = np.concatenate((now[1:], [time[-1]]))
        low, high = now - 0.45 * (now - before), now + 0.45 * (behind - now)  # never past its neighbour
        first = np.array([stretch.first, *(_state_after(int(kind)) for kind in kinds[:-1])])
        for kind in np.unique(kinds):
            for state in np.unique(first[kinds == kind]):
                pick = np.flatnonzero((kinds == kind) & (first == state))
                if kind in (LAND, STOP, MEET):
                    edges = np.concatenate((-near[::-1], [0.0]))
                    parts = [*landing, {LAND: STICK, STOP: REST, MEET: MET}[int(kind)]]
                    corner, half, back, on = 4, unit / 64, unit / 64, unit / 12
                    if kind == MEET:
                        edges, parts = np.append(edges, far[0]), [*parts, RIDE]
                else:
                    edges = np.concatenate(([0.0], far))
                    parts = [int(state), *onset]
                    corner, half, back, on = 0, unit / 16, unit / 64, unit / 8
                    if state == RIDE:
                        edges, parts, corner = np.concatenate(([-far[0]], edges)), [RIDE, LEAVING, *onset], 1
                found = np.empty((pick.size, 2))
                place(
                    *(time, position, stored, now, pick, int(kind), low[pick], high[pick]),
                    *(max(width * half, series.interval), finest, back, on, edges, np.array(parts, np.uint8), corner),
                    *(levels.q, levels.r, levels.jump, found),
                )
                at[stretch.corners.start + pick] = found[:, 0]
                sd[stretch.corners.start + pick] = found[:, 1] * (SHARP if kind in (LAND, STOP) else 1.0)
    return replace(layout, at=at, sd=sd)


def _gate(
    series: Series, room: Room, layout: Layout, levels: Levels, noise: rts.Noise, begun: Layout
) -> tuple[Layout, Levels] | None:
    """Keep the sticks that make the record more likely, each on the belt that does: even, or not.

    Without the sticks, the record is held to be white jerk or white snap all through, whichever does better.
    """
    sticks = _sticks(layout)
    if not sticks:
        return None
    bare = _without(layout, np.ones(layout.at.size, bool))
    snap = _snap_levels(levels)
    for _ in range(3):
        snap = _learned(series, room, layout, snap, 1, bare=True)
    spans = _spans(series, layout, sticks)
    plain = _jerk_gains(series, noise, room, spans)
    smooth = _gains(series, bare, snap, room, spans)
    even = _gains(series, layout, levels, room, spans)
    needed = GATE * math.log(series.time.size)
    corners = np.array([len(stick) for stick in sticks])
    ridden = np.zeros(len(sticks), bool)
    other_way = np.maximum(plain, smooth)
    gained = (even - other_way)[:-1]
    uneven = levels.r[STICK] > 1.3 * levels.r[SLIP]
    if uneven or (gained < needed * corners).any():
        kinds = np.where(begun.kind == LAND, MEET, begun.kind).astype(np.uint8)
        firsts = tuple(RIDE if first == STICK else first for first in begun.first)
        other = replace(begun, kind=kinds, first=firsts)
        riding = replace(levels, r=np.full(LABELS, levels.r[SLIP]))
        for width in (1.0, 0.25):
            riding = _learned(series, room, other, riding, 2)
            other = _placed(series, room, other, riding, width)
        riding = _learned(series, room, other, riding, 2)
        rides = _gains(series, other, riding, room, spans)
        ridden = (rides > even + needed)[:-1]
        gained = np.maximum(gained, (rides - other_way)[:-1])
        if ridden.any():
            levels = riding if ridden.all() else _merged(levels, riding)
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
        even = _gains(series, layout, levels, room, spans[-1:])
    # What the sticks that are left gain must not be lost where the others were dropped.
    return (layout, levels) if even[-1] - max(plain[-1], smooth[-1]) > needed * layout.at.size else None


def _sticks(layout: Layout) -> list[list[int]]:
    """Return the corners of every stick and ride: the one it begins with and the one it ends with, where it has any."""
    found: list[list[int]] = []
    for k, kind in enumerate(layout.kind.tolist()):
        if kind in (LAND, MEET):
            ends = k + 1 < layout.kind.size and layout.kind[k + 1] == LEAVE
            found.append([k, k + 1] if ends else [k])
        elif kind == LEAVE and (k == 0 or layout.kind[k - 1] not in (LAND, MEET)):
            found.append([k])
    return found


def _spans(series: Series, layout: Layout, sticks: list[list[int]]) -> NDArray[np.int64]:
    """Return the samples by which each stick is judged, its own and some to either side; and last, all: (s + 1, 2)."""
    spans = []
    for stick in sticks:
        begin = layout.at[stick[0]] if layout.kind[stick[0]] != LEAVE else layout.at[stick[0]] - layout.unit
        end = layout.at[stick[-1]] if layout.kind[stick[-1]] == LEAVE else layout.at[stick[-1]] + layout.unit
        spans.append(np.searchsorted(series.time, (begin - layout.unit / 16, end + layout.unit / 8)))
    return np.array([*spans, (0, series.time.size)], np.int64)


def _gains(series: Series, layout: Layout, levels: Levels, room: Room, spans: NDArray[np.int64]) -> Array:
    """Return the log likelihood of the samples of every span given those before, up to a constant."""
    total = np.zeros(len(spans))
    for stretch in _stretches(series, layout):
        stored = _filtered(series, layout, levels, stretch, room)[1]
        total += _summed(stored, 14, stretch, spans)
    return total


def _jerk_gains(series: Series, noise: rts.Noise, room: Room, spans: NDArray[np.int64]) -> Array:
    """As `_gains`, for the motion of white jerk."""
    total = np.zeros(len(spans))
    for piece in series.pieces:
        if piece.stop - piece.start < rts.SHORT:
            continue
        time, position = series.time[piece], series.position[piece]
        state, stored = np.empty(jerk_filter.STATE), room.stored(time.size, jerk_filter.STORED)
        compiled(jerk_filter.start, rts.KERNELS)(time, position, noise.reading, state)
        compiled(jerk_filter.forward, rts.KERNELS)(time, position, noise.jerk, noise.reading, state, stored)
        total += _summed(stored, 9, Stretch(piece, SLIP, slice(0, 0)), spans)
    return total


def _summed(stored: Array, surprise: int, stretch: Stretch, spans: NDArray[np.int64]) -> Array:
    inside = np.clip(spans - stretch.own.start, 0, stretch.own.stop - stretch.own.start)
    gain = np.zeros(len(spans))
    compiled(snap_filter.gains, KERNELS)(stored, surprise, inside, gain)
    return gain


def _snap_levels(levels: Levels) -> Levels:
    """Return levels with one roughness for a record without corners."""
    return replace(levels, q=np.full(LABELS, levels.q[LANDING + 1]), r=np.full(LABELS, levels.r[SLIP]))


def _merged(even: Levels, riding: Levels) -> Levels:
    """Return the levels of the even sticks with those of the ridden ones."""
    q, r, jump = even.q.copy(), even.r.copy(), even.jump.copy()
    for label in (RIDE, MET, LEAVING):
        q[label], r[label] = riding.q[label], riding.r[label]
    jump[2:4] = riding.jump[2:4]
    return Levels(q, r, jump)


def _without(layout: Layout, gone: NDArray[np.bool_]) -> Layout:
    """Return the layout without some corners; what they parted is slip."""
    return replace(
        layout,
        at=layout.at[~gone],
        sd=layout.sd[~gone],
        kind=layout.kind[~gone],
        first=tuple(SLIP for _ in layout.first) if gone.all() else layout.first,
    )


def _rebuilt(
    series: Series,
    room: Room,
    layout: Layout,
    levels: Levels,
    sticks: list[list[int]],
    dropped: NDArray[np.bool_],
    ridden: NDArray[np.bool_],
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
        levels = _learned(series, room, layout, levels, 2)
        layout = _placed(series, room, layout, levels, 0.25)
    return layout, levels


def _averaged(series: Series, room: Room, layout: Layout, levels: Levels, window: int) -> Motion:
    """Smooth, averaging over what is open of the corners' times."""
    back = compiled(snap_filter.backward, KERNELS)
    total, still = _run(series, room, layout, levels, back, lines=True)
    before, still_before = _run(series, room, replace(layout, at=_moved(layout, -1.0)), levels, back, lines=False)
    behind, still_behind = _run(series, room, replace(layout, at=_moved(layout, 1.0)), levels, back, lines=False)
    sure = still & still_before & still_behind
    compiled(snap_filter.average, KERNELS)(total, before, behind, sure)
    return Motion(
        position=series.origin + total[0],
        velocity=total[1],
        acceleration=total[2],
        position_errors=total[3],
        velocity_errors=total[4],
        acceleration_errors=total[5],
        window=window,
        order=ORDER,
        method="segment",
        corners=tuple(
            Corner(float(at), float(sd), WHAT[int(kind)])
            for at, sd, kind in zip(layout.at, layout.sd, layout.kind, strict=True)
        ),
    )


def _moved(layout: Layout, shift: float) -> Array:
    """Return the corners' times moved by sqrt(3) standard deviations, in order still."""
    at = layout.at + shift * math.sqrt(3) * layout.sd
    return np.asarray(np.maximum.accumulate(at))


def _run(
    series: Series, room: Room, layout: Layout, levels: Levels, back: Callable[..., None], *, lines: bool
) -> tuple[Array, NDArray[np.bool_]]:
    """Smooth with the corners where they are; return the motion and its variances (6, n), and what lies in sticks."""
    motion, still = np.empty((6, series.time.size)), np.zeros(series.time.size, bool)
    for piece in series.pieces:
        if piece.stop - piece.start < rts.SHORT:
            motion[:, piece] = rts.parabola(series.time[piece], series.position[piece], float(levels.r[SLIP]))
    for stretch in _stretches(series, layout):
        label, stored = _filtered(series, layout, levels, stretch, room)
        at, kind = layout.at[stretch.corners], layout.kind[stretch.corners]
        noise, steps = np.zeros((LABELS, 4)), np.zeros((snap_filter.JUMPS, 2))
        back(series.time[stretch.own], label, at, kind, stored, True, motion[:, stretch.own], noise, steps)
        still[stretch.own] = label == STICK
        if lines:
            _straighten(series, stretch, label, layout, levels, motion)
    return motion, still


def _straighten(series: Series, stretch: Stretch, label: Labels, layout: Layout, levels: Levels, motion: Array) -> None:
    """Replace what lies in sticks by straight lines; their errors are scaled to what neighbouring lines differ by."""
    run = compiled(line_fit.lines, LINES)
    still = np.diff(np.concatenate(([0], (label == STICK).astype(np.int8), [0])))
    begins, ends = np.flatnonzero(still == 1), np.flatnonzero(still == -1)
    window = max(int(LINE * layout.unit / series.interval), 16)
    own, variance = motion[:, stretch.own], float(levels.r[STICK])
    time, position = series.time[stretch.own], series.position[stretch.own]
    fitted = [(i, j) for i, j in zip(begins.tolist(), ends.tolist(), strict=True) if j - i >= 8]
    differing = np.array([run(time, position, i, j, window, variance, own) for i, j in fitted])
    known = differing > 0
    factor = (differing[known].sum() + 4.0) / (known.sum() + 4.0)
    for i, j in fitted:
        own[3:, i:j] *= factor
