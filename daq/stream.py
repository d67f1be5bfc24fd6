"""A finished byte stream, frame by frame, into arrays of samples: the vectorised reader behind every run file.

Each line's COBS and CRC are undone in C, one call each; what is left is regular, so frames of the same length are laid
side by side and read as one numpy array.  Same rules as `daq.wire.FrameReader`, which is the one that judges lines.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq import wire


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
        See `daq.wire.FrameReader`.
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
    reader = wire.FrameReader()
    blocks: list[bytes] = []
    stamps: list[int] = []
    ident: wire.Ident | None = None
    belt = edge = False
    idents: list[int] = []
    configs: list[tuple[int, str]] = []
    notices: list[tuple[int, str]] = []
    truth_payloads: list[bytes] = []
    truth_frames: list[int] = []
    crc_frame: list[int] = []
    unknown = 0
    unknown_bytes = 0
    lengths = _lengths(belt, edge)
    begun: list[tuple[int, int]] = []  # of the line in progress: reads that ended inside it, and its bytes then
    parts: list[tuple[int, int, int]] = []
    for stamp, data in reads:
        errors_before = reader.crc_errors
        payloads = reader.payloads(data)
        if begun and reader.first_held is not None:
            if reader.first_held and payloads[0][0] == wire.SAMPLES:
                parts += [(at, len(blocks), count) for at, count in begun]
            begun.clear()
        if reader.waiting:
            begun.append((stamp, reader.waiting))
        for payload in payloads:
            if payload[0] == wire.SAMPLES and payload[1] == wire.VERSION:
                if len(payload) >= wire.SAMPLES_HEADER and lengths.get(len(payload)) == payload[2]:
                    blocks.append(payload)
                    stamps.append(stamp)
                    continue
            frame = None if payload[0] == wire.SAMPLES else wire.decode_payload(payload, belt, edge)
            if isinstance(frame, wire.Truth):
                truth_payloads.append(payload)
                truth_frames.append(len(blocks))
            elif isinstance(frame, wire.Ident):
                idents.append(len(blocks))
                if ident is None or not blocks:  # its decoder may have been set in between
                    ident = frame
                    belt = wire.Capability.BELT in frame.capabilities
                    edge = wire.Capability.EDGE_TIME in frame.capabilities
                    lengths = _lengths(belt, edge)
            elif isinstance(frame, wire.Config):
                configs.append((len(blocks), frame.toml))
            elif isinstance(frame, wire.Notice):
                notices.append((len(blocks), frame.text))
            else:
                unknown += 1
                unknown_bytes += len(payload)
        crc_frame += [len(blocks)] * (reader.crc_errors - errors_before)
    columns, heads, first = _columns(blocks, belt, edge)
    part = np.array([row for row in parts if row[1] < len(blocks)], dtype=np.int64).reshape(-1, 3)
    size = np.fromiter(map(len, blocks), dtype=np.int64, count=len(blocks))
    truth_seq, truth_frame, truth = _truth(truth_payloads, truth_frames)
    return Stream(
        first=first,
        n=heads["n"].astype(np.int64),
        seq=heads["seq"].astype(np.int64),
        ticks=heads["time"].astype(np.int64),
        illegal=heads["illegal"].astype(np.int64),
        stamp_ns=np.array(stamps, dtype=np.int64),
        dt=columns["dt"].copy(),
        up=columns["up"].copy(),
        down=columns["down"].copy(),
        status=columns["status"].copy(),
        belt=columns["belt"].copy() if belt else None,
        edge=columns["edge"].copy() if edge else None,
        ident=ident,
        idents=np.array(idents, dtype=np.int64),
        configs=tuple(configs),
        notices=tuple(notices),
        truth_seq=truth_seq,
        truth_frame=truth_frame,
        truth=truth,
        crc_frame=np.array(crc_frame, dtype=np.int64),
        crc_errors=reader.crc_errors,
        unknown=unknown,
        discarded_bytes=reader.discarded_bytes + unknown_bytes,
        length=size + 4 + (size + 2) // 254,  # CRC, COBS and its delimiter
        part_stamp_ns=part[:, 0],
        part_frame=part[:, 1],
        part_bytes=part[:, 2],
    )


_HEAD = np.dtype([("kind", "u1"), ("version", "u1"), ("n", "u1"), ("seq", "<u2"), ("time", "<u4"), ("illegal", "<u2")])


def _row(belt: bool, edge: bool) -> np.dtype[np.void]:
    names = ["dt", "up", "down", "status", *["belt"] * belt, *["edge"] * edge]
    return np.dtype([(name, "u1" if name == "status" else "<u2") for name in names])


def _lengths(belt: bool, edge: bool) -> dict[int, int]:
    """Return the number of samples of a SAMPLES payload by its length."""
    size = _row(belt, edge).itemsize
    return {wire.SAMPLES_HEADER + size * n: n for n in range(1, 256)}


def _columns(
    blocks: list[bytes], belt: bool, edge: bool
) -> tuple[NDArray[np.void], NDArray[np.void], NDArray[np.int64]]:
    """Return the samples of all frames as one structured array, the frames' heads, and where each frame begins."""
    row = _row(belt, edge)
    n = np.fromiter((block[2] for block in blocks), dtype=np.int64, count=len(blocks))
    first = np.concatenate(([0], np.cumsum(n)))
    samples = np.empty(int(first[-1]), dtype=row)
    heads = np.empty(len(blocks), dtype=_HEAD)
    for size in np.unique(n).tolist():
        where = np.flatnonzero(n == size)
        shape = np.dtype([("head", _HEAD), ("rows", row, (size,))])
        together = np.frombuffer(b"".join(blocks[k] for k in where), dtype=shape)
        heads[where] = together["head"]
        samples[(first[where, np.newaxis] + np.arange(size)).ravel()] = together["rows"].ravel()
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
