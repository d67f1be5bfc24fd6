"""Frames lost or doubled among even times, where noise hides single ones: what they leave in the residuals of a fit.

Each lost frame moves all positions behind it by the way v dt of one frame.  The residuals of a window then are noise
and a random walk, whose variance grows by p (v dt)^2 a sample when a share p of the frames is missing.  The residuals
are cut into pieces, each less a cubic and what it has in common with the same piece of the other cycles: that takes
away what a wrong law, a ripple or wear leaves.  The squares of what a piece holds of the modes of a random walk are
regressed on the variances that noise and the walk give to each mode.
Noise may be correlated over three samples, as after a filter in the tracker: its autocovariances are unknowns, too.
What rounding leaves of a slow motion is correlated for longer: where it makes up the noise, nothing is looked for.

`processing.defects.frames` counts the frames where single ones are clear of the noise.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fitting.driver.fit import Fit
from processing.record.kinematics import Kinematics
from processing.record.noise import DITHERED
from stickslip.compute.arrays import Array, Integers
from stickslip.units import Measured

# Samples of a piece: the shortest that shows the share to `SHARE_ERROR` is taken, or the last.  In 16 a law's misfit
# leaves nothing, in 256 (0.64 s at 400 frames a second) constant friction shows the share under 1 mm of noise.
PIECE_SAMPLES = (16, 32, 64, 128, 192, 256)
TREND_DEGREE = 3  # degree of the polynomial taken off each piece
NOISE_LAGS = 3  # samples over which noise may be correlated
# Standard error of the share without lost frames.  With twice as much, 5 % would be five errors away, which is no sure
# finding; half as much wants longer pieces, and none is long enough for constant friction under 1 mm of noise.
SHARE_ERROR = 0.005
# Share of lost frames in standard errors: where losses are possible, and sure.  Of 40 sound tracks (0.2 to 1 mm of
# noise, also of other laws than the six) none exceeds 2.1, of 24 that miss 5 % of their frames none has less than 10.
# Between the two limits longer pieces decide.
POSSIBLE_ERRORS, SURE_ERRORS = 3.0, 6.0
LEAST_SHARE = 0.01  # share of lost frames: less moves parameters by less than 1 %
ERRORS_BETWEEN_CYCLES = 2.5  # share in standard errors by the scatter between cycles, which the walk makes large
FEWEST_PIECES, FEWEST_CYCLES = 8, 4
REWEIGHTINGS = 4  # fits, each with the weights of the last


@dataclass(frozen=True, eq=False)
class PieceModes:
    """Modes of a random walk in a piece of n samples, without its cubic."""

    vectors: Array
    noise: Array  # variance that noise of unit autocovariance at each lag gives to each mode
    walk: Array  # the same of a random walk of unit steps


@lru_cache(maxsize=len(PIECE_SAMPLES))
def piece_modes(n: int) -> PieceModes:
    smooth = np.linalg.qr(np.vander(np.linspace(-1, 1, n), TREND_DEGREE + 1))[0]
    left = np.eye(n) - smooth @ smooth.T
    steps = left @ np.tril(np.ones((n, n)))
    size, vectors = np.linalg.eigh(steps @ steps.T)
    size, vectors = size[TREND_DEGREE + 1 :], vectors[:, TREND_DEGREE + 1 :]  # the smallest belong to the cubic
    lags = [np.eye(n, k=lag) + (lag > 0) * np.eye(n, k=-lag) for lag in range(NOISE_LAGS + 1)]
    return PieceModes(vectors, np.array([np.sum(vectors * (lag @ vectors), axis=0) for lag in lags]), size)


def missing_share(fit: Fit, record: Kinematics, run: int = 0) -> Measured | None:
    """Return the share of lost (or doubled) frames of a run, 0 to 1, by the best law; None where none is seen.

    A board's recording and uneven times are not tested: their times show what is missing.
    """
    motion = fit.problem.motions[run]
    if record.recording.raw is not None or not record.even_times or motion.resolution < DITHERED * motion.step:
        return None
    own = fit.for_run(run)
    interval = float(np.median(np.diff(record.time)))
    for n in PIECE_SAMPLES:
        squares, speeds, cycle = _pieces(own, n, interval)
        if len(cycle) < FEWEST_PIECES or np.unique(cycle).size < FEWEST_CYCLES:
            return None
        found = _regressed(squares, speeds, cycle, piece_modes(n), SHARE_ERROR if n < PIECE_SAMPLES[-1] else math.inf)
        if found is not None:
            share, null = found
            if share.value > max(LEAST_SHARE, SURE_ERRORS * null, ERRORS_BETWEEN_CYCLES * share.sd):
                return share
            if share.value < POSSIBLE_ERRORS * null:
                return None
    return None


def _pieces(fit: Fit, n: int, interval: float) -> tuple[Array, Array, Integers]:
    """Return squared modes (k, m), m^2, mean square step (k,), m^2, and cycle (k,) of every piece.

    Pieces are at the same places in every window, and the mean of their modes over the cycles is subtracted: lost
    frames do not repeat, the misfit of a wrong law does.
    """
    modes, steps, cycles, places = [], [], [], []
    windows = fit.windows
    model, vectors = fit.residual + windows.position, piece_modes(n).vectors
    for cycle, stick, first, size, *_ in windows.table:
        if not fit.inlier_cycles[cycle]:
            continue
        for number in range(size // n):
            piece = slice(first + number * n, first + (number + 1) * n)
            time = windows.time[piece]
            if time[-1] - time[0] > (n - 0.5) * interval:  # samples are left out of it
                continue
            modes.append(np.einsum("ij,i->j", vectors, fit.residual[piece]))
            steps.append(float(np.mean(np.gradient(model[piece]) ** 2)))
            cycles.append(int(cycle))
            places.append(2 * number + int(stick))
    place = np.array(places, np.int64)
    squares = np.array(modes).reshape(place.size, vectors.shape[1])
    kept = np.zeros(place.size, np.bool_)
    for one in np.unique(place):
        own = place == one
        count = int(own.sum())
        if count >= FEWEST_CYCLES:
            squares[own] = (squares[own] - squares[own].mean(axis=0)) ** 2 * (count / (count - 1))
            kept |= own
    return squares[kept], np.array(steps)[kept], np.array(cycles, np.int64)[kept]


def _regressed(
    squares: Array, steps: Array, cycle: Integers, modes: PieceModes, certain: float
) -> tuple[Measured, float] | None:
    """Return the share with its standard error by cycles, and that of a record without lost frames.

    None where the latter is larger than ``certain``.
    """
    noise = np.broadcast_to(modes.noise[:, None, :], (NOISE_LAGS + 1, *squares.shape))
    columns = np.concatenate((noise, (steps[:, None] * modes.walk)[None]))
    level = float(np.mean(squares[:, : squares.shape[1] // 2]))  # of the modes that the walk hardly has
    scale = np.append(np.full(NOISE_LAGS + 1, level), 1.0)
    variance = np.full(squares.shape, level)
    null = 0.0
    for round_ in range(REWEIGHTINGS):
        weight = variance**-2
        curvature = np.einsum("akm,bkm,km->ab", columns, columns, weight) * np.outer(scale, scale)
        inverse = np.linalg.inv(curvature) * np.outer(scale, scale)
        if round_ == 0:
            null = float(np.sqrt(2 * inverse[-1, -1]))
            if null > certain:
                return None
        found = inverse @ np.einsum("akm,km->a", columns, weight * squares)
        expected = np.einsum("a,akm->km", found, columns)
        variance = np.maximum(expected, 0.1 * level)
    pull = np.einsum("akm,km->ka", columns, weight * (squares - expected)) @ inverse[-1]
    by_cycle = np.array([pull[cycle == one].sum() for one in np.unique(cycle)])
    spread = float(np.sqrt(np.sum(by_cycle**2) * by_cycle.size / (by_cycle.size - 1)))
    return Measured(float(found[-1]), spread), null
