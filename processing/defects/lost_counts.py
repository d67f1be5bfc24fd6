"""Lost counts: places where ten or more counts went missing, at once or over up to five samples.

When the mass bounces or a coupling slips, the count falls behind and stays behind.  Where two parabolas, before and
after a place, miss each other by enough, the record around it is tested (`processing.defects.change_point`): it is a
loss where only a step of the count, over one to five samples, explains it, and no corner or step of the velocity does.

Losses are marked and counted.  Motion is made from the record with them restored (`processing.record.lost_counts`), and
its position falls behind again with the count unless repair was asked for.  Not found: smaller losses, and slower ones.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from daq.compute.arrays import Array
from processing.defects.change_point import ChangeModels, change_models, jump_weights
from processing.record.lost_counts import LostCounts, loss_profile
from processing.record.series import Series

# Chosen together on benchmarks/velocity_seeds.py, section losses (95 % of the losses of 10 counts found, none in ten
# clean minutes); not swept one by one.
LEAST = 10.0  # counts
SUSPECT = 4.5  # counts: what the parabolas must miss each other by for a suspect
ROUNDING = 1.6  # counts that a size may come out too small
SPREAD = 5  # samples
SIDE = 8  # samples of a parabola on either side
AROUND = 20  # samples on either side that the models are fitted to
SCATTER = 4.5  # times the median miss nearby
BETTER = 2.0  # times smaller squares that a step must leave
CLEAR = 1.3 / 12  # counts^2: a mean square that leaves nothing to explain
CORNERS = np.arange(-12.0, 13.0, 2)  # samples from the suspect: where a corner or a velocity step is tried
DEGREE = 4  # of the polynomial beside the models


def losses(series: Series) -> tuple[LostCounts, ...]:
    """Find where ten or more counts were lost.

    Parameters
    ----------
    series : Series
        The record; one without counts has none to lose.

    Returns
    -------
    tuple of LostCounts
        In order of time.  A loss adds ``counts`` to all readings from ``last`` on.
    """
    if not series.pitch:
        return ()
    found: list[LostCounts] = []
    for piece, count in zip(series.pieces, series.even_counts, strict=True):
        if count.size > 2 * AROUND + SPREAD:
            own = _in_piece(count)
            found += [LostCounts(piece.start + loss.first, piece.start + loss.last, loss.counts) for loss in own]
    return tuple(found)


@lru_cache(maxsize=8)
def _miss(width: int) -> Array:
    return jump_weights(SIDE, width, 0)


def _in_piece(count: Array) -> list[LostCounts]:
    suspects = []
    for width in range(1, SPREAD + 1):
        miss = np.abs(np.correlate(count, _miss(width), "valid"))
        loud = np.flatnonzero(miss >= SUSPECT)
        if loud.size:
            usual = np.median(sliding_window_view(np.pad(miss, AROUND, mode="reflect"), 2 * AROUND + 1)[loud], axis=1)
            suspects += (loud[miss[loud] >= SCATTER * usual] + SIDE).tolist()
    found: list[LostCounts] = []
    first = 0
    places = sorted(set(suspects))
    for k, place in enumerate(places):
        if k + 1 == len(places) or places[k + 1] - place > 3:
            loss = _tested(count, places[first], place)
            first = k + 1
            if loss is not None and not (found and loss.first <= found[-1].last):
                found.append(loss)
    return found


@dataclass(frozen=True, eq=False)
class LossModels:
    """What may have happened around a suspect, at ``times`` (n,) from the first sample.

    ``corners`` (c, n) are corners and velocity steps, ``bent`` the models of one of them; ``stepped`` are losses that
    begin at ``first`` and take ``width`` samples.
    """

    times: Array
    corners: Array
    bent: ChangeModels
    stepped: ChangeModels
    first: Array
    width: Array


@lru_cache(maxsize=64)
def _models(low: int, high: int, samples: int) -> LossModels:
    """Return the models of so many samples, the suspects low..high among them."""
    times = (np.arange(samples) - 0.5 * (low + high)) / AROUND
    kinks = np.maximum(times - (CORNERS / AROUND)[:, None], 0.0)
    corners = np.concatenate((kinks, kinks**2))
    starts = np.arange(max(low - SPREAD, 3), min(high + SPREAD, samples - 3 - SPREAD), dtype=float)
    first, width = (own.ravel() for own in np.meshgrid(starts, np.arange(1.0, SPREAD + 1)))
    stepped = change_models(_steps(samples, first, width)[:, None], times, DEGREE)
    return LossModels(times, corners, change_models(corners[:, None], times, DEGREE), stepped, first, width)


@lru_cache(maxsize=64)
def _two_corners(low: int, high: int, samples: int) -> ChangeModels:
    models = _models(low, high, samples)
    return change_models(np.array(list(combinations(models.corners, 2))), models.times, DEGREE)


def _tested(count: Array, low: int, high: int) -> LostCounts | None:
    """Test the record around the samples low..high; None unless a step alone explains it."""
    begin, end = max(low - AROUND, 0), min(high + AROUND + SPREAD, count.size)
    place = low - begin, high - begin, end - begin
    models, own = _models(*place), count[begin:end] - count[begin]
    best_bent = float(models.bent.fit(own)[1].min())
    if best_bent < CLEAR:
        return None
    first, width, stepped = models.first, models.width, models.stepped
    sizes, squares = stepped.fit(own)
    at = int(np.argmin(squares))
    if width[at] > 1:  # it need not begin or end with a sample
        finer = first[at] + np.arange(-1.0, 1.01, 0.25), width[at] + np.arange(-1.0, 1.51, 0.5)
        first, width = (part.ravel() for part in np.meshgrid(*finer))
        stepped = change_models(_steps(own.size, first, width)[:, None], models.times, DEGREE)
        sizes, squares = stepped.fit(own)
        at = int(np.argmin(squares))
    size, square = float(sizes[at, 0]), float(squares[at])
    if square * BETTER > best_bent:
        # Perhaps a loss beside a corner: both together, against any two corners.
        step = np.broadcast_to(_steps(own.size, first[at : at + 1], width[at : at + 1]), models.corners.shape)
        sizes, squares = change_models(np.stack((step, models.corners), axis=1), models.times, DEGREE).fit(own)
        both = int(np.argmin(squares))
        size, square = float(sizes[both, 0]), float(squares[both])
        if square * BETTER > min(best_bent, float(_two_corners(*place).fit(own)[1].min())):
            return None
    if abs(size) < LEAST - ROUNDING:
        return None
    start = begin + first[at]
    return LostCounts(math.ceil(start), max(math.ceil(start + width[at] - 1), math.ceil(start)), round(size))


def _steps(samples: int, first: Array, width: Array) -> Array:
    """Return the losses of one count that begin at ``first`` and take ``width`` samples, (k,) each: (k, samples)."""
    return loss_profile(np.arange(samples) - first[:, None] + 1, width[:, None])
