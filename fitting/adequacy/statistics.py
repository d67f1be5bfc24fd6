"""Statistics of residuals that noise alone leaves small: what repeats from slip to slip, and what is smooth in a slip.

Each slip, from its window's start to the landing, is cut into bins of its phase, and the residuals are averaged in
them.  A law that is wrong leaves residuals that are smooth over a bin, and mostly the same in every slip.  A slip that
a velocity step has spoilt must not count for more than the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fitting.least_squares.problem import Block
from fitting.model.windows import ShootingWindows
from stickslip.compute.arrays import Array, Integers, Mask

MOST_BINS = 60  # bins of a slip, with 8 to 20 samples each at 1 kHz
# Samples in a bin of the usual slip, at the least.  Chosen: the mean of one sample is that sample, so a bin of 1.5
# hides what is smooth in a slip; with 6, a slip of 12 samples has two bins, in which what repeats from slip to slip
# cancels.
SAMPLES_IN_BIN = 3
FEWEST_SLIPS = 2  # at least: what repeats needs two


class Statistics(NamedTuple):
    """Statistics of B sets of residuals of a run's judged cycles, each (B,); 0 without slips to judge but for `rms`."""

    # share of the binned residuals' variance that repeats from slip to slip, without bias: 0 for noise, 1 for residuals
    # that are the same in every slip
    repeat: Array
    # variance of the binned residuals over that of independent residuals of the same rms; median over the slips. 1 for
    # white noise, up to the number of samples in a bin.
    smooth: Array
    worst: Array  # largest mean square of a cycle, over the median
    rms: Array  # of all cycles, equally weighted, m


def cycle_squares(residuals: Array, rows: Sequence[slice]) -> Array:
    """Return the mean square of residuals (N, B) in each cycle, m^2, shape (cycles, B)."""
    first = np.array([own.start - rows[0].start for own in rows])
    count = np.array([own.stop - own.start for own in rows])
    return np.asarray(np.add.reduceat(residuals**2, first, axis=0) / count[:, np.newaxis])


@dataclass(frozen=True, eq=False)
class SlipBins:
    """Bins of the slips of a run: rows of residuals, and where each bin begins among them."""

    rows: Integers  # (n,) the residuals in a bin, slip by slip
    starts: Integers  # (occupied bins,) first of ``rows`` in each bin that is not empty
    slip: Integers  # (occupied bins,) slip and bin of its phase
    phase: Integers
    count: Array  # (occupied bins,) residuals in it
    slips: int
    # into how many the phase of a slip is cut: `SAMPLES_IN_BIN` of the usual slip's samples in each, at most
    # `MOST_BINS`
    bins: int

    @property
    def judged(self) -> bool:
        return self.slips >= FEWEST_SLIPS

    @classmethod
    def cut(cls, windows: ShootingWindows, landings: Array, inliers: Mask, run: int = 0) -> "SlipBins":
        rows, phases = [], []
        for k, stick, first, count, _, own in windows.table:
            if stick or own != run or not inliers[k]:
                continue
            time = windows.time[first : first + count]
            phase = (time - time[0]) / (landings[k] - time[0])
            before = phase < 1.0
            rows.append(first + np.flatnonzero(before))
            phases.append(phase[before])
        slips = len(rows)
        if not slips:
            empty = np.empty(0, np.int64)
            return cls(empty, empty, empty, empty, np.empty(0), 0, 1)
        usual = float(np.median([phase.size for phase in phases]))
        bins = int(min(max(usual // SAMPLES_IN_BIN, 1), MOST_BINS))
        cell = [slip * bins + np.floor(bins * phase).astype(np.int64) for slip, phase in enumerate(phases)]
        occupied, starts, count = np.unique(np.concatenate(cell), return_index=True, return_counts=True)
        return cls(np.concatenate(rows), starts, occupied // bins, occupied % bins, count.astype(float), slips, bins)

    def sums(self, values: Array, block: Block | None = None) -> Array:
        """Return the sum of values (N, B) in each bin, shape (occupied bins, B); of a block, those of its bins."""
        if block is None:
            return np.asarray(np.add.reduceat(values[self.rows], self.starts, axis=0))
        first, last = np.searchsorted(self.rows, (block.rows.start, block.rows.stop))
        starts = self.starts[np.searchsorted(self.starts, first) : np.searchsorted(self.starts, last)]
        if not starts.size:
            return np.zeros((0, values.shape[1]))
        return np.asarray(np.add.reduceat(values[self.rows[first:last] - block.rows.start], starts - first, axis=0))

    def per_slip(self, binned: Array) -> Array:
        """Return the sum over the bins (occupied bins, B) of each slip, shape (slips, B)."""
        return np.asarray(np.add.reduceat(binned, self._edges, axis=0))

    def per_phase(self, binned: Array) -> Array:
        """Return the sum over the bins (occupied bins, B) of each phase, shape (phases met, B)."""
        order, edges = self._by_phase
        return np.asarray(np.add.reduceat(binned[order], edges, axis=0))

    @cached_property
    def _edges(self) -> Integers:
        """First occupied bin of each slip."""
        return np.searchsorted(self.slip, np.arange(self.slips))

    @cached_property
    def _by_phase(self) -> tuple[Integers, Integers]:
        """Occupied bins in order of phase, and the first of each phase."""
        order = np.argsort(self.phase, kind="stable")
        return order, np.unique(self.phase[order], return_index=True)[1]

    @cached_property
    def residuals_and_bins(self) -> tuple[Array, Array]:
        """Residuals and occupied bins of each slip, shapes (slips, 1)."""
        return self.per_slip(self.count[:, None]), self.per_slip(np.ones((self.slip.size, 1)))

    def lag1(self, residual: Array) -> float:
        """Return the autocorrelation of neighbouring residuals (N,) of the slips."""
        products = np.r_[0.0, residual[1:] * residual[:-1]]
        return float(np.sum(products[self.rows])) / max(float(np.sum(residual[self.rows] ** 2)), 1e-300)

    def statistics(self, residuals: Array, squares: Array) -> Statistics:
        """Return the statistics of residuals (N, B), m, with the mean squares (cycles, B) of their judged cycles."""
        return self.combine(self.sums(residuals), self.sums(residuals**2), squares)

    def combine(self, sums: Array, squared: Array, squares: Array) -> Statistics:
        """Return the same from the sums of residuals and of their squares in each bin."""
        rms = np.asarray(np.sqrt(np.sum(squares, axis=0) / max(squares.shape[0], 1)))
        if not self.judged:
            nothing = np.zeros(rms.size)
            return Statistics(nothing, nothing, nothing, rms)
        number, occupied = self.residuals_and_bins
        square = np.maximum(self.per_slip(squared) / number, 1e-300)
        binned = self.per_slip(sums**2 / self.count[:, None]) / occupied
        usual = np.median(square, axis=0)
        weight = np.sqrt(np.minimum(usual / square, 1.0))  # a spoilt slip is scaled down to the usual one
        mean = sums / self.count[:, None] * weight[self.slip]
        each, together = np.sum(mean**2, axis=0), self.per_phase(mean)
        return Statistics(
            repeat=(np.sum(together**2, axis=0) - each) / np.maximum((self.slips - 1) * each, 1e-300),
            smooth=np.median(binned / square, axis=0),
            worst=np.max(squares, axis=0) / np.maximum(np.median(squares, axis=0), 1e-300),
            rms=rms,
        )
