"""Every sample of a record, seen through fewer nodes: the last pass of a fit needs tangents at these alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.model.windows import ShootingWindows, Thinning, stuck_from
from stickslip.compute.arrays import Array, Integers


@dataclass(frozen=True, eq=False)
class SampleNodes:
    """Samples n apart in each window, and its last; each sample counts to its two nodes by linear shares."""

    windows: ShootingWindows  # of the nodes
    left: Integers  # (N,) the node before each sample
    share: Array  # (N,) the share of each sample that counts to the next node
    count: Array  # (nodes,) samples about each

    @classmethod
    def of(cls, whole: ShootingWindows, thinned: Sequence[Thinning]) -> "SampleNodes":
        table, picked, left, share, total = whole.table.copy(), [], [], [], 0
        ends = np.zeros(len(whole.rows), np.int64)
        for row, (cycle, stick, first, size, overtakes, run) in enumerate(whole.table):
            time = whole.time[first : first + size]
            landing = 2 * float(whole.earliest_landing[row]) - float(time[0])
            stuck = stuck_from(time, stick, landing, overtakes=bool(overtakes))
            own = np.unique(np.r_[thinned[run].taken(size, stuck), size - 1])
            before = np.clip(np.searchsorted(own, np.arange(size), side="right") - 1, 0, max(own.size - 2, 0))
            gap = time[own[np.minimum(before + 1, own.size - 1)]] - time[own[before]]
            left.append(total + before)
            share.append((time - time[own[before]]) / np.where(gap > 0, gap, 1.0))
            picked.append(first + own)
            table[row, 2:4] = total, own.size
            total += own.size
            ends[cycle] = total
        index, before, part = np.concatenate(picked), np.concatenate(left), np.concatenate(share)
        windows = replace(
            whole,
            table=table,
            time=whole.time[index],
            position=whole.position[index],
            source=whole.source[index],
            rows=tuple(slice(int(a), int(b)) for a, b in zip(np.r_[0, ends[:-1]], ends, strict=True)),
            parts=(),
        )
        return cls(windows, before, part, _shared_out(np.ones(part.size), before, part, total))

    def seen(self, model: Array, residual: Array) -> ShootingWindows:
        """Return the nodes, measured where their residual is the mean of the residual (N,) of samples near them.

        ``model`` (nodes,) are predicted positions, m.
        """
        total = _shared_out(residual, self.left, self.share, self.count.size)
        mean = np.divide(total, self.count, out=np.zeros_like(total), where=self.count > 0)
        return replace(self.windows, position=model - mean)


def _shared_out(values: Array, left: Integers, share: Array, nodes: int) -> Array:
    """Return the sum of values (N,) about each node, shape (nodes,)."""
    right = np.minimum(left + 1, nodes - 1)
    return np.asarray(np.bincount(left, (1 - share) * values, nodes) + np.bincount(right, share * values, nodes))
