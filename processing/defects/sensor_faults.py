"""Readings that are no positions: spikes and drop-outs, and stretches in which a sensor holds its last value.

A spike is out of line with its neighbours (`processing.defects.fault_kernel.find_outliers`).  Only the worst of five
neighbours is taken at a time, since the others may merely lie beside it; then the rest is looked at again.  A drop-out
of three samples or more holds one value and returns.  A frozen stretch holds one for five samples or more and then
catches up with the motion; rest does not, nor does a count that changes slowly.

Found are single spikes beyond six standard deviations of a position (and two and a half counts); not found are longer
bursts of noise, and a sensor that holds its value while nothing moves or until the mass has come back.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.base.compute.arrays import HOLE, Array, Integers, Mask, runs
from daq.base.compute.compile import compiled
from processing.defects import fault_kernel
from processing.record.motion import Fault, mask_of
from processing.record.noise import position_noise, reading_step
from processing.record.series import LONG, Series

KERNELS = ("processing.defects.fault_kernel",)

# In 96 clean records (encoders, cameras of 0.2 and 1 mm, real landings) nothing is flagged; with 4 sd some are.
OUT_OF_LINE = 6.0  # standard deviations of a position, and of the scatter nearby
STEPS = 2.5  # counts, or printed steps: a count that dithers moves by one or two
NORMAL = 0.6745  # median of the absolute value of a standard normal number
PASSES = 8
DROPPED, FROZEN = 3, 5  # samples of one value
BESIDE = 8  # steps on either side of held values that say how the mass moves there
CATCH_UP = 4.0  # times the mean step beside them: what the value jumps by when it is released
LESS = 0.95  # of the noise before: where it falls below that without the faults, more of them show


@dataclass(frozen=True)
class FaultLimits:
    """What faults are judged by, m.

    Attributes
    ----------
    step : float
        That readings are rounded to; 0 where there is none.
    spread : float
        Standard deviation of a position as `OUT_OF_LINE` takes it: that of the record with the faults in it, unless
        they are so frequent that they raise it.
    noise : float
        Standard deviation of a position that is no fault.
    """

    step: float
    spread: float
    noise: float


@dataclass(frozen=True, eq=False)
class SoundRecord:
    """A record without its faults.

    Attributes
    ----------
    faults : tuple of Fault
        In order of time.
    kept : array of bool, shape (n,)
        True for the samples that are positions.
    series : Series
        Those samples.
    bridged : Series
        All n samples, with straight lines where there are faults.
    """

    faults: tuple[Fault, ...]
    kept: Mask
    series: Series
    bridged: Series


def learn(series: Series) -> tuple[FaultLimits, SoundRecord]:
    """Return the limits of a record, and the record without its faults."""
    step = reading_step(series)
    spread = noise = position_noise(series)
    left = without_faults(series, FaultLimits(step, spread, noise))
    for _ in range(3 if left.faults else 0):  # frequent spikes add to the noise
        before, noise = noise, position_noise(left.series)
        if noise > LESS * before:
            break
        spread = noise
        left = without_faults(series, FaultLimits(step, spread, noise))
    return FaultLimits(step, spread, noise), left


def without_faults(series: Series, limits: FaultLimits) -> SoundRecord:
    """Return the record, or a block of it, without its faults."""
    faults: list[Fault] = []
    for piece in series.pieces:
        if piece.stop - piece.start > 2 * BESIDE:
            faults += _in_piece(series.position[piece], limits.spread, limits.step, piece.start)
    kept = ~mask_of(faults, series.time.size)
    if not faults:
        return SoundRecord((), kept, series, series)
    left = series.taken(kept, max(HOLE * series.interval, LONG))
    bridged = np.interp(series.time, left.time, left.position)
    return SoundRecord(tuple(faults), kept, left, replace(series, position=bridged))


def _in_piece(x: Array, noise: float, step: float, start: int) -> list[Fault]:
    jump = OUT_OF_LINE * noise + STEPS * step
    spike, frozen = np.zeros(x.size, bool), np.zeros(x.size, bool)
    own = np.arange(x.size)
    limit = max(OUT_OF_LINE * noise, STEPS * step)
    for _ in range(PASSES):
        if own.size <= 2 * BESIDE:
            break
        out = _outliers(x[own], limit)
        if not out.size:
            break
        spike[own[out]] = True
        own = np.delete(own, out)
    left = x[own] if own.size < x.size else x
    for first, last in _held(left, jump):
        kind = _kind_of_held(left, first, last, jump)
        if kind == "frozen":
            frozen[own[first + 1 : last + 1]] = True  # the first one is sound
        elif kind == "spike":
            spike[own[first : last + 1]] = True
    found = [Fault(start + i, start + j - 1, "spike") for i, j in runs(spike)]
    found += [Fault(start + i, start + j - 1, "frozen") for i, j in runs(frozen)]
    return sorted(found, key=lambda fault: fault.first)


def _kind_of_held(x: Array, first: int, last: int, jump: float) -> str:
    """Return "spike" for a drop-out at the equal values first..last, "frozen" for a sensor that stood still, or ""."""
    before = np.abs(np.diff(x[max(first - 1 - BESIDE, 0) : first]))
    behind = np.abs(np.diff(x[last + 1 : last + 2 + BESIDE]))
    if before.size < 3 or behind.size < 3:
        return ""
    usual = float(np.mean(np.concatenate((before, behind))))
    there, back = float(x[first] - x[first - 1]), float(x[last + 1] - x[last])
    least = jump + CATCH_UP * usual
    if there * back < 0 and min(abs(there), abs(back)) > max(least, 2 * abs(there + back)):
        return "spike"
    moves = np.median(before) > 0 and np.median(behind) > 0
    return "frozen" if moves and last - first + 1 >= FROZEN and abs(back) > least else ""


def _outliers(x: Array, limit: float) -> Integers:
    """Return the samples out of line, of five neighbours only the worst."""
    padded = np.concatenate((_beyond(x)[::-1], x, _beyond(x[::-1])))
    found, size = _outlying(padded, limit)
    ends = (found == 0) | (found == x.size - 1)  # a line from one side only
    if ends.any():
        keep = ~ends
        for k in np.flatnonzero(ends).tolist():
            beside = x[: 2 * BESIDE] if found[k] == 0 else x[::-1][: 2 * BESIDE]
            steps = np.diff(beside[1:])
            keep[k] = np.median(np.abs(steps)) > 0 and size[k] > 2 * limit + 6 * np.abs(np.diff(steps)).max()
        found, size = found[keep], size[keep]
    worst: Mask = np.ones(found.size, bool)
    for k in (1, 2):
        near = found[k:] - found[:-k] <= 2
        worst[k:] &= ~near | (size[k:] > size[:-k])
        worst[:-k] &= ~near | (size[:-k] >= size[k:])
    return np.asarray(found[worst])


def _beyond(x: Array) -> Array:
    """Return the values before the first, nearest first, on a line through medians of those behind it."""
    near, far = float(np.median(x[1:4])), float(np.median(x[3:6]))
    return np.asarray(near - (far - near) / 2 * (3.0 + np.arange(fault_kernel.REACH)))


def _outlying(padded: Array, limit: float) -> tuple[Integers, Array]:
    run = compiled(fault_kernel.find_outliers, KERNELS)
    found, size = _all_found(lambda *out: run(padded, limit, NORMAL / OUT_OF_LINE, *out), ((), np.int64), ((), float))
    return found, size


def _held(x: Array, jump: float) -> list[list[int]]:
    run = compiled(fault_kernel.find_held, KERNELS)
    (found,) = _all_found(lambda out: run(x, DROPPED, jump, out), ((2,), np.int64))
    return found.tolist()  # type: ignore[no-any-return]


def _all_found(run: Callable[..., int], *rows: tuple[tuple[int, ...], type]) -> list[Any]:
    """Return what ``run`` writes into arrays of rows of these shapes and types; it returns how many rows there are."""
    room = 256
    while True:
        arrays: list[Any] = [np.empty((room, *shape), dtype) for shape, dtype in rows]
        count = run(*arrays)
        if count <= room:
            return [array[:count] for array in arrays]
        room = count
