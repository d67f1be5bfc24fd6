"""From a journal to one sequence of samples: connections decoded, frames ordered, parts set on one time axis.

A part holds the samples after one start of the board: it ends where the port was lost, where the board restarted, or
where its sequence numbers jump against its clock.  The next one begins with its own sequence numbers and device time.
The device's clock is the time axis.  A later part is placed on it by the host's clock, with the least delay of the last
seconds before and the first seconds after the gap; after a jump that the device's clock does not take part in, by that.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from daq import protocols
from daq.runfile import journal
from daq.wire import counters, decode
from daq.wire import frames as wire

# Seconds on either side of a gap in which the least delay is searched.  Half finds fewer undelayed reads; double lets
# the drift of the clocks (100 ppm) add 0.2 ms more to the placement.  Not swept.
PLACE_S = 2.0
COUNTER_BITS, TICK_NS = 16, 1000  # of the project's firmware, where a journal's identification cannot be true
# A board's clock that moved on across a jump as the host's did, to within so much, has not been reset.  Half refuses it
# on a busy computer; double believes a clock that was reset to within as much more.  Not swept.
SAME_CLOCK_S = 0.1

PartReason = Literal["reopened", "restarted", "jumped"]


@dataclass(frozen=True)
class Samples:
    """Samples in order of time, n of them.

    Attributes
    ----------
    time : (n,) float64
        Seconds since the first one, increasing.
    part : (n,) int64
        Which part, from 0.
    begun_by : tuple of PartReason
        What began each part: a port that came back (the first part, too), a restart of the board that it announced, or
        a sequence number that does not follow.
    index, ticks : (n,) int64
        Sequence number and device time without roll-over, in the board's units.
    frame : (n,) int64
        Which frame it came in, counted over all connections; frames that gave no sample are counted, too.
    stamp_ns : (n,) int64
        Host's monotonic clock when that frame had come in.
    time_error : (n,) int64 or None
        The time as sent less ``ticks``; None where no time is interpolated.
    up, down, status, illegal, belt, edge
        As sent (`daq.wire.decode.Stream`), the illegal count repeated over its frame.
    repeated : int
        Samples left out because their time did not advance: repeated, late, or stamped wrongly by the board.
    """

    time: NDArray[np.float64]
    part: NDArray[np.int64]
    begun_by: tuple[PartReason, ...]
    index: NDArray[np.int64]
    ticks: NDArray[np.int64]
    frame: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    up: NDArray[np.uint16] | NDArray[np.uint32]
    down: NDArray[np.uint16] | NDArray[np.uint32]
    status: NDArray[np.uint8]
    illegal: NDArray[np.uint16]
    belt: NDArray[np.uint16] | None
    edge: NDArray[np.uint16] | None
    time_error: NDArray[np.int64] | None = None
    repeated: int = 0

    def __len__(self) -> int:
        return len(self.time)

    def take(self, where: NDArray[np.bool_]) -> "Samples":
        """Return the samples for which ``where``, (n,), is True."""
        chosen: dict[str, Any] = {}
        for field in fields(self):
            column = getattr(self, field.name)
            if isinstance(column, np.ndarray):
                chosen[field.name] = column[where]
        return replace(self, **chosen)


@dataclass(frozen=True)
class TruthRows:
    """Rows of the exact motion as sent: part and sequence number, (m,); time, x, v, F in s, m, m/s, N, (m, 4)."""

    part: NDArray[np.int64]
    index: NDArray[np.int64]
    rows: NDArray[np.float64]


def connections(taken: journal.Journal) -> list[decode.Stream]:
    """Return the decoded stream of each connection: a new one begins where the port was reopened.

    Raises
    ------
    InputError
        The journal is in a protocol that this version does not know.
    """
    backend = protocols.load(taken.header["protocol"], str(taken.path))
    reads: list[list[tuple[int, bytes]]] = [[]]
    for record in taken.records:
        if record.kind == journal.REOPENED:
            reads.append([])
        elif record.kind == journal.RECEIVED:
            reads[-1].append((record.stamp_ns, record.data))
    return [backend.decode(part, taken.header) for part in reads]


def assemble(streams: list[decode.Stream], rate_hz: float, tick_ns: int) -> tuple[Samples, TruthRows]:
    """Set the samples of all connections on one time axis; at least one of them must hold samples.

    ``rate_hz`` is the nominal rate, Hz; ``tick_ns`` the tick of the device's clock, ns.
    """
    ticks_per_sample = 1e9 / (rate_hz * tick_ns)
    flat: list[Samples] = []
    truths: list[TruthRows] = []
    parts = 0
    frames = 0
    begun_by: list[PartReason] = []
    late = 0
    for connection in streams:
        order = counters.order_frames(
            connection.seq, connection.ticks, connection.n, ticks_per_sample, connection.idents
        )
        part = parts + np.cumsum(order.restart)
        if len(part):
            flat.append(_samples(connection, order, part, frames))
            truths.append(_truth(connection, order, part))
            jumps = order.jump[order.restart].tolist()
            begun_by += ["reopened", *("jumped" if jump else "restarted" for jump in jumps)]
            parts = len(begun_by)
        late += int(connection.n[~order.keep].sum())
        frames += len(connection.n)
    samples = _joined(flat, tuple(begun_by))
    samples = replace(samples, time=_times(samples, rate_hz, tick_ns))
    advances = np.ones(len(samples), dtype=np.bool_)
    advances[1:] = samples.time[1:] > np.maximum.accumulate(samples.time)[:-1]
    late += int(np.count_nonzero(~advances))
    return replace(samples.take(advances) if late else samples, repeated=late), _joined_truth(truths)


def run_index(samples: Samples, rate_hz: float) -> NDArray[np.int64]:
    """Return the sample periods from the start of the run to each sample, (n,), lost samples and gaps included."""
    place = samples.index.copy()
    for part, first in parts_of(samples):
        if part > 0:
            place[first] += round(float(samples.time[first.start]) * rate_hz)
    return place


def parts_of(samples: Samples) -> Iterator[tuple[int, slice]]:
    """Yield each part's number and the slice of its samples."""
    cuts = np.flatnonzero(np.diff(samples.part)) + 1
    edges = [0, *cuts.tolist(), len(samples)]
    for k, start in enumerate(edges[:-1]):
        if edges[k + 1] > start:
            yield int(samples.part[start]), slice(start, edges[k + 1])


def _samples(stream: decode.Stream, order: counters.Order, part: NDArray[np.int64], frames: int) -> Samples:
    """Return the samples of the frames that are kept, their times still to be set."""
    frame = np.repeat(np.arange(len(stream.n)), stream.n)
    within = np.arange(len(frame)) - stream.first[frame]
    elapsed = np.cumsum(stream.dt, dtype=np.int64)
    made = Samples(
        time=np.zeros(len(frame)),
        part=part[frame],
        begun_by=(),
        index=order.index[frame] + within,
        ticks=order.ticks[frame] + elapsed - elapsed[stream.first[frame]],
        frame=frames + frame,
        stamp_ns=stream.stamp_ns[frame],
        up=stream.up,
        down=stream.down,
        status=stream.status,
        illegal=stream.illegal[frame].astype(np.uint16),
        belt=stream.belt,
        edge=stream.edge,
        time_error=None if stream.time_error is None else stream.time_error[frame],
    )
    return made if np.all(order.keep) else made.take(order.keep[frame])


def _joined(flat: list[Samples], begun_by: tuple[PartReason, ...]) -> Samples:
    """Return the samples of all connections in order; an optional column is kept only when all have it."""
    columns: dict[str, Any] = {}
    for field in fields(Samples):
        pieces = [getattr(piece, field.name) for piece in flat]
        if field.name not in ("begun_by", "repeated"):
            whole = all(isinstance(piece, np.ndarray) for piece in pieces)
            columns[field.name] = np.concatenate(pieces) if whole else None
    return Samples(begun_by=begun_by, **columns)


def _times(samples: Samples, rate_hz: float, tick_ns: int) -> NDArray[np.float64]:
    """Return the time axis: device time in the first part, later parts placed after it by the host's clock."""
    time = np.zeros(len(samples))
    before: slice | None = None
    for part, here in parts_of(samples):
        device = (samples.ticks[here] - samples.ticks[here.start]) * tick_ns / 1e9
        start = 0.0
        if before is not None:
            gone = _host_at(samples, before, time[before], last=True) - time[before.stop - 1]
            back = _host_at(samples, here, device, last=False)
            start = float(back - gone)
            moved_on = (int(samples.ticks[here.start] - samples.ticks[before.stop - 1]) & 0xFFFFFFFF) * tick_ns / 1e9
            by_device = float(time[before.stop - 1]) + moved_on
            if samples.begun_by[part] == "jumped" and moved_on > 0 and abs(by_device - start) < SAME_CLOCK_S:
                start = by_device
            else:
                start = max(start, float(time[before.stop - 1]) + 1 / rate_hz)
        time[here] = start + device
        before = here
    return time


def _host_at(samples: Samples, here: slice, device: NDArray[np.float64], last: bool) -> float:
    """Return the host's clock (s) at a part's last or first sample, by the least delay of the seconds beside it."""
    stamps = samples.stamp_ns[here] / 1e9
    at = float(device[-1] if last else device[0])
    near = np.abs(device - at) <= PLACE_S
    # Only a frame's last sample was taken right before the frame came in; the least difference finds such a one.
    return at + float(np.min(stamps[near] - device[near]))


def _truth(stream: decode.Stream, order: counters.Order, part: NDArray[np.int64]) -> TruthRows:
    """Return the rows of the exact motion, each placed by the sample frame before it."""
    beside = np.clip(stream.truth_frame - 1, 0, None)
    offset = (stream.truth_seq - stream.seq[beside] + 0x8000 & 0xFFFF) - 0x8000
    placed = order.keep[beside]
    return TruthRows(part[beside][placed], (order.index[beside] + offset)[placed], stream.truth[placed])


def _joined_truth(truths: list[TruthRows]) -> TruthRows:
    return TruthRows(
        np.concatenate([t.part for t in truths]),
        np.concatenate([t.index for t in truths]),
        np.concatenate([t.rows for t in truths]),
    )


def first_ident(streams: list[decode.Stream]) -> wire.Ident | None:
    """Return the board's first identification; one that cannot be true with the firmware's own counters and tick.

    A recorder refuses such a board; a journal that holds one is read all the same.
    """
    ident = next((connection.ident for connection in streams if connection.ident is not None), None)
    if ident is not None and ident.implausible:
        return replace(ident, counter_bits=COUNTER_BITS, tick_ns=TICK_NS)
    return ident
