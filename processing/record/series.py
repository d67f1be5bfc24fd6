"""A record prepared for smoothing: its units, its pieces, steps of its position, and the even grid.

Units.  Positions and times are scaled before smoothing and back to SI units after it.  In between no second, hertz or
metre exists: a threshold is a number of samples, of standard deviations of the noise, of slips, or a ratio.  Both units
are powers of two, so that the scaling rounds nothing, and a record whose positions or times are multiplied by a power
of two gives the same scaled numbers, bit for bit.  The unit of length is negative where slips run towards +x: a
mirrored record gives the same numbers, too.

Pieces.  Counts are subtracted as whole numbers before they become metres, so an offset of 2^60 costs no digit.  A hole
of more than `HOLE` (`stickslip.compute.arrays`) sample intervals ends a piece, and so does a new segment; nothing is
smoothed across a cut.  A shorter hole stays inside its piece: the recorded times say where the neighbours lie.

Grid.  An import has no sample numbers: intervals are multiples of the usual one, and the grid runs from the first time
to the last.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from stickslip.compute.arrays import HOLE, Array, Mask, pieces
from stickslip.errors import InputError
from stickslip.units import Measured

if TYPE_CHECKING:
    from daq.runfile.recording import Recording
    from daq.runfile.store import RunReader


@dataclass(frozen=True)
class Units:
    length_unit: float = 1.0  # m (or counts), signed: about the travel of the record
    time_unit: float = 1.0  # s: about its sample interval
    start: float = 0.0  # s: the time at which that of the record is 0

    def of(self, length: int, time: int) -> float:
        """Return the signed unit, in SI units, of a quantity with these powers of length and time."""
        return self.length_unit**length * self.time_unit**time


def power_of_two(size: float) -> float:
    """Return the power of two above a size, 1 for size 0."""
    return math.ldexp(1.0, math.frexp(size)[1]) if size > 0 else 1.0


def speed_in(units: Units, speed: float | None) -> float | None:
    return None if speed is None else speed / units.of(1, -1)


def measured_in(units: Units, speed: Measured | None) -> Measured | None:
    unit = units.of(1, -1)
    return None if speed is None else Measured(speed.value / unit, speed.sd / abs(unit))


LEAST = 5  # samples: a local parabola and its error need as many
TIMES = ("recorded", "nominal")
READ = 2**16  # samples of a file read at a time

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
    moving: tuple[float, float] | None = None  # start of the first motion of the record and end of the last, s

    def in_units(self, units: Units) -> "Series":
        length, time = units.length_unit, units.time_unit
        return replace(
            self,
            time=(self.time - units.start) / time,
            position=self.position / length,
            origin=self.origin / length,
            pitch=self.pitch / abs(length),
            interval=self.interval / time,
        )

    def select(self, kept: Mask) -> "Series":
        """Return the samples ``kept``; a hole longer than `HOLE` intervals ends a piece."""
        samples = np.flatnonzero(kept)
        time = self.time[samples]
        cut = (np.diff(samples) > 1) & (np.diff(time) > HOLE * self.interval)
        starts = {int(np.searchsorted(samples, piece.start)) for piece in self.pieces}
        edges = sorted({0, samples.size} | starts | set((np.flatnonzero(cut) + 1).tolist()))
        taken = tuple(slice(i, j) for i, j in pairwise(edges))
        return replace(self, time=time, position=self.position[samples], pieces=taken)

    def drop_missing(self) -> "Series":
        """Return the record without missing readings (NaN)."""
        present = ~np.isnan(self.position)
        return self if present.all() else self.select(present)

    def cut_at_holes(self, longest: float) -> "Series":
        """Return the record with pieces cut at holes of missing readings (NaN) longer than ``longest``, s.

        Samples in such holes, and missing ones at the ends of a piece, belong to no piece.
        """
        present = np.flatnonzero(~np.isnan(self.position))
        if present.size == self.time.size:
            return self
        parts = []
        for piece in self.pieces:
            samples = present[np.searchsorted(present, piece.start) : np.searchsorted(present, piece.stop)]
            cut = np.flatnonzero((np.diff(samples) > 1) & (np.diff(self.time[samples]) > longest)) + 1
            for first, last in pairwise([0, *cut.tolist(), samples.size]):
                parts.append(slice(int(samples[first]), int(samples[last - 1]) + 1))
        return replace(self, pieces=tuple(parts))


def computed_once(function: Callable[[Series], Result]) -> Callable[[Series], Result]:
    """Cache the result of ``function`` for as long as its series exists."""
    results: WeakKeyDictionary[Series, Result] = WeakKeyDictionary()

    @wraps(function)
    def compute(series: Series) -> Result:
        if series not in results:
            results[series] = function(series)
        return results[series]

    return compute


def from_recording(recording: "Recording", times: str = "recorded", start: "Recording | None" = None) -> Series:
    """Return the series of a recording; InputError for samples that are too few, not finite or not increasing in time.

    Positions are relative to the first sample of ``start``, by default of ``recording``.
    """
    where = recording.where
    if times not in TIMES:
        raise InputError(f"times is {times!r}", "--times", f"known: {', '.join(TIMES)}")
    recorded, positions = recording.time, recording.position
    if recorded.size < LEAST:
        raise InputError(f"has {recorded.size} samples, but smoothing needs {LEAST}", where, "record for longer")
    segment = recording.segment
    time = recorded
    if times == "nominal":
        number = None if recording.raw is None else recording.raw.sample
        time = nominal_times(recorded, segment, number, recording.rate_hz)
    check_numbers(time, positions, where)
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


def check_numbers(time: Array, position: Array, where: str) -> None:
    """Raise InputError, naming the sample, unless times increase and every number is finite."""
    for name, values in (("time", time), ("position", position)):
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise InputError(f"{name} is {values[index]} at sample {index}", where, "remove or correct that sample")
    steps = np.diff(time)
    if not (steps > 0).all():
        index = int(np.argmin(steps > 0)) + 1
        word = "repeats" if steps[index - 1] == 0 else "decreases"
        raise InputError(
            f"time {word} at sample {index} ({time[index - 1]:.6f} s, then {time[index]:.6f} s)",
            where,
            "times must increase: remove that sample, or use --times nominal if only the clock is wrong",
        )


def nominal_times(
    recorded: Array, segment: NDArray[np.integer], number: NDArray[np.integer] | None, rate_hz: float
) -> Array:
    """Return an even grid, s: the first recorded time of each segment plus sample number over rate.

    Lost samples keep their place, by their ``number`` if recorded, else by the length of the hole.
    """
    time = np.empty_like(recorded)
    edges = [0, *(np.flatnonzero(np.diff(segment.astype(np.int64)) != 0) + 1).tolist(), recorded.size]
    for first, last in pairwise(edges):
        samples = slice(first, last)
        if number is not None:
            steps, step = number[samples].astype(np.int64) - int(number[first]), 1.0 / rate_hz
        else:
            gaps = np.diff(recorded[samples])
            step = float(np.median(gaps)) if gaps.size else 1.0 / rate_hz
            # Interval by interval: over a long record a small error of the step would add up to samples.
            steps = np.concatenate(([0], np.cumsum(np.maximum(np.rint(gaps / step), 1).astype(np.int64))))
            if gaps.size:
                step = float(recorded[last - 1] - recorded[first]) / float(steps[-1])
        time[samples] = recorded[first] + steps * step
    return time


def read_nominal_times(run: "RunReader") -> Array:
    """Return the even grid of a run in a file, s, which is read block by block."""
    rows = []
    for first in range(0, run.samples, READ):
        part = run.load(slice(first, first + READ))
        rows.append((part.time, part.segment, None if part.raw is None else part.raw.sample))
    recorded, segment, number = zip(*rows, strict=True)
    numbers = None if part.raw is None else np.concatenate(number)
    return nominal_times(np.concatenate(recorded), np.concatenate(segment), numbers, part.rate_hz)


@dataclass(frozen=True)
class PositionStep:
    """From sample ``first`` to ``last`` the reading moved by ``size`` more than the mass did, for good."""

    first: int
    last: int
    counts: int  # missing counts, positive towards +x; 0 in a record without counts
    size: float  # the same in the unit of the position, m (or counts)


def step_offsets(segment: NDArray[np.integer], steps: tuple[PositionStep, ...]) -> Array:
    """Return the error of each sample due to earlier steps, m (or counts); a step lasts until its segment ends."""
    offset = np.zeros(segment.size)
    edges = np.append(np.flatnonzero(np.diff(segment.astype(np.int64)) != 0) + 1, segment.size) if steps else ()
    for step in steps:
        end = int(edges[np.searchsorted(edges, step.first, side="right")])
        next_sample = min(step.last + 1, end)
        offset[step.first : next_sample] += (
            step.size * step_profile(step.last - step.first + 1)[: next_sample - step.first]
        )
        offset[next_sample:end] += step.size
    return offset


def step_profile(width: int) -> Array:
    """Return the share of a step of ``width`` samples that is complete at each of them."""
    return np.arange(1, width + 1) / width
