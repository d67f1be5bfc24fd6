"""A finished byte stream, frame by frame, into arrays of samples: the vectorised reader behind every run file.

Lines of one length are deframed together (`daq.wire.deframe`), and sample frames of one length read as one array;
what is rare or long is taken one line at a time.  Same rules as `daq.wire.frames.FrameReader`, and where the reads
ended makes no difference.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.wire import cut, deframe
from daq.wire import frames as wire


@dataclass(frozen=True)
class Stream:
    """What f SAMPLES frames with n samples in all, and the frames beside them, said.

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
    truth_seq, truth_frame : (m,) int64
        Sequence number as sent of each row of truth, and the frame it came before.
    truth : (m, 4) float64
        Time, x, v, F.
    crc_frame : (c,) int64
        Before which frame each damaged line came (as near as its read tells).
    crc_errors, unknown, discarded_bytes : int
        See `daq.wire.frames.FrameReader`.
    length : (f,) int64
        Each frame's bytes on the line.
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
    belt: NDArray[np.uint16] | None
    edge: NDArray[np.uint16] | None
    ident: wire.Ident | None
    idents: NDArray[np.int64]
    configs: tuple[tuple[int, str], ...]
    notices: tuple[tuple[int, str], ...]
    truth_seq: NDArray[np.int64]
    truth_frame: NDArray[np.int64]
    truth: NDArray[np.float64]
    crc_frame: NDArray[np.int64]
    crc_errors: int
    unknown: int
    discarded_bytes: int
    length: NDArray[np.int64]
    part_stamp_ns: NDArray[np.int64]
    part_frame: NDArray[np.int64]
    part_bytes: NDArray[np.int64]


def decode(reads: Iterable[tuple[int, bytes]]) -> Stream:
    """Decode the reads of one connection.

    Parameters
    ----------
    reads : iterable of (int, bytes)
        Host's monotonic stamp in ns at the end of each read, and the bytes it gave.
    """
    lines = cut.cut(reads, wire.DELIMITER)
    found = deframe.payloads(lines)
    told = [(line, payload, wire.decode_payload(payload, False, False)) for line, payload in found.others]
    idents = [(line, said) for line, _, said in told if isinstance(said, wire.Ident)]
    ident = _governing(idents, found.samples)
    belt = ident is not None and wire.Capability.BELT in ident.capabilities
    edge = ident is not None and wire.Capability.EDGE_TIME in ident.capabilities
    ours = [group for group in found.samples if _fits(group, belt, edge)]
    counts = np.zeros(len(lines), dtype=np.int64)  # samples in each line
    for group in ours:
        counts[group.lines] = group.payloads[0, 2]
    before = np.concatenate(([0], np.cumsum(counts > 0)))  # frames before each line
    frames = np.flatnonzero(counts)
    columns, heads, first = _columns(ours, before, counts[frames], belt, edge)
    truths = [(line, payload) for line, payload, said in told if isinstance(said, wire.Truth)]
    truth_seq, truth_frame, truth = _truth([t for _, t in truths], [int(before[line]) for line, _ in truths])
    unknown = [len(payload) for _, payload, said in told if said is None]
    for group in found.samples:
        if not _fits(group, belt, edge):
            unknown += [group.payloads.shape[1]] * len(group.lines)
    part_ns, part_line, part_bytes = _parts(lines, counts > 0)
    return Stream(
        first=first,
        n=counts[frames],
        seq=heads["seq"].astype(np.int64),
        ticks=heads["time"].astype(np.int64),
        illegal=heads["illegal"].astype(np.int64),
        stamp_ns=lines.stamp_ns[frames],
        dt=columns["dt"].copy(),
        up=columns["up"].copy(),
        down=columns["down"].copy(),
        status=columns["status"].copy(),
        belt=columns["belt"].copy() if belt else None,
        edge=columns["edge"].copy() if edge else None,
        ident=ident,
        idents=before[[line for line, _ in idents]] if idents else np.empty(0, dtype=np.int64),
        configs=tuple((int(before[line]), said.toml) for line, _, said in told if isinstance(said, wire.Config)),
        notices=tuple((int(before[line]), said.text) for line, _, said in told if isinstance(said, wire.Notice)),
        truth_seq=truth_seq,
        truth_frame=truth_frame,
        truth=truth,
        crc_frame=before[found.wrong],
        crc_errors=len(found.wrong),
        unknown=len(unknown),
        discarded_bytes=found.wrong_bytes + sum(unknown),
        length=lines.length[frames] + 1,
        part_stamp_ns=part_ns,
        part_frame=before[part_line],
        part_bytes=part_bytes,
    )


def _fits(group: deframe.Group, belt: bool, edge: bool) -> bool:
    """Return whether frames are as long as the samples they say they hold."""
    size, n = group.payloads.shape[1], int(group.payloads[0, 2])
    return n > 0 and size == wire.SAMPLES_HEADER + n * _row(belt, edge).itemsize


def _governing(idents: list[tuple[int, wire.Ident]], samples: list[deframe.Group]) -> wire.Ident | None:
    """Return the last identification before the first sample frame: the decoder may have been set in between."""
    chosen: wire.Ident | None = None
    begun = False
    for line, ident in idents:
        if chosen is not None:
            has = wire.Capability.BELT in chosen.capabilities, wire.Capability.EDGE_TIME in chosen.capabilities
            begun = begun or any(_fits(group, *has) and group.lines.min() < line for group in samples)
        if not begun:
            chosen = ident
    return chosen


def _parts(lines: cut.Cut, is_frame: NDArray[np.bool_]) -> tuple[NDArray[np.int64], ...]:
    """Return the reads that ended inside a sample frame: stamp, line, and bytes of it that were there."""
    line = np.searchsorted(lines.start, lines.read_end, side="left") - 1
    inside = (line >= 0) & (lines.read_end <= lines.stop[line]) if len(lines) else np.zeros(len(line), dtype=np.bool_)
    inside[inside] = is_frame[line[inside]]
    return lines.read_ns[inside], line[inside], lines.read_end[inside] - lines.start[line[inside]]


_HEAD = np.dtype([("kind", "u1"), ("version", "u1"), ("n", "u1"), ("seq", "<u2"), ("time", "<u4"), ("illegal", "<u2")])


def _row(belt: bool, edge: bool) -> np.dtype[np.void]:
    names = ["dt", "up", "down", "status", *["belt"] * belt, *["edge"] * edge]
    return np.dtype([(name, "u1" if name == "status" else "<u2") for name in names])


def _columns(
    ours: list[deframe.Group], before: NDArray[np.int64], n: NDArray[np.int64], belt: bool, edge: bool
) -> tuple[NDArray[np.void], NDArray[np.void], NDArray[np.int64]]:
    """Return the samples of all frames as one structured array, the frames' heads, and where each frame begins."""
    row = _row(belt, edge)
    first = np.concatenate(([0], np.cumsum(n)))
    samples = np.empty(int(first[-1]), dtype=row)
    heads = np.empty(len(n), dtype=_HEAD)
    for group in ours:
        size = int(group.payloads[0, 2])
        shape = np.dtype([("head", _HEAD), ("rows", row, (size,))])
        together = group.payloads.view(shape)[:, 0]
        frames = before[group.lines]
        heads[frames] = together["head"]
        samples[(first[frames, np.newaxis] + np.arange(size)).ravel()] = together["rows"].ravel()
    return samples, heads, first[:-1]


def _truth(
    payloads: list[bytes], frames: list[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    n = np.fromiter((payload[2] for payload in payloads), dtype=np.int64, count=len(payloads))
    seq = [payload[3] | payload[4] << 8 for payload in payloads]
    rows = np.frombuffer(b"".join(payload[wire.TRUTH_HEADER :] for payload in payloads), dtype="<f8")
    first = np.repeat(np.cumsum(n) - n, n)
    within = np.arange(int(n.sum())) - first
    truth_seq = (np.repeat(np.array(seq, dtype=np.int64), n) + within) & 0xFFFF
    return truth_seq, np.repeat(np.array(frames, dtype=np.int64), n), rows.reshape(-1, 4).copy()
