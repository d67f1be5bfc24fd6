"""Counters that roll over: unwrapped by differences modulo their width, and checked against the other data sent.

Rule: the difference of two readings, taken modulo 2^bits, is the true increment as long as it is below 2^bits.  For a
16-bit counter that holds across gaps shorter than 65,536 / peak count rate (0.6 s for x4 at 107 k edges/s).  Across a
longer gap the counts are unknown: a new segment begins there, marked invalid.

The sequence number (16 bit) is unwrapped with the help of the device time (32 bit, 71.6 min at 1 us): a gap may be
longer than 65,536 samples and still gets its true length.  The two must agree on it: where they do not, the board has
been reset, or one of them is wrong, and nothing is known of what lies between.

The host's checks are in the high byte of a sample's flags; the low byte is the status as sent (`daq.wire.frames`).
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.wire.quadrature import PHASE

Whole = TypeVar("Whole", int, NDArray[np.int64])

# A frame up to so many frames back is a repeat or came late; further back, the board has restarted.  A line repeats or
# delays only a few: half would take some of them for restarts, double more restarts for repeats.  Not swept.
LATE_FRAMES = 8
# How far, in sample periods, sequence number and device time may disagree on the length of a gap: 2 and 5 % of it, at
# most 200.  Half of the 200 would break gaps of minutes whose rate is known to 1e-4; double trusts twice as many of the
# resets after which the clock happens to have moved on (200 of 32,768 jumps).  Not swept.
GAP_DOUBT, GAP_DOUBT_SHARE, GAP_DOUBT_MOST = 2.0, 0.05, 200.0

FEWEST_TO_PACE = 16  # frames that follow each other from which the true sample period is taken

# The host's checks, one bit each.
FLAG_ILLEGAL = 0x0100  # the illegal count rose within this sample's frame
FLAG_PHASE = 0x0200  # (up - down) mod 4 is not the phase of the levels sent with it
FLAG_BOTH = 0x0400  # up and down both changed since the previous sample
FLAG_GAP = 0x0800  # samples are missing directly before this one
FLAG_TIME = 0x2000  # the time as sent was not true and has been interpolated (lines without a checksum)
FLAG_COUNT_UNCERTAIN = 0x1000  # illegal transitions came before this sample: its count may be off by two for each


def increments(values: NDArray[np.integer], bits: int | NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the increments between neighbouring readings, (n,), of an up-counter, (n - 1,), each 0 to 2^bits - 1.

    ``bits`` may be given for each increment, (n - 1,).
    """
    whole = values.astype(np.int64)
    return np.asarray(whole[1:] - whole[:-1] & (1 << bits) - 1, dtype=np.int64)


def signed(value: Whole, bits: int | NDArray[np.int64]) -> Whole:
    """Return ``value`` modulo 2^bits as the number nearest to zero: -2^(bits-1) to 2^(bits-1) - 1."""
    half: Any = 1 << (bits - 1)
    wrapped: Whole = (value + half & (1 << bits) - 1) - half
    return wrapped


def moves(values: NDArray[np.integer], bits: int | NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the signed increments between neighbouring readings, (n,), of an up-and-down counter, (n - 1,).

    Of the two directions the shorter one is taken: each is -2^(bits-1) to 2^(bits-1) - 1.
    """
    return signed(increments(values, bits), bits)


def unwrap(values: NDArray[np.integer], bits: int) -> NDArray[np.int64]:
    """Return an up-counter's readings, counts, without roll-over, (n,), starting at its first reading."""
    out = np.empty(len(values), dtype=np.int64)
    if len(values):
        out[0] = int(values[0])
        np.cumsum(increments(values, bits), out=out[1:])
        out[1:] += out[0]
    return out


def net_count(up: NDArray[np.unsignedinteger], down: NDArray[np.unsignedinteger], bits: int) -> NDArray[np.int64]:
    """Return the unwrapped net count up - down of one segment, (n,).

    The first value is the signed difference, which is correct when the counters have moved by less than half
    their range since power-up, net; it is off by a multiple of 2^bits otherwise.
    """
    if len(up) == 0:
        return np.empty(0, dtype=np.int64)
    start = signed(int(up[0]) - int(down[0]), bits)
    net = unwrap(up, bits) - unwrap(down, bits)
    return np.asarray(net - net[0] + start, dtype=np.int64)


def longest_gap_s(max_edge_rate_hz: float, edges_per_count: int, bits: int) -> float:
    """Return the longest gap, s, across which a counter cannot have rolled over undetected; infinite for rate 0."""
    if max_edge_rate_hz <= 0:
        return float("inf")
    return (1 << bits) * edges_per_count / max_edge_rate_hz


@dataclass(frozen=True)
class Order:
    """Order and place of the f frames of one stream, in order of arrival."""

    keep: NDArray[np.bool_]  # (f,) false for a repeated or late frame, which is not used
    # (f,) the stream begins anew with this frame: sequence and device time do not continue together
    restart: NDArray[np.bool_]
    jump: NDArray[np.bool_]  # (f,) of these, where nothing announced it: the board has not identified itself
    # (f,) the sequence goes on, and the device time moves on by more or less than that: the clock has leapt, or the
    # board has paused.  Number and time are continued all the same.
    leap: NDArray[np.bool_]
    # (f,) sequence number and device time of the frame's first sample without roll-over: as sent at the first frame
    # after each restart (a jump: from sequence number 0), and continued from there.  0 where ``keep`` is False.
    index: NDArray[np.int64]
    ticks: NDArray[np.int64]


class FrameOrder:
    """Place the frames of a stream: undo roll-over, measure gaps, find repeats and restarts.

    The frames come in pieces: all of them are surveyed first, then placed in the same order.  Device time determines
    how often the sequence number rolled over between two frames, so a gap may have any length below 2^31 ticks
    (35.8 min at 1 us).  A frame that steps back in time, and in sequence by as many samples, by `LATE_FRAMES` at most,
    is a repeat or came late.  Any other step back, of either, and a gap on whose length the two do not agree (`fits`),
    is a jump; where the sequence shows no gap, it is a leap of the time alone.

    ticks_per_sample: Nominal sample interval.
    """

    def __init__(self, ticks_per_sample: float) -> None:
        self._nominal = ticks_per_sample
        self._pace = _Pace()
        self._period, self._doubt = ticks_per_sample, 0.0
        self.begin()

    def begin(self) -> None:
        """Begin to place the frames, once more from the first one."""
        self._surveyed = False
        self._repeats = _Repeats(self._nominal)
        self._last: tuple[int, int, int, int, int] | None = None  # kept: seq, ticks, n, and its place: index, ticks

    def survey(
        self, seq: NDArray[np.int64], ticks: NDArray[np.int64], n: NDArray[np.int64], restarts: NDArray[np.int64]
    ) -> None:
        """Take the next frames, to learn the true sample period from all.

        seq, ticks: (f,) As sent: modulo 2^16 and 2^32.
        n: (f,) Samples in each frame.
        restarts: (r,) Frames before which the board is known to have restarted: it identified itself.
        """
        self._surveyed = True
        keep, _, _ = self._repeats.find(seq, ticks, n, restarts)
        step, forward, before = self._steps(seq[keep], ticks[keep], n[keep])
        self._pace.take(step, forward, before)
        if keep.any():
            self._last = (int(seq[keep][-1]), int(ticks[keep][-1]), int(n[keep][-1]), 0, 0)

    def place(
        self, seq: NDArray[np.int64], ticks: NDArray[np.int64], n: NDArray[np.int64], restarts: NDArray[np.int64]
    ) -> Order:
        """Place the next frames, given as to `survey`."""
        if self._surveyed:
            self._period, self._doubt = self._pace.found(self._nominal)
            self.begin()
        keep, restart, known = self._repeats.find(seq, ticks, n, restarts)
        kept = np.flatnonzero(keep)
        step, forward, before = self._steps(seq[kept], ticks[kept], n[kept])
        period = self._period
        step += 65536 * np.round((forward / period - step) / 65536).astype(np.int64)
        begun = 0 if self._last else 1  # the first frame of all follows none
        again, agrees = restart[kept[begun:]], fits(step, forward / period, self._doubt)
        again = again | (step < before) | ((step != before) & ~agrees)
        restart[kept[begun:]] = again
        leap = np.zeros(len(seq), dtype=np.bool_)
        leap[kept[begun:]] = ~again & ~agrees
        restart[kept[:begun]] = False
        jump = restart & ~known
        index = np.zeros(len(seq), dtype=np.int64)
        placed = np.zeros(len(seq), dtype=np.int64)
        if len(kept):
            first_index, first_ticks = np.where(jump, 0, seq)[kept], ticks[kept]
            if self._last:
                first_index = np.concatenate(([self._last[3]], first_index))
                first_ticks = np.concatenate(([self._last[4]], first_ticks))
            starts = np.concatenate(([True], again))
            index[kept] = running_sum(starts, step, first_index)[1 - begun :]
            placed[kept] = running_sum(starts, forward, first_ticks)[1 - begun :]
            at = int(kept[-1])
            self._last = (int(seq[at]), int(ticks[at]), int(n[at]), int(index[at]), int(placed[at]))
        return Order(keep, restart, jump, leap, index, placed)

    def _steps(
        self, seq: NDArray[np.int64], ticks: NDArray[np.int64], n: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the steps to each kept frame from the one before, in sequence and time, and the length of that one."""
        if self._last:
            seq, ticks, n = (
                np.concatenate(([last], own)) for last, own in zip(self._last, (seq, ticks, n), strict=False)
            )
        return np.diff(seq) & 0xFFFF, np.diff(ticks) & 0xFFFFFFFF, n[:-1]


def fits(
    step: NDArray[np.int64] | int, periods: NDArray[np.float64] | float, doubt: float = 0.0
) -> NDArray[np.bool_] | np.bool_:
    """Return whether a step of the sequence number and one of the device time, in sample periods, tell of one gap.

    ``doubt`` is how far off its grid the board takes samples, in periods.
    """
    return np.abs(step - periods) <= np.minimum(GAP_DOUBT + GAP_DOUBT_SHARE * step, GAP_DOUBT_MOST) + doubt


def is_late(back_in_seq: int, back: float, n: int) -> bool:
    """Return whether a frame that is back in sequence, and in time (sample periods), is a repeat or came late.

    ``n`` is the samples in the newest frame.
    """
    return back_in_seq <= LATE_FRAMES * n and abs(back - back_in_seq) <= 2 + 0.05 * back_in_seq


class _Pace:
    """The ticks of a sample period between frames that follow each other, and how far off that frames are.

    Frames of one length and distance in time are counted together: a board has few such distances.
    """

    def __init__(self) -> None:
        self._step = np.empty(0, dtype=np.int64)
        self._forward = np.empty(0, dtype=np.int64)
        self._count = np.empty(0, dtype=np.int64)

    def take(self, step: NDArray[np.int64], forward: NDArray[np.int64], before: NDArray[np.int64]) -> None:
        """Take steps between frames in sequence and in time, and the samples in the first of each two, all (f,)."""
        follows = step == before
        step, forward = (
            np.concatenate((old, new[follows])) for old, new in ((self._step, step), (self._forward, forward))
        )
        count = np.concatenate((self._count, np.ones(np.count_nonzero(follows), dtype=np.int64)))
        distinct, which = np.unique(forward << 16 | step, return_inverse=True)
        self._forward, self._step = distinct >> 16, distinct & 0xFFFF
        self._count = np.bincount(which, count, len(distinct)).astype(np.int64)

    def found(self, nominal: float) -> tuple[float, float]:
        """Return the period, and twice the deviation from it that 99 % of the frames keep to.

        ``nominal``, ticks, is returned where few frames follow each other.
        """
        if self._count.sum() < FEWEST_TO_PACE:
            return nominal, 0.0
        period = _quantile(self._forward / self._step, self._count, 0.5)
        if not 0.5 * nominal < period < 2 * nominal:
            return nominal, 0.0
        return period, 2 * _quantile(np.abs(self._forward / period - self._step), self._count, 0.99)


def _quantile(values: NDArray[np.float64], count: NDArray[np.int64], share: float) -> float:
    """Return the quantile of values that occur so many times each, interpolated as by `np.quantile`."""
    order = np.argsort(values)
    values, ends = values[order], np.cumsum(count[order])
    place = (int(ends[-1]) - 1) * share
    low, high = values[np.searchsorted(ends, [int(place), min(int(place) + 1, int(ends[-1]) - 1)], side="right")]
    return float(np.quantile([low, high], place - int(place)))


class _Repeats:
    """Which frames are repeats or came late, and which begin the stream anew, of frames that come in pieces."""

    def __init__(self, ticks_per_sample: float) -> None:
        self._ticks_per_sample = ticks_per_sample
        self._newest: tuple[int, int, int] | None = None  # seq, ticks, n
        self._announced = False  # an identification came after the last frame

    def find(
        self, seq: NDArray[np.int64], ticks: NDArray[np.int64], n: NDArray[np.int64], restarts: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which frames to keep, where a new stream begins, and where the board has announced that, (f,) each."""
        keep = np.ones(len(seq), dtype=np.bool_)
        known = np.zeros(len(seq), dtype=np.bool_)
        known[restarts[restarts < len(seq)]] = True
        known[: int(self._announced)] = True
        self._announced = bool((restarts >= len(seq)).any()) or (self._announced and not len(seq))
        restart = known.copy()
        if len(seq) == 0:
            return keep, restart, known
        first = 0 if self._newest else 1
        newest = self._newest or (int(seq[0]), int(ticks[0]), int(n[0]))
        forward = np.diff(ticks[first:], prepend=newest[1]) & 0xFFFFFFFF
        if np.all((forward > 0) & (forward < 1 << 31)):
            self._newest = int(seq[-1]), int(ticks[-1]), int(n[-1])
            return keep, restart, known
        for frame in range(first, len(seq)):
            sent = int(seq[frame]), int(ticks[frame]), int(n[frame])
            ahead = (sent[1] - newest[1]) & 0xFFFFFFFF
            if not (0 < ahead < 1 << 31 or restart[frame]):
                back = (-ahead & 0xFFFFFFFF) / self._ticks_per_sample
                if is_late((newest[0] - sent[0]) & 0xFFFF, back, newest[2]):
                    keep[frame] = False
                    continue
                restart[frame] = True
            newest = sent
        self._newest = newest
        return keep, restart, known


def running_sum(starts: NDArray[np.bool_], steps: NDArray[np.int64], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the running sum of ``steps`` (between neighbours), reset to ``first`` where ``starts`` is True, (n,).

    ``starts`` and ``first`` are (n,), n at least 1; the first of ``starts`` is True.
    """
    total = np.concatenate(([0], np.cumsum(steps)))
    origin = np.flatnonzero(starts)[np.cumsum(starts) - 1]
    return np.asarray(total - total[origin] + first[origin], dtype=np.int64)


def phase_error(
    up: NDArray[np.unsignedinteger], down: NDArray[np.unsignedinteger], levels: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Return the difference, modulo 4, of x4 counts from the phase of the levels sent with them, (n,), 0 to 3."""
    return np.asarray(((up - down) - PHASE[levels & 3]) & 3).astype(np.uint8)


def check_both_moved(up: NDArray[np.unsignedinteger], down: NDArray[np.unsignedinteger]) -> NDArray[np.bool_]:
    """Return where both counters changed since the previous sample, (n,); False at the first sample.

    An x4 decoder does that at every reversal.  With a J-K box it means pulses for which the count cannot be trusted.
    """
    moved = np.zeros(len(up), dtype=np.bool_)
    moved[1:] = (np.diff(up) != 0) & (np.diff(down) != 0)
    return moved
