"""Samples that come as lines of text, without frames, sequence numbers or a checksum: what guards them, and a stream.

Guards: a line must match its whole pattern, so that most damage (a byte that is no digit, a byte too few or too many)
is seen.  A flipped digit is still a digit; `daq.protocols.neighbours` finds it by the lines around it.  What cannot be
seen is a wrong last digit, and damaged lines side by side.  Of lines damaged at random, 0.8 % pass in a QSB's records,
2 % in text lines, and less than 1 of 256 in text lines with a column xor.

Lost lines show in the time: a step of n periods is n - 1 lines lost.  A sequence number is made from the time, one
period a number, and a net count is split into what went up and what went down, so that everything behind this module is
the same as for frames.
"""

import math
import re
from array import array
from collections.abc import Callable, Iterable, Iterator
from enum import IntFlag
from itertools import chain
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.protocols.judge import Between, Judge, Lines
from daq.protocols.neighbours import LOOK_AHEAD, time_ahead
from daq.protocols.session import Tally
from daq.wire import frames
from daq.wire.arrival import LeastDelay
from daq.wire.counters import LATE_FRAMES, signed
from daq.wire.decode import Stream
from daq.wire.splitter import Splitter
from stickslip.compute import arrays

BLOCK_BYTES = 1 << 16  # size of reads that are parsed at once; half costs 10 % more CPU time, double 5 % less
# Lines that are read together.  Half costs a tenth more CPU time in short reads where every tenth line is damaged, and
# gains nothing elsewhere; double costs 1.2 us a line more in reads of 10 lines.
FEWEST_ALIKE = 8


class Other(IntFlag):
    """What a line is that holds no sample."""

    REMARK = 0
    DAMAGED = 1
    START = 2  # the board reports its start; with `DAMAGED` after a line that its reset cut short


# What a sample's line holds, as far as the protocol has it: ticks, up, down, status, illegal, each modulo its width.  A
# net count stands for up.
Row = tuple[int, ...]


class Parser(Protocol):
    """What reads the lines of one stream: any line with `read`, and together those that are alike."""

    @property
    def alike(self) -> re.Pattern[bytes] | None:
        """Pattern of any number of whole lines, delimiters included; None: no lines are read together.

        `read` must read each of these lines as a sample unless a value is out of its range, and remain as it is.
        """

    def read(self, line: bytes) -> Row | Other:
        """Return what a line holds."""

    def read_alike(self, lines: bytes) -> NDArray[np.int64]:
        """Return the values in n lines that match ``alike``, (n, k), up to the first line with one out of range."""

    def missed(self) -> None:
        """Note that the lines which come are not alike; the pattern may be chosen anew by the next one."""


class LineBatch(NamedTuple):
    """What some bytes hold: n samples in m lines."""

    rows: NDArray[np.int64]  # (n, k) their values: `Row`
    line: NDArray[np.int64]  # (n,) which of the lines each is from
    others: list[tuple[int, Other]]  # damage and starts: behind how many of the samples each is
    lines: int  # m


class LineReader:
    """Read samples from a stream of lines; never raises on garbage, back in step at the next delimiter.

    delimiter, longest: What ends a line, and bytes beyond which a line is damaged.
    parser: Reads the lines.
    trusts_first: A first line that has lost its beginning is seen as damaged by its form.  It is no error then; where
        it could not be seen, the first line is no sample either.
    delimiter: What ends a line.
    example: The last line that was damaged; the first one of a stream may only be cut.
    """

    def __init__(self, delimiter: bytes, longest: int, parser: Parser, *, trusts_first: bool) -> None:
        self.delimiter = delimiter
        self.example = b""
        self._splitter = Splitter(delimiter, longest)
        self._longest = longest
        self._parser = parser
        self._trusts_first = trusts_first
        self._first = True
        self._damaged_bytes = 0

    @property
    def discarded_bytes(self) -> int:
        """Bytes of all damaged lines, delimiters not included."""
        return self._damaged_bytes + self._splitter.dropped_bytes

    def feed(self, data: bytes) -> LineBatch:
        """Take bytes as they came; return what the lines hold that they complete."""
        block = self._splitter.whole(data)
        lines = block.count(self.delimiter)
        values, numbers = array("q"), array("q")
        others: list[tuple[int, Other]] = []
        at = line = 0
        while line < lines:
            few = lines - line  # lines to be read one by one
            if self._first and not self._trusts_first:
                few = 1
            elif few >= FEWEST_ALIKE:
                rows, at, few = self._alike(block, at)
                self._first = self._first and not len(rows)
                if len(rows) == lines:
                    return LineBatch(rows, np.arange(lines), others, lines)
                values.frombytes(rows.tobytes())
                numbers.frombytes(np.arange(line, line + len(rows)).tobytes())
                line += len(rows)
                few = min(few, lines - line)
            end = at
            for _ in range(few):
                end = block.index(self.delimiter, end) + 1
            for text in block[at:end].split(self.delimiter)[:few]:
                item = self._parser.read(text) if len(text) <= self._longest else Other.DAMAGED
                if isinstance(item, tuple):
                    if self._trusts_first or not self._first:
                        values.extend(item)
                        numbers.append(line)
                elif item:
                    if Other.DAMAGED in item:
                        self.example = text
                        self._damaged_bytes += len(text)
                    others.append((len(numbers), item & ~Other.DAMAGED if self._first else item))
                self._first = False
                line += 1
            at = end
        rows = np.array(values).reshape(len(numbers), -1) if numbers else np.empty((0, 1), dtype=np.int64)
        return LineBatch(rows, np.array(numbers), others, lines)

    def _alike(self, block: bytes, at: int) -> tuple[NDArray[np.int64], int, int]:
        """Return the values in the lines from a place in a block on that are alike, (n, k), and where these end.

        The last value is how many lines from there on are to be read one by one before others are searched for.
        """
        none = np.empty((0, 1), dtype=np.int64)
        found = None if self._parser.alike is None else self._parser.alike.match(block, at)
        lines = 0 if found is None else block.count(self.delimiter, at, found.end())
        if found is None or lines < FEWEST_ALIKE:
            self._parser.missed()
            return none, at, FEWEST_ALIKE if self._parser.alike is None else lines + 1
        rows = self._parser.read_alike(found[0])
        end = found.end()
        if len(rows) < lines:
            end = at
            for _ in range(len(rows)):
                end = block.index(self.delimiter, end) + 1
        return rows, end, 1


class LineTally(Tally):
    """How far a stream of lines has come, by their times; see `daq.protocols.session.Tally`."""

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
        """Take bytes as they came."""
        self._at_s = at_s
        batch = self._reader.feed(data)
        ticks, at = batch.rows[:, 0].tolist(), 0
        for behind, other in batch.others:
            if Other.START in other:
                self._advance(ticks[at:behind])
                at = behind
                self.resets += self._last is not None
                self._last = None
                self._least.begin()
        self._advance(ticks[at:])

    def begin_again(self, reached: int) -> None:
        """Begin anew, ``reached`` periods after the start."""
        self._reader = self._make_reader()
        self._last, self._odd = None, 0
        self._least.begin()
        super().begin_again(reached)

    def _advance(self, lines: list[int]) -> None:
        """Take the times of lines."""
        self.received += len(lines)
        last, usual, periods = self._last, 0, 0
        for ticks in lines:
            if last is None:
                self.reached += 1
                last = ticks
                continue
            step = ticks - last & 0xFFFFFFFF
            if 0 < step <= self._most:
                if step != usual:
                    usual, periods = step, round(step / self._period) or 1
                self.reached += periods
                self._device += step
                last, self._odd = ticks, 0
                continue
            self._odd += 1
            if self._odd > LOOK_AHEAD:  # not one damaged line: there is a gap, or the board has started anew
                self._odd = 0
                ahead = signed(step, 32)
                self._device += ahead
                if ahead < 0 or self._leapt(ahead):
                    self.resets += 1
                    self._least.begin()
                else:  # a time that stands still is no start
                    self.reached += round(ahead / self._period)
                last = ticks
        self._last = last
        if self._at_s is not None and lines:
            device_s = self._device * self._tick_s
            self._least.note([device_s], [self._at_s - device_s])

    def _leapt(self, ahead: int) -> bool:
        """Return whether a time that is now so many ticks ahead of the last good one has leapt (`LeastDelay`)."""
        device_s = self._device * self._tick_s
        return self._at_s is not None and self._least.leapt(device_s, self._at_s - device_s, ahead * self._tick_s)


def pieces(
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

    Lines that cannot be true are counted as damaged.  The pieces make together what a single one is; a start or damage
    behind a piece's last frame belongs to the first frame of the next one.

    reads: Host's monotonic stamp in ns at the end of each read, and the bytes it gave.  With more than one piece, it
        must give the same whenever it is asked.
    make_reader, ident, period_ticks: Makes a reader of this protocol's lines; what is known of the board; the nominal
        sample interval.
    net: There is but one counter, a signed net count.
    most_bytes: A piece is made of about so many; infinite: one piece.
    resolution: Ticks by which its clock may advance at once, if its times are multiples of that; 0: its times are
        exact.
    """
    source = _taken(reads, make_reader(), most_bytes)
    begun = next(source)
    again: Iterator[_Taken] = chain([begun], source)
    if resolution:
        most = math.inf
        if not begun.last:
            delimiter = make_reader().delimiter
            most = sum(data.count(delimiter) for _, data in reads)
        if _is_finer(again, resolution, most):
            resolution = 0
        again = iter([begun]) if begun.last else _taken(reads, make_reader(), most_bytes)
    judge = Judge(ident.counter_bits, period_ticks, resolution, ident.tick_ns, net=net)
    waiting = 0  # bytes discarded since the last piece
    for taken in again:
        lines = judge.feed(taken.lines, taken.last)
        waiting += taken.discarded_bytes
        if len(lines) or taken.last:
            yield _stream(lines, ident, taken.damaged + judge.damaged if taken.last else 0, waiting)
            waiting = 0


class _Taken(NamedTuple):
    """What some reads hold."""

    lines: Lines  # the lines with samples
    damaged: int  # damaged lines behind the last of these
    discarded_bytes: int  # see `LineReader`; of these reads
    last: bool  # no more reads follow


def _taken(reads: Iterable[tuple[int, bytes]], reader: LineReader, most_bytes: float) -> Iterator[_Taken]:
    """Yield what the reads hold, in pieces."""
    between = Between()
    parts: list[Lines] = []
    ends: list[tuple[int, int]] = []  # of each read since the last block: its stamp, and how many lines it ended
    block = bytearray()
    taken = discarded = 0
    ahead = 0  # 1 where an endless line has been cut that no read has ended yet

    def parsed() -> Lines:
        nonlocal ahead
        batch = reader.feed(bytes(block))
        stamps = np.repeat(*np.array(ends, dtype=np.int64).reshape(-1, 2).T)
        n = len(batch.line)
        fresh, damaged = np.zeros(n + 1, dtype=np.bool_), np.zeros(n + 1, dtype=np.int64)
        for behind, other in batch.others:
            fresh[behind] |= Other.START in other
            damaged[behind] += Other.DAMAGED in other
        columns = np.zeros((5, n), dtype=np.int64)
        columns[: batch.rows.shape[1]] = batch.rows.T
        line = batch.line + ahead
        ahead += batch.lines - len(stamps)
        block.clear()
        ends.clear()
        ticks, up, down, status, illegal = columns
        fresh, damaged = between.before(fresh, damaged)
        return Lines(ticks, ticks, up, down, status, illegal, stamps[line], fresh, damaged, np.zeros_like(ticks))

    for stamp, read in reads:
        for at in range(0, len(read), BLOCK_BYTES):
            data = read[at : at + BLOCK_BYTES]
            ends.append((stamp, data.count(reader.delimiter)))
            block += data
            if len(block) < min(BLOCK_BYTES, most_bytes):
                continue
            taken += len(block)
            parts.append(parsed())
            if taken >= most_bytes:
                yield _Taken(arrays.joined(parts), between.damaged, reader.discarded_bytes - discarded, last=False)
                taken, discarded = 0, reader.discarded_bytes
                parts.clear()
    parts.append(parsed())
    yield _Taken(arrays.joined(parts), between.damaged, reader.discarded_bytes - discarded, last=True)


def _is_finer(pieces: Iterable[_Taken], resolution: int, most: float) -> bool:
    """Return whether more than a tenth of the times, at most so many, are no multiples of a resolution."""
    finer = lines = 0
    for taken in pieces:
        finer += int(np.count_nonzero(taken.lines.ticks % resolution))
        lines += len(taken.lines)
        if finer > 0.1 * most:
            return True
    return finer > 0.1 * lines


def _stream(lines: Lines, ident: frames.Ident, damaged: int, discarded_bytes: int) -> Stream:
    """Return lines as frames; ``damaged`` lines stand behind the last of them."""
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
        discarded_bytes=discarded_bytes,
        length=np.zeros(n, dtype=np.int64),
    )
