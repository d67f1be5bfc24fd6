"""Counters that roll over: unwrapped by differences modulo their width, and checked against the other data sent.

Rule: the difference of two readings, taken modulo 2^bits, is the true increment as long as it is below 2^bits.  For a
16-bit counter that holds across gaps shorter than 65,536 / peak count rate (0.6 s for x4 at 107 k edges/s).  Across a
longer gap the counts are unknown: a new segment begins there, marked invalid.

The sequence number (16 bit) is unwrapped with the help of the device time (32 bit, 71.6 min at 1 us): a gap may be
longer than 65,536 samples and still gets its true length.  The two must agree on it: where they do not, the board has
been reset, or one of them is wrong, and the samples between are unknown.

The host's checks are in the high byte of a sample's flags; the low byte is the status as sent (`daq.wire.frames`).
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.wire.quadrature import PHASE

Integer = TypeVar("Integer", int, NDArray[np.int64])

# Up to so many frames back, a frame is a repeat or late, of which there are few; further back, the board has restarted.
LATE_FRAMES = 8
# How far, in sample periods, sequence number and device time may disagree on the length of a gap: 2 and 5 % of it, at
# most 200, so that 200 of 32,768 resets pass for a gap because the clock happens to have advanced.
GAP_DOUBT, GAP_DOUBT_SHARE, GAP_DOUBT_MOST = 2.0, 0.05, 200.0

FEWEST_TO_PACE = 16  # consecutive frames from which the true sample period is estimated

# The host's checks, one bit each.
FLAG_ILLEGAL = 0x0100  # the illegal count rose within this sample's frame
FLAG_PHASE = 0x0200  # (up - down) mod 4 is not the phase of the levels sent with it
FLAG_BOTH = 0x0400  # up and down both changed since the previous sample
FLAG_GAP = 0x0800  # samples are missing directly before this one
FLAG_TIME = 0x2000  # the time as sent was not true and has been interpolated (lines without a checksum)
FLAG_COUNT_UNCERTAIN = 0x1000  # illegal transitions before this sample: its count may be off by two for each


def diff_unsigned(values: NDArray[np.integer], bits: int | NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the increments between neighbouring readings, (n,), of an up-counter, (n - 1,), each 0 to 2^bits - 1.

    ``bits`` may be one for each increment, (n - 1,).
    """
    readings = values.astype(np.int64)
    return np.asarray(readings[1:] - readings[:-1] & (1 << bits) - 1, dtype=np.int64)


def wrap_signed(value: Integer, bits: int | NDArray[np.int64]) -> Integer:
    """Return ``value`` modulo 2^bits as the number nearest to zero: -2^(bits-1) to 2^(bits-1) - 1."""
    half: Any = 1 << (bits - 1)
    wrapped: Integer = (value + half & (1 << bits) - 1) - half
    return wrapped


def diff_signed(values: NDArray[np.integer], bits: int | NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the signed increments between neighbouring readings, (n,), of an up-and-down counter, (n - 1,).

    Each is the shorter of the two ways: -2^(bits-1) to 2^(bits-1) - 1.
    """
    return wrap_signed(diff_unsigned(values, bits), bits)


def net_count(
    up: NDArray[np.unsignedinteger],
    down: NDArray[np.unsignedinteger],
    begins: NDArray[np.bool_],
    bits: NDArray[np.int64],
    scale: NDArray[np.int64],
    before: int | None = None,
) -> NDArray[np.int64]:
    """Return the net count up - down without roll-over, (n,), n at least 1; each segment, where it ``begins``, anew.

    Its first value is the signed difference, which is correct if the counters have moved by less than half their range
    since power-up, net; otherwise it is off by a multiple of 2^bits.  The first value of all is ``before``, if given.
    ``bits`` is the counters' width, and ``scale`` what one of their counts is, of each sample.
    """
    first = wrap_signed(up.astype(np.int64) - down, bits) * scale
    if before is not None:
        begins, first[0] = np.concatenate(([True], begins[1:])), before
    steps = diff_unsigned(up, bits[1:]) - diff_unsigned(down, bits[1:])
    return running_sum(begins, steps * scale[1:], first)


def longest_gap_s(max_edge_rate_hz: float, edges_per_count: int, bits: int) -> float:
    """Return the longest gap, s, across which a counter cannot have rolled over undetected; infinite for rate 0."""
    if max_edge_rate_hz <= 0:
        return float("inf")
    return (1 << bits) * edges_per_count / max_edge_rate_hz


@dataclass(frozen=True)
class Order:
    keep: NDArray[np.bool_]  # (f,) false for a repeated or late frame, which is not used
    # (f,) the stream restarts at this frame: sequence and device time do not continue together
    restart: NDArray[np.bool_]
    jump: NDArray[np.bool_]  # (f,) restarts that the board did not announce by an identification
    # (f,) the sequence continues, and the device time advances by more or less than that: the clock has leapt, or the
    # board has paused.  Number and time are continued nevertheless.
    leap: NDArray[np.bool_]
    # (f,) sequence number and device time of the frame's first sample without roll-over: as sent at the first frame
    # after each restart (a jump: from sequence number 0), and continued from there.  0 where ``keep`` is False.
    index: NDArray[np.int64]
    ticks: NDArray[np.int64]


class FrameOrder:
    """Place the frames of a stream: undo roll-over, measure gaps, find repeats and restarts.

    The frames come in pieces; the true sample period is that of all frames so far.  Device time determines how often
    the sequence number rolled over between two frames, so a gap may have any length below 2^31 ticks (35.8 min at
    1 us).  A frame that steps back in time, and in sequence by as many samples, by `LATE_FRAMES` at most,
    is a repeat or late.  Any other step back, of either, and a gap on whose length the two disagree (`agree_on_gap`),
    is a jump; where the sequence shows no gap, it is a leap of the time alone.

    ticks_per_sample: Nominal sample interval.
    """

    def __init__(self, ticks_per_sample: float) -> None:
        self._nominal = ticks_per_sample
        self._pace = _Pace()
        self._repeats = _Repeats(ticks_per_sample)
        self._last: tuple[int, int, int, int, int] | None = None  # kept: seq, ticks, n, and its place: index, ticks

    def place(
        self, seq: NDArray[np.int64], ticks: NDArray[np.int64], n: NDArray[np.int64], restarts: NDArray[np.int64]
    ) -> Order:
        """Place the next frames.

        ``seq`` and ``ticks``, (f,), are as sent: modulo 2^16 and 2^32; ``n``, (f,), is the samples in each frame.
        Before the frames ``restarts``, (r,), the board identified itself.
        """
        keep, restart, announced = self._repeats.find(seq, ticks, n, restarts)
        kept = np.flatnonzero(keep)
        step, forward, previous_n = self._find_steps(seq[kept], ticks[kept], n[kept])
        self._pace.add(step, forward, previous_n)
        period, doubt = self._pace.estimate(self._nominal)
        step += 65536 * np.round((forward / period - step) / 65536).astype(np.int64)
        first = 0 if self._last else 1  # the first frame of all follows none
        restarts_here, agrees = restart[kept[first:]], agree_on_gap(step, forward / period, doubt)
        restarts_here = restarts_here | (step < previous_n) | ((step != previous_n) & ~agrees)
        restart[kept[first:]] = restarts_here
        leap = np.zeros(len(seq), dtype=np.bool_)
        leap[kept[first:]] = ~restarts_here & ~agrees
        restart[kept[:first]] = False
        jump = restart & ~announced
        index = np.zeros(len(seq), dtype=np.int64)
        total_ticks = np.zeros(len(seq), dtype=np.int64)
        if len(kept):
            first_index, first_ticks = np.where(jump, 0, seq)[kept], ticks[kept]
            if self._last:
                first_index = np.concatenate(([self._last[3]], first_index))
                first_ticks = np.concatenate(([self._last[4]], first_ticks))
            starts = np.concatenate(([True], restarts_here))
            index[kept] = running_sum(starts, step, first_index)[1 - first :]
            total_ticks[kept] = running_sum(starts, forward, first_ticks)[1 - first :]
            last = int(kept[-1])
            self._last = (int(seq[last]), int(ticks[last]), int(n[last]), int(index[last]), int(total_ticks[last]))
        return Order(keep, restart, jump, leap, index, total_ticks)

    def _find_steps(
        self, seq: NDArray[np.int64], ticks: NDArray[np.int64], n: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the steps to each kept frame from the previous one, in sequence and time, and its length."""
        if self._last:
            seq, ticks, n = (
                np.concatenate(([last], piece)) for last, piece in zip(self._last, (seq, ticks, n), strict=False)
            )
        return np.diff(seq) & 0xFFFF, np.diff(ticks) & 0xFFFFFFFF, n[:-1]


def agree_on_gap(
    step: NDArray[np.int64] | int, periods: NDArray[np.float64] | float, doubt: float = 0.0
) -> NDArray[np.bool_] | np.bool_:
    """Return whether a step of the sequence number and one of the device time, in sample periods, mean the same gap.

    ``doubt`` is how far off its grid the board takes samples, in periods.
    """
    return np.abs(step - periods) <= np.minimum(GAP_DOUBT + GAP_DOUBT_SHARE * step, GAP_DOUBT_MOST) + doubt


def is_late(back_in_seq: int, back: float, n: int) -> bool:
    """Return whether a frame that is back in sequence, and in time (sample periods), is a repeat or late.

    ``n`` is the samples in the newest frame.
    """
    return back_in_seq <= LATE_FRAMES * n and abs(back - back_in_seq) <= 2 + 0.05 * back_in_seq


class _Pace:
    """The ticks of a sample period between consecutive frames, and how far frames deviate from it.

    Frames of one length and distance in time are counted together: a board has few such distances.
    """

    def __init__(self) -> None:
        self._step = np.empty(0, dtype=np.int64)
        self._forward = np.empty(0, dtype=np.int64)
        self._count = np.empty(0, dtype=np.int64)

    def add(self, step: NDArray[np.int64], forward: NDArray[np.int64], previous_n: NDArray[np.int64]) -> None:
        """Add steps between frames in sequence and in time, and the samples in the first of each two, all (f,)."""
        follows = step == previous_n
        step, forward = (
            np.concatenate((old, new[follows])) for old, new in ((self._step, step), (self._forward, forward))
        )
        count = np.concatenate((self._count, np.ones(np.count_nonzero(follows), dtype=np.int64)))
        distinct, which = np.unique(forward << 16 | step, return_inverse=True)
        self._forward, self._step = distinct >> 16, distinct & 0xFFFF
        self._count = np.bincount(which, count, len(distinct)).astype(np.int64)

    def estimate(self, nominal: float) -> tuple[float, float]:
        """Return the period, and twice the deviation from it that 99 % of the frames keep to.

        ``nominal``, ticks, is returned if few frames are consecutive.
        """
        if self._count.sum() < FEWEST_TO_PACE:
            return nominal, 0.0
        period = _weighted_quantile(self._forward / self._step, self._count, 0.5)
        if not 0.5 * nominal < period < 2 * nominal:
            return nominal, 0.0
        return period, 2 * _weighted_quantile(np.abs(self._forward / period - self._step), self._count, 0.99)


def _weighted_quantile(values: NDArray[np.float64], count: NDArray[np.int64], share: float) -> float:
    """Return the quantile of values that occur so many times each, interpolated as by `np.quantile`."""
    order = np.argsort(values)
    values, ends = values[order], np.cumsum(count[order])
    rank = (int(ends[-1]) - 1) * share
    low, high = values[np.searchsorted(ends, [int(rank), min(int(rank) + 1, int(ends[-1]) - 1)], side="right")]
    return float(np.quantile([low, high], rank - int(rank)))


class _Repeats:
    """Finds repeated and late frames, and the frames at which the stream restarts, among frames that come in pieces."""

    def __init__(self, ticks_per_sample: float) -> None:
        self._ticks_per_sample = ticks_per_sample
        self._newest: tuple[int, int, int] | None = None  # seq, ticks, n
        self._announced = False  # an identification came after the last frame

    def find(
        self, seq: NDArray[np.int64], ticks: NDArray[np.int64], n: NDArray[np.int64], restarts: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which frames to keep, where the stream restarts, and where the board announced that, (f,) each."""
        keep = np.ones(len(seq), dtype=np.bool_)
        announced = np.zeros(len(seq), dtype=np.bool_)
        announced[restarts[restarts < len(seq)]] = True
        announced[: int(self._announced)] = True
        self._announced = bool((restarts >= len(seq)).any()) or (self._announced and not len(seq))
        restart = announced.copy()
        if len(seq) == 0:
            return keep, restart, announced
        first = 0 if self._newest else 1
        newest = self._newest or (int(seq[0]), int(ticks[0]), int(n[0]))
        forward = np.diff(ticks[first:], prepend=newest[1]) & 0xFFFFFFFF
        if np.all((forward > 0) & (forward < 1 << 31)):
            self._newest = int(seq[-1]), int(ticks[-1]), int(n[-1])
            return keep, restart, announced
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
        return keep, restart, announced


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
    """Return the difference, modulo 4, between x4 counts and the phase of the levels sent with them, (n,), 0 to 3."""
    return np.asarray(((up - down) - PHASE[levels & 3]) & 3).astype(np.uint8)


def check_both_moved(up: NDArray[np.unsignedinteger], down: NDArray[np.unsignedinteger]) -> NDArray[np.bool_]:
    """Return where both counters changed since the previous sample, (n,); False at the first sample.

    An x4 decoder does that at every reversal.  With a J-K box it means pulses for which the count cannot be trusted.
    """
    moved = np.zeros(len(up), dtype=np.bool_)
    moved[1:] = (np.diff(up) != 0) & (np.diff(down) != 0)
    return moved
