"""The reads of one connection, decoded into arrays of samples: the first step to every run file.

Lines of one length are checked and read as one array; `daq.wire.frames.FrameReader` does the same line by line, and the
tests compare the two.  Where a read ended changes nothing but the stamps.
"""

from array import array
from binascii import crc_hqx
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.wire import frames as wire
from daq.wire.splitter import Splitter
from stickslip.text import printable, storable


def _empty() -> NDArray[np.int64]:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Stream:
    """What one connection sent: f SAMPLES frames with n samples in all, and the frames between them."""

    first: NDArray[np.int64]  # (f,) index of each frame's first sample in the columns below
    n: NDArray[np.int64]  # (f,) each frame's length, and its numbers as sent
    seq: NDArray[np.int64]
    ticks: NDArray[np.int64]
    illegal: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]  # (f,) host's monotonic clock when the frame was complete
    dt: NDArray[np.uint16]  # (n,) the columns as sent; belt and edge are None when the board does not send them
    up: NDArray[np.uint16] | NDArray[np.uint32]
    down: NDArray[np.uint16] | NDArray[np.uint32]
    status: NDArray[np.uint8]
    ident: wire.Ident | None  # the board's identification when it began to sample: the last one before the first frame
    idents: NDArray[np.int64]  # (i,) the frame after each identification
    crc_frame: NDArray[np.int64]  # (c,) the frame after each damaged line
    crc_errors: int  # see `daq.wire.frames.FrameReader`
    length: NDArray[np.int64]  # (f,) each frame's bytes on the line; 0 where that is not known
    belt: NDArray[np.uint16] | None = None
    edge: NDArray[np.uint16] | None = None
    # each of these identifications: the frames from there on were sent under it, those before the first one under
    # ``ident``; empty if only ``ident`` is known
    identified: tuple[wire.Ident, ...] = ()
    # before which frame, and its text, with characters escaped that a file cannot store or a terminal cannot show
    configs: tuple[tuple[int, str], ...] = ()
    notices: tuple[tuple[int, str], ...] = ()
    unknown: int = 0
    # (f,) the time as sent less ``ticks``: not 0 where it was wrong and has been interpolated; None: as sent
    time_error: NDArray[np.int64] | None = None
    # (n, 4) exact time, x, v, F of each sample, NaN where it was not sent; None of boards that never send it
    truth: NDArray[np.float64] | None = None
    # (p,) reads that ended inside a frame: stamp, frame, and how many of its bytes had arrived
    part_stamp_ns: NDArray[np.int64] = field(default_factory=_empty)
    part_frame: NDArray[np.int64] = field(default_factory=_empty)
    part_bytes: NDArray[np.int64] = field(default_factory=_empty)

    def split_by_ident(self) -> list[tuple[int, int, wire.Ident | None]]:
        """Return the stretches of frames sent under one identification: first frame, end, identification; at least one.

        Identifications that differ only in the samples of a frame, a setting, are one.
        """
        frames = len(self.n)
        spans = [(0, self.ident)]
        for first, ident in zip(self.idents.tolist(), self.identified, strict=False):
            if first >= frames:
                break
            if first == spans[-1][0]:
                spans.pop()
            if not spans or not _same_board(spans[-1][1], ident):
                spans.append((first, ident))
        ends = [*(first for first, _ in spans[1:]), frames]
        return [(first, end, ident) for (first, ident), end in zip(spans, ends, strict=True)]


def _same_board(before: wire.Ident | None, ident: wire.Ident) -> bool:
    return before is not None and replace(before, block_size=ident.block_size) == ident


# SAMPLES frames by bytes of payload and declared samples: their lines (k,) and payloads (k, size).
Groups = dict[tuple[int, int], tuple[NDArray[np.int64], NDArray[np.uint8]]]
FEWEST_TOGETHER = 192  # payloads of one length from which their CRCs are computed together: faster from about here
_READ_AT_ONCE = 1 << 20  # bytes of a read that are cut into lines at once, which takes 20 MB
_CRC_OF_BYTE = np.array([crc_hqx(bytes((byte,)), 0) for byte in range(256)], dtype=np.uint16)
_HEAD = np.dtype([("kind", "u1"), ("version", "u1"), ("n", "u1"), ("seq", "<u2"), ("time", "<u4"), ("illegal", "<u2")])


@dataclass(frozen=True)
class _Lines:
    """Lines that were read together, k of them, their CRCs checked."""

    bodies: list[bytes]  # payload and CRC of every line; lines are numbered by their index here
    sent_bytes: NDArray[np.int64]  # (k,) bytes of each on the line, and of its payload, 0 for a damaged line
    size: NDArray[np.int64]
    samples: Groups  # frames with samples (`Groups`), and the other frames with their lines
    others: list[tuple[int, wire.Frame]]
    ends: list[tuple[int, int]]  # of each read: its stamp, and how many lines it ended
    parts: list[tuple[int, int, int]]  # reads that ended inside a line: stamp, line, its bytes so far


def decode_pieces(
    reads: Iterable[tuple[int, bytes]], most_bytes: float, decoder: str | None = None
) -> Iterator[Stream]:
    """Decode the reads of one connection piece by piece, each of about so many bytes; at least one piece.

    ``reads`` are the host's monotonic stamp at the end of each read, ns, and its bytes; ``decoder`` is the one that the
    recorder requested, also of a board that had restarted.  A read that ends inside a frame belongs to the piece of
    that frame; an identification after a piece's last frame to the first frame of the next piece.

    If the first piece has no identification, ``reads`` is iterated over twice and must yield the same.
    """
    source = _read_lines(reads, most_bytes)
    first_lines = next(source)
    earliest = _find_ident([first_lines])
    if earliest is None and (second_lines := next(source, None)) is not None:
        earliest = _find_ident(chain([second_lines], source))
        source = _read_lines(reads, most_bytes)
    else:
        source = chain([first_lines], source)
    first = True
    tracker = _IdentTracker(earliest, decoder)
    for lines in source:
        yield _build_stream(lines, *tracker.take(lines), first)
        first = first and not lines.bodies


def _find_ident(pieces: Iterable[_Lines]) -> wire.Ident | None:
    """Return the first identification: what was sent before it is read by it."""
    return next((frame for lines in pieces for _, frame in lines.others if isinstance(frame, wire.Ident)), None)


def _read_lines(reads: Iterable[tuple[int, bytes]], most_bytes: float) -> Iterator[_Lines]:
    """Yield the lines of one connection, in pieces; at least one, which may be empty."""
    splitter = Splitter(wire.DELIMITER, wire.LONGEST_LINE)
    bodies: list[bytes] = []
    length = array("q")
    ends: list[tuple[int, int]] = []
    parts: list[tuple[int, int, int]] = []
    bytes_taken = 0

    def pack() -> _Lines:
        size, samples, rest = _group_lines(bodies)
        others = [(line, frame) for line in rest if (frame := wire.decode_payload(bodies[line][:-2], False, False))]
        return _Lines(bodies, np.array(length), size, samples, others, ends, parts)

    for stamp, read in reads:
        for begin in range(0, len(read), _READ_AT_ONCE):
            data = read[begin : begin + _READ_AT_ONCE]
            lines = list(filter(None, splitter.feed(data)))
            bodies += wire.unstuff(lines)
            length.extend(map(len, lines))
            ends.append((stamp, len(lines)))
            if splitter.pending_bytes and begin + len(data) == len(read):
                parts.append((stamp, len(bodies), splitter.pending_bytes))
            bytes_taken += len(data)
            if bytes_taken >= most_bytes and not _awaits_truth(bodies):
                carried = [(stamp_ns, 0, count) for stamp_ns, line, count in parts if line == len(bodies)]
                parts = [part for part in parts if part[1] < len(bodies)]
                yield pack()
                bytes_taken = 0
                bodies, length, ends, parts = [], array("q"), [], carried
    yield pack()


def _awaits_truth(bodies: list[bytes]) -> bool:
    """Return whether the exact motion of the last frame, sent after it, may be still to come."""
    kinds = [body[:1] for body in bodies]
    return kinds[-1:] == [b"S"] and b"T" in kinds


def _build_stream(
    lines: _Lines, ident: wire.Ident | None, identified: list[tuple[int, wire.Ident]], first_piece: bool
) -> Stream:
    """Return the stream of some lines of a connection.

    ``ident`` is the board's identification before them; ``identified`` are the lines among them with an identification,
    and what the frames after each were sent as.
    """
    size, others = lines.size, lines.others
    sample_frames = _sample_frames(lines.samples, ident, identified)
    layouts = list(dict.fromkeys(row for _, _, _, row in sample_frames)) or [_sample_layout(ident)]
    row = max(layouts, key=lambda layout: len(layout.names or ()))
    if len(layouts) > 1:
        row = _make_layout(set().union(*(layout.names or () for layout in layouts)))
    count = np.zeros(len(size), dtype=np.int64)  # samples in each line
    for line_numbers, n_samples, _, _ in sample_frames:
        count[line_numbers] = n_samples
    before = np.concatenate(([0], np.cumsum(count > 0)))  # sample frames before each line
    frame_line = np.flatnonzero(count)
    n = count[frame_line]
    first = np.cumsum(n) - n
    rows = np.zeros(int(n.sum()), dtype=row) if len(layouts) > 1 else np.empty(int(n.sum()), dtype=row)
    heads = np.empty(len(n), dtype=_HEAD)
    for line_numbers, n_samples, payloads, layout in sample_frames:
        sent = payloads.view(np.dtype([("head", _HEAD), ("rows", layout, (n_samples,))]))[:, 0]
        heads[before[line_numbers]] = sent["head"]
        row_numbers = (first[before[line_numbers], np.newaxis] + np.arange(n_samples)).ravel()
        if layout == row:
            rows[row_numbers] = sent["rows"].ravel()
        else:
            for name in layout.names or ():
                rows[name][row_numbers] = sent["rows"].ravel()[name]
    is_known = np.zeros(len(size), dtype=np.bool_)
    is_known[frame_line] = True
    is_known[[line for line, _ in others]] = True
    unknown = size[~is_known & (size > 0)]
    damaged = np.flatnonzero(size == 0)
    if first_piece:
        damaged = damaged[damaged > 0]  # the first line's beginning may be missing

    sends_truth = [
        wire.Capability.TRUTH in each.capabilities for _, each in [(0, ident), *identified] if each is not None
    ]
    truth = np.full((len(rows), 4), np.nan) if any(sends_truth) else None
    for line, frame in others:
        k = int(before[line]) - 1  # the frame with samples before it
        if truth is not None and isinstance(frame, wire.TruthFrame) and k >= 0:
            if (heads["seq"][k], n[k]) == (frame.seq, len(frame.rows)):
                truth[first[k] : first[k] + n[k]] = frame.rows
    part_ns, part_line, part_bytes = np.array(lines.parts, dtype=np.int64).reshape(-1, 3).T
    inside = np.isin(part_line, frame_line)
    # Of boards that differ, what all of them send.
    names = [name for name in row.names or () if all(name in (layout.names or ()) for layout in layouts)]
    columns: dict[str, Any] = {name: rows[name].copy() for name in names}
    return Stream(
        first=first,
        n=n,
        seq=heads["seq"].astype(np.int64),
        ticks=heads["time"].astype(np.int64),
        illegal=heads["illegal"].astype(np.int64),
        stamp_ns=np.repeat(*np.array(lines.ends, dtype=np.int64).reshape(-1, 2).T)[frame_line],
        **columns,
        ident=next((each for line, each in reversed(identified) if not before[line]), ident),
        idents=before[np.array([line for line, _ in identified], dtype=np.int64)],
        identified=tuple(each_ident for _, each_ident in identified),
        configs=tuple(
            (int(before[line]), storable(frame.toml)) for line, frame in others if isinstance(frame, wire.Config)
        ),
        notices=tuple(
            (int(before[line]), printable(frame.text)) for line, frame in others if isinstance(frame, wire.Notice)
        ),
        truth=truth,
        crc_frame=before[damaged],
        crc_errors=len(damaged),
        unknown=len(unknown),
        length=lines.sent_bytes[frame_line] + 1,
        part_stamp_ns=part_ns[inside],
        part_frame=before[part_line[inside]],
        part_bytes=part_bytes[inside],
    )


def _group_lines(bodies: list[bytes]) -> tuple[NDArray[np.int64], Groups, list[int]]:
    """Check every line's CRC; return bytes of each payload, 0 if damaged, the SAMPLES frames, and the other lines."""
    length = np.fromiter(map(len, bodies), np.int64, len(bodies))
    size = np.zeros(len(bodies), dtype=np.int64)
    samples: Groups = {}
    others: list[int] = []
    for body_bytes in np.unique(length[length >= wire.SHORTEST_BODY]).tolist():
        lines = np.flatnonzero(length == body_bytes)
        rows = np.frombuffer(b"".join([bodies[line] for line in lines.tolist()]), np.uint8).reshape(-1, body_bytes)
        good = _compute_crc(rows[:, :-2]) == rows[:, -2] | rows[:, -1].astype(np.uint16) << 8
        size[lines[good]] = body_bytes - 2
        sample = good & (rows[:, 0] == wire.SAMPLES) & (rows[:, 1] == wire.VERSION)
        sample &= body_bytes - 2 >= wire.SAMPLES_HEADER
        others += lines[good & ~sample].tolist()
        for n in np.unique(rows[sample, 2]).tolist():
            same_n = np.flatnonzero(sample & (rows[:, 2] == n))
            samples[body_bytes - 2, n] = lines[same_n], rows[same_n, :-2]
    return size, samples, sorted(others)


def _compute_crc(payloads: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return the CRC of payloads of one length, (n, bytes), as `binascii.crc_hqx` computes it: (n,)."""
    if len(payloads) < FEWEST_TOGETHER:
        return np.array([crc_hqx(payload, wire.CRC_SEED) for payload in map(bytes, payloads)], dtype=np.uint16)
    crc = np.full(len(payloads), wire.CRC_SEED, dtype=np.uint16)
    for column in payloads.T:
        crc = crc << 8 ^ _CRC_OF_BYTE[crc >> 8 ^ column]
    return crc


def _sample_frames(
    groups: Groups, ident: wire.Ident | None, identified: list[tuple[int, wire.Ident]]
) -> list[tuple[NDArray[np.int64], int, NDArray[np.uint8], np.dtype[np.void]]]:
    """Return the frames with samples grouped by layout: lines, (k,), samples in each, payloads, layout."""
    layouts = [_sample_layout(ident), *(_sample_layout(later) for _, later in identified)]
    distinct = list(dict.fromkeys(layouts))
    number = np.array([distinct.index(layout) for layout in layouts])
    lines = np.array([line for line, _ in identified], dtype=np.int64)
    frames = []
    for (size, n_samples), (line_numbers, payloads) in groups.items():
        layout_number = number[np.searchsorted(lines, line_numbers)]
        for k, row in enumerate(distinct):
            matches = layout_number == k
            if _fits_layout(size, n_samples, row) and matches.any():
                frames.append((line_numbers[matches], n_samples, payloads[matches], row))
    return frames


def _sample_layout(ident: wire.Ident | None) -> np.dtype[np.void]:
    has = wire.Capability(0) if ident is None else ident.capabilities
    return _make_layout(["belt"] * (wire.Capability.BELT in has) + ["edge"] * (wire.Capability.EDGE_TIME in has))


def _make_layout(optional: Iterable[str]) -> np.dtype[np.void]:
    """Return the layout of one sample with these columns in addition to those that each one has."""
    chosen = set(optional)
    names = ["dt", "up", "down", "status", *(name for name in ("belt", "edge") if name in chosen)]
    return np.dtype([(name, "u1" if name == "status" else "<u2") for name in names])


def _fits_layout(size: int, n: int, row: np.dtype[np.void]) -> bool:
    return n > 0 and size == wire.SAMPLES_HEADER + n * row.itemsize


class _IdentTracker:
    """The identification in force: the first one from the beginning, then each later one from its line on.

    A board that has restarted sends an identification, then the recorder sets the decoder of this run.  It requests an
    identification again; if there is none (older recorders did not request it), the requested decoder applies.
    """

    def __init__(self, earliest: wire.Ident | None, decoder: str | None) -> None:
        self._ident = earliest
        self._decoder = decoder
        self._first = True  # no identification has come
        self._sampled = False  # since the last identification

    def take(self, lines: _Lines) -> tuple[wire.Ident | None, list[tuple[int, wire.Ident]]]:
        """Return the identification before the next lines, and the one in force after each line that has one."""
        ident_before, changes = self._ident, []
        sampled = np.sort(np.concatenate([_empty(), *(line_numbers for line_numbers, _ in lines.samples.values())]))
        last = -1
        for line, frame in lines.others:
            if not isinstance(frame, wire.Ident):
                continue
            self._sampled |= bool(np.searchsorted(sampled, last) < np.searchsorted(sampled, line))
            restarted = self._sampled and not self._first
            self._ident = frame if self._decoder is None or not restarted else replace(frame, decoder=self._decoder)
            changes.append((line, self._ident))
            self._first, self._sampled, last = False, False, line
        self._sampled |= bool(np.searchsorted(sampled, last) < len(sampled))
        return ident_before, changes
