"""Counts unwrapped, segments cut, and every sample held against what came with it.

A new segment begins where the port came back, where the board restarted or its sequence numbers jumped, and after a gap
across which the counters (the belt's, too) may have rolled over unseen.  In each the count starts at the counters' own
difference: nothing is carried over, nothing is filled in.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from daq.finalise.timeline import PartReason, Samples
from daq.protocols import link_budget
from daq.runfile.rig import Rig
from daq.wire import counters, frames
from daq.wire.quadrature import EDGES_PER_COUNT

# A segment begins with a part (`daq.finalise.timeline`), or where the counters may have rolled over unseen.
SegmentReason = PartReason | Literal["invalid"]
PEAK_OVER_S = 1e-3  # over less, one count more or less would look like a fast motion


@dataclass(frozen=True)
class CheckedCounts:
    """The counts of n samples in s segments, and what is wrong with them.

    Attributes
    ----------
    count : (n,) int64
        Unwrapped net count.
    segment : (n,) uint16
        From 0.
    flags : (n,) uint16
        Status as sent, less the levels, and the host's checks (`daq.wire.counters`).
    lost : (n,) int64
        Samples missing right before each one.
    illegal : int
        Illegal transitions the board counted during this run.
    peak_count_rate : float
        Fastest counting over `PEAK_OVER_S` (over a sample where that is longer), counts/s.
    starts : (s,) int64
        First sample of each segment.
    reasons : tuple of SegmentReason
        What began each segment; of the first one it means nothing.
    """

    count: NDArray[np.int64]
    segment: NDArray[np.uint16]
    flags: NDArray[np.uint16]
    lost: NDArray[np.int64]
    illegal: int
    peak_count_rate: float
    reasons: tuple[SegmentReason, ...]
    starts: NDArray[np.int64]


def check(
    samples: Samples, ident: frames.Ident | None, rig: Rig, rate_hz: float, *, starts_at_phase: bool = True
) -> CheckedCounts:
    """Unwrap the counts, cut the run into segments, and flag what does not agree.

    Parameters
    ----------
    samples, ident, rig, rate_hz
        The run, who sent it, its calibration, and its nominal rate.
    starts_at_phase : bool
        The board's rule: an x4 counter starts at the phase of its levels.  Another sketch's may start anywhere; then
        the offset that most samples of a segment have is taken as its own.

    Raises
    ------
    ValueError
        There is no sample.
    """
    if len(samples) == 0:
        raise ValueError("nothing to check: there is no sample")
    bits = rig.counter_bits
    fresh = np.concatenate(([True], np.diff(samples.part) > 0))  # first sample of a part
    lost = np.zeros(len(samples), dtype=np.int64)
    lost[1:] = np.where(fresh[1:], 0, np.diff(samples.index) - 1)
    lost[fresh] = samples.index[fresh]  # a start numbers from 0, so what is missing there was lost, too
    interval = np.concatenate(([0.0], np.diff(samples.time)))
    edges = EDGES_PER_COUNT.get(rig.decoder, 1)
    # By its number, or by a time that no jitter explains: above 30 kHz jitter alone is more than half a period.
    gap = (lost > 0) | (interval > max(1.5 / rate_hz, PEAK_OVER_S))
    moved = np.maximum(counters.increments(samples.up, bits), counters.increments(samples.down, bits))
    peak = _peak_rate(samples.time, moved, gap | fresh, max(1, round(PEAK_OVER_S * rate_hz)))
    safe = counters.longest_gap_s(link_budget.peak_edge_rate_hz(ident, rig, peak * edges), edges, bits)
    if samples.belt is not None:
        moved_belt = np.abs(counters.moves(samples.belt, bits))
        belt_peak = _peak_rate(samples.time, moved_belt, gap | fresh, max(1, round(PEAK_OVER_S * rate_hz)))
        safe = min(safe, counters.longest_gap_s(2 * belt_peak, 1, bits - 1))
    invalid = gap & (interval > safe) & ~fresh
    starts = np.flatnonzero(fresh | invalid)
    segment = np.cumsum(fresh | invalid) - 1
    stretches = list(pairwise([*starts.tolist(), len(samples)]))
    count = np.empty(len(samples), dtype=np.int64)
    for start, stop in stretches:
        count[start:stop] = counters.net_count(samples.up[start:stop], samples.down[start:stop], bits)
    flags = (samples.status & ~np.uint8(frames.LEVELS)).astype(np.uint16)
    flags[lost > 0] |= counters.FLAG_GAP
    if samples.time_error is not None:
        flags[samples.time_error != 0] |= counters.FLAG_TIME
    both = counters.check_both_moved(samples.up, samples.down)
    both[starts] = False
    flags[both] |= counters.FLAG_BOTH
    if rig.decoder == "x4" and ident is not None and frames.Capability.LEVELS in ident.capabilities:
        wrong = counters.phase_error(samples.up, samples.down, samples.status)
        if not starts_at_phase:
            for start, stop in stretches:
                wrong[start:stop] -= np.bincount(wrong[start:stop], minlength=4).argmax().astype(np.uint8)
        flags[wrong & 3 != 0] |= counters.FLAG_PHASE
    rise = np.zeros(len(samples), dtype=np.int64)
    if ident is not None and frames.Capability.ILLEGAL in ident.capabilities:
        rise[1:] = counters.increments(samples.illegal, 16)
        rise[fresh] = 0  # what the board counted before this start is not this run's
        # The count stands for its whole frame, so every sample of the frame is suspect.
        flags[np.isin(samples.frame, samples.frame[rise > 0])] |= counters.FLAG_ILLEGAL
        # What was missed stays missing, and an even number of misses hides from the phase.
        total = np.cumsum(rise)
        begun = np.maximum.accumulate(np.where(fresh, np.arange(len(samples)), 0))
        flags[total > total[begun]] |= counters.FLAG_COUNT_UNCERTAIN
    reasons: tuple[SegmentReason, ...] = tuple(
        "invalid" if invalid[s] else samples.begun_by[samples.part[s]] for s in starts
    )
    return CheckedCounts(count, segment.astype(np.uint16), flags, lost, int(rise.sum()), peak, reasons, starts)


def _peak_rate(time: NDArray[np.float64], moved: NDArray[np.int64], broken: NDArray[np.bool_], stride: int) -> float:
    """Return the fastest counting (counts/s) over ``stride`` samples in a row that no gap breaks; 0 for one sample.

    Where gaps leave no stretch as long, the longest that there are must do: half of it, a quarter ...
    """
    total = np.concatenate(([0], np.cumsum(moved)))
    breaks = np.cumsum(broken)
    while stride:
        whole = breaks[stride:] == breaks[:-stride]
        if whole.any():
            rate = (total[stride:] - total[:-stride]) / (time[stride:] - time[:-stride])
            return float(rate[whole].max())
        stride //= 2
    return 0.0
