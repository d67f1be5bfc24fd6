"""A run file as the live view reads it: its samples in pieces, their totals, and any stretch of them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from daq.live.tail import JournalTotals, NewSamples
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.wire import counters

PIECE = 1 << 16  # samples read at once: with fewer, compressed parts of the file are read more than once


class RunSamples:
    """The samples of a run file.

    path: The run file; it is only read.
    times: (n,) of all samples, s.
    header: The run with its first samples alone: title, calibration, markers.
    counts: Totals of the pieces so far; a table has no sequence numbers that could show a loss.
    Raises InputError if the file is missing, or not a run (`daq.runfile.store.load`).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counts = JournalTotals()
        with store.reading(path) as run:
            self.times = run.times()
            self.header = run.load(slice(0, 2))
        self.counts.crc_errors = self.header.event_kind.count("crc")

    def read_pieces(self) -> Iterator[NewSamples]:
        """Yield all samples in order, and count them."""
        with store.reading(self.path) as run:
            for first in range(0, self.times.size, PIECE):
                # With the sample before: losses and transitions are counted between two.
                n_before = min(first, 1)
                piece = run.load(slice(first - n_before, min(first + PIECE, self.times.size)))
                fresh = np.diff(piece.segment.astype(np.int64), prepend=-1) != 0
                self._count(piece, fresh, n_before)
                yield _convert_samples(piece, fresh, n_before)

    def load_between(self, begin: float, end: float, margin: int, most: int) -> NewSamples:
        """Return the samples from time ``begin`` to ``end``, s, at most so many, and a margin around them."""
        first, stop = np.searchsorted(self.times, (begin, end), "right").tolist()
        stop = min(stop, first + most)
        piece = store.load(self.path, slice(max(0, first - 1 - margin), min(self.times.size, stop + 1 + margin)))
        return _convert_samples(piece, np.diff(piece.segment.astype(np.int64), prepend=-1) != 0, 0)

    def _count(self, run: Recording, fresh: np.typing.NDArray[np.bool_], n_before: int) -> None:
        self.counts.samples += run.time.size - n_before
        self.counts.segments += int(np.count_nonzero(fresh[n_before:]))
        if run.raw is not None and run.time.size > 1:
            within = ~fresh[1:]
            self.counts.lost += int((np.diff(run.raw.sample.astype(np.int64))[within] - 1).sum())
            self.counts.illegal += int(counters.diff_unsigned(run.raw.illegal, 16)[within].sum())
            self.counts.phase_errors += int(np.count_nonzero(run.raw.flags[n_before:] & counters.FLAG_PHASE))


def _convert_samples(run: Recording, fresh: np.typing.NDArray[np.bool_], first: int) -> NewSamples:
    pitch = run.rig.belt_metres_per_count
    belt = None if run.belt_count is None or pitch is None else pitch.value * run.belt_count[first:].astype(np.float64)
    return NewSamples(run.time[first:], run.position[first:], fresh[first:], belt)
