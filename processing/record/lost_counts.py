"""Counts that went missing: what is known of each loss, and the record with them restored."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from processing.record.series import Series


@dataclass(frozen=True)
class LostCounts:
    """From sample ``first`` to ``last`` the reading fell behind by ``counts`` (signed, towards +x)."""

    first: int
    last: int
    counts: int


def counts_missing(segment: NDArray[np.integer], losses: tuple[LostCounts, ...]) -> Array:
    """Return by how many counts each sample is behind.

    Parameters
    ----------
    segment : array of int, shape (n,)
        Segment number of each sample; a loss lasts to the end of its segment.
    losses : tuple of LostCounts
        In order of time.

    Returns
    -------
    array of shape (n,)
        Counts.
    """
    behind = np.zeros(segment.size)
    edges = np.append(np.flatnonzero(np.diff(segment.astype(np.int64)) != 0) + 1, segment.size)
    for loss in losses:
        end = int(edges[np.searchsorted(edges, loss.first, side="right")])
        since = np.arange(end - loss.first) + 1.0
        behind[loss.first : end] += loss.counts * loss_profile(since, loss.last - loss.first + 1.0)
    return behind


def restore_counts(series: Series, behind: Array) -> Series:
    """Return the record with the lost counts put back; ``behind`` (n,) is the result of `counts_missing`."""
    if not behind.any():
        return series
    return replace(series, position=series.position - series.pitch * behind, count=None)


def loss_profile(since: NDArray[np.floating], width: Array | float) -> Array:
    """Return the share of a loss that has happened ``since`` samples after the last one before it, 0 to 1: a cubic."""
    s = np.clip(since / width, 0.0, 1.0)
    return np.asarray(s * s * (3 - 2 * s))
