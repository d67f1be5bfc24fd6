"""Kicks: places where the velocity steps, as when a joint of the belt comes by.  Marked, never taken out.

Two parabolas, one on the samples before a place and one on those behind, are set against each other: where their slopes
differ by enough, a kink of the position (a step of the velocity) is held against a kink of the velocity (a corner, as
at every landing).  It is a kick where corners do not explain the record and a kink does, by itself or with a corner
close behind: the belt soon catches the mass again.  Not seen: kicks below a few counts per sample, and those within
some samples of another corner.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from processing.evengrid import even_grid
from processing.series import Series

Array = NDArray[np.float64]

SIDE = 10  # samples of a parabola to either side
AROUND = 16  # samples to either side that the models are fitted to
SUSPECT = 1.2  # counts per sample that the slopes must differ by to be looked at closely
LEAST = 1.5  # counts per sample
BETTER = 2.5  # times smaller squares that a kink must leave than corners alone
CLEAR = 2.0 / 12  # counts^2: mean square that a kink may leave
LATER = np.arange(2.0, 15.0)  # samples behind a kick: where a corner may follow
PLACES = np.arange(-6.0, 6.1, 0.25)  # samples from the suspect: where the kink or the corner may be


@dataclass(frozen=True)
class Kick:
    """The velocity stepped by ``step`` (m/s) just before sample ``sample``."""

    sample: int
    step: float


def kicks(series: Series) -> tuple[Kick, ...]:
    """Find where the velocity steps; a record without counts shows none."""
    if not series.pitch:
        return ()
    found: list[Kick] = []
    for piece in series.pieces:
        if piece.stop - piece.start <= 2 * AROUND + 2:
            continue
        count = even_grid(series.time[piece], series.position[piece]) / series.pitch
        for sample, step in _in_piece(count):
            found.append(Kick(piece.start + sample, step * series.pitch / series.interval))
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
    for group in groups:
        place = int(group[np.argmax(steps[group - SIDE])])
        if AROUND <= place < count.size - AROUND:
            step = _judged(count, place)
            if step is not None:
                found.append((place, step))
    return found


def _judged(count: Array, place: int) -> float | None:
    """Return the step, counts per sample, where a kink alone explains the record around ``place``."""
    j = np.arange(-AROUND, AROUND, dtype=float)
    y = count[place - AROUND : place + AROUND] - count[place]
    smooth = np.linalg.qr(np.vander(j / AROUND, 4))[0]
    y = y - smooth @ (smooth.T @ y)
    left, size = [], 0.0
    for power in (1, 2):
        bent = np.maximum(j - PLACES[:, None], 0.0) ** power
        bent = bent - (bent @ smooth) @ smooth.T
        norm = np.einsum("ij,ij->i", bent, bent)
        squares = (y @ y - (bent @ y) ** 2 / norm) / y.size
        at = int(np.argmin(squares))
        left.append(max(float(squares[at]), 1 / 12))
        if power == 1:
            size = float(bent[at] @ y / norm[at])
    if left[1] <= CLEAR:
        return None  # a corner is all there is
    if left[0] > CLEAR:
        # The mass may be back on the belt, or turned to another slip, within milliseconds: with corners beside it.
        best = (np.inf, 0.0, 0.0, 0.0)
        corners = np.inf
        for at in PLACES[::2]:
            for later in LATER:
                bent = _bent(j, smooth, at, later)
                solved, squares = _fitted(bent, y)
                best = min(best, (squares, at, later, float(solved[0])))
                corners = min(corners, _fitted(bent[1:], y)[1])
        for at in best[1] + np.arange(-0.4, 0.41, 0.05):
            for later in best[2] + np.arange(-0.75, 0.76, 0.25):
                solved, squares = _fitted(_bent(j, smooth, at, later), y)
                best = min(best, (squares, at, later, float(solved[0])))
        left, size = [best[0], corners], best[3]
    if left[0] > CLEAR or left[0] * BETTER > left[1] or abs(size) < LEAST:
        return None
    return size


def _bent(j: Array, smooth: Array, at: float, later: float) -> Array:
    """Return a kink, a corner with it and a corner ``later`` behind it, less what smooth polynomials follow."""
    corners = np.maximum(j - at - np.array([[0.0], [later]]), 0.0) ** 2
    bent = np.vstack((np.maximum(j - at, 0.0), corners))
    return np.asarray(bent - (bent @ smooth) @ smooth.T)


def _fitted(columns: Array, y: Array) -> tuple[Array, float]:
    """Return the coefficients of the columns and the mean square they leave of y; a count's rounding at least."""
    solved: Array = np.asarray(np.linalg.lstsq(columns.T, y, rcond=None)[0], np.float64)
    residual = y - solved @ columns
    return solved, max(float(residual @ residual) / y.size, 1 / 12)
