"""The base of the tests for departures: a fit of a law or of the free curve, made linear about its solution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.estimation.linearised import LinearisedFit
from fitting.forces.departure import Forcing
from fitting.forces.fitted_motion import FittedMotion
from fitting.least_squares.problem import Derivatives
from fitting.model.problem import COARSE_SAMPLES
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.flow import SEARCH_STEP
from fitting.sensitivity.path import Path, follow
from fitting.sensitivity.tangents import tangents
from stickslip.compute.arrays import Array, Integers


@dataclass(frozen=True, eq=False)
class Base:
    linear: LinearisedFit
    path: Path
    trajectory: FittedMotion

    @classmethod
    def of(
        cls, linear: LinearisedFit, path: Path, records: Sequence[MeasuredMotion], revolution: float | None = None
    ) -> "Base":
        """Read a path; ``revolution`` is the encoder's travel per revolution, m, if calibrated."""
        trajectory = FittedMotion.from_path(path, records, linear.residual, revolution)
        return cls(linear, path, trajectory)

    def thinned(self) -> "Base":
        """Return the base on blocks of samples, `COARSE_SAMPLES` a slip, or itself where these steps are too long.

        The residual and derivatives of a block are means; the path is at its middle.
        """
        whole = self.path.windows
        stride = max(1, round(self.trajectory.samples_per_slip / COARSE_SAMPLES))
        if stride == 1:
            return self
        blocks = Blocks.of(whole, stride)
        windows = replace(
            whole,
            table=blocks.table,
            time=whole.time[blocks.middle],
            position=self.path.model[blocks.middle] - blocks.mean(self.linear.residual),
            source=whole.source[blocks.middle],
            rows=blocks.rows,
        )
        path = follow(windows, self.path.curve, self.path.u, self.path.local, longest_step=SEARCH_STEP)
        if path is None:
            return self
        derivatives = blocks.mean(self.linear.derivatives.columns())
        linear = LinearisedFit.of(
            Derivatives(windows.blocks, lambda block: derivatives[block.rows]),
            blocks.mean(self.linear.residual),
            blocks.rows,
            self.linear.weights * stride,
            self.linear.priors,
        )
        trajectory = FittedMotion.from_path(path, self.trajectory.records, linear.residual, self.trajectory.revolution)
        return Base(linear, path, trajectory)

    def respond(self, forcings: Sequence[Forcing]) -> Array:
        """Return the response of the positions to forcings, shape (N, columns of all)."""
        widths = [next(part.shape[1] for part in forcing if part is not None) for forcing in forcings]
        stage, sample = self.path.time.size, self.trajectory.samples.size
        whole = (
            _side_by_side([forcing.acceleration for forcing in forcings], widths, stage),
            _side_by_side([forcing.reading for forcing in forcings], widths, sample),
            _side_by_side([forcing.belt_speed for forcing in forcings], widths, stage),
        )
        acceleration, reading, belt_speed = whole
        if acceleration is None and belt_speed is None and reading is not None:
            return reading
        if acceleration is None:
            acceleration = np.zeros((stage, sum(widths)))
        return tangents(self.path, acceleration, belt_speed=belt_speed, position=reading)


def _side_by_side(parts: Sequence[Array | None], widths: Sequence[int], rows: int) -> Array | None:
    """Return the parts as columns of one array, zero for None; None where all are."""
    if all(part is None for part in parts):
        return None
    whole = np.zeros((rows, sum(widths)))
    first = 0
    for part, width in zip(parts, widths, strict=True):
        if part is not None:
            whole[:, first : first + width] = part
        first += width
    return whole


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of samples of each window, after its first sample, where a path begins."""

    table: Integers  # (windows, 6) as in `ShootingWindows`, in blocks
    middle: Integers  # (n,) middle sample of each block
    first: Integers  # (n,) its first sample; -1 for the first sample of a window, which counts nothing
    rows: tuple[slice, ...]  # the blocks of each cycle
    size: int  # samples in a block

    @classmethod
    def of(cls, windows: ShootingWindows, size: int) -> "Blocks":
        """Divide every window into blocks of ``size`` >= 2; the remainder belongs to none."""
        table, middle, first, total = windows.table.copy(), [], [], 0
        ends = np.zeros(len(windows.rows), np.int64)
        for row, (cycle, _, begin, count, _, _) in enumerate(windows.table):
            begins = begin + size * np.arange(count // size)
            middle.append(np.r_[begin, begins + size // 2])
            first.append(np.r_[-1, begins])
            table[row, 2:4] = total, middle[-1].size
            total += middle[-1].size
            ends[cycle] = total
        starts = np.r_[0, ends[:-1]]
        rows = tuple(slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True))
        return cls(table, np.concatenate(middle), np.concatenate(first), rows, size)

    def mean(self, values: Array) -> Array:
        """Return the mean of ``values`` (N, ...) over each block, 0 if it counts nothing; shape (n, ...)."""
        out = np.zeros((self.first.size, *values.shape[1:]))
        real = self.first >= 0
        for offset in range(self.size):
            out[real] += values[self.first[real] + offset]
        return np.ascontiguousarray(out / self.size)


def usual_rms(residual: Array, rows: Sequence[slice]) -> float:
    """Return the median of the cycles' errors, m, which spoilt cycles do not move."""
    return math.sqrt(float(np.median([np.mean(residual[cycle] ** 2) for cycle in rows])))
