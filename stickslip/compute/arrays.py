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

from stickslip.errors import InputError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Columns = TypeVar("Columns", bound="DataclassInstance")

HOLE = 3.5  # sample intervals: longer than any jitter or a missing sample or two, shorter than a lost frame of eight


def rows(columns: Columns, where: NDArray[Any] | slice) -> Columns:
    """Return a dataclass with some rows of its arrays; its other fields stay as they are."""
    selected = {name: value[where] for name, value in vars(columns).items() if isinstance(value, np.ndarray)}
    return replace(columns, **selected)


def joined(pieces: Sequence[Columns]) -> Columns:
    """Concatenate the arrays of dataclasses; other fields are those of the first one."""
    names = [name for name, value in vars(pieces[0]).items() if isinstance(value, np.ndarray)]
    return replace(pieces[0], **{name: np.concatenate([vars(piece)[name] for piece in pieces]) for name in names})


def end_to_end(parts: Sequence[slice]) -> tuple[slice, ...]:
    """Return slices of the lengths of ``parts``, the first from 0 and each from where the one before ends."""
    edges = np.cumsum([0, *(part.stop - part.start for part in parts)]).tolist()
    return tuple(slice(first, last) for first, last in pairwise(edges))


def numbers(values: Any, name: str, where: str, do: str, *, single: bool = False) -> "NDArray[Any]":
    """Check numbers from Python, of shape (n,) or with ``single`` one alone; masked samples are errors."""
    if np.ma.is_masked(values):
        masked = np.flatnonzero(np.ma.getmaskarray(values))
        what = f"{name} is masked at sample {masked[0]}" + (f" and {masked.size - 1} more" if masked.size > 1 else "")
        raise InputError(what, where, f"remove those samples: keep = ~np.ma.getmaskarray({name})")
    try:
        column = np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of unequal length
        raise InputError(f"{name} is not an array of numbers", where, do) from error
    if column.dtype == object and column.ndim == 1:  # a column of a table with a number as text or None in it
        try:
            column = column.astype(np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{name} contains {_find_non_number(column)!r:.40} instead of numbers", where, do
            ) from error
    if column.dtype.kind in "mM":
        do = "convert them to seconds: (t - t[0]) / np.timedelta64(1, 's')"
        raise InputError(f"{name} contains dates or durations instead of numbers", where, do)
    if column.dtype.kind not in "iuf":
        raise InputError(f"{name} contains {column.dtype} values instead of numbers", where, do)
    if single and column.ndim == 0:
        return column.reshape(1)
    if column.ndim != 1:
        raise InputError(
            f"{name} has shape {column.shape}", where, f"pass one dimension, as in {name}[:, 0] or .ravel()"
        )
    return column


def _find_non_number(column: "NDArray[Any]") -> Any:
    for value in column:
        try:
            float(value)
        except (TypeError, ValueError, OverflowError):
            return value
    return None


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
    """Return 1 + 2 sum rho(lag) up to the first rho < 0, in samples; rho is pooled over residuals of zero mean."""
    residuals = list(pieces)
    lags = np.zeros(max((r.size for r in residuals), default=1))
    for r in residuals:
        size = 1 << (2 * r.size - 1).bit_length()
        spectrum = np.fft.rfft(r, size)
        lags[: r.size] += np.fft.irfft(spectrum * np.conj(spectrum), size)[: r.size]
    if lags[0] <= 0:
        return 1.0
    rho = lags / lags[0]
    end = int(np.argmax(rho < 0)) if np.any(rho < 0) else rho.size
    return max(1.0, 1 + 2 * float(np.sum(rho[1:end])))
