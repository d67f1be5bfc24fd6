"""Array types by their element, dataclasses of columns, runs of a mask, and the integrated autocorrelation time.

Source of the autocorrelation time: A. Sokal, Monte Carlo Methods in Statistical Mechanics (1997), section 3; the sum is
cut at the first negative estimate.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Columns = TypeVar("Columns", bound="DataclassInstance")

HOLE = 3.5  # sample intervals: longer than any jitter or a missing sample or two, shorter than a lost frame of eight


def rows(columns: Columns, where: NDArray[Any] | slice) -> Columns:
    """Return a dataclass with some rows of its arrays; what is no array stays as it is."""
    own = {name: value[where] for name, value in vars(columns).items() if isinstance(value, np.ndarray)}
    return replace(columns, **own)


def joined(pieces: Sequence[Columns]) -> Columns:
    """Return dataclasses as one, their arrays one behind the other; what is no array is that of the first one."""
    names = [name for name, value in vars(pieces[0]).items() if isinstance(value, np.ndarray)]
    return replace(pieces[0], **{name: np.concatenate([vars(piece)[name] for piece in pieces]) for name in names})


def end_to_end(parts: Sequence[slice]) -> tuple[slice, ...]:
    """Return slices of the lengths of ``parts``, the first from 0 and each from where the one before ends."""
    edges = np.cumsum([0, *(part.stop - part.start for part in parts)]).tolist()
    return tuple(slice(first, last) for first, last in pairwise(edges))


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the half-open index ranges over which ``mask``, shape (n,), is true, in order."""
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def pieces(time: Array, segment: NDArray[np.integer], interval: float) -> tuple[slice, ...]:
    """Return the stretches between segment changes and holes longer than `HOLE` intervals."""
    steps = np.diff(time)
    # Nine in ten intervals are no longer than this: the nominal one, or its like where samples come at random.
    usual = max(interval, float(np.percentile(steps, 90)))
    cut = (np.diff(segment.astype(np.int64)) != 0) | (steps > HOLE * usual)
    edges = [0, *(np.flatnonzero(cut) + 1).tolist(), time.size]
    return tuple(slice(first, last) for first, last in pairwise(edges))


def autocorrelation_time(pieces: Iterable[Array]) -> float:
    """Return the integrated autocorrelation time in samples, at least 1: 1 + 2 sum rho(lag), up to the first rho < 0.

    Parameters
    ----------
    pieces : iterable of ndarray, shape (n_i,)
        Residuals of zero mean, evenly sampled; the autocorrelation is pooled over the pieces.  Nothing but zeros: 1.
    """
    kept = list(pieces)
    lags = np.zeros(max((r.size for r in kept), default=1))
    for r in kept:
        size = 1 << (2 * r.size - 1).bit_length()
        spectrum = np.fft.rfft(r, size)
        lags[: r.size] += np.fft.irfft(spectrum * np.conj(spectrum), size)[: r.size]
    if lags[0] <= 0:
        return 1.0
    rho = lags / lags[0]
    end = int(np.argmax(rho < 0)) if np.any(rho < 0) else rho.size
    return max(1.0, 1 + 2 * float(np.sum(rho[1:end])))
