"""Least-squares polynomials on an even grid: the weights of the samples, the fit around each, and the grid.

On the grid u = j/M, j = -M..M, each power of u is made orthogonal to those before it, starting not from the power but
from u times the last orthonormal polynomial: the columns stay well conditioned at every degree, and derivatives obey
the same recurrence.  Weights are then right to 1e-14 of the largest one for windows to 3001 and orders to 20.  (A
least-squares solution of the powers themselves, as in scipy's ``savgol_coeffs``, loses every digit at a window of 301
and an order of 7, without a warning.)

Estimates that need an even grid move readings onto it: where times scatter about the grid by less than half an
interval, a reading moves by v dt with a rough velocity (at 30 us of jitter the next term, a dt^2/2, is 5 nm); wilder
times are interpolated linearly.  Smoothing itself never does.

Source: P. D. Brubeck, Y. Nakatsukasa and L. N. Trefethen, SIAM Rev. 63 (2021) 405.
"""

from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from stickslip.compute.arrays import Array

BLOCK = 8  # windows in a block that is transformed, rounded up to the next power of two
CACHED = 2**14  # samples of the blocks transformed in one go: they stay in the processor's cache


def coefficients(window: int, order: int, sample: int = 0) -> Array:
    """Return the weights, (3, window), of the samples j = -M..M in x, dx/dj and d2x/dj2 of the fit at ``sample``.

    Divide row d by interval**d; the rows of derivatives above the order are zero.
    """
    if window < 1 or window % 2 == 0:
        raise ValueError(f"the window must be an odd number above the order ({order}), not {window}")
    if not 0 <= order < window:
        raise ValueError(f"the order must be from 0 to {window - 1} for a window of {window}, not {order}")
    weights = (_centred(window, order) if sample == 0 else _weights(window, order, sample)).view()
    weights.flags.writeable = False
    return weights


@lru_cache(maxsize=256)
def _centred(window: int, order: int) -> Array:
    return _weights(window, order, 0)


def _weights(window: int, order: int, sample: int) -> Array:
    basis, values = _orthonormal(window, order)
    return np.asarray(values[:, window // 2 + sample] @ basis.T)


@lru_cache(maxsize=4)
def _orthonormal(window: int, order: int) -> tuple[Array, Array]:
    """Return the orthonormal polynomials on the grid, (window, order + 1), and the same with two derivatives, (3, ...).

    Derivatives are per sample interval.
    """
    half = max(window // 2, 1)
    u = np.arange(-(window // 2), window // 2 + 1) / half
    values = np.zeros((3, window, order + 1))
    values[0, :, 0] = 1 / np.sqrt(window)
    basis = values[0]
    for k in range(order):
        new = u[:, None] * values[:, :, k].T
        new[:, 1] += values[0, :, k] / half
        new[:, 2] += 2 * values[1, :, k] / half
        lower = values[:, :, : k + 1]
        for _ in range(2):  # once leaves rounding of the size of what is taken off
            new -= (lower @ (basis[:, : k + 1].T @ new[:, 0])).T
        values[:, :, k + 1] = (new / np.linalg.norm(new[:, 0])).T
    return basis, values


def convolve(position: Array, weights: Array, out: Array | None = None) -> Array:
    """Convolve samples (n,) with weights (k, window) by Fourier transforms of overlapping blocks: (k, n - window + 1).

    Rounding grows with the largest number of a block, so the middle sample of each block is subtracted first.
    """
    n, window = position.size, weights.shape[1]
    size = 1 << (BLOCK * window - 1).bit_length()
    step, outputs = size - window + 1, n - window + 1
    samples_per_pass = max(CACHED // size, 1) * step
    spectra = np.conj(np.fft.rfft(weights, size))
    total = weights.sum(axis=1)
    result = np.empty((weights.shape[0], outputs)) if out is None else out
    for begin in range(0, outputs, samples_per_pass):
        end = min(begin + samples_per_pass, outputs)
        padded = np.full(-(-(end - begin) // step) * step + window - 1, position[-1])
        samples = position[begin : begin + padded.size]
        padded[: samples.size] = samples
        blocks = sliding_window_view(padded, size)[::step]
        middle = blocks[:, size // 2, None]
        spectrum = np.fft.rfft(blocks - middle)
        for k, weight_spectrum in enumerate(spectra):
            sums = np.fft.irfft(spectrum * weight_spectrum, size)[:, :step] + total[k] * middle
            result[k, begin:end] = sums.ravel()[: end - begin]
    return result


def fit(position: Array, window: int, order: int, interval: float) -> tuple[Array, Array]:
    """Fit a polynomial around every sample, one-sided near the ends; return what `uneven.fit` returns."""
    n, half = position.size, window // 2
    values, norms = np.empty((3, n)), np.empty((3, n))
    scale = np.array([1.0, 1.0 / interval, 1.0 / interval**2])[:, None]
    weights = scale * coefficients(window, order)
    convolve(position, weights, values[:, half : n - half])
    norms[:, half : n - half] = np.linalg.norm(weights, axis=1)[:, None]
    basis, fitted = _orthonormal(window, order)
    for inside, source in ((slice(0, half), slice(0, window)), (slice(n - half, n), slice(n - window, n))):
        relative = slice(inside.start - source.start, inside.stop - source.start)
        values[:, inside] = scale * (fitted[:, relative] @ (basis.T @ (position[source] - position[source.start])))
        values[0, inside] += position[source.start]
        norms[:, inside] = scale * np.linalg.norm(fitted[:, relative], axis=2)
    return values, norms


ROUGH = 31, 4  # window and order of the rough velocity


def even_grid(time: Array, position: Array) -> Array:
    """Return the positions on the even grid from the first to the last sample; ``position`` itself if times are even.

    The times, s, increase and have no gaps.
    """
    n = time.size
    step = (time[-1] - time[0]) / (n - 1)
    grid = time[0] + step * np.arange(n)
    offset = time - grid
    if np.abs(offset).max() <= 1e-6 * step:
        return position
    if np.abs(offset).max() > 0.5 * step or n < ROUGH[0]:
        return np.asarray(np.interp(grid, time, position))
    half = ROUGH[0] // 2
    inner = convolve(position, coefficients(*ROUGH))[1]
    return np.asarray(position - offset / step * np.pad(inner, half, mode="edge"))


def is_even(time: Array) -> bool:
    """Return whether the times lie on an even grid, to a millionth of an interval."""
    n = time.size
    if n < 3:
        return True
    step = (time[-1] - time[0]) / (n - 1)
    return bool(np.abs(time - (time[0] + step * np.arange(n))).max() <= 1e-6 * step)
