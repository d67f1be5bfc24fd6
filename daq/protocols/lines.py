"""Samples in lines of text, without frames, sequence numbers or a checksum: how damage is detected, and a stream.

A line must match its whole pattern, so that most damage (a byte that is not a digit, a byte too few or too many) is
detected.  A flipped digit is still a digit; `daq.protocols.neighbours` finds it by the lines around it.  A wrong last
digit, and damaged lines next to each other, cannot be detected.  Of lines damaged at random, 0.8 % pass in a QSB's
records, 2 % in text lines, and less than 1 of 256 in text lines with a column xor.

Lost lines show in the time: a step of n periods is n - 1 lines lost.  A sequence number is made from the time, one per
period, and a net count is split into its rises and falls, so that everything after this module is the same as for
frames.
"""

from array import array
from collections.abc import Callable, Iterable, Iterator
from enum import IntFlag
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.protocols.judge import GapNotes, LineJudge, Lines
from daq.protocols.neighbours import LOOK_AHEAD, time_ahead
from daq.protocols.session import Tally
from daq.wire import frames
from daq.wire.arrival import LeastDelay
from daq.wire.counters import LATE_FRAMES, wrap_signed
from daq.wire.decode import Stream
from daq.wire.splitter import Splitter

CLOCK_LINES = 4096  # lines from which a clock is known to be coarse: 4 s at 1 kHz


class NoSample(IntFlag):
    """Kinds of lines without a sample."""

    REMARK = 0
    DAMAGED = 1
    START = 2  # the board reports its start; with `DAMAGED` if a line before it was cut short by the reset


# The values in a sample's line, as far as the protocol has them: ticks, up, down, status, illegal, each modulo its
# width.  A net count replaces up.
Row = tuple[int, ...]


Parser = Callable[[bytes], Row | NoSample]  # of a line without its delimiter


class LineBatch(NamedTuple):
    """The n samples in some bytes."""

    rows: NDArray[np.int64]  # (n, k) values: `Row`
    others: list[tuple[int, NoSample]]  # damage and starts, each with the number of samples before it


class LineReader:
    """Read samples from a stream of lines; never raises on garbage, synchronised again at the next delimiter.

    delimiter, longest: The end of a line, and bytes beyond which a line is damaged.
    trusts_first: Whether a first line that has lost its beginning is recognised by its form.  It is not an error then;
        otherwise the first line is not used as a sample.
    example: The last damaged line; the first one of a stream may only be cut.
    """

    def __init__(self, delimiter: bytes, longest: int, parse: Parser, *, trusts_first: bool) -> None:
        self.example = b""
        self._splitter = Splitter(delimiter, longest)
        self._longest = longest
        self._parse = parse
        self._trusts_first = trusts_first
        self._first = True

    def feed(self, data: bytes) -> LineBatch:
        """Return the samples in the lines that the bytes complete."""
        values, n = array("q"), 0
        others: list[tuple[int, NoSample]] = []
        for line in self._splitter.feed(data):
            item = self._parse(line) if len(line) <= self._longest else NoSample.DAMAGED
            if isinstance(item, tuple):
                if self._trusts_first or not self._first:
                    values.extend(item)
                    n += 1
            elif item:
                if NoSample.DAMAGED in item:
                    self.example = line
                others.append((n, item & ~NoSample.DAMAGED if self._first else item))
            self._first = False
        return LineBatch(np.array(values).reshape(n, -1) if n else np.empty((0, 1), dtype=np.int64), others)


class LineTally(Tally):
    """How far a stream of lines has advanced, by their times; see `daq.protocols.session.Tally`."""

    def __init__(self, make_reader: Callable[[], LineReader], period_ticks: float, tick_ns: int = 1000) -> None:
        super().__init__()
        self._tick_s = tick_ns / 1e9
        self._device = 0  # ticks from the first line to the last good one
        self._least = LeastDelay()
        self._at_s: float | None = None  # host's clock at the lines that are taken
        self._make_reader = make_reader
        self._reader = make_reader()
        self._period = period_ticks
        self._most = min(LATE_FRAMES * period_ticks, (1 << 31) - 1)  # ticks by which a line may follow the last one
        self._last: int | None = None
        self._odd = 0  # lines in a row whose times do not follow the last good one

    def feed(self, data: bytes, at_s: float | None = None) -> None:
        self._at_s = at_s
        batch = self._reader.feed(data)
        ticks, first = batch.rows[:, 0].tolist(), 0
        for samples_before, remark in batch.others:
            if NoSample.START in remark:
                self._advance(ticks[first:samples_before])
                first = samples_before
                self.resets += self._last is not None
                self._last = None
                self._least.reset()
        self._advance(ticks[first:])

    def begin_again(self, reached: int) -> None:
        self._reader = self._make_reader()
        self._last, self._odd = None, 0
        self._least.reset()
        super().begin_again(reached)

    def _advance(self, lines: list[int]) -> None:
        """Count lines by their times."""
        self.received += len(lines)
        last, usual_step, periods = self._last, 0, 0
        for ticks in lines:
            if last is None:
                self.reached += 1
                last = ticks
                continue
            step = ticks - last & 0xFFFFFFFF
            if 0 < step <= self._most:
                if step != usual_step:
                    usual_step, periods = step, round(step / self._period) or 1
                self.reached += periods
                self._device += step
                last, self._odd = ticks, 0
                continue
            self._odd += 1
            if self._odd > LOOK_AHEAD:  # not one damaged line: there is a gap, or the board has restarted
                self._odd = 0
                ahead = wrap_signed(step, 32)
                self._device += ahead
                device_s, at_s = self._device * self._tick_s, self._at_s
                if ahead < 0 or (
                    at_s is not None and self._least.has_leapt(device_s, at_s - device_s, ahead * self._tick_s)
                ):
                    self.resets += 1
                    self._least.reset()
                else:  # a constant time is not a restart
                    self.reached += round(ahead / self._period)
                last = ticks
        self._last = last
        if self._at_s is not None and lines:
            device_s = self._device * self._tick_s
            self._least.note([device_s], [self._at_s - device_s])


def decode_pieces(
    reads: Iterable[tuple[int, bytes]],
    make_reader: Callable[[], LineReader],
    ident: frames.Ident,
    period_ticks: float,
    *,
    net: bool,
    most_bytes: float,
    resolution: int = 0,
) -> Iterator[Stream]:
    """Decode the reads of one connection into frames of one sample each, piece by piece; at least one piece.

    Lines that cannot be true are counted as damaged.  The pieces together equal a single one; a start or damage after a
    piece's last frame belongs to the first frame of the next one.

    ``reads`` are the host's monotonic stamp at the end of each read, ns, and its bytes.  ``net``: there is only one
    counter, a signed net count.  ``most_bytes`` is the approximate size of a piece; infinite: one piece.
    ``resolution`` is the ticks by which the clock may advance at once, if its times are multiples of that; 0: its times
    are exact.
    """
    source = _read_pieces(reads, make_reader(), most_bytes)
    pieces: list[_LinePiece] = []
    if resolution:
        ticks = np.empty(0, dtype=np.int64)
        while len(ticks) < CLOCK_LINES and not (pieces and pieces[-1].last):
            pieces.append(next(source))
            ticks = np.concatenate((ticks, pieces[-1].lines.ticks))
        finer = np.count_nonzero(ticks[:CLOCK_LINES] % resolution)
        resolution = 0 if finer > 0.1 * len(ticks[:CLOCK_LINES]) else resolution
    judge = LineJudge(ident.counter_bits, period_ticks, resolution, ident.tick_ns, net=net)
    for piece in chain(pieces, source):
        lines = judge.feed(piece.lines, piece.last)
        if len(lines) or piece.last:
            yield _build_stream(lines, ident, piece.damaged + judge.damaged if piece.last else 0)


class _LinePiece(NamedTuple):
    lines: Lines  # the lines with samples
    damaged: int  # damaged lines after the last of these
    last: bool  # no more reads follow


def _read_pieces(reads: Iterable[tuple[int, bytes]], reader: LineReader, most_bytes: float) -> Iterator[_LinePiece]:
    notes = GapNotes()
    rows: list[NDArray[np.int64]] = []
    others: list[tuple[int, NoSample]] = []
    stamps: list[tuple[int, int]] = []  # of each read: its stamp, and how many samples end in it
    n = bytes_taken = 0

    def build_piece(*, last: bool) -> _LinePiece:
        fresh, damaged = np.zeros(n + 1, dtype=np.bool_), np.zeros(n + 1, dtype=np.int64)
        for samples_before, remark in others:
            fresh[samples_before] |= NoSample.START in remark
            damaged[samples_before] += NoSample.DAMAGED in remark
        fresh, damaged = notes.carry_over(fresh, damaged)
        columns = np.zeros((5, n), dtype=np.int64)
        if rows:
            columns[: rows[0].shape[1]] = np.concatenate(rows).T
        ticks, up, down, status, illegal = columns
        stamp_ns = np.repeat(*np.array(stamps, dtype=np.int64).reshape(-1, 2).T)
        lines = Lines(ticks, ticks, up, down, status, illegal, stamp_ns, fresh, damaged, np.zeros_like(ticks))
        return _LinePiece(lines, notes.damaged, last)

    for stamp, read in reads:
        batch = reader.feed(read)
        others += [(n + samples_before, remark) for samples_before, remark in batch.others]
        if len(batch.rows):
            rows.append(batch.rows)
            stamps.append((stamp, len(batch.rows)))
            n += len(batch.rows)
        bytes_taken += len(read)
        if bytes_taken >= most_bytes:
            yield build_piece(last=False)
            n = bytes_taken = 0
            rows, others, stamps = [], [], []
    yield build_piece(last=True)


def _build_stream(lines: Lines, ident: frames.Ident, damaged: int) -> Stream:
    """Return lines as frames; ``damaged`` lines follow the last of them."""
    n = len(lines)
    wide = ident.counter_bits > 16
    crc_frame = np.repeat(np.arange(n + 1), np.append(lines.damaged, damaged))
    return Stream(
        first=np.arange(n),
        n=np.ones(n, dtype=np.int64),
        seq=lines.number & 0xFFFF,
        ticks=lines.ticks,
        illegal=lines.illegal,
        stamp_ns=lines.stamp_ns,
        dt=np.zeros(n, dtype=np.uint16),
        up=lines.up.astype(np.uint32) if wide else lines.up.astype(np.uint16),
        down=lines.down.astype(np.uint32) if wide else lines.down.astype(np.uint16),
        status=lines.status.astype(np.uint8),
        ident=ident,
        idents=np.flatnonzero(lines.fresh),
        time_error=time_ahead(lines.ticks, lines.sent),
        crc_frame=crc_frame,
        crc_errors=len(crc_frame),
        length=np.zeros(n, dtype=np.int64),
    )
