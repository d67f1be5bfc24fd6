"""From a journal to one sequence of samples: connections decoded, frames ordered, parts set on one time axis.

A part is the samples after one start of the board: it ends where the port was lost, where the board restarted, or where
its sequence numbers jump relative to its clock.  The next one begins with its own sequence numbers and device time, and
in the units of the identification it was sent under.  The device's clock is the time axis.  A later part is placed on
it by the host's clock, with the least delay of the last seconds before and the first seconds after the gap; after a
jump that does not affect the device's clock, by the device's clock.

Where the clock alone leaps while the sequence continues, the host's clock decides between the two.  Nearer to the
device's time: the board has paused, and its clock is right.  Nearer to the sequence: its clock has leapt, and the part
that begins there is placed by the sequence.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.wire import counters, decode, frames
from stickslip.compute import arrays

# Seconds on either side of a gap in which the least delay is searched, over which clocks drift by 0.2 ms (100 ppm).
PLACE_S = 2.0
# A board's clock that advanced across a jump as the host's did, to within so much (a busy computer's), was not reset.
SAME_CLOCK_S = 0.1

OPTIONAL = ("belt", "edge", "time_error", "truth")  # columns that a board need not send

PartReason = Literal["reopened", "restarted", "jumped", "clock", "paused"]


def make_empty() -> NDArray[np.int64]:
    return np.empty(0, np.int64)


@dataclass(frozen=True)
class Samples:
    """Samples in order of time, n of them."""

    time: NDArray[np.float64]  # (n,) seconds since the first one, increasing
    part: NDArray[np.int64]  # (n,) which part, from 0
    # the start of each part: a port that came back (the first part, too), a restart that the board announced, a jump of
    # the sequence number, a leap of the clock, or a pause of the board.  The sequence continues in the last two, and
    # the last one begins no segment.
    begun_by: Sequence[PartReason]
    index: NDArray[np.int64]  # (n,) sequence number and device time without roll-over, in the board's units
    ticks: NDArray[np.int64]
    # (n,) number of its frame over all connections, frames without a sample included
    frame: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]  # (n,) host's monotonic clock when that frame was complete
    # as sent (`daq.wire.decode.Stream`), the illegal count repeated over its frame
    up: NDArray[np.uint16] | NDArray[np.uint32]
    down: NDArray[np.uint16] | NDArray[np.uint32]
    status: NDArray[np.uint8]
    illegal: NDArray[np.uint16]
    belt: NDArray[np.uint16] | None
    edge: NDArray[np.uint16] | None
    # (n,) the time as sent less ``ticks``; None where no time is interpolated
    time_error: NDArray[np.int64] | None = None
    truth: NDArray[np.float64] | None = None  # (n, 4) the exact motion (`daq.wire.decode.Stream`)
    # (n,) number of its identification in `Timeline.idents`
    source: NDArray[np.int64] = field(default_factory=make_empty)
    # (n,) sample periods from the start of the run, lost samples and gaps included
    place: NDArray[np.int64] = field(default_factory=make_empty)

    def __len__(self) -> int:
        return len(self.time)

    def take(self, where: NDArray[np.bool_]) -> "Samples":
        """Return the samples for which ``where``, (n,), is True."""
        return arrays.rows(self, where)


@dataclass(frozen=True)
class Frames:
    """The frames of a piece, f of them, those without a sample too."""

    first: int  # number of the first one, over all connections
    length: NDArray[np.int64]  # (f,); and the others as of `daq.wire.decode.Stream`
    crc_frame: NDArray[np.int64]
    part_stamp_ns: NDArray[np.int64] = field(default_factory=make_empty)
    part_frame: NDArray[np.int64] = field(default_factory=make_empty)
    part_bytes: NDArray[np.int64] = field(default_factory=make_empty)
    notices: tuple[tuple[int, str], ...] = ()
    unknown: int = 0


class Piece(NamedTuple):
    """Some samples of a run, of whole frames, and these frames."""

    samples: Samples
    frames: Frames


@dataclass
class _Part:
    """A part, as far as it has come, and its place on the time axis."""

    number: int
    ticks: int  # device time of its first and last sample
    last_ticks: int
    index: int  # their sequence numbers
    last_index: int
    tick_ns: int  # tick of the device's clock, ns
    prompt_s: float  # host's clock less the device's time since the first sample, the least of the first seconds
    start_s: float = 0.0  # time of its first sample in the run
    # device time and host's stamp of its last seconds
    end_ticks: NDArray[np.int64] = field(default_factory=make_empty)
    end_ns: NDArray[np.int64] = field(default_factory=make_empty)

    def measure_s(self, ticks: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return device times as seconds since the part's first sample."""
        return np.asarray((ticks - self.ticks) * self.tick_ns / 1e9)

    def extend(self, ticks: NDArray[np.int64], index: int, stamp_ns: NDArray[np.int64]) -> None:
        """Add its next samples, the last of which has this sequence number."""
        self.last_ticks, self.last_index = int(ticks[-1]), index
        device = self.measure_s(ticks)
        at_start = np.abs(device) <= PLACE_S
        # Only a frame's last sample was taken right before the frame arrived; the least difference is of such a one.
        self.prompt_s = float(np.min(stamp_ns[at_start] / 1e9 - device[at_start], initial=self.prompt_s))
        ticks, stamp_ns = np.concatenate((self.end_ticks, ticks)), np.concatenate((self.end_ns, stamp_ns))
        near_end = np.abs(ticks - self.last_ticks) * self.tick_ns <= 2e9 * PLACE_S
        self.end_ticks, self.end_ns = ticks[near_end], stamp_ns[near_end]

    def find_end(self) -> tuple[float, float]:
        """Return the time of its last sample, and the host's clock then: with the least delay of its last seconds."""
        end_s = self.start_s + (self.last_ticks - self.ticks) * self.tick_ns / 1e9
        time = self.start_s + self.measure_s(self.end_ticks)
        at_end = np.abs(time - end_s) <= PLACE_S
        delay_s = float(np.min(self.end_ns[at_end] / 1e9 - time[at_end], initial=np.inf))
        return end_s, float(end_s + delay_s)


class Timeline:
    """The samples of all connections on one time axis, in one pass, piece by piece.

    A piece is held back until the first seconds of its parts have come, which place them.

    connections: The pieces of each connection (`daq.stream.connections`).
    rate_hz: Nominal rate, Hz.
    tick_ns: Tick of the clock of a device that has not identified itself, ns.
    most: Sample periods from the start of the run after which samples are dropped.

    Of the pieces so far:

    idents: The identifications that samples were sent under, each once, in the order of their first samples; None: the
        board did not identify itself.
    ident: The board's first identification.
    configs: The calibrations that the boards sent.
    times_bytes: Whether the recorder knows the length of the frames on the line.
    repeated: Samples left out because their time did not advance: repeated, late, or stamped wrongly by the board.
    missing: Optional columns that not all frames have.
    lengths: Samples in each part.
    """

    def __init__(
        self,
        connections: Iterable[Iterable[decode.Stream]],
        rate_hz: float,
        tick_ns: int,
        most: int | None = None,
    ) -> None:
        self.times_bytes = False
        self.repeated = 0
        self.idents: list[frames.Ident | None] = []
        self.ident: frames.Ident | None = None
        self.configs: list[str] = []
        self.missing: set[str] = set()
        self.lengths: dict[int, int] = {}
        self._connections = connections
        self._rate_hz, self._tick_ns, self._most = rate_hz, tick_ns, most
        self._begun_by: list[PartReason] = []
        self._parts: dict[int, _Part] = {}
        self._placed: _Part | None = None  # the last part whose place is known
        self._newest: _Part | None = None

    def __iter__(self) -> Iterator[Piece]:
        newest_s = -np.inf
        part, offset = 0, 0
        for samples, stream, before in self._place_parts():
            self.repeated += int(stream.n.sum()) - len(samples)
            samples = replace(samples, time=self._compute_times(samples))
            if len(samples):
                advances = samples.time > np.maximum.accumulate(np.concatenate(([newest_s], samples.time)))[:-1]
                newest_s = max(newest_s, float(samples.time.max()))
                if not advances.all():
                    self.repeated += int(np.count_nonzero(~advances))
                    samples = samples.take(advances)
            for number, span in split_parts(samples):
                if number != part:
                    part, offset = number, round(float(samples.time[span.start]) * self._rate_hz)
                    if self._begun_by[number] in ("clock", "paused"):
                        offset -= int(samples.index[span.start])
                samples.place[span] += offset
            if self._most is not None and samples.place.max(initial=0) >= self._most:
                samples = samples.take(samples.place < self._most)
            for number, span in split_parts(samples):
                self.lengths[number] = self.lengths.get(number, 0) + span.stop - span.start
            cut = stream.part_stamp_ns, stream.part_frame, stream.part_bytes
            sent = Frames(before, stream.length, stream.crc_frame, *cut, stream.notices, stream.unknown)
            yield Piece(samples, sent)

    def _place_parts(self) -> "Iterator[_OrderedPiece]":
        """Yield the ordered pieces, each once the places of its parts are known."""
        waiting: deque[_OrderedPiece] = deque()
        for ordered in self._order_pieces():
            waiting.append(ordered)
            samples = ordered[0]
            for number, span in split_parts(samples):
                if self._newest is None or number != self._newest.number:
                    self._find_place()
                    tick_ns = self._tick_of(int(samples.source[span.start]))
                    ticks, index = int(samples.ticks[span.start]), int(samples.index[span.start])
                    self._newest = self._parts[number] = _Part(number, ticks, 0, index, 0, tick_ns, np.inf)
                last = span.stop - 1
                self._newest.extend(samples.ticks[span], int(samples.index[last]), samples.stamp_ns[span])
            newest = self._newest
            # A frame may reach beyond the start of the next one, so a time may still go back a little.
            if newest and (newest.last_ticks - newest.ticks) * newest.tick_ns > 2e9 * PLACE_S:
                self._find_place()
            while waiting and (self._placed is self._newest or not self._is_newest(waiting[0])):
                yield waiting.popleft()
        self._find_place()
        yield from waiting

    def _is_newest(self, ordered: "_OrderedPiece") -> bool:
        part = ordered[0].part
        return len(part) > 0 and self._newest is not None and int(part[-1]) == self._newest.number

    def _order_pieces(self) -> "Iterator[_OrderedPiece]":
        """Yield the samples of each piece, without times, its frames, and how many frames came before."""
        before = 0
        last_part = -1
        for connection in self._connections:
            begun = False  # a frame of the connection has come
            order, ident_number = counters.FrameOrder(1.0), -1
            for stream in connection:
                self._note_stream(stream)
                placed_frames: list[counters.Order] = []
                source = np.zeros(len(stream.n), dtype=np.int64)
                for first, end, ident in stream.split_by_ident():
                    new_source = first < end and self._number_ident(ident) != ident_number
                    if new_source:
                        ident_number = self._number_ident(ident)
                        order = counters.FrameOrder(1e9 / (self._rate_hz * self._tick_of(ident_number)))
                    source[first:end] = max(ident_number, 0)
                    # An identification after the last frame of the stream precedes what follows.
                    within = (stream.idents >= first) & ((stream.idents < end) | (end == len(stream.n)))
                    sent = stream.seq[first:end], stream.ticks[first:end], stream.n[first:end]
                    placed_frames.append(order.place(*sent, stream.idents[within] - first))
                    if new_source and (first or begun):
                        placed_frames[-1].restart[0] = True
                placed = arrays.joined(placed_frames)
                if not begun and len(stream.n):
                    begun = True
                    last_part += 1
                    self._begun_by.append("reopened")
                begins = placed.restart | placed.leap
                part = last_part + np.cumsum(begins)
                for leap, jump in zip(placed.leap[begins].tolist(), placed.jump[begins].tolist(), strict=True):
                    self._begun_by.append("clock" if leap else "jumped" if jump else "restarted")
                yield self._build_samples(stream, placed, part, source, before), stream, before
                before += len(stream.n)
                last_part = int(part[-1]) if len(part) else last_part

    def _note_stream(self, stream: decode.Stream) -> None:
        self.ident = self.ident or stream.ident
        self.configs += [text for _, text in stream.configs]
        self.times_bytes = self.times_bytes or bool(stream.length.any())
        self.missing |= {name for name in OPTIONAL if len(stream.n) and getattr(stream, name) is None}

    def _number_ident(self, ident: frames.Ident | None) -> int:
        """Return the number of an identification, regardless of its number of samples in a frame."""
        same = None if ident is None else replace(ident, block_size=1)
        if same not in self.idents:
            self.idents.append(same)
        return self.idents.index(same)

    def _tick_of(self, source: int) -> int:
        ident = self.idents[source]
        return self._tick_ns if ident is None else ident.tick_ns

    def _build_samples(
        self,
        stream: decode.Stream,
        order: counters.Order,
        part: NDArray[np.int64],
        source: NDArray[np.int64],
        before: int,
    ) -> Samples:
        """Return the samples of the frames that are kept, their times and places still to be set."""
        frame = np.repeat(np.arange(len(stream.n)), stream.n)
        sample_in_frame = np.arange(len(frame)) - stream.first[frame]
        elapsed = np.cumsum(stream.dt, dtype=np.int64)
        index = order.index[frame] + sample_in_frame
        samples = Samples(
            time=np.zeros(len(frame)),
            part=part[frame],
            begun_by=self._begun_by,
            index=index,
            ticks=order.ticks[frame] + elapsed - elapsed[stream.first[frame]],
            frame=before + frame,
            stamp_ns=stream.stamp_ns[frame],
            up=stream.up,
            down=stream.down,
            status=stream.status,
            illegal=stream.illegal[frame].astype(np.uint16),
            belt=stream.belt,
            edge=stream.edge,
            time_error=None if stream.time_error is None else stream.time_error[frame],
            truth=stream.truth,
            source=source[frame],
            place=index.copy(),
        )
        return samples if np.all(order.keep) else samples.take(order.keep[frame])

    def _compute_times(self, samples: Samples) -> NDArray[np.float64]:
        time = np.zeros(len(samples))
        for number, span in split_parts(samples):
            part = self._parts[number]
            time[span] = part.start_s + part.measure_s(samples.ticks[span])
        return time

    def _find_place(self) -> None:
        """Place the newest part: by the host's clock, with the least delay on both sides of the gap before it."""
        part, previous = self._newest, self._placed
        if part is None or part is previous:
            return
        self._placed = part
        if previous is None:
            return
        end_s, end_host_s = previous.find_end()
        previous.end_ticks = previous.end_ns = previous.end_ticks[:0]
        start = part.prompt_s - (end_host_s - end_s)
        advanced_s = (part.ticks - previous.last_ticks & 0xFFFFFFFF) * part.tick_ns / 1e9
        by_device = end_s + advanced_s
        begun_by = self._begun_by[part.number]
        if begun_by == "clock":
            by_sequence = end_s + max(part.index - previous.last_index, 1) / self._rate_hz
            if abs(by_device - start) > abs(by_sequence - start):
                part.start_s = by_sequence
            else:
                self._begun_by[part.number], part.start_s = "paused", by_device
        elif begun_by == "jumped" and advanced_s > 0 and abs(by_device - start) < SAME_CLOCK_S:
            part.start_s = by_device
        else:
            part.start_s = max(start, end_s + 1 / self._rate_hz)


_OrderedPiece = tuple[Samples, decode.Stream, int]


def split_parts(samples: Samples) -> Iterator[tuple[int, slice]]:
    """Yield each part's number and the slice of its samples."""
    cuts = np.flatnonzero(np.diff(samples.part)) + 1
    for start, stop in pairwise([0, *cuts.tolist(), len(samples)]):
        if stop > start:
            yield int(samples.part[start]), slice(start, stop)


def join(pieces: Sequence[Samples]) -> Samples:
    """Return the samples of all pieces in order, with the columns that all of those with a sample have."""
    pieces = [piece for piece in pieces if len(piece)] or pieces[:1]
    missing = [name for name in OPTIONAL if any(getattr(piece, name) is None for piece in pieces)]
    return arrays.joined([drop_columns(piece, missing) for piece in pieces]) if len(pieces) > 1 else pieces[0]


def drop_columns(samples: Samples, names: Iterable[str]) -> Samples:
    none: dict[str, Any] = dict.fromkeys(names)
    return replace(samples, **none)
