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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from daq.runfile.spill import Shelf, Spill
from daq.wire import counters, decode, frames
from stickslip.compute import arrays

# Seconds on either side of a gap in which the least delay is searched, over which clocks drift by 0.2 ms (100 ppm).
PLACE_S = 2.0
# A board's clock that advanced across a jump as the host's did, to within so much (a busy computer's), was not reset.
SAME_CLOCK_S = 0.1

PartReason = Literal["reopened", "restarted", "jumped", "clock", "paused"]


@dataclass(frozen=True)
class Samples:
    """Samples in order of time, n of them."""

    time: NDArray[np.float64]  # (n,) seconds since the first one, increasing
    part: NDArray[np.int64]  # (n,) which part, from 0
    # the start of each part: a port that came back (the first part, too), a restart that the board announced, a jump of
    # the sequence number, a leap of the clock, or a pause of the board.  The sequence continues in the last two, and
    # the last one begins no segment.
    begun_by: tuple[PartReason, ...]
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
    # (n,) number of its identification in `Timeline.idents`; None: there is only one
    source: NDArray[np.int64] | None = None
    # samples dropped because their time did not advance: repeated, late, or stamped wrongly by the board
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
    """Some samples of a run, k of them, and their frames."""

    samples: Samples  # of whole frames
    stream: decode.Stream  # all frames of the piece, those without a sample too
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
    prompt_s: float  # host's clock less the device's time since the first sample, the least of the first seconds
    start_s: float = 0.0  # time of its first sample in the run


class Timeline:
    """The samples of all connections on one time axis, piece by piece, each time it is iterated over.

    connections: The pieces of each connection (`daq.finalise.connections`); each is iterated over several times.
    rate_hz: Nominal rate, Hz.
    tick_ns: Tick of the clock of a device that has not identified itself, ns.
    most: Sample periods from the start of the run after which samples are dropped.
    spill: Storage of the rows of the exact motion.
    idents: The identifications that samples were sent under, each once, in the order of their first samples; None: the
        board did not identify itself.
    truth: The exact motion.
    times_bytes: Whether the recorder knows the length of the frames on the line.
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
        self._has_column = dict.fromkeys(("belt", "edge", "time_error"), True)
        for orders, connection in zip(self._orders, connections, strict=True):
            source = -1
            for stream in connection:
                for first, end, ident in stream.split_by_ident():
                    if first < end and self._number_ident(ident) != source:
                        source = self._number_ident(ident)
                        orders.append(counters.FrameOrder(1e9 / (rate_hz * self._tick_of(source))))
                    if orders:
                        orders[-1].survey(*_select_frames(stream, first, end))
                self.times_bytes = self.times_bytes or bool(stream.length.any())
                for name in self._has_column:
                    self._has_column[name] &= not len(stream.n) or getattr(stream, name) is not None
        self._parts: dict[int, _Part] = {}
        self._single_piece: _OrderedPiece | None = None
        for number, ordered in enumerate(self._order_pieces(learning=True)):
            samples, _, _, truth = ordered
            self._single_piece = None if number else ordered
            if len(truth.key):
                self.truth.append(truth)
            for part, span in split_parts(samples):
                self._learn(part, samples, span)
        if len(self._parts) > 1:
            self._set_starts()

    def __iter__(self) -> Iterator[Piece]:
        repeated = 0
        newest_s = -np.inf
        part, offset = 0, 0
        for samples, stream, before, _ in [self._single_piece] if self._single_piece else self._order_pieces():
            repeated += int(stream.n.sum()) - len(samples)
            samples = replace(samples, time=self._compute_times(samples), begun_by=tuple(self._begun_by))
            if len(samples):
                advances = samples.time > np.maximum.accumulate(np.concatenate(([newest_s], samples.time)))[:-1]
                newest_s = max(newest_s, float(samples.time.max()))
                if not advances.all():
                    repeated += int(np.count_nonzero(~advances))
                    samples = samples.take(advances)
            place = samples.index.copy()
            for number, span in split_parts(samples):
                if number != part:
                    part, offset = number, round(float(samples.time[span.start]) * self._rate_hz)
                    if self._begun_by[number] in ("clock", "paused"):
                        offset -= int(samples.index[span.start])
                place[span] += offset
            if self._most is not None and len(place) and place.max() >= self._most:
                samples, place = samples.take(place < self._most), place[place < self._most]
            self.repeated = repeated
            yield Piece(samples, stream, before, place)

    def _order_pieces(self, learning: bool = False) -> Iterator["_OrderedPiece"]:
        """Yield the samples of each piece, without times, its frames, how many frames came before, its exact motion."""
        before = 0
        last_part = -1
        for orders, connection in zip(self._orders, self._connections, strict=True):
            for order in orders:
                order.rewind()
            last_frame: _LastFrame | None = None
            order_number, ident_number = -1, -1
            for stream in connection:
                placed_frames: list[counters.Order] = []
                source = np.zeros(len(stream.n), dtype=np.int64)
                for first, end, ident in stream.split_by_ident():
                    new_source = first < end and self._number_ident(ident) != ident_number
                    if new_source:
                        order_number, ident_number = order_number + 1, self._number_ident(ident)
                    source[first:end] = max(ident_number, 0)
                    order = orders[order_number] if order_number >= 0 else counters.FrameOrder(1.0)
                    placed_frames.append(order.place(*_select_frames(stream, first, end)))
                    if new_source and (first or last_frame is not None):
                        placed_frames[-1].restart[0] = True
                placed = arrays.joined(placed_frames)
                if last_frame is None and len(stream.n):
                    last_part += 1
                    if learning:
                        self._begun_by.append("reopened")
                begins = placed.restart | placed.leap
                part = last_part + np.cumsum(begins)
                if learning:
                    for leap, jump in zip(placed.leap[begins].tolist(), placed.jump[begins].tolist(), strict=True):
                        self._begun_by.append("clock" if leap else "jumped" if jump else "restarted")
                truth, last_frame = _place_truth(stream, placed, part, last_frame)
                yield self._build_samples(stream, placed, part, source, before), stream, before, truth
                before += len(stream.n)
                last_part = int(part[-1]) if len(part) else last_part

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
        """Return the samples of the frames that are kept, their times still to be set."""
        frame = np.repeat(np.arange(len(stream.n)), stream.n)
        sample_in_frame = np.arange(len(frame)) - stream.first[frame]
        elapsed = np.cumsum(stream.dt, dtype=np.int64)
        time_error = stream.time_error if self._has_column["time_error"] else None
        samples = Samples(
            time=np.zeros(len(frame)),
            part=part[frame],
            begun_by=tuple(self._begun_by),
            index=order.index[frame] + sample_in_frame,
            ticks=order.ticks[frame] + elapsed - elapsed[stream.first[frame]],
            frame=before + frame,
            stamp_ns=stream.stamp_ns[frame],
            up=stream.up,
            down=stream.down,
            status=stream.status,
            illegal=stream.illegal[frame].astype(np.uint16),
            belt=stream.belt if self._has_column["belt"] else None,
            edge=stream.edge if self._has_column["edge"] else None,
            time_error=None if time_error is None else time_error[frame],
            source=source[frame] if len(self.idents) > 1 else None,
        )
        return samples if np.all(order.keep) else samples.take(order.keep[frame])

    def _learn(self, number: int, samples: Samples, span: slice) -> None:
        """Update a part with its next samples."""
        if number not in self._parts:
            first = int(samples.ticks[span.start]), int(samples.index[span.start])
            tick_ns = self._tick_of(0 if samples.source is None else int(samples.source[span.start]))
            self._parts[number] = _Part(first[0], 0, first[1], 0, tick_ns, np.inf)
        part = self._parts[number]
        part.last_ticks, part.last_index = int(samples.ticks[span.stop - 1]), int(samples.index[span.stop - 1])
        device = self._device_s(samples, span, part)
        at_start = np.abs(device) <= PLACE_S
        # Only a frame's last sample was taken right before the frame arrived; the least difference is of such a one.
        part.prompt_s = float(np.min(samples.stamp_ns[span][at_start] / 1e9 - device[at_start], initial=part.prompt_s))

    def _device_s(self, samples: Samples, span: slice, part: _Part) -> NDArray[np.float64]:
        return np.asarray((samples.ticks[span] - part.ticks) * part.tick_ns / 1e9)

    def _compute_times(self, samples: Samples) -> NDArray[np.float64]:
        time = np.zeros(len(samples))
        for number, span in split_parts(samples):
            part = self._parts[number]
            time[span] = part.start_s + self._device_s(samples, span, part)
        return time

    def _set_starts(self) -> None:
        """Place every part after the first: by the host's clock, with the least delay on both sides of the gap."""
        previous, delay_s = 0, np.inf  # the part, and the host's clock less its time, the least of its last seconds
        for samples, _, _, _ in self._order_pieces():
            for number, span in split_parts(samples):
                part, last = self._parts[number], self._parts[previous]
                end_s = last.start_s + (last.last_ticks - last.ticks) * last.tick_ns / 1e9
                if number != previous:
                    part.start_s = self._find_start(number, end_s, float(end_s + delay_s), last)
                    previous, delay_s = number, np.inf
                time = part.start_s + self._device_s(samples, span, part)
                last_s = part.start_s + (part.last_ticks - part.ticks) * part.tick_ns / 1e9
                at_end = np.abs(time - last_s) <= PLACE_S
                delay_s = float(np.min(samples.stamp_ns[span][at_end] / 1e9 - time[at_end], initial=delay_s))

    def _find_start(self, number: int, end_s: float, end_host_s: float, previous: _Part) -> float:
        """Return the time of a part's first sample, from the previous part's end on the run's and the host's clock."""
        part = self._parts[number]
        start = float((0.0 + part.prompt_s) - (end_host_s - end_s))
        advanced_s = (part.ticks - previous.last_ticks & 0xFFFFFFFF) * part.tick_ns / 1e9
        by_device = end_s + advanced_s
        if self._begun_by[number] == "clock":
            by_sequence = end_s + max(part.index - previous.last_index, 1) / self._rate_hz
            if abs(by_device - start) > abs(by_sequence - start):
                return by_sequence
            self._begun_by[number] = "paused"
            return by_device
        if self._begun_by[number] == "jumped" and advanced_s > 0 and abs(by_device - start) < SAME_CLOCK_S:
            return by_device
        return max(start, end_s + 1 / self._rate_hz)


def _select_frames(
    stream: decode.Stream, first: int, end: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return sequence numbers, times and lengths of some frames, and before which of them the board restarted.

    An identification after the last frame of the stream precedes what follows.
    """
    in_range = (stream.idents >= first) & ((stream.idents < end) | (end == len(stream.n)))
    return stream.seq[first:end], stream.ticks[first:end], stream.n[first:end], stream.idents[in_range] - first


_OrderedPiece = tuple[Samples, decode.Stream, int, TruthRows]


@dataclass(frozen=True)
class _LastFrame:
    """The last frame before a piece, to which the truth at its beginning belongs."""

    seq: int
    index: int
    part: int
    keep: bool


def assemble(streams: list[decode.Stream], rate_hz: float, tick_ns: int) -> Samples:
    """Place the samples of all connections on one time axis; at least one of them must have samples.

    ``rate_hz`` is the nominal rate, Hz; ``tick_ns`` the tick of the device's clock, ns.
    """
    line = Timeline([[stream] for stream in streams], rate_hz, tick_ns)
    return replace(join([piece.samples for piece in line]), repeated=line.repeated)


def split_parts(samples: Samples) -> Iterator[tuple[int, slice]]:
    """Yield each part's number and the slice of its samples."""
    cuts = np.flatnonzero(np.diff(samples.part)) + 1
    for start, stop in pairwise([0, *cuts.tolist(), len(samples)]):
        if stop > start:
            yield int(samples.part[start]), slice(start, stop)


def join(pieces: Sequence[Samples]) -> Samples:
    """Return the samples of all pieces in order; those that are not empty have the same columns."""
    pieces = [piece for piece in pieces if len(piece)] or pieces[:1]
    return arrays.joined(pieces) if len(pieces) > 1 else pieces[0]


def sample_keys(part: NDArray[np.int64], index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one number for part and index: parts are few, and an index stays far below 2^48."""
    return np.asarray(part << 48 | index)


def _place_truth(
    stream: decode.Stream, order: counters.Order, part: NDArray[np.int64], last_frame: _LastFrame | None
) -> tuple[TruthRows, _LastFrame | None]:
    """Return the rows of the exact motion, each placed by the sample frame before it; and the piece's last frame."""
    seq, index, keep = stream.seq, order.index, order.keep
    frame = stream.truth_frame
    if last_frame is not None:
        seq, index, part = (
            np.concatenate(([first], rest))
            for first, rest in ((last_frame.seq, seq), (last_frame.index, index), (last_frame.part, part))
        )
        keep = np.concatenate(([last_frame.keep], keep))
        frame = frame + 1
    last_of_piece = (
        last_frame if len(seq) == 0 else _LastFrame(int(seq[-1]), int(index[-1]), int(part[-1]), bool(keep[-1]))
    )
    before_row = np.clip(frame - 1, 0, None) if len(seq) else frame[:0]
    offset = counters.wrap_signed(stream.truth_seq[: len(before_row)] - seq[before_row], 16)
    placed = keep[before_row]
    key = sample_keys(part[before_row][placed], (index[before_row] + offset)[placed])
    return TruthRows(key, stream.truth[: len(before_row)][placed]), last_of_piece
