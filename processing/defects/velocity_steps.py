"""Kicks: places where the velocity steps, as when a joint of the belt comes by.  Marked, never taken out.

Two parabolas, one on the samples before a place and one on those behind, are set against each other: where their slopes
differ by enough, a kink of the position (a step of the velocity) is held against a kink of the velocity (a corner, as
at every landing).  It is a kick where corners no sharper than the record's accelerations do not explain it and a kink
does, with a corner close behind: the belt soon catches the mass again.  Of kicks by 50 mm/s at 7.67 um and 1 kHz all
are seen, of those by 20 mm/s, over within 3 samples, half.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from daq.compute.arrays import Array
from processing.record.motion import VelocityStep
from processing.record.series import Series

SIDE = 10  # samples of a parabola to either side
AROUND = 16  # samples to either side that the models are fitted to
SUSPECT = 1.2  # counts per sample that the slopes must differ by to be looked at closely
LEAST = 1.5  # counts per sample; and no less than a corner may do in a sample
BETTER = 2.0  # times smaller squares that a kink must leave than corners alone
CLEAR = 2.0 / 12  # counts^2: mean square that a kink may leave
LATER = np.append(np.arange(2.0, AROUND + 3.0), 2 * AROUND)  # samples behind a kick or a corner: where one may follow
MEAN = 10  # samples averaged into one for a rough acceleration
SHARPEST = 2.0  # times the largest rough acceleration: what it may jump by at a corner
PLACES = np.arange(-6.0, 6.1, 0.25)  # samples from the suspect: where the kink or the corner may be


def kicks(series: Series) -> tuple[VelocityStep, ...]:
    """Find where the velocity steps; a record without counts shows none."""
    if not series.pitch:
        return ()
    found: list[VelocityStep] = []
    for piece, count in zip(series.pieces, series.even_counts, strict=True):
        if count.size <= 2 * AROUND + 2:
            continue
        for sample, step in _in_piece(count):
            found.append(VelocityStep(piece.start + sample, step * series.pitch / series.interval))
    return tuple(found)


@lru_cache(maxsize=1)
def _slopes() -> Array:
    """Return weights of 2 SIDE samples: the later parabola's slope between them less the earlier one's."""
    j = np.arange(2 * SIDE) - (SIDE - 0.5)
    weights = np.zeros(j.size)
    for own, sign in ((slice(0, SIDE), -1.0), (slice(SIDE, None), 1.0)):
        weights[own] = sign * np.linalg.pinv(np.vander(j[own], 3))[1]
    return weights


def _in_piece(count: Array) -> list[tuple[int, float]]:
    steps = np.abs(np.correlate(count, _slopes(), "valid"))
    loud = np.flatnonzero(steps >= SUSPECT) + SIDE
    found: list[tuple[int, float]] = []
    groups = np.split(loud, np.flatnonzero(np.diff(loud) > SIDE) + 1) if loud.size else []
    if not groups:
        return found
    # No corner bends the motion by more than its accelerations differ.
    means = count[: count.size // MEAN * MEAN].reshape(-1, MEAN).mean(axis=1)
    sharpest = SHARPEST * float(np.percentile(np.abs(np.diff(means, 2)), 99)) / MEAN**2
    for group in groups:
        place = int(group[np.argmax(steps[group - SIDE])])
        if AROUND <= place < count.size - AROUND:
            step = _judged(count[place - AROUND : place + AROUND], sharpest)
            if step is not None:
                found.append((place, step))
    return found


@dataclass(frozen=True, eq=False)
class Models:
    """Models of the record around a suspect, (m, k, 2 AROUND), less what smooth polynomials follow; and (X X')^-1."""

    columns: Array
    inverse: Array

    def fitted(self, y: Array, corners: slice, sharpest: float) -> tuple[Array, Array]:
        """Return the coefficients, (m, k), and the mean squares left; infinite where a corner is too sharp."""
        along = self.columns @ y
        solved = np.einsum("mij,mj->mi", self.inverse, along)
        squares = (y @ y - np.einsum("mi,mi->m", solved, along)) / y.size
        sharp = (np.abs(solved[:, corners]) > sharpest / 2).any(axis=1)
        return solved, np.where(sharp, np.inf, np.maximum(squares, 1 / 12))


def _models(at: Array, later: Array, *, kinked: bool) -> Models:
    """Return a corner at each time with another ``later``, and with a kink there, if ``kinked``: all pairs of both."""
    at, later = (own.ravel() for own in np.meshgrid(at, later, indexing="ij"))
    j = np.arange(-AROUND, AROUND, dtype=float)
    since = np.maximum(j - at[:, None], 0.0)
    rows = [since] if kinked else []
    rows += [since**2, np.maximum(j - (at + later)[:, None], 0.0) ** 2]
    columns = np.stack(rows, axis=1)
    smooth = _smooth()
    columns = columns - (columns @ smooth) @ smooth.T
    square = columns @ columns.transpose(0, 2, 1)
    size = np.sqrt(np.einsum("mii->mi", square))
    size[size == 0] = 1.0  # a corner behind all samples
    scale = size[:, :, None] * size[:, None, :]
    return Models(columns, np.linalg.inv(square / scale + 1e-9 * np.eye(len(rows))) / scale)


@lru_cache(maxsize=1)
def _smooth() -> Array:
    """Return an orthonormal base of the cubics, (2 AROUND, 4)."""
    return np.asarray(np.linalg.qr(np.vander(np.arange(-AROUND, AROUND, dtype=float) / AROUND, 4))[0])


@lru_cache(maxsize=2)
def _tried(kinked: bool) -> Models:
    return _models(PLACES, LATER, kinked=kinked)


def _judged(count: Array, sharpest: float) -> float | None:
    """Return the step, counts per sample, where only a kink explains the record around its middle.

    ``sharpest`` is what the acceleration may jump by at a corner, counts per sample^2.
    """
    smooth = _smooth()
    y = count - count[AROUND]
    y = y - smooth @ (smooth.T @ y)
    corners = float(_tried(False).fitted(y, slice(0, 2), sharpest)[1].min())
    if corners <= CLEAR:
        return None
    # The mass may be back on the belt, or turned to another slip, within milliseconds: with corners beside it.
    squares = _tried(True).fitted(y, slice(1, 3), sharpest)[1]
    best = int(np.argmin(squares))
    at, later = PLACES[best // LATER.size], LATER[best % LATER.size]
    near = _models(at + np.arange(-0.2, 0.21, 0.05), later + np.arange(-0.75, 0.76, 0.25), kinked=True)
    solved, squares = near.fitted(y, slice(1, 3), sharpest)
    best = int(np.argmin(squares))
    size = float(solved[best, 0])
    if squares[best] > CLEAR or squares[best] * BETTER > corners or abs(size) < max(LEAST, sharpest):
        return None
    return size
