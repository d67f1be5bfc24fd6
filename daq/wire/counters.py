"""Counters that roll over: unwrapped by differences modulo their width, and checked against the other data sent.

Rule: the difference of two readings, taken modulo 2^bits, is the true increment as long as it is below 2^bits.  For a
16-bit counter that holds across gaps shorter than 65,536 / peak count rate (0.6 s for x4 at 107 k edges/s).  Across a
longer gap the counts are unknown: a new segment begins there, marked invalid.

The sequence number (16 bit) is unwrapped with the help of the device time (32 bit, 71.6 min at 1 us): a gap may be
longer than 65,536 samples and still gets its true length.

The host's checks are in the high byte of a sample's flags; the low byte is the status as sent (`daq.wire.frames`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.wire.quadrature import PHASE

# A frame up to so many frames back is a repeat or came late; further back, the board has restarted.  A line repeats or
# delays only a few: half would take some of them for restarts, double more restarts for repeats.  Not swept.
LATE_FRAMES = 8

# The host's checks, one bit each.
FLAG_ILLEGAL = 0x0100  # the illegal count rose within this sample's frame
FLAG_PHASE = 0x0200  # (up - down) mod 4 is not the phase of the levels sent with it
FLAG_BOTH = 0x0400  # up and down both changed since the previous sample
FLAG_GAP = 0x0800  # samples are missing directly before this one
FLAG_COUNT_UNCERTAIN = 0x1000  # illegal transitions came before this sample: its count may be off by two for each


def increments(values: NDArray[np.integer], bits: int) -> NDArray[np.int64]:
    """Return the increments between neighbouring readings, (n,), of an up-counter, (n - 1,), each 0 to 2^bits - 1."""
    whole = values.astype(np.int64)
    return np.asarray(whole[1:] - whole[:-1] & (1 << bits) - 1, dtype=np.int64)


def moves(values: NDArray[np.integer], bits: int) -> NDArray[np.int64]:
    """Return the signed increments between neighbouring readings, (n,), of an up-and-down counter, (n - 1,).

    Of the two directions the shorter one is taken: each is -2^(bits-1) to 2^(bits-1) - 1.
    """
    half = 1 << (bits - 1)
    whole = values.astype(np.int64)
    return np.asarray((whole[1:] - whole[:-1] + half & (1 << bits) - 1) - half, dtype=np.int64)


def unwrap(values: NDArray[np.integer], bits: int) -> NDArray[np.int64]:
    """Return an up-counter's readings, counts, without roll-over, (n,), starting at its first reading."""
    out = np.empty(len(values), dtype=np.int64)
    if len(values):
        out[0] = int(values[0])
        np.cumsum(increments(values, bits), out=out[1:])
        out[1:] += out[0]
    return out


def signed(value: int, bits: int) -> int:
    """Return ``value`` modulo 2^bits as the number nearest to zero: -2^(bits-1) to 2^(bits-1) - 1."""
    half = 1 << (bits - 1)
    return (value + half) % (1 << bits) - half


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
    """Order and place of the f frames of one stream, in order of arrival.

    Attributes
    ----------
    keep : (f,) bool
        False for a repeated or late frame, which is not used.
    restart : (f,) bool
        The board restarted with this frame: neither sequence nor device time continues.
    index, ticks : (f,) int64
        Sequence number and device time of the frame's first sample without roll-over: as sent at the first frame
        after each restart, and continued from there.  0 where ``keep`` is False.
    """

    keep: NDArray[np.bool_]
    restart: NDArray[np.bool_]
    index: NDArray[np.int64]
    ticks: NDArray[np.int64]


def order_frames(
    seq: NDArray[np.int64],
    ticks: NDArray[np.int64],
    n: NDArray[np.int64],
    ticks_per_sample: float,
    restarts: NDArray[np.int64],
) -> Order:
    """Place the frames of a stream: undo roll-over, measure gaps, find repeats and restarts.

    Device time determines how often the sequence number rolled over between two frames, so a gap may have any length
    below 2^31 ticks (35.8 min at 1 us).  A frame that steps back in time, and in sequence by as many samples, by
    `LATE_FRAMES` at most, is a repeat or came late; any other step back, of either, is a restart of the board.

    Parameters
    ----------
    seq, ticks : (f,) int64
        As sent: modulo 2^16 and 2^32.
    n : (f,) int64
        Samples in each frame.
    ticks_per_sample : float
        Nominal sample interval.
    restarts : (r,) int64
        Frames before which the board is known to have restarted: it identified itself.
    """
    keep, restart = _repeats(seq, ticks, n, ticks_per_sample, restarts)
    kept = np.flatnonzero(keep)
    forward = np.diff(ticks[kept]) & 0xFFFFFFFF
    step = np.diff(seq[kept]) & 0xFFFF
    step += 65536 * np.round((forward / ticks_per_sample - step) / 65536).astype(np.int64)
    again = restart[kept[1:]] | (step < n[kept[:-1]])
    restart[kept[1:]] = again
    restart[kept[:1]] = False
    index = np.zeros(len(seq), dtype=np.int64)
    placed = np.zeros(len(seq), dtype=np.int64)
    starts = np.concatenate(([True], again)) if len(kept) else np.zeros(0, dtype=np.bool_)
    index[kept] = _sum_from(starts, step, seq[kept])
    placed[kept] = _sum_from(starts, forward, ticks[kept])
    return Order(keep, restart, index, placed)


def _repeats(
    seq: NDArray[np.int64],
    ticks: NDArray[np.int64],
    n: NDArray[np.int64],
    ticks_per_sample: float,
    restarts: NDArray[np.int64],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    keep = np.ones(len(seq), dtype=np.bool_)
    restart = np.zeros(len(seq), dtype=np.bool_)
    restart[restarts[restarts < len(seq)]] = True
    forward = np.diff(ticks) & 0xFFFFFFFF
    if np.all((forward > 0) & (forward < 1 << 31)):
        return keep, restart
    newest = 0
    for frame in range(1, len(seq)):
        ahead = (int(ticks[frame]) - int(ticks[newest])) & 0xFFFFFFFF
        if 0 < ahead < 1 << 31 or restart[frame]:
            newest = frame
            continue
        back = (-ahead & 0xFFFFFFFF) / ticks_per_sample
        back_in_seq = (int(seq[newest]) - int(seq[frame])) & 0xFFFF
        late = back_in_seq <= LATE_FRAMES * int(n[newest])
        if late and abs(back - back_in_seq) <= 2 + 0.05 * back_in_seq:
            keep[frame] = False
        else:
            restart[frame] = True
            newest = frame
    return keep, restart


def _sum_from(starts: NDArray[np.bool_], steps: NDArray[np.int64], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the running sum of ``steps`` (between neighbours), reset to ``first`` where ``starts`` is True."""
    if len(starts) == 0:
        return np.empty(0, dtype=np.int64)
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
