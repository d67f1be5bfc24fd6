"""From a journal to one sequence of samples: connections decoded, frames ordered, parts set on one time axis.

A part holds the samples after one start of the board: it ends where the port was lost, where the board restarted, or
where its sequence numbers jump against its clock.  The next one begins with its own sequence numbers and device time,
and in the units of the identification it was sent under.  The device's clock is the time axis.  A later part is placed
on it by the host's clock, with the least delay of the last seconds before and the first seconds after the gap; after a
jump that the device's clock does not take part in, by that.

Where the clock alone leaps while the sequence goes on, the host's clock decides between the two.  Nearer to the
device's time: the board has paused, and its clock is right.  Nearer to the sequence: its clock has leapt, and the part
that begins there is placed by the sequence.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from daq.runfile.spill import Shelf, Spill
from daq.wire import counters, decode, frames
from stickslip.compute import arrays

# Seconds on either side of a gap in which the least delay is searched.  Half finds fewer undelayed reads; double lets
# the drift of the clocks (100 ppm) add 0.2 ms more to the placement.  Not swept.
PLACE_S = 2.0
# A board's clock that moved on across a jump as the host's did, to within so much, has not been reset.  Half refuses it
# on a busy computer; double believes a clock that was reset to within as much more.  Not swept.
SAME_CLOCK_S = 0.1

PartReason = Literal["reopened", "restarted", "jumped", "clock", "paused"]


@dataclass(frozen=True)
class Samples:
    """Samples in order of time, n of them."""

    time: NDArray[np.float64]  # (n,) seconds since the first one, increasing
    part: NDArray[np.int64]  # (n,) which part, from 0
    # what began each part: a port that came back (the first part, too), a restart of the board that it announced, a
    # sequence number that does not follow, a clock that leapt, or a pause of the board.  The sequence goes on in the
    # last two, and the last one interrupts nothing.
    begun_by: tuple[PartReason, ...]
    index: NDArray[np.int64]  # (n,) sequence number and device time without roll-over, in the board's units
    ticks: NDArray[np.int64]
    # (n,) which frame it came in, counted over all connections; frames that gave no sample are counted, too
    frame: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]  # (n,) Host's monotonic clock when that frame had come in
    # as sent (`daq.wire.decode.Stream`), the illegal count repeated over its frame
    up: NDArray[np.uint16] | NDArray[np.uint32]
    down: NDArray[np.uint16] | NDArray[np.uint32]
    status: NDArray[np.uint8]
    illegal: NDArray[np.uint16]
    belt: NDArray[np.uint16] | None
    edge: NDArray[np.uint16] | None
    # (n,) the time as sent less ``ticks``; None where no time is interpolated
    time_error: NDArray[np.int64] | None = None
    # (n,) under which of the run's identifications it was sent (`Timeline.idents`); None: there is one
    source: NDArray[np.int64] | None = None
    # samples left out because their time did not advance: repeated, late, or stamped wrongly by the board
    repeated: int = 0

    def __len__(self) -> int:
        return len(self.time)

    def take(self, where: NDArray[np.bool_]) -> "Samples":
        """Return the samples for which ``where``, (n,), is True."""
        return arrays.rows(self, where)


@dataclass(frozen=True)
class TruthRows:
    """Rows of the exact motion as sent: `sample_keys` of their samples, (m,); time, x, v, F in s, m, m/s, N, (m, 4)."""

    key: NDArray[np.int64]
    rows: NDArray[np.float64]


@dataclass(frozen=True)
class Piece:
    """Some samples of a run, k of them, and what they are from."""

    samples: Samples  # the samples; whole frames
    stream: decode.Stream  # all frames that the piece is from, those without a sample too
    frames: int  # frames before it, over all connections
    # (k,) sample periods from the start of the run to each sample, lost samples and gaps included
    place: NDArray[np.int64]


@dataclass
class _Part:
    """A part's place on the time axis."""

    ticks: int  # device time of its first and last sample
    last_ticks: int
    index: int  # their sequence numbers
    last_index: int
    tick_ns: int  # tick of the device's clock, ns
    prompt_s: float  # Host's clock less the device's time since the first sample, the least of the first seconds
    start_s: float = 0.0  # time of its first sample in the run


class Timeline:
    """The samples of all connections on one time axis, piece by piece, each time it is iterated over.

    connections: The pieces of each connection (`daq.finalise.connections`); each is iterated over several times.
    rate_hz: Nominal rate, Hz.
    tick_ns: Tick of the clock of a device that has not identified itself, ns.
    most: Sample periods from the start of the run that samples are taken of.
    spill: Takes the rows of the exact motion.
    idents: The identifications that samples were sent under, each once, in the order of their first samples; None for
        that of a board which did not identify itself.
    truth: The exact motion.
    times_bytes: The recorder knows how long the frames were on the line.
    repeated: Samples left out because their time did not advance; after the last piece.
    """

    def __init__(
        self,
        connections: Sequence[Iterable[decode.Stream]],
        rate_hz: float,
        tick_ns: int,
        most: int | None = None,
        spill: Spill | None = None,
    ) -> None:
        self.truth: Shelf[TruthRows] = Shelf(spill or Spill())
        self.times_bytes = False
        self.repeated = 0
        self._connections = connections
        self._rate_hz, self._tick_ns, self._most = rate_hz, tick_ns, most
        self.idents: list[frames.Ident | None] = []
        self._orders: list[list[counters.FrameOrder]] = [[] for _ in connections]
        self._begun_by: list[PartReason] = []
        self._has = dict.fromkeys(("belt", "edge", "time_error"), True)
        for orders, connection in zip(self._orders, connections, strict=True):
            source = -1
            for stream in connection:
                for first, end, ident in stream.sent_as():
                    if first < end and self._source(ident) != source:
                        source = self._source(ident)
                        orders.append(counters.FrameOrder(1e9 / (rate_hz * self._tick_of(source))))
                    if orders:
                        orders[-1].survey(*_frames(stream, first, end))
                self.times_bytes = self.times_bytes or bool(stream.length.any())
                for name in self._has:
                    self._has[name] &= not len(stream.n) or getattr(stream, name) is not None
        self._parts: dict[int, _Part] = {}
        self._sole: _Unplaced | None = None
        for number, unplaced in enumerate(self._unplaced(learn=True)):
            samples, _, _, truth = unplaced
            self._sole = None if number else unplaced
            if len(truth.key):
                self.truth.append(truth)
            for part, here in parts_of(samples):
                self._learn(part, samples, here)
        if len(self._parts) > 1:
            self._set_starts()

    def __iter__(self) -> Iterator[Piece]:
        late = 0
        newest = -np.inf
        part, offset = 0, 0
        for samples, stream, before, _ in [self._sole] if self._sole else self._unplaced():
            late += int(stream.n.sum()) - len(samples)
            samples = replace(samples, time=self._times(samples), begun_by=tuple(self._begun_by))
            if len(samples):
                advances = samples.time > np.maximum.accumulate(np.concatenate(([newest], samples.time)))[:-1]
                newest = max(newest, float(samples.time.max()))
                if not advances.all():
                    late += int(np.count_nonzero(~advances))
                    samples = samples.take(advances)
            place = samples.index.copy()
            for own, here in parts_of(samples):
                if own != part:
                    part, offset = own, round(float(samples.time[here.start]) * self._rate_hz)
                    if self._begun_by[own] in ("clock", "paused"):
                        offset -= int(samples.index[here.start])
                place[here] += offset
            if self._most is not None and len(place) and place.max() >= self._most:
                samples, place = samples.take(place < self._most), place[place < self._most]
            self.repeated = late
            yield Piece(samples, stream, before, place)

    def _unplaced(self, learn: bool = False) -> Iterator["_Unplaced"]:
        """Yield the samples of each piece, without times, its frames and how many came before, its exact motion."""
        before = 0
        parts = -1
        for orders, connection in zip(self._orders, self._connections, strict=True):
            for order in orders:
                order.begin()
            beside: _Beside | None = None
            using, now = -1, -1
            for stream in connection:
                stretches: list[counters.Order] = []
                source = np.zeros(len(stream.n), dtype=np.int64)
                for first, end, ident in stream.sent_as():
                    anew = first < end and self._source(ident) != now
                    if anew:
                        using, now = using + 1, self._source(ident)
                    source[first:end] = max(now, 0)
                    order = orders[using] if using >= 0 else counters.FrameOrder(1.0)
                    stretches.append(order.place(*_frames(stream, first, end)))
                    if anew and (first or beside is not None):
                        stretches[-1].restart[0] = True
                unplaced = arrays.joined(stretches)
                if beside is None and len(stream.n):
                    parts += 1
                    if learn:
                        self._begun_by.append("reopened")
                begins = unplaced.restart | unplaced.leap
                part = parts + np.cumsum(begins)
                if learn:
                    for leap, jump in zip(unplaced.leap[begins].tolist(), unplaced.jump[begins].tolist(), strict=True):
                        self._begun_by.append("clock" if leap else "jumped" if jump else "restarted")
                truth, beside = _truth(stream, unplaced, part, beside)
                yield self._samples(stream, unplaced, part, source, before), stream, before, truth
                before += len(stream.n)
                parts = int(part[-1]) if len(part) else parts

    def _source(self, ident: frames.Ident | None) -> int:
        """Return the number of an identification, without its number of samples in a frame."""
        same = None if ident is None else replace(ident, block_size=1)
        if same not in self.idents:
            self.idents.append(same)
        return self.idents.index(same)

    def _tick_of(self, source: int) -> int:
        ident = self.idents[source]
        return self._tick_ns if ident is None else ident.tick_ns

    def _samples(
        self,
        stream: decode.Stream,
        order: counters.Order,
        part: NDArray[np.int64],
        source: NDArray[np.int64],
        before: int,
    ) -> Samples:
        """Return the samples of the frames that are kept, their times still to be set."""
        frame = np.repeat(np.arange(len(stream.n)), stream.n)
        within = np.arange(len(frame)) - stream.first[frame]
        elapsed = np.cumsum(stream.dt, dtype=np.int64)
        time_error = stream.time_error if self._has["time_error"] else None
        made = Samples(
            time=np.zeros(len(frame)),
            part=part[frame],
            begun_by=tuple(self._begun_by),
            index=order.index[frame] + within,
            ticks=order.ticks[frame] + elapsed - elapsed[stream.first[frame]],
            frame=before + frame,
            stamp_ns=stream.stamp_ns[frame],
            up=stream.up,
            down=stream.down,
            status=stream.status,
            illegal=stream.illegal[frame].astype(np.uint16),
            belt=stream.belt if self._has["belt"] else None,
            edge=stream.edge if self._has["edge"] else None,
            time_error=None if time_error is None else time_error[frame],
            source=source[frame] if len(self.idents) > 1 else None,
        )
        return made if np.all(order.keep) else made.take(order.keep[frame])

    def _learn(self, number: int, samples: Samples, here: slice) -> None:
        """Take a part's samples, or some of them, all of which come in order."""
        if number not in self._parts:
            first = int(samples.ticks[here.start]), int(samples.index[here.start])
            tick_ns = self._tick_of(0 if samples.source is None else int(samples.source[here.start]))
            self._parts[number] = _Part(first[0], 0, first[1], 0, tick_ns, np.inf)
        part = self._parts[number]
        part.last_ticks, part.last_index = int(samples.ticks[here.stop - 1]), int(samples.index[here.stop - 1])
        device = self._device(samples, here, part)
        near = np.abs(device) <= PLACE_S
        # Only a frame's last sample was taken right before the frame came in; the least difference finds such a one.
        part.prompt_s = float(np.min(samples.stamp_ns[here][near] / 1e9 - device[near], initial=part.prompt_s))

    def _device(self, samples: Samples, here: slice, part: _Part) -> NDArray[np.float64]:
        return np.asarray((samples.ticks[here] - part.ticks) * part.tick_ns / 1e9)

    def _times(self, samples: Samples) -> NDArray[np.float64]:
        time = np.zeros(len(samples))
        for number, here in parts_of(samples):
            part = self._parts[number]
            time[here] = part.start_s + self._device(samples, here, part)
        return time

    def _set_starts(self) -> None:
        """Place every part after the first: by the host's clock, with the least delay on both sides of the gap."""
        now, late_s = 0, np.inf  # the part, and the host's clock less its time, the least of its last seconds
        for samples, _, _, _ in self._unplaced():
            for number, here in parts_of(samples):
                part, before = self._parts[number], self._parts[now]
                before_s = before.start_s + (before.last_ticks - before.ticks) * before.tick_ns / 1e9
                if number != now:
                    part.start_s = self._start(number, before_s, float(before_s + late_s), before)
                    now, late_s = number, np.inf
                time = part.start_s + self._device(samples, here, part)
                last_s = part.start_s + (part.last_ticks - part.ticks) * part.tick_ns / 1e9
                near = np.abs(time - last_s) <= PLACE_S
                late_s = float(np.min(samples.stamp_ns[here][near] / 1e9 - time[near], initial=late_s))

    def _start(self, number: int, before_s: float, host_s: float, before: _Part) -> float:
        """Return the time of a part's first sample; ``before_s``, ``host_s``: of the one before, on both clocks."""
        part = self._parts[number]
        start = float((0.0 + part.prompt_s) - (host_s - before_s))
        moved_on = (part.ticks - before.last_ticks & 0xFFFFFFFF) * part.tick_ns / 1e9
        by_device = before_s + moved_on
        if self._begun_by[number] == "clock":
            by_sequence = before_s + max(part.index - before.last_index, 1) / self._rate_hz
            if abs(by_device - start) > abs(by_sequence - start):
                return by_sequence
            self._begun_by[number] = "paused"
            return by_device
        if self._begun_by[number] == "jumped" and moved_on > 0 and abs(by_device - start) < SAME_CLOCK_S:
            return by_device
        return max(start, before_s + 1 / self._rate_hz)


def _frames(
    stream: decode.Stream, first: int, end: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return sequence numbers, times and lengths of some frames, and before which of them the board restarted.

    An identification behind the last frame of the stream is one before what follows.
    """
    own = (stream.idents >= first) & ((stream.idents < end) | (end == len(stream.n)))
    return stream.seq[first:end], stream.ticks[first:end], stream.n[first:end], stream.idents[own] - first


_Unplaced = tuple[Samples, decode.Stream, int, TruthRows]


@dataclass(frozen=True)
class _Beside:
    """The last frame before a piece, which the truth at its beginning belongs to."""

    seq: int
    index: int
    part: int
    keep: bool


def assemble(streams: list[decode.Stream], rate_hz: float, tick_ns: int) -> Samples:
    """Set the samples of all connections on one time axis; at least one of them must hold samples.

    ``rate_hz`` is the nominal rate, Hz; ``tick_ns`` the tick of the device's clock, ns.
    """
    line = Timeline([[stream] for stream in streams], rate_hz, tick_ns)
    return replace(joined([piece.samples for piece in line]), repeated=line.repeated)


def parts_of(samples: Samples) -> Iterator[tuple[int, slice]]:
    """Yield each part's number and the slice of its samples."""
    cuts = np.flatnonzero(np.diff(samples.part)) + 1
    for start, stop in pairwise([0, *cuts.tolist(), len(samples)]):
        if stop > start:
            yield int(samples.part[start]), slice(start, stop)


def joined(pieces: Sequence[Samples]) -> Samples:
    """Return the samples of all pieces in order; those that have any have the same columns."""
    pieces = [piece for piece in pieces if len(piece)] or pieces[:1]
    return arrays.joined(pieces) if len(pieces) > 1 else pieces[0]


def sample_keys(part: NDArray[np.int64], index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one number for part and index: parts are few, and an index stays far below 2^48."""
    return np.asarray(part << 48 | index)


def _truth(
    stream: decode.Stream, order: counters.Order, part: NDArray[np.int64], before: _Beside | None
) -> tuple[TruthRows, _Beside | None]:
    """Return the rows of the exact motion, each placed by the sample frame before it; and the piece's last frame."""
    seq, index, keep = stream.seq, order.index, order.keep
    at = stream.truth_frame
    if before is not None:
        seq, index, part = (
            np.concatenate(([first], rest))
            for first, rest in ((before.seq, seq), (before.index, index), (before.part, part))
        )
        keep = np.concatenate(([before.keep], keep))
        at = at + 1
    last = before if len(seq) == 0 else _Beside(int(seq[-1]), int(index[-1]), int(part[-1]), bool(keep[-1]))
    beside = np.clip(at - 1, 0, None) if len(seq) else at[:0]
    offset = counters.signed(stream.truth_seq[: len(beside)] - seq[beside], 16)
    placed = keep[beside]
    key = sample_keys(part[beside][placed], (index[beside] + offset)[placed])
    return TruthRows(key, stream.truth[: len(beside)][placed]), last
