"""Steps of the position: a reading that shifts and stays shifted, and the record with such steps removed."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from processing.record.series import Series
from stickslip.compute.arrays import Array


@dataclass(frozen=True)
class PositionStep:
    """From sample ``first`` to ``last`` the reading moved by ``size`` more than the mass did, for good."""

    first: int
    last: int
    counts: int  # missing counts, positive towards +x; 0 in a record without counts
    size: float  # the same in the unit of the position, m (or counts)


def step_offsets(segment: NDArray[np.integer], steps: tuple[PositionStep, ...]) -> Array:
    """Return the error of each sample due to earlier steps, m (or counts); a step lasts until its segment ends."""
    offset = np.zeros(segment.size)
    edges = np.append(np.flatnonzero(np.diff(segment.astype(np.int64)) != 0) + 1, segment.size) if steps else ()
    for step in steps:
        end = int(edges[np.searchsorted(edges, step.first, side="right")])
        next_sample = min(step.last + 1, end)
        offset[step.first : next_sample] += (
            step.size * step_profile(step.last - step.first + 1)[: next_sample - step.first]
        )
        offset[next_sample:end] += step.size
    return offset


def without_steps(series: Series, offset: Array) -> Series:
    """Return the record without its steps; ``offset`` is the result of `step_offsets`."""
    if not offset.any():
        return series
    return replace(series, position=series.position - offset)


def step_profile(width: int) -> Array:
    """Return the share of a step of ``width`` samples that is complete at each of them."""
    return np.arange(1, width + 1) / width
