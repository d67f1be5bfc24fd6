"""The samples of a fit: a stick window and a slip window of each cycle; their nodes; wear.

Wear is the decrease of the friction level from cycle to cycle, by a straight line through the cycles' levels.

The level is new after each landing, so the error of the line comes from the scatter of the levels about it.  The change
of a level within a cycle is a separate parameter of the fit (`fitting.model.unknowns`, fade) and is not used for wear,
since a contact may lose its strength only when it is formed again.

Nodes represent the samples of a record: the last pass of a fit needs tangents only at nodes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting import noise_levels
from fitting.least_squares.normal_equations import Block, blocks_of
from fitting.model import unknowns
from fitting.model.unknowns import PER_CYCLE, PER_RUN, PerCycle
from fitting.record.cycles import Cycle
from fitting.record.motion import MeasuredMotion
from stickslip.compute.arrays import Array, Integers, Mask, end_to_end
from stickslip.units import Measured

# Mean square of a cycle over the median of its run, above which it is an outlier.  Noise alone gives up to 1.2; a belt
# joint with a step of 10 mm/s gives 3 to 20.  With a limit of 3, slips with weak steps still led to p = 1e-8 of true
# laws.
SPOILT = 1.5
BESIDE_BELT = 0.9995  # fastest start of a slip window over the belt's speed


class Thinning(NamedTuple):
    """Selection of samples in a window: every ``stride``-th, and about ``most`` of a long stick."""

    stride: int = 1
    most: float = math.inf

    def select(self, size: int, stuck: int) -> NDArray[np.int64]:
        """Return the selected samples of a window that sticks from sample ``stuck`` on."""
        moving = np.arange(0, stuck, self.stride)
        begin = moving.size * self.stride
        return np.concatenate([moving, np.arange(begin, size, max(self.stride, int((size - begin) / self.most)))])


EVERY_SAMPLE = Thinning()


def first_stuck_sample(time: Array, stick: int, landing: float, *, overtakes: bool) -> int:
    """Return the first stuck sample of a window (n,), s.

    After overtaking the belt, it slips forwards for less time than it slipped before.
    """
    if stick:
        return 0
    end = 2 * landing - float(time[0]) if overtakes else landing
    return int(np.searchsorted(time, end))


@dataclass(frozen=True, eq=False)
class ShootingWindows:
    """The samples of all windows, end to end, each cycle's stick window before its slip window."""

    # (windows, 6) cycle, 1 for a stick window and 0 for a slip window, first sample, number of samples, 1 if the mass
    # overtakes the belt after landing, run (0 if there is only one)
    table: NDArray[np.int64]
    level_epoch: Array  # (windows,) s; the cycle's break-away: its level is the level at that time
    # (windows,) s; half way from a slip window's start to the measured landing: an earlier contact is not a landing
    earliest_landing: Array
    time: Array  # (N,) s, m
    position: Array
    source: NDArray[np.int64]  # (N,) index of each sample in its run's record
    rows: tuple[slice, ...]  # the samples of each cycle
    parts: "tuple[ShootingWindows, ...]" = ()  # each run's own, where several are joined

    @classmethod
    def from_cycles(
        cls, motion: MeasuredMotion, cycles: tuple[Cycle, ...], thinning: Thinning = EVERY_SAMPLE
    ) -> "ShootingWindows":
        table, level_epoch, earliest_landing, source, rows, total = [], [], [], [], [], 0
        for k, cycle in enumerate(cycles):
            begin = total
            for stick, (first, end) in ((1, cycle.stick), (0, cycle.slip)):
                if end > first:
                    stuck = first_stuck_sample(motion.time[first:end], stick, cycle.landing, overtakes=cycle.overtakes)
                    samples = first + thinning.select(end - first, stuck)
                    table.append((k, stick, total, samples.size, cycle.overtakes, 0))
                    level_epoch.append(cycle.break_away)
                    earliest_landing.append(0.5 * (float(motion.time[first]) + cycle.landing))
                    source.append(samples)
                    total += samples.size
            rows.append(slice(begin, total))
        index = np.concatenate(source)
        return cls(
            np.array(table, np.int64),
            np.array(level_epoch),
            np.array(earliest_landing),
            motion.time[index],
            motion.measured[index],
            index,
            tuple(rows),
        )

    @classmethod
    def join(cls, parts: "Sequence[ShootingWindows]") -> "ShootingWindows":
        """Concatenate the windows of several runs; those of one run stay as they are."""
        if len(parts) == 1:
            return parts[0]
        tables: list[NDArray[np.int64]] = []
        rows: list[slice] = []
        total = 0
        for run, windows in enumerate(parts):
            tables.append(windows.table + np.array([len(rows), 0, total, 0, 0, run]))
            rows += [slice(cycle.start + total, cycle.stop + total) for cycle in windows.rows]
            total += windows.time.size
        return cls(
            table=np.concatenate(tables),
            level_epoch=np.concatenate([windows.level_epoch for windows in parts]),
            earliest_landing=np.concatenate([windows.earliest_landing for windows in parts]),
            time=np.concatenate([windows.time for windows in parts]),
            position=np.concatenate([windows.position for windows in parts]),
            source=np.concatenate([windows.source for windows in parts]),
            rows=tuple(rows),
            parts=tuple(parts),
        )

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        return blocks_of(self.rows)

    def of_cycles(self, cycles: NDArray[np.int64]) -> "ShootingWindows":
        """Return the windows of these cycles (ascending indices)."""
        number = np.full(len(self.rows), -1)
        number[cycles] = np.arange(cycles.size)
        rows_of_cycles = number[self.table[:, 0]] >= 0
        table = self.table[rows_of_cycles]
        samples = np.concatenate([np.arange(first, first + size) for first, size in table[:, 2:4]])
        table[:, 0] = number[table[:, 0]]
        table[:, 2] = np.cumsum(table[:, 3]) - table[:, 3]
        return ShootingWindows(
            table=table,
            level_epoch=self.level_epoch[rows_of_cycles],
            earliest_landing=self.earliest_landing[rows_of_cycles],
            time=self.time[samples],
            position=self.position[samples],
            source=self.source[samples],
            rows=end_to_end([self.rows[k] for k in cycles]),
        )

    @property
    def run(self) -> NDArray[np.int64]:
        """Run of each cycle, shape (cycles,)."""
        runs = np.zeros(len(self.rows), np.int64)
        runs[self.table[:, 0]] = self.table[:, 5]
        return runs

    @property
    def overtaking(self) -> NDArray[np.bool_]:
        """Return the cycles (cycles,) in which the mass overtakes the belt."""
        overtaking = np.zeros(len(self.rows), np.bool_)
        overtaking[self.table[:, 0]] = self.table[:, 4] == 1
        return overtaking

    def rms(self, residual: Array) -> Array:
        """Return the rms (cycles,) of each cycle's residuals (N,)."""
        return np.sqrt(self._mean_squares(residual))

    def _mean_squares(self, residual: Array) -> Array:
        return np.array([np.mean(residual[rows] ** 2) for rows in self.rows])

    def spoilt(self, residual: Array) -> NDArray[np.bool_]:
        """Return the outlier cycles (cycles,): those with residuals (N,) far above the median of their run."""
        square, run = self._mean_squares(residual), self.run
        usual = np.array([np.median(square[run == number]) for number in range(int(run.max()) + 1)])
        return np.asarray(square > SPOILT * usual[run])

    def starting_values(self, motions: Sequence[MeasuredMotion]) -> Array:
        """Return starting values (cycles, 6) of the cycles' own unknowns, from the smoothed motions."""
        local = np.zeros((len(self.rows), PER_CYCLE))
        for k, stick, first, _, _, run in self.table:
            motion = motions[run]
            sample = self.source[first]
            column = 4 if stick else 0
            local[k, column] = motion.position[sample]
            local[k, column + 1] = motion.velocity[sample]
        return local

    def fastest_starts(self, u: Array) -> Array:
        """Return upper bounds (cycles, 6) of the cycles' own unknowns: a slip starts slower than the belt.

        Above the belt's speed friction is reversed. Within the noise that allows local minima with Fs 15 % and friction
        7 % off.
        """
        bounds = np.full((len(self.rows), PER_CYCLE), np.inf)
        for k, stick, first, _, _, run in self.table:
            p = unknowns.values(u[PER_RUN * run : PER_RUN * (run + 1)])
            turn = p.omega * self.time[first]
            belt = p.v_dr + p.cosine * math.cos(turn) + p.sine * math.sin(turn)
            if not stick:
                bounds[k, PerCycle.V_SLIP] = BESIDE_BELT * belt
        return bounds


@dataclass(frozen=True)
class Wear:
    relative_rate: Measured  # fraction of the mean level lost per second, 1/s; negative where the contact runs in
    middle: float  # s, the mean time of the levels: there the line passes through their mean
    degrees_of_freedom: int  # of the standard error of ``relative_rate``

    @property
    def first(self) -> Measured:
        """Level when the recording begins, over the mean level; the error is the line's."""
        return Measured(1 + self.relative_rate.value * self.middle, self.relative_rate.sd * self.middle)

    @property
    def rate(self) -> Measured:
        """Fraction of the first level lost per second, 1/s."""
        first = self.first.value
        return Measured(self.relative_rate.value / first, self.relative_rate.sd / first**2)


def level_trend(time: Array, level: Array) -> Wear | None:
    """Fit a line to levels (n,) at times (n,), s; None for fewer than four, or if it is negative at the start."""
    if level.size < noise_levels.FEWEST:
        return None
    level = level / level.mean()
    middle = float(time.mean())
    t = time - middle
    square = float(np.sum(t**2))
    slope = float(np.sum(t * level)) / square
    rest = level - 1 - slope * t
    freedom = level.size - 2
    wear = Wear(Measured(-slope, float(np.sqrt(np.sum(rest**2) / freedom / square))), middle, freedom)
    return wear if wear.first.value > 0 else None


def fit_wear(windows: ShootingWindows, inlier: Mask, local: Array, run: int) -> Wear | None:
    """Return the line through one run's inlier levels, whose logs ``local`` (cycles, 6) has."""
    table = windows.table
    rows = (table[:, 1] == 0) & (table[:, 5] == run) & inlier[table[:, 0]]
    return level_trend(windows.level_epoch[rows], np.exp(local[table[rows, 0], PerCycle.LEVEL]))


@dataclass(frozen=True, eq=False)
class SampleNodes:
    """Every n-th sample of each window, and its last; each sample is shared linearly between its two nodes."""

    windows: ShootingWindows  # of the nodes
    node_before: Integers  # (N,) of each sample
    share: Array  # (N,) the share of each sample that belongs to the node after it
    count: Array  # (nodes,) samples that belong to each

    @classmethod
    def of(cls, every_sample: ShootingWindows, thinned: Sequence[Thinning]) -> "SampleNodes":
        table, picked, node_before, share, total = every_sample.table.copy(), [], [], [], 0
        ends = np.zeros(len(every_sample.rows), np.int64)
        for row, (cycle, stick, first, size, overtakes, run) in enumerate(every_sample.table):
            time = every_sample.time[first : first + size]
            landing = 2 * float(every_sample.earliest_landing[row]) - float(time[0])
            stuck = first_stuck_sample(time, stick, landing, overtakes=bool(overtakes))
            nodes = np.unique(np.r_[thinned[run].select(size, stuck), size - 1])
            before = np.clip(np.searchsorted(nodes, np.arange(size), side="right") - 1, 0, max(nodes.size - 2, 0))
            gap = time[nodes[np.minimum(before + 1, nodes.size - 1)]] - time[nodes[before]]
            node_before.append(total + before)
            share.append((time - time[nodes[before]]) / np.where(gap > 0, gap, 1.0))
            picked.append(first + nodes)
            table[row, 2:4] = total, nodes.size
            total += nodes.size
            ends[cycle] = total
        index, before, shares = np.concatenate(picked), np.concatenate(node_before), np.concatenate(share)
        windows = replace(
            every_sample,
            table=table,
            time=every_sample.time[index],
            position=every_sample.position[index],
            source=every_sample.source[index],
            rows=tuple(slice(int(a), int(b)) for a, b in zip(np.r_[0, ends[:-1]], ends, strict=True)),
            parts=(),
        )
        return cls(windows, before, shares, _shared_out(np.ones(shares.size), before, shares, total))

    def with_mean_residuals(self, model: Array, residual: Array) -> ShootingWindows:
        """Return the nodes with positions such that their residual is the mean of the residual (N,) of their samples.

        ``model`` (nodes,) are predicted positions, m.
        """
        total = _shared_out(residual, self.node_before, self.share, self.count.size)
        mean = np.divide(total, self.count, out=np.zeros_like(total), where=self.count > 0)
        return replace(self.windows, position=model - mean)


def _shared_out(values: Array, before: Integers, share: Array, nodes: int) -> Array:
    """Return the sum of values (N,) that belong to each node, shape (nodes,)."""
    after = np.minimum(before + 1, nodes - 1)
    return np.asarray(np.bincount(before, (1 - share) * values, nodes) + np.bincount(after, share * values, nodes))
