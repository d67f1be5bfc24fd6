"""Steps of the position: a reading that fell behind and stays behind, and the record with such steps taken out."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing.record.series import Series
from stickslip.compute.arrays import Array


@dataclass(frozen=True)
class PositionStep:
    """From sample ``first`` to ``last`` the reading moved by ``size`` more than the mass did, and stays so."""

    first: int  # Samples
    last: int
    counts: int  # counts that went missing, signed, towards +x; 0 in a record without counts
    size: float  # the same in the unit of the position, m (or counts)


def step_offsets(segment: NDArray[np.integer], steps: tuple[PositionStep, ...]) -> Array:
    """Return by how much each sample is off because of the steps before it.

    segment: Segment number of each sample; a step lasts to the end of its segment.
    steps: In order of time.
    Returns: In the unit of the position, m (or counts).
    """
    offset = np.zeros(segment.size)
    edges = np.append(np.flatnonzero(np.diff(segment.astype(np.int64)) != 0) + 1, segment.size) if steps else ()
    for step in steps:
        end = int(edges[np.searchsorted(edges, step.first, side="right")])
        behind = min(step.last + 1, end)
        offset[step.first : behind] += step.size * step_profile(step.last - step.first + 1)[: behind - step.first]
        offset[behind:end] += step.size
    return offset


def without_steps(series: Series, offset: Array) -> Series:
    """Return the record without its steps; ``offset`` (n,) is the result of `step_offsets`."""
    if not offset.any():
        return series
    return replace(series, position=series.position - offset)


def step_profile(width: int) -> Array:
    """Return the share of a step over so many samples that has happened at each of them."""
    return np.arange(1, width + 1) / width
