"""Readings of the host's and the device's clock out of a run: at ends of frames, and of reads that ended in one."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.finalise.clock_sync import ClockPoints, ClockSync, Points
from daq.finalise.timeline import Piece, split_parts
from daq.protocols.link_budget import BITS_PER_BYTE
from daq.runfile.spill import Spill
from stickslip.compute.arrays import joined, rows


class PartClock:
    """The clocks over one part of a run, whose pieces come in order.

    part: The part: the longest one of the run.
    baud: On a serial line of known speed every byte has its time, so reads that ended inside a frame count as well.
    by_bytes: Whether the length of the frames is known: not for text lines.
    spill: Storage of the points.
    """

    def __init__(self, part: int, baud: int | None, by_bytes: bool, spill: Spill) -> None:
        self._part = part
        self._byte_s = 0.0 if baud is None else BITS_PER_BYTE / baud
        self._reads = baud is not None
        self._by_bytes = by_bytes and self._reads
        self._points = ClockPoints(spill)
        self._first_ns = 0
        self._samples = 0
        self._last: _FrameEnds | None = None  # the last frame, whose next frame has not come
        self._held = Points(np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.int64))  # not yet in order
        self._held_kind = np.empty(0, dtype=np.int8)

    def take(self, piece: Piece) -> None:
        samples = piece.samples
        if not self._samples and len(samples):
            self._first_ns = int(samples.stamp_ns[0])
        for part, span in split_parts(samples):
            if part == self._part:
                self._take_part(piece, span)
        self._samples += len(samples)

    def compare(self) -> ClockSync:
        """Return the comparison of the clocks; ``index`` is the run's sample."""
        if self._last is not None:
            self._hold(self._last, np.array([np.nan]))
            self._release(np.inf)
        return self._points.compare(by_bytes=self._by_bytes)

    def _take_part(self, piece: Piece, span: slice) -> None:
        samples, frames = piece
        last = span.start + np.flatnonzero(np.diff(samples.frame[span], append=-1) != 0)
        frame = samples.frame[last]
        sent_s = np.zeros(len(last))
        if self._reads:
            sent_s = frames.length[frame - frames.first] * self._byte_s
        ends = _FrameEnds(samples.stamp_ns[last], samples.time[last], frame, self._samples + last, sent_s)
        cut_frames = frames.first + frames.part_frame if self._reads else np.empty(0, dtype=np.int64)
        ends_index = np.searchsorted(frame, cut_frames)
        has_samples = (ends_index < len(frame)) & (frame[np.minimum(ends_index, len(frame) - 1)] == cut_frames)
        with_last = ends if self._last is None else joined([self._last, ends])
        # What had not arrived yet: the next frame, if another read brought it.
        following = np.where(np.diff(with_last.host_ns) > 0, with_last.time[1:], np.nan)
        if self._by_bytes:
            # The next byte; after a frame, the first of the next one, if no byte of it had arrived.
            following[np.isin(with_last.frame[1:], cut_frames)] = np.nan
            following += self._byte_s
        self._hold(rows(with_last, slice(-1)), following)
        if has_samples.any():
            part_s = frames.part_bytes[has_samples] * self._byte_s
            inside = replace(
                rows(ends, ends_index[has_samples]), host_ns=frames.part_stamp_ns[has_samples], sent_s=part_s
            )
            after = inside.time + part_s + self._byte_s if self._by_bytes else np.full(len(part_s), np.nan)
            self._hold(inside, after, kind=1)
        self._last = rows(with_last, slice(-1, None))
        self._release(float(self._last.time[0]))

    def _hold(self, ends: "_FrameEnds", following: NDArray[np.float64], kind: int = 0) -> None:
        new = Points((ends.host_ns - self._first_ns) / 1e9, ends.time + ends.sent_s, following, ends.sample)
        self._held = joined([self._held, new])
        self._held_kind = np.concatenate((self._held_kind, np.full(len(following), kind, dtype=np.int8)))

    def _release(self, before_s: float) -> None:
        """Pass on the points before a time that no later one precedes: in order, frames before parts of them."""
        order = np.lexsort((self._held_kind, self._held.device))
        done = self._held.device[order] < before_s
        self._points.append(rows(self._held, order[done]))
        self._held, self._held_kind = rows(self._held, order[~done]), self._held_kind[order[~done]]


@dataclass(frozen=True)
class _FrameEnds:
    """Ends of frames, or of parts of them: stamp, last sample and its time, time of the bytes, (f,) each."""

    host_ns: NDArray[np.int64]
    time: NDArray[np.float64]
    frame: NDArray[np.int64]
    sample: NDArray[np.int64]
    sent_s: NDArray[np.float64]
