"""Samples that come as lines of text, without frames, sequence numbers or a checksum: what guards them, and a stream.

Guards: a line must match its whole pattern, so that most damage (a byte that is no digit, a byte too few or too many)
is seen.  A flipped digit is still a digit; `daq.protocols.neighbours` finds it by the lines around it.  What cannot be
seen is a wrong last digit, and damaged lines side by side.  Of lines damaged at random, 0.8 % pass in a QSB's records,
2 % in text lines, and less than 1 of 256 in text lines with a column xor.

Lost lines show in the time: a step of n periods is n - 1 lines lost.  A sequence number is made from the time, one
period a number, and a net count is split into what went up and what went down, so that everything behind this module is
the same as for frames.
"""

from array import array
from collections.abc import Callable, Iterable
from enum import IntFlag
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from daq.protocols.neighbours import LOOK_AHEAD, judge
from daq.protocols.session import Tally
from daq.wire import frames
from daq.wire.counters import LATE_FRAMES, moves, signed
from daq.wire.decode import Stream
from daq.wire.splitter import Splitter


class Other(IntFlag):
    """What a line is that holds no sample."""

    REMARK = 0
    DAMAGED = 1
    START = 2  # the board reports its start; with `DAMAGED` after a line that its reset cut short


# What a sample's line holds, as far as the protocol has it: ticks, up, down, status, illegal, each modulo its width.  A
# net count stands for up.
Row = tuple[int, ...]


class LineReader:
    """Read samples from a stream of lines; never raises on garbage, back in step at the next delimiter.

    Parameters
    ----------
    delimiter, longest : bytes, int
        What ends a line, and bytes beyond which a line is damaged.
    parse : callable
        Returns what a line holds.
    trusts_first : bool
        A first line that has lost its beginning is seen as damaged by its form.  It is no error then; where it could
        not be seen, the first line is no sample either.

    Attributes
    ----------
    example : bytes
        The last line that was damaged; the first one of a stream may only be cut.
    """

    def __init__(
        self, delimiter: bytes, longest: int, parse: Callable[[bytes], Row | Other], *, trusts_first: bool
    ) -> None:
        self.example = b""
        self._splitter = Splitter(delimiter, longest)
        self._longest = longest
        self._parse = parse
        self._trusts_first = trusts_first
        self._first = True
        self._damaged_bytes = 0

    @property
    def discarded_bytes(self) -> int:
        """Bytes of all damaged lines, delimiters not included."""
        return self._damaged_bytes + self._splitter.dropped_bytes

    def feed(self, data: bytes) -> tuple[list[Row], list[tuple[int, Other]]]:
        """Take bytes as they came; return the samples in order, and damage and starts: each behind how many of them."""
        rows: list[Row] = []
        others: list[tuple[int, Other]] = []
        for line in self._splitter.feed(data):
            item = self._parse(line) if len(line) <= self._longest else Other.DAMAGED
            if isinstance(item, tuple):
                if self._trusts_first or not self._first:
                    rows.append(item)
            elif item:
                if Other.DAMAGED in item:
                    self.example = line
                    self._damaged_bytes += len(line)
                if self._first:
                    item &= ~Other.DAMAGED
                others.append((len(rows), item))
            self._first = False
        return rows, others


class LineTally(Tally):
    """How far a stream of lines has come, by their times; see `daq.protocols.session.Tally`."""

    def __init__(self, make_reader: Callable[[], LineReader], period_ticks: float) -> None:
        super().__init__()
        self._make_reader = make_reader
        self._reader = make_reader()
        self._period = period_ticks
        self._last: int | None = None
        self._odd = 0  # lines in a row whose times do not follow the last good one

    def feed(self, data: bytes) -> None:
        """Take bytes as they came."""
        rows, others = self._reader.feed(data)
        starts = [behind for behind, other in others if Other.START in other]
        for behind in range(len(rows) + 1):
            if behind in starts and self._last is not None:
                self.resets += 1
                self._last = None
            if behind < len(rows):
                self._step(rows[behind][0])

    def begin_again(self, reached: int) -> None:
        """Begin anew, ``reached`` periods after the start."""
        self._reader = self._make_reader()
        self._last, self._odd = None, 0
        super().begin_again(reached)

    def _step(self, ticks: int) -> None:
        """Take the time of a line."""
        if self._last is None:
            self.reached += 1
            self._last = ticks
            return
        periods = signed(ticks - self._last, 32) / self._period
        if 0 < periods <= LATE_FRAMES:
            self.reached += max(1, round(periods))
            self._last, self._odd = ticks, 0
            return
        self._odd += 1
        if self._odd > LOOK_AHEAD:  # not one damaged line: there is a gap, or the board has started anew
            self._odd = 0
            if periods > 0:
                self.reached += round(periods)
            else:
                self.resets += 1
            self._last = ticks


def decode(
    reads: Iterable[tuple[int, bytes]],
    reader: LineReader,
    ident: frames.Ident,
    period_ticks: float,
    *,
    net: bool,
    resolution: int = 0,
) -> Stream:
    """Decode the reads of one connection into frames of one sample each.

    Lines that cannot be true are counted as damaged.

    Parameters
    ----------
    reads : iterable of (int, bytes)
        Host's monotonic stamp in ns at the end of each read, and the bytes it gave.
    reader, ident, period_ticks
        Reader of this protocol's lines, what is known of the board, and the nominal sample interval.
    net : bool
        There is but one counter, a signed net count.
    resolution : int
        Ticks by which its clock may advance at once, if its times are multiples of that; 0: its times are exact.
    """
    values = array("q")
    stamps: list[int] = []  # of each good line
    found: list[tuple[int, Other]] = []  # behind how many good lines
    for stamp, data in reads:
        rows, others = reader.feed(data)
        found += [(len(stamps) + behind, other) for behind, other in others]
        values.extend(chain.from_iterable(rows))
        stamps += [stamp] * len(rows)
    bad, begun = ([behind for behind, other in found if what in other] for what in (Other.DAMAGED, Other.START))
    columns = np.zeros((5, len(stamps)), dtype=np.int64)
    sent = np.frombuffer(values, dtype=np.int64).reshape(len(stamps), -1).T if stamps else columns
    columns[: len(sent)] = sent
    ticks, up, down, status, illegal = columns
    if resolution and np.count_nonzero(ticks % resolution) > 0.1 * len(ticks):
        resolution = 0  # the times are finer
    judged = judge(ticks, up - down, bits=ident.counter_bits, period=period_ticks, starts=begun, resolution=resolution)
    keep = judged.keep
    damaged = np.sort(np.concatenate((np.array(bad, dtype=np.int64), np.flatnonzero(~keep))))
    kept = np.concatenate(([0], np.cumsum(keep)))  # lines kept before each good one
    ticks, up, down = judged.ticks, up[keep], down[keep]
    if net:
        up, down = _two_counters(up, ident.counter_bits)
    n = len(ticks)
    wide = ident.counter_bits > 16
    return Stream(
        first=np.arange(n),
        n=np.ones(n, dtype=np.int64),
        seq=judged.number & 0xFFFF,
        ticks=ticks,
        illegal=illegal[keep],
        stamp_ns=np.array(stamps, dtype=np.int64)[keep],
        dt=np.zeros(n, dtype=np.uint16),
        up=up.astype(np.uint32) if wide else up.astype(np.uint16),
        down=down.astype(np.uint32) if wide else down.astype(np.uint16),
        status=status[keep].astype(np.uint8),
        ident=ident,
        idents=judged.starts,
        time_error=judged.time_error,
        crc_frame=kept[damaged],
        crc_errors=len(damaged),
        discarded_bytes=reader.discarded_bytes,
        length=np.zeros(n, dtype=np.int64),
    )


def _two_counters(count: NDArray[np.int64], bits: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the up and the down counter that a net count stands for: up - down is the count, and both only rise."""
    step = moves(count, bits)
    down = np.concatenate(([0], np.cumsum(np.maximum(-step, 0))))[: len(count)]
    limit = (1 << bits) - 1
    return (count + down) & limit, down & limit
