"""A record made ready for smoothing: positions from the first sample on, the time axis asked for, cut at its gaps.

Rules: counts are subtracted as whole numbers before they become metres, so an offset of 2^60 costs no digit; a hole
of more than `HOLE` (`stickslip.compute.arrays`) sample intervals ends a piece, and so does a new segment; nothing is
ever smoothed across a cut.
A shorter hole (a lost sample or two) stays inside its piece: the recorded times say where the neighbours lie.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from processing.record.units import Units
from stickslip.compute.arrays import HOLE, Array, Integers, Mask, pieces
from stickslip.errors import InputError

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


LEAST = 5  # samples: a local parabola and its error need as many
TIMES = ("recorded", "nominal")

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Series:
    """Positions against time, every array of shape (n,)."""

    time: Array  # s, increasing
    position: Array  # m, seen from `origin`, so that the first of the record is 0
    origin: float  # m; add it to get the recording's positions
    pitch: float  # metres per count (positive); 0 for a record without counts
    interval: float  # median sample interval, s
    pieces: tuple[slice, ...]  # stretches without a gap, in order; together they are the record
    source: str = ""  # the file, for messages
    # (float, float) when the first motion of the record begins and the last one ends, s, where that is known from all
    # of it
    moving: tuple[float, float] | None = None

    def in_units(self, units: Units) -> "Series":
        """Return the record in the units of a record, one that is in SI units."""
        length, time = units.length_unit, units.time_unit
        return replace(
            self,
            time=(self.time - units.start) / time,
            position=self.position / length,
            origin=self.origin / length,
            pitch=self.pitch / abs(length),
            interval=self.interval / time,
        )

    def taken(self, kept: Mask) -> "Series":
        """Return the samples ``kept``, (n,); a hole that is left ends a piece where it is longer than `HOLE`."""
        own = np.flatnonzero(kept)
        time = self.time[own]
        cut = (np.diff(own) > 1) & (np.diff(time) > HOLE * self.interval)
        starts = {int(np.searchsorted(own, piece.start)) for piece in self.pieces}
        edges = sorted({0, own.size} | starts | set((np.flatnonzero(cut) + 1).tolist()))
        taken = tuple(slice(i, j) for i, j in pairwise(edges))
        return replace(self, time=time, position=self.position[own], pieces=taken)

    def readings(self) -> "Series":
        """Return the record without the samples whose reading is missing (NaN)."""
        known = ~np.isnan(self.position)
        return self if known.all() else self.taken(known)

    def parted(self, longest: float) -> "Series":
        """Return the record with pieces that end at holes of missing readings (NaN) longer than ``longest``, s.

        Samples in such holes, and missing ones at the ends of a piece, are in no piece.
        """
        known = np.flatnonzero(~np.isnan(self.position))
        if known.size == self.time.size:
            return self
        parts = []
        for piece in self.pieces:
            own = known[np.searchsorted(known, piece.start) : np.searchsorted(known, piece.stop)]
            cut = np.flatnonzero((np.diff(own) > 1) & (np.diff(self.time[own]) > longest)) + 1
            for first, last in pairwise([0, *cut.tolist(), own.size]):
                parts.append(slice(int(own[first]), int(own[last - 1]) + 1))
        return replace(self, pieces=tuple(parts))


def computed_once(function: Callable[[Series], Result]) -> Callable[[Series], Result]:
    """Return ``function``, whose result is kept for as long as the series it was computed from exists."""
    found: WeakKeyDictionary[Series, Result] = WeakKeyDictionary()

    @wraps(function)
    def kept(series: Series) -> Result:
        if series not in found:
            found[series] = function(series)
        return found[series]

    return kept


def from_recording(
    recording: "Recording",
    times: str = "recorded",
    anchor: "tuple[float, int] | None" = None,
    grid: Array | None = None,
    start: "Recording | None" = None,
) -> Series:
    """Return the series of a recording.

    recording: The run.
    times: The board's sample times, or an even grid at the nominal rate that starts with each segment.
    anchor: (float, int) Time and number of the sample at which the first segment's even grid starts; by default the
        first.
    grid: The even grid itself, where it follows from more than this recording.
    start: Begins with the record's first sample, from which positions are seen; by default ``recording``.
    Raises InputError: for an unknown time axis, fewer than 5 samples, a position or time that is not finite, or times
        that are repeated or decrease; the message names the sample.
    """
    where = recording.where
    if times not in TIMES:
        raise InputError(f"times is {times!r}", "--times", f"known: {', '.join(TIMES)}")
    recorded, positions = recording.time, recording.position
    if recorded.size < LEAST:
        raise InputError(f"holds {recorded.size} samples; smoothing needs {LEAST}", where, "record for longer")
    segment = recording.segment
    time = recorded if times == "recorded" else nominal(recording, anchor) if grid is None else grid
    check(time, positions, where)
    pitch, start = 0.0, recording if start is None else start
    if recording.count is not None and start.count is not None:
        metres = recording.rig.metres_per_count
        scale = metres.value if metres is not None else 1.0
        pitch = abs(scale)
        position = (recording.count - start.count[0]) * scale
    else:
        position = positions - start.position[0]
    interval = float(np.median(np.diff(time)))
    return Series(
        time=time,
        position=position,
        origin=float(start.position[0]),
        pitch=pitch,
        interval=interval,
        pieces=pieces(time, segment, interval),
        source=where,
    )


def check(time: Array, position: Array, where: str) -> None:
    """Raise InputError, naming the sample, unless times increase and every number is finite."""
    for name, values in (("time", time), ("position", position)):
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise InputError(f"{name} is {values[index]} at sample {index}", where, "remove or mend that sample")
    steps = np.diff(time)
    if not (steps > 0).all():
        index = int(np.argmin(steps > 0)) + 1
        word = "repeats" if steps[index - 1] == 0 else "decreases"
        raise InputError(
            f"time {word} at sample {index} ({time[index - 1]:.6f} s, then {time[index]:.6f} s)",
            where,
            "times must increase: remove that sample, or use --times nominal when only the clock is bad",
        )


def nominal(recording: "Recording", anchor: "tuple[float, int] | None" = None) -> Array:
    """Return an even grid, s: the first recorded time of each segment plus sample number over rate.

    Lost samples keep their place, by the sequence number where there is one, else by the length of the hole.
    """
    recorded = recording.time
    time = np.empty_like(recorded)
    edges = [0, *(np.flatnonzero(np.diff(recording.segment.astype(np.int64)) != 0) + 1).tolist(), recorded.size]
    for first, last in pairwise(edges):
        own = slice(first, last)
        if recording.raw is not None:
            step = 1.0 / recording.rate_hz
            number = recording.raw.sample[own].astype(np.int64)
            start, zero = (recorded[first], number[0]) if anchor is None or first else anchor
            time[own] = start + (number - zero) * step
            continue
        else:
            gaps = np.diff(recorded[own])
            step = float(np.median(gaps)) if gaps.size else 1.0 / recording.rate_hz
            # Interval by interval: over a long record a small error of the step would add up to samples.
            number = np.concatenate(([0], np.cumsum(interval_numbers(gaps, step))))
            if gaps.size:
                step = float(recorded[last - 1] - recorded[first]) / float(number[-1])
        time[own] = recorded[first] + number * step
    return time


def interval_numbers(gaps: Array, step: float) -> Integers:
    """Return how many steps each interval takes, at least one."""
    return np.asarray(np.maximum(np.rint(gaps / step), 1).astype(np.int64))
