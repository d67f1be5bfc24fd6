"""Steps of the velocity, as when a joint of the belt comes by.  Marked, never taken out.

Where the slopes of two parabolas, before and after a place, differ by enough, a kink of the position (a step of the
velocity) is tested against corners (a kink of the velocity, as at every landing; `processing.defects.change_point`).
It is a step where corners no sharper than the record's accelerations do not explain it and a kink does, with a corner
close behind: the belt soon catches the mass again.  Of steps by 50 mm/s at 7.67 um and 1 kHz all are found, of those by
20 mm/s, over within 3 samples, half.
"""

from functools import lru_cache

import numpy as np

from daq.base.compute.arrays import Array
from processing.defects.change_point import ChangeModels, change_models, jump_weights
from processing.record.motion import VelocityStep
from processing.record.series import Series

# Chosen together on benchmarks/velocity_seeds.py, section kicks (recall without false ones); not swept one by one.
SIDE = 10  # samples of a parabola on either side
AROUND = 16  # samples on either side that the models are fitted to
SUSPECT = 1.2  # counts per sample that the slopes must differ by for a suspect
LEAST = 1.5  # counts per sample; and no less than a corner may do in a sample
BETTER = 2.0  # times smaller squares that a kink must leave than corners alone
CLEAR = 2.0 / 12  # counts^2: mean square that a kink may leave
LATER = np.append(np.arange(2.0, AROUND + 3.0), 2 * AROUND)  # samples after a step or corner: where one may follow
MEAN = 10  # samples averaged into one for a rough acceleration
SHARPEST = 2.0  # times the largest rough acceleration: what it may jump by at a corner
PLACES = np.arange(-6.0, 6.1, 0.25)  # samples from the suspect: where the kink or the corner may be
DEGREE = 3  # of the polynomial beside the models
SLOPES = jump_weights(SIDE, 1, 1)


def velocity_steps(series: Series) -> tuple[VelocityStep, ...]:
    """Find where the velocity steps; a record without counts shows none."""
    if not series.pitch:
        return ()
    found: list[VelocityStep] = []
    for piece, count in zip(series.pieces, series.even_counts, strict=True):
        if count.size > 2 * AROUND + 2:
            for sample, step in _in_piece(count):
                found.append(VelocityStep(piece.start + sample, step * series.pitch / series.interval))
    return tuple(found)


def _in_piece(count: Array) -> list[tuple[int, float]]:
    steps = np.abs(np.correlate(count, SLOPES, "valid"))
    loud = np.flatnonzero(steps >= SUSPECT) + SIDE
    found: list[tuple[int, float]] = []
    if not loud.size:
        return found
    # No corner bends the motion by more than its accelerations differ.
    means = count[: count.size // MEAN * MEAN].reshape(-1, MEAN).mean(axis=1)
    sharpest = SHARPEST * float(np.percentile(np.abs(np.diff(means, 2)), 99)) / MEAN**2
    for group in np.split(loud, np.flatnonzero(np.diff(loud) > SIDE) + 1):
        place = int(group[np.argmax(steps[group - SIDE])])
        if AROUND <= place < count.size - AROUND:
            step = _tested(count[place - AROUND : place + AROUND], sharpest)
            if step is not None:
                found.append((place, step))
    return found


def _models(at: Array, later: Array, *, kinked: bool) -> ChangeModels:
    """Return a corner at each time with another ``later``, and with a kink there, if ``kinked``: all pairs of both."""
    at, later = (own.ravel() for own in np.meshgrid(at, later, indexing="ij"))
    j = np.arange(-AROUND, AROUND, dtype=float)
    since = np.maximum(j - at[:, None], 0.0)
    corners = [since**2, np.maximum(j - (at + later)[:, None], 0.0) ** 2]
    return change_models(np.stack([since, *corners] if kinked else corners, axis=1), j / AROUND, DEGREE)


@lru_cache(maxsize=2)
def _tried(kinked: bool) -> ChangeModels:
    return _models(PLACES, LATER, kinked=kinked)


def _fit(models: ChangeModels, count: Array, sharpest: float, *, kinked: bool) -> tuple[Array, Array]:
    """Fit; the mean square is infinite where a corner is sharper than ``sharpest``."""
    solved, squares = models.fit(count)
    sharp = (np.abs(solved[:, int(kinked) :]) > sharpest / 2).any(axis=1)
    return solved, np.where(sharp, np.inf, squares)


def _tested(count: Array, sharpest: float) -> float | None:
    """Return the step, counts per sample, where only a kink explains the record around its middle.

    ``sharpest`` is what the acceleration may jump by at a corner, counts per sample^2.
    """
    count = count - count[AROUND]
    corners = float(_fit(_tried(False), count, sharpest, kinked=False)[1].min())
    if corners <= CLEAR:
        return None
    # The mass may be back on the belt, or turned to another slip, within milliseconds: with corners beside it.
    best = int(np.argmin(_fit(_tried(True), count, sharpest, kinked=True)[1]))
    at, later = PLACES[best // LATER.size], LATER[best % LATER.size]
    near = _models(at + np.arange(-0.2, 0.21, 0.05), later + np.arange(-0.75, 0.76, 0.25), kinked=True)
    solved, squares = _fit(near, count, sharpest, kinked=True)
    best = int(np.argmin(squares))
    size = float(solved[best, 0])
    if squares[best] > CLEAR or squares[best] * BETTER > corners or abs(size) < max(LEAST, sharpest):
        return None
    return size
