"""Steps of the position: places where the reading moved and the mass did not, at once or over up to five samples.

When the mass bounces or a coupling slips, a count falls behind and stays behind; a camera that is moved, or a wheel
that slips, adds a constant to all positions from there on.  Where two parabolas, before and after a place, miss each
other by enough, the record around it is tested (`processing.defects.change_point`): it holds a step where only a step
of the position, over one to five samples, explains it, and no corner or step of the velocity does.

The unit of the test is the count.  In a record without counts it is `PER_NOISE` standard deviations of a position:
its independent errors then have the mean square that rounding to whole counts has.

Steps are marked and counted.  Motion is made from the record without them (`processing.record.position_steps`), and its
position has them again unless repair was asked for.  Not found: smaller steps, slower ones, and one across a gap.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from daq.base.compute.arrays import Array, Integers
from processing.defects.change_point import ROUNDED, ChangeModels, change_models, jump_weights
from processing.polynomial.even_grid import even_grid
from processing.record.position_steps import PositionStep, step_offsets, step_profile
from processing.record.series import Series

BETTER = 2.0  # times smaller squares that a step over several samples must leave: corners look like one


@dataclass(frozen=True)
class StepLimits:
    """Limits of the test, in counts or their equivalent.

    ``least`` is the smallest step reported, ``suspect`` what the parabolas must miss each other by for a suspect,
    ``clear`` a mean square that leaves nothing to explain, ``abrupt`` times smaller squares that a step from one sample
    to the next must leave.
    """

    least: float
    suspect: float
    clear: float
    abrupt: float


# Chosen together on benchmarks/velocity_seeds.py, section losses (95 % of the losses of 10 counts found, none in ten
# clean minutes); not swept one by one.  A size may come out 1.6 counts too small.
COUNTED = StepLimits(10.0 - 1.6, 4.5, 1.3 / 12, BETTER)
# Of steps of 10 standard deviations in camera tracks of 0.2 and 1 mm (laws 1 to 6) 125 of 134 are found, of those of 12
# and more 409 of 409, of those of 8 four in ten; none in 78 clean tracks.  With ``abrupt`` 2 most of 10 are missed.
NOISY = StepLimits(2.3, 1.6, 1.2 / 12, 1.6)
PER_NOISE = math.sqrt(12)
SPREAD = 5  # samples
SIDE = 8  # samples of a parabola on either side
AROUND = 20  # samples on either side that the models are fitted to
SCATTER = 4.5  # times the median miss nearby
BESIDE = 3  # samples from one suspect to the next of the same place
TOGETHER = 256  # suspects tested at a time: 4 MB; with more the test costs as much
CORNERS = np.arange(-12.0, 13.0, 2)  # samples from the suspect: where a corner or a velocity step is tried
DEGREE = 4  # of the polynomial beside the models
SLACK = 0.5  # of the sum of steps: by how much a record may be wider without them; without slips it is by all of it


def learn(series: Series, noise: float) -> float:
    """Return the unit of the test, m; 0 where the record shows no steps, or slips that look like steps.

    ``noise`` is the standard deviation of a position, m.
    """
    if series.pitch:
        return series.pitch
    unit = PER_NOISE * noise
    return unit if _is_datum(series, _found(series, unit)) else 0.0


def position_steps(series: Series, unit: float) -> tuple[PositionStep, ...]:
    """Find where the position steps by ten counts or more, or by eight to ten standard deviations of a position.

    Parameters
    ----------
    series : Series
        The record, or a block of it.
    unit : float
        Of the test, from `learn`.

    Returns
    -------
    tuple of PositionStep
        In order of time.  A step adds its size to all readings from ``last`` on.
    """
    found = _found(series, unit)
    return tuple(found) if series.pitch or _is_datum(series, found) else ()


def _found(series: Series, unit: float) -> list[PositionStep]:
    found: list[PositionStep] = []
    if not unit:
        return found
    counted = bool(series.pitch)
    for number, piece in enumerate(series.pieces):
        if piece.stop - piece.start <= 2 * AROUND + SPREAD:
            continue
        if counted:
            own = _in_piece(series.even_counts[number], COUNTED)
        else:
            own = _in_piece(even_grid(series.time[piece], series.position[piece]) / unit, NOISY)
        for first, last, size in own:
            counts = round(size) if counted else 0
            found.append(PositionStep(piece.start + first, piece.start + last, counts, unit * (counts or size)))
    return found


def _is_datum(series: Series, steps: list[PositionStep]) -> bool:
    """Return whether steps are of the datum: without them the record has hardly a wider range.

    A slip that is over within a few samples looks like a step, but brings the mass back: without slips the record leads
    away with the belt, by the sum of them.
    """
    left = series.position - step_offsets(np.zeros(series.time.size, np.int64), tuple(steps))
    return float(np.ptp(left) - np.ptp(series.position)) <= SLACK * sum(abs(step.size) for step in steps)


@lru_cache(maxsize=8)
def _miss(width: int) -> Array:
    return jump_weights(SIDE, width, 0)


def _in_piece(count: Array, limits: StepLimits) -> list[tuple[int, int, float]]:
    """Return first and last sample and the size of each step, in counts."""
    alike: dict[tuple[int, int, int], list[int]] = {}
    for low, high in _suspects(count, limits):
        begin, end = max(low - AROUND, 0), min(high + AROUND + SPREAD, count.size)
        alike.setdefault((low - begin, high - begin, end - begin), []).append(begin)
    steps: list[tuple[int, tuple[int, int, float]]] = []
    for place, begins in alike.items():
        around = sliding_window_view(count, place[2])
        for first in range(0, len(begins), TOGETHER):
            own = np.array(begins[first : first + TOGETHER])
            for k, start, width, size in _tested(around[own].T - count[own], place, limits):
                at = int(own[k]) + start
                begins_at = math.ceil(at)
                steps.append((int(own[k]) + place[0], (begins_at, max(math.ceil(at + width - 1), begins_at), size)))
    found: list[tuple[int, int, float]] = []
    for _, step in sorted(steps):
        if not found or step[0] > found[-1][1]:
            found.append(step)
    return found


def _suspects(count: Array, limits: StepLimits) -> list[tuple[int, int]]:
    """Return the first and last of the samples beside each other at which two parabolas miss each other."""
    loud: list[Integers] = [np.empty(0, np.int64)]
    for width in range(1, SPREAD + 1):
        miss = np.abs(np.correlate(count, _miss(width), "valid"))
        own = np.flatnonzero(miss >= limits.suspect)
        if own.size:
            near = sliding_window_view(np.pad(SCATTER * miss, AROUND, mode="reflect"), 2 * AROUND + 1)[own]
            quiet = np.count_nonzero(near <= miss[own, None], axis=1)  # more than half: the median is among them
            loud.append(own[quiet > AROUND] + SIDE)
    places = np.unique(np.concatenate(loud))
    if not places.size:
        return []
    apart = np.flatnonzero(np.diff(places) > BESIDE)
    return list(zip(places[[0, *(apart + 1)]].tolist(), places[[*apart, -1]].tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class StepModels:
    """What may have happened around a suspect, at ``times`` (n,) from the first sample.

    ``corners`` (c, n) are corners and velocity steps, ``bent`` the models of one of them; ``stepped`` are steps that
    begin at ``first`` and take ``width`` samples.
    """

    times: Array
    corners: Array
    bent: ChangeModels
    stepped: ChangeModels
    first: Array
    width: Array


@lru_cache(maxsize=64)
def _models(low: int, high: int, samples: int) -> StepModels:
    """Return the models of so many samples, the suspects low..high among them."""
    times = (np.arange(samples) - 0.5 * (low + high)) / AROUND
    kinks = np.maximum(times - (CORNERS / AROUND)[:, None], 0.0)
    corners = np.concatenate((kinks, kinks**2))
    starts = np.arange(max(low - SPREAD, 3), min(high + SPREAD, samples - 3 - SPREAD), dtype=float)
    first, width = (own.ravel() for own in np.meshgrid(starts, np.arange(1.0, SPREAD + 1)))
    stepped = change_models(_steps(samples, first, width)[:, None], times, DEGREE)
    return StepModels(times, corners, change_models(corners[:, None], times, DEGREE), stepped, first, width)


@lru_cache(maxsize=64)
def _two_corners(low: int, high: int, samples: int) -> ChangeModels:
    models = _models(low, high, samples)
    return change_models(np.array(list(combinations(models.corners, 2))), models.times, DEGREE)


@lru_cache(maxsize=256)
def _finer(low: int, high: int, samples: int, at: int) -> tuple[Array, Array, ChangeModels]:
    """Return first samples, widths and models of steps near number ``at`` of `StepModels`, in fractions of a sample."""
    models = _models(low, high, samples)
    near = models.first[at] + np.arange(-1.0, 1.01, 0.25), models.width[at] + np.arange(-1.0, 1.51, 0.5)
    first, width = (part.ravel() for part in np.meshgrid(*near))
    return first, width, change_models(_steps(samples, first, width)[:, None], models.times, DEGREE)


def _tested(own: Array, place: tuple[int, int, int], limits: StepLimits) -> Iterator[tuple[int, float, float, float]]:
    """Test b stretches of n samples, (n, b), with suspects at the same ``place`` in each.

    Yields number, first sample, width and size of those that a step alone explains.
    """
    models, number = _models(*place), np.arange(own.shape[1])
    bent = models.bent.fit(own)[1].min(axis=0)
    # No model leaves less than `ROUNDED`.
    left = bent >= max(limits.clear, min(limits.abrupt, BETTER) * ROUNDED)
    own, number, bent = own[:, left], number[left], bent[left]
    at, size, square = _best(models.stepped, own)
    first, width = models.first[at], models.width[at]
    for best in np.unique(at[width > 1]).tolist():
        k = np.flatnonzero(at == best)
        firsts, widths, finer = _finer(*place, best)
        near, size[k], square[k] = _best(finer, own[:, k])
        first[k], width[k] = firsts[near], widths[near]
    better = np.where(width <= 1, limits.abrupt, BETTER)
    k = np.flatnonzero((square * better > bent) & (ROUNDED * better <= bent))
    if k.size:  # perhaps a step beside a corner: both together, against any two corners
        bent[k] = np.minimum(bent[k], _two_corners(*place).fit(own[:, k])[1].min(axis=0))
        sizes, squares = models.bent.fit_beside(_steps(len(own), first[k], width[k]).T, own[:, k])
        both = squares.argmin(axis=0), np.arange(k.size)
        size[k], square[k] = sizes[both], squares[both]
    found = (square * better <= bent) & (np.abs(size) >= limits.least)
    yield from zip(*(part[found].tolist() for part in (number, first, width, size)), strict=True)


def _best(models: ChangeModels, own: Array) -> tuple[Integers, Array, Array]:
    """Return which model of one column explains stretches (n, b) best, its coefficient, and the mean square left."""
    sizes, squares = models.fit(own)
    best = squares.argmin(axis=0)
    each = np.arange(best.size)
    return best, sizes[best, 0, each], squares[best, each]


def _steps(samples: int, first: Array, width: Array) -> Array:
    """Return the steps of one count that begin at ``first`` and take ``width`` samples, (k,) each: (k, samples)."""
    return step_profile(np.arange(samples) - first[:, None] + 1, width[:, None])
