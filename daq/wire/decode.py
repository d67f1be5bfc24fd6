"""The reads of one connection, decoded into arrays of samples: what stands behind every run file.

`daq.wire.frames.FrameReader` splits and checks the frames; the payloads of sample frames of one length are then read as
one array.  Where the reads ended makes no difference but for the stamps.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.wire import frames as wire


def _nothing() -> NDArray[np.int64]:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Stream:
    """What one connection sent: f SAMPLES frames with n samples in all, and the frames between them.

    Attributes
    ----------
    first : (f,) int64
        Index of each frame's first sample in the columns below.
    n, seq, ticks, illegal : (f,) int64
        Each frame's length, and its numbers as sent.
    stamp_ns : (f,) int64
        Host's monotonic clock when the frame had come in full.
    dt, up, down, status, belt, edge : (n,)
        The columns as sent; belt and edge are None when the board does not send them.
    ident : Ident or None
        The board's identification when it began to sample: the last one before the first frame.
    idents : (i,) int64
        Before which frame each identification came.
    configs, notices : tuple of (int, str)
        Before which frame, and its text.
    time_error : (f,) int64 or None
        The time as sent less ``ticks``: not 0 where it was not true and has been interpolated.  None: as sent.
    truth_seq, truth_frame : (m,) int64
        Sequence number as sent of each row of truth, and the frame it came before.
    truth : (m, 4) float64
        Time, x, v, F.
    crc_frame : (c,) int64
        Before which frame each damaged line came.
    crc_errors, unknown, discarded_bytes : int
        See `daq.wire.frames.FrameReader`.
    length : (f,) int64
        Each frame's bytes on the line; 0 where that is not known.
    part_stamp_ns, part_frame, part_bytes : (p,) int64
        Reads that ended inside a frame: when, which frame, and how many of its bytes were there.
    """

    first: NDArray[np.int64]
    n: NDArray[np.int64]
    seq: NDArray[np.int64]
    ticks: NDArray[np.int64]
    illegal: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    dt: NDArray[np.uint16]
    up: NDArray[np.uint16] | NDArray[np.uint32]
    down: NDArray[np.uint16] | NDArray[np.uint32]
    status: NDArray[np.uint8]
    ident: wire.Ident | None
    idents: NDArray[np.int64]
    crc_frame: NDArray[np.int64]
    crc_errors: int
    discarded_bytes: int
    length: NDArray[np.int64]
    belt: NDArray[np.uint16] | None = None
    edge: NDArray[np.uint16] | None = None
    configs: tuple[tuple[int, str], ...] = ()
    notices: tuple[tuple[int, str], ...] = ()
    unknown: int = 0
    time_error: NDArray[np.int64] | None = None
    truth_seq: NDArray[np.int64] = field(default_factory=_nothing)
    truth_frame: NDArray[np.int64] = field(default_factory=_nothing)
    truth: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))
    part_stamp_ns: NDArray[np.int64] = field(default_factory=_nothing)
    part_frame: NDArray[np.int64] = field(default_factory=_nothing)
    part_bytes: NDArray[np.int64] = field(default_factory=_nothing)


# SAMPLES frames by bytes of payload and declared samples: their lines (k,) and payloads (k, size).
Groups = dict[tuple[int, int], tuple[NDArray[np.int64], NDArray[np.uint8]]]
_HEAD = np.dtype([("kind", "u1"), ("version", "u1"), ("n", "u1"), ("seq", "<u2"), ("time", "<u4"), ("illegal", "<u2")])


def decode(reads: Iterable[tuple[int, bytes]]) -> Stream:
    """Decode the reads of one connection.

    Parameters
    ----------
    reads : iterable of (int, bytes)
        Host's monotonic stamp in ns at the end of each read, and the bytes it gave.
    """
    reader = wire.FrameReader()
    payloads: list[bytes | None] = []  # of every line; a line is known by its place here
    length: list[int] = []
    stamp_ns: list[int] = []
    parts: list[tuple[int, int, int]] = []
    for stamp, data in reads:
        lines, found = reader.lines(data)
        payloads += found
        length += map(len, lines)
        stamp_ns += [stamp] * len(lines)
        if reader.pending_bytes:
            parts.append((stamp, len(payloads), reader.pending_bytes))

    size = np.array([0 if payload is None else len(payload) for payload in payloads], dtype=np.int64)
    samples, rest = _groups(payloads, size)
    others = [(line, frame) for line in rest if (frame := wire.decode_payload(payloads[line] or b"", False, False))]
    ident = _governing(others, samples)
    row = _row(ident)
    ours = {key: group for key, group in samples.items() if _fits(*key, row)}
    count = np.zeros(len(size), dtype=np.int64)  # samples in each line
    for (_, each), (where, _) in ours.items():
        count[where] = each
    before = np.concatenate(([0], np.cumsum(count > 0)))  # sample frames before each line
    frame_line = np.flatnonzero(count)
    n = count[frame_line]
    first = np.cumsum(n) - n
    rows = np.empty(int(n.sum()), dtype=row)
    heads = np.empty(len(n), dtype=_HEAD)
    for (_, each), (where, together) in ours.items():
        sent = together.view(np.dtype([("head", _HEAD), ("rows", row, (each,))]))[:, 0]
        heads[before[where]] = sent["head"]
        rows[(first[before[where], np.newaxis] + np.arange(each)).ravel()] = sent["rows"].ravel()
    known = np.zeros(len(size), dtype=np.bool_)
    known[frame_line] = True
    known[[line for line, _ in others]] = True
    unknown = size[~known & (size > 0)]
    damaged = np.flatnonzero(size == 0)

    truths = [(line, frame) for line, frame in others if isinstance(frame, wire.TruthFrame)]
    truth_n = [len(frame.rows) for _, frame in truths]
    truth_seq = [seq & 0xFFFF for _, frame in truths for seq in range(frame.seq, frame.seq + len(frame.rows))]
    part_ns, part_line, part_bytes = np.array(parts, dtype=np.int64).reshape(-1, 3).T
    inside = np.isin(part_line, frame_line)
    columns: dict[str, Any] = {name: rows[name].copy() for name in row.names or ()}
    return Stream(
        first=first,
        n=n,
        seq=heads["seq"].astype(np.int64),
        ticks=heads["time"].astype(np.int64),
        illegal=heads["illegal"].astype(np.int64),
        stamp_ns=np.array(stamp_ns, dtype=np.int64)[frame_line],
        **columns,
        ident=ident,
        idents=before[np.array([line for line, frame in others if isinstance(frame, wire.Ident)], dtype=np.int64)],
        configs=tuple((int(before[line]), frame.toml) for line, frame in others if isinstance(frame, wire.Config)),
        notices=tuple((int(before[line]), frame.text) for line, frame in others if isinstance(frame, wire.Notice)),
        truth_seq=np.array(truth_seq, dtype=np.int64),
        truth_frame=np.repeat(before[np.array([line for line, _ in truths], dtype=np.int64)], truth_n),
        truth=np.array([row for _, frame in truths for row in frame.rows], dtype=np.float64).reshape(-1, 4),
        crc_frame=before[damaged[damaged > 0]],  # the first line's beginning may be missing
        crc_errors=reader.crc_errors,
        unknown=len(unknown),
        discarded_bytes=reader.discarded_bytes + int(unknown.sum()),
        length=np.array(length, dtype=np.int64)[frame_line] + 1,
        part_stamp_ns=part_ns[inside],
        part_frame=before[part_line[inside]],
        part_bytes=part_bytes[inside],
    )


def _groups(payloads: list[bytes | None], size: NDArray[np.int64]) -> tuple[Groups, list[int]]:
    """Return the lines of SAMPLES frames and their payloads, by bytes and declared samples; and the other lines."""
    samples: Groups = {}
    others: list[int] = []
    for each in np.unique(size[size > 0]).tolist():
        lines = np.flatnonzero(size == each)
        rows = np.frombuffer(b"".join([payloads[line] or b"" for line in lines.tolist()]), np.uint8).reshape(-1, each)
        sample = np.all(rows[:, :2] == (wire.SAMPLES, wire.VERSION), axis=1) & (each >= wire.SAMPLES_HEADER)
        others += lines[~sample].tolist()
        for n in np.unique(rows[sample, 2]).tolist() if sample.any() else ():
            chosen = sample & (rows[:, 2] == n)
            samples[each, n] = lines[chosen], rows[chosen]
    return samples, sorted(others)


def _row(ident: wire.Ident | None) -> np.dtype[np.void]:
    """Return the layout of one sample from a board that identified itself so."""
    has = wire.Capability(0) if ident is None else ident.capabilities
    names = ["dt", "up", "down", "status"]
    names += ["belt"] * (wire.Capability.BELT in has) + ["edge"] * (wire.Capability.EDGE_TIME in has)
    return np.dtype([(name, "u1" if name == "status" else "<u2") for name in names])


def _fits(size: int, n: int, row: np.dtype[np.void]) -> bool:
    """Return whether a payload is as long as the n samples it declares."""
    return n > 0 and size == wire.SAMPLES_HEADER + n * row.itemsize


def _governing(others: list[tuple[int, wire.Frame]], samples: Groups) -> wire.Ident | None:
    """Return the last identification before the first sample frame: the decoder may have been set in between."""
    chosen: wire.Ident | None = None
    for line, frame in others:
        if not isinstance(frame, wire.Ident):
            continue
        if chosen is not None and any(
            _fits(*key, _row(chosen)) and lines[0] < line for key, (lines, _) in samples.items()
        ):
            break
        chosen = frame
    return chosen
