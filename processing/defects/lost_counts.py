"""Lost counts: places where ten or more counts went missing, at once or over up to five samples.

When the mass bounces or a coupling slips, the count falls behind and stays behind.  Around every place two polynomials
are set, one on the samples before and one on those behind; where they miss each other by enough, the record around is
held against models of what may have happened there: a step of the count, spread over one to five samples, or a corner
or a kick of the motion and no step.  It is a loss where only a step explains the record.

Losses are marked and counted.  Motion is made from the record with them restored (`processing.record.lost_counts`), and
its position falls behind again with the count unless repair was asked for.  Not seen: smaller losses, and slower ones.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from daq.compute.arrays import Array
from processing.record.lost_counts import LostCounts, loss_profile
from processing.record.series import Series

LEAST = 10.0  # counts
SUSPECT = 4.5  # counts: what the polynomials must miss each other by to be looked at closely
ROUNDING = 1.6  # counts that a size may come out too small
SPREAD = 5  # samples
SIDE = 8  # samples of a polynomial to either side
AROUND = 20  # samples to either side that the models are fitted to
SCATTER = 4.5  # times the usual miss nearby
BETTER = 2.0  # times smaller squares that a step must leave
CLEAR = 1.3 / 12  # counts^2: mean square of what a model leaves that explains all
CORNERS = np.arange(-12, 13, 2)  # samples from the suspect: where a corner or a kick may explain it


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
            found += [
                LostCounts(piece.start + loss.first, piece.start + loss.last, loss.counts) for loss in _in_piece(count)
            ]
    return tuple(found)


@lru_cache(maxsize=8)
def _miss(width: int) -> Array:
    """Return weights of 2 SIDE + width - 1 samples: by how much the later parabola lies above the earlier one."""
    middle = SIDE + (width - 2) / 2
    j = np.arange(2 * SIDE + width - 1) - middle
    weights = np.zeros(j.size)
    for own, sign in ((slice(0, SIDE), -1.0), (slice(j.size - SIDE, None), 1.0)):
        weights[own] = sign * np.linalg.pinv(np.vander(j[own], 3))[2]
    return weights


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
            loss = _judged(count, places[first], place)
            first = k + 1
            if loss is not None and not (found and loss.first <= found[-1].last):
                found.append(loss)
    return found


@dataclass(frozen=True, eq=False)
class Models:
    """What may have happened around a suspect, less what smooth polynomials follow; samples count from the first.

    ``bent`` are corners and kicks, ``stepped`` losses that begin at ``first`` and take ``width``.
    """

    smooth: Array
    bent: Array
    stepped: Array
    first: Array
    width: Array


@lru_cache(maxsize=64)
def _models(low: int, high: int, samples: int) -> Models:
    """Return the models of so many samples, the suspects low..high among them."""
    j = np.arange(samples, dtype=float)
    t = (j - 0.5 * (low + high)) / AROUND
    smooth = np.linalg.qr(np.vander(t, 5))[0]
    corners = np.maximum(t - (CORNERS / AROUND)[:, None], 0.0)
    starts = np.arange(max(low - SPREAD, 3), min(high + SPREAD, samples - 3 - SPREAD), dtype=float)
    first, width = (own.ravel() for own in np.meshgrid(starts, np.arange(1.0, SPREAD + 1)))
    bent = _beside(smooth, np.concatenate((corners, corners**2)))
    return Models(smooth, bent, _beside(smooth, _ramps(j, first, width)), first, width)


def _judged(count: Array, low: int, high: int) -> LostCounts | None:
    """Hold the record around the samples low..high against the models; None unless a step alone explains it."""
    begin, end = max(low - AROUND, 0), min(high + AROUND + SPREAD, count.size)
    models = _models(low - begin, high - begin, end - begin)
    smooth, bent = models.smooth, models.bent
    y = _beside(smooth, count[begin:end] - count[begin])
    best_bent = float(_left(bent, y).min())
    if best_bent < CLEAR:
        return None
    first, width = models.first, models.width
    at = int(np.argmin(_left(models.stepped, y)))
    step = models.stepped[at]
    if width[at] > 1:  # it need not begin or end with a sample
        own = first[at] + np.arange(-1.0, 1.01, 0.25), width[at] + np.arange(-1.0, 1.51, 0.5)
        first, width = (part.ravel() for part in np.meshgrid(*own))
        finer = _beside(smooth, _ramps(np.arange(end - begin, dtype=float), first, width))
        at = int(np.argmin(_left(finer, y)))
        step = finer[at]
    if step @ step < 1e-9:
        return None
    squares = float(_left(step[None], y)[0])
    size = float(step @ y / (step @ step))
    if squares * BETTER > best_bent:
        # Perhaps a loss beside a corner: both together, against any two corners.
        with_step, sizes = _pairs(step[None], bent, y)
        both = int(np.argmin(with_step[0]))
        squares, size = float(with_step[0, both]), float(sizes[0, both])
        if squares * BETTER > best_bent or squares * BETTER > float(_pairs(bent, bent, y)[0].min()):
            return None
    if abs(size) < LEAST - ROUNDING:
        return None
    start = begin + first[at]
    return LostCounts(math.ceil(start), max(math.ceil(start + width[at] - 1), math.ceil(start)), round(size))


def _ramps(j: Array, first: Array, width: Array) -> Array:
    return loss_profile(j - first[:, None] + 1, width[:, None])


def _beside(smooth: Array, columns: Array) -> Array:
    """Return what of the columns the smooth polynomials cannot follow."""
    return np.asarray(columns - (columns @ smooth) @ smooth.T)


def _left(columns: Array, y: Array) -> Array:
    """Return the mean square that each column alone leaves of y; the rounding of a count at least."""
    followed = (columns @ y) ** 2 / np.maximum(np.einsum("ij,ij->i", columns, columns), 1e-12)
    return np.asarray(np.maximum((y @ y - followed) / y.size, 1 / 12))


def _pairs(one: Array, other: Array, y: Array) -> tuple[Array, Array]:
    """Return the mean squares that pairs of columns leave of y, (ones, others), and the coefficients of the first."""
    a = np.einsum("ij,ij->i", one, one)[:, None]
    b = one @ other.T
    c = np.einsum("ij,ij->i", other, other)[None, :]
    d, e = (one @ y)[:, None], (other @ y)[None, :]
    determinant = a * c - b * b
    apart = determinant > 1e-9 * a * c + 1e-30
    safe = np.where(apart, determinant, 1.0)
    first, second = (c * d - b * e) / safe, (a * e - b * d) / safe
    squares = np.where(apart, np.maximum((y @ y - first * d - second * e) / y.size, 1 / 12), np.inf)
    return squares, first
