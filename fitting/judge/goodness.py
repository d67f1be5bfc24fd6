"""Absolute goodness of fit: whether noise alone explains the residual of a law.

Noise.  A counter rounds, a camera adds white noise, and jitter of the sample times moves a position by velocity times
the error of the time.  All three are estimated from fourth differences of the residual, in which a smooth misfit
cancels.  Not modelled: noise that is correlated over several samples, as after a low-pass filter.

Statistics.  Each slip, from its window's start to the landing, is divided into bins of its phase, and the residual is
averaged in them: the residual of a wrong law is smooth over a bin and repeats from slip to slip.  The third statistic
is the rms of whole cycles, sticks included.

Null distribution.  Measurements of the fitted motion are simulated with the record's noise, all unknowns are fitted
again, linearly, and the statistics of the residuals are computed.  Rounding causes patterns that repeat from cycle to
cycle; the simulations have them too.  A statistic that is the same in all simulations is not tested.

Excluded cycles.  A cycle with a residual far above the median of its run is not evidence against a law if one velocity
step, as from the belt's joint, explains the excess.  In a stick, and after the landing, friction stops the mass again
within milliseconds, and a step of the position remains.

Smallest visible departure.  A wave is added to the friction: with one or two periods over the slip speeds and constant
amplitude, or with two or four periods over the travel and in proportion to the friction.  The law's parameters absorb
part of it.  It is visible if half of all simulations with it are rejected.  The median over the waves is reported.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy import special

from fitting import noise_levels
from fitting.judge.linearised import LinearisedFit, Repeat
from fitting.least_squares.normal_equations import Block, UnfollowableError
from fitting.model.path import Path
from fitting.model.tangents import tangents
from fitting.model.unknowns import PER_RUN, Global, PerCycle
from fitting.model.windows import SPOILT, ShootingWindows
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array, Integers, Mask

# Order of differences, and their weights (1, 4, 6, 4, 1) squared and summed.
DIFFERENCE_ORDER, SQUARED_WEIGHTS = 4, 70.0
STEADY_SPEED = 0.1  # distance from the belt's speed, over it: nearer, in stick, rounding errors are not white
FASTEST_PATTERN = 0.8  # pitches a sample: slower readings repeat patterns, whose differences are not white
LEAST_WHITE_NOISE = 0.5  # smallest variance of white noise over rounding's; encoders without noise give up to 0.3
FEWEST_DIFFERENCES = 50  # differences from which noise is estimated
ROUNDING = 1e-9  # spread over a mean, below which numbers are equal


@dataclass(frozen=True)
class PositionNoise:
    pitch: float  # m, step to which readings are rounded; 0 for none
    white: float  # m, standard deviation of white noise before the rounding
    jitter: float  # s, standard deviation of a sample time

    def variance(self, velocity: Array) -> Array:
        """At velocities (n,), m^2, (n,)."""
        return np.asarray(self.pitch**2 / 12 + self.white**2 + (self.jitter * velocity) ** 2)

    def sd(self, velocity: Array) -> float:
        return math.sqrt(float(np.mean(self.variance(velocity))))

    def draw(self, position: Array, velocity: Array, rng: np.random.Generator, shift: float) -> Array:
        """Draw position minus reading (n,), m, with the counter's grid moved by ``shift`` pitches."""
        spread = np.sqrt(self.white**2 + (self.jitter * velocity) ** 2)
        error = spread * rng.standard_normal(position.size)
        if self.pitch == 0:
            return np.asarray(-error)
        moved = position + self.pitch * shift
        return np.asarray(moved - (np.floor((moved + error) / self.pitch) + 0.5) * self.pitch)


def estimate_noise(
    windows: ShootingWindows, residual: Array, inliers: Mask, motion: MeasuredMotion, run: int = 0
) -> PositionNoise:
    pitch = motion.step
    rounding = pitch**2 / 12
    interval = float(np.median(np.diff(motion.time)))
    slowest = FASTEST_PATTERN * pitch / interval if motion.resolution < pitch else 0.0
    squares, speeds = [], []
    for k, _, first, count, _, row_run in windows.table:
        if row_run == run and inliers[k] and count > DIFFERENCE_ORDER:
            rows = slice(first, first + count)
            speed = motion.velocity[windows.source[rows]][DIFFERENCE_ORDER // 2 : -DIFFERENCE_ORDER // 2]
            is_fast = np.abs(speed) >= slowest
            if slowest > 0:
                is_fast &= np.abs(speed - motion.belt_speed) > STEADY_SPEED * abs(motion.belt_speed)
            squares.append((np.diff(residual[rows], DIFFERENCE_ORDER) ** 2 / SQUARED_WEIGHTS)[is_fast])
            speeds.append(speed[is_fast] ** 2)
    square, v2 = (np.concatenate(parts) if parts else np.empty(0) for parts in (squares, speeds))
    if square.size < FEWEST_DIFFERENCES:
        return PositionNoise(pitch, math.sqrt(max(motion.resolution**2 - rounding, 0.0)), 0.0)
    middle = v2 - v2.mean()
    slope = float(np.sum(middle * square) / max(np.sum(middle**2), 1e-300))
    white2 = max(float(square.mean()) - max(slope, 0.0) * float(v2.mean()) - rounding, 0.0)
    if white2 < LEAST_WHITE_NOISE * rounding:
        white2 = 0.0
    excess = square - rounding - white2
    scale = max(float(np.sum(v2**2)), 1e-300)
    jitter2 = float(np.sum(excess * v2)) / scale
    error = math.sqrt(float(np.sum(((excess - jitter2 * v2) * v2) ** 2))) / scale
    return PositionNoise(pitch, math.sqrt(white2), math.sqrt(jitter2) if jitter2 > noise_levels.SHOWN * error else 0.0)


MOST_BINS = 60  # bins of a slip, with 8 to 20 samples each at 1 kHz
SAMPLES_IN_BIN = 3  # samples of the median slip in a bin, chosen: enough to average, few enough for short slips
FEWEST_SLIPS = 2  # slips needed to see a repetition


class Statistics(NamedTuple):
    """Statistics of B sets of residuals of a run's judged cycles, each (B,); without slips all but `rms` are 0."""

    repeat: Array  # share of the binned variance that repeats from slip to slip, without bias: 0 for noise
    smooth: Array  # variance of the binned residuals over that of white noise of the same rms; median
    rms: Array  # of all cycles, equally weighted, m


def cycle_squares(residuals: Array, rows: Sequence[slice]) -> Array:
    """Return the mean squares of residuals (N, B), m^2, shape (cycles, B)."""
    first = np.array([rows_of_cycle.start - rows[0].start for rows_of_cycle in rows])
    count = np.array([rows_of_cycle.stop - rows_of_cycle.start for rows_of_cycle in rows])
    return np.asarray(np.add.reduceat(residuals**2, first, axis=0) / count[:, np.newaxis])


@dataclass(frozen=True, eq=False)
class SlipBins:
    """Bins of the slips of a run: rows of residuals, and where each bin begins among them."""

    rows: Integers  # (n,) the residuals in a bin, slip by slip
    starts: Integers  # (occupied bins,) first of ``rows`` in each bin that is not empty
    slip: Integers  # (occupied bins,) slip and bin of its phase
    phase: Integers
    count: Array  # (occupied bins,) residuals in it
    slips: int
    bins: int  # into which the phase of a slip is cut

    @property
    def judged(self) -> bool:
        return self.slips >= FEWEST_SLIPS

    @classmethod
    def cut(cls, windows: ShootingWindows, landings: Array, inliers: Mask, run: int = 0) -> "SlipBins":
        rows, phases = [], []
        for k, stick, first, count, _, row_run in windows.table:
            if stick or row_run != run or not inliers[k]:
                continue
            time = windows.time[first : first + count]
            phase = (time - time[0]) / (landings[k] - time[0])
            before = phase < 1.0
            rows.append(first + np.flatnonzero(before))
            phases.append(phase[before])
        slips = len(rows)
        if not slips:
            empty = np.empty(0, np.int64)
            return cls(empty, empty, empty, empty, np.empty(0), 0, 1)
        usual_size = float(np.median([phase.size for phase in phases]))
        bins = int(min(max(usual_size // SAMPLES_IN_BIN, 1), MOST_BINS))
        cell = [slip * bins + np.floor(bins * phase).astype(np.int64) for slip, phase in enumerate(phases)]
        occupied, starts, count = np.unique(np.concatenate(cell), return_index=True, return_counts=True)
        return cls(np.concatenate(rows), starts, occupied // bins, occupied % bins, count.astype(float), slips, bins)

    def sums(self, values: Array, block: Block | None = None) -> Array:
        """Return the sum of values (N, B) in each bin, or in those of a block."""
        if block is None:
            return np.asarray(np.add.reduceat(values[self.rows], self.starts, axis=0))
        first, last = np.searchsorted(self.rows, (block.rows.start, block.rows.stop))
        starts = self.starts[np.searchsorted(self.starts, first) : np.searchsorted(self.starts, last)]
        if not starts.size:
            return np.zeros((0, values.shape[1]))
        return np.asarray(np.add.reduceat(values[self.rows[first:last] - block.rows.start], starts - first, axis=0))

    def per_slip(self, binned: Array) -> Array:
        return np.asarray(np.add.reduceat(binned, self._edges, axis=0))

    def per_phase(self, binned: Array) -> Array:
        order, edges = self._by_phase
        return np.asarray(np.add.reduceat(binned[order], edges, axis=0))

    @cached_property
    def _edges(self) -> Integers:
        return np.searchsorted(self.slip, np.arange(self.slips))

    @cached_property
    def _by_phase(self) -> tuple[Integers, Integers]:
        order = np.argsort(self.phase, kind="stable")
        return order, np.unique(self.phase[order], return_index=True)[1]

    @cached_property
    def residuals_and_bins(self) -> tuple[Array, Array]:
        return self.per_slip(self.count[:, None]), self.per_slip(np.ones((self.slip.size, 1)))

    def lag1(self, residual: Array) -> float:
        products = np.r_[0.0, residual[1:] * residual[:-1]]
        return float(np.sum(products[self.rows])) / max(float(np.sum(residual[self.rows] ** 2)), 1e-300)

    def statistics(self, residuals: Array, squares: Array) -> Statistics:
        return self.combine(self.sums(residuals), self.sums(residuals**2), squares)

    def combine(self, sums: Array, squared: Array, squares: Array) -> Statistics:
        rms = np.asarray(np.sqrt(np.sum(squares, axis=0) / max(squares.shape[0], 1)))
        if not self.judged:
            nothing = np.zeros(rms.size)
            return Statistics(nothing, nothing, rms)
        number, occupied = self.residuals_and_bins
        square = np.maximum(self.per_slip(squared) / number, 1e-300)
        binned = self.per_slip(sums**2 / self.count[:, None]) / occupied
        usual_square = np.median(square, axis=0)
        weight = np.sqrt(np.minimum(usual_square / square, 1.0))  # an outlier slip is scaled down to the median one
        mean = sums / self.count[:, None] * weight[self.slip]
        each, together = np.sum(mean**2, axis=0), self.per_phase(mean)
        return Statistics(
            repeat=(np.sum(together**2, axis=0) - each) / np.maximum((self.slips - 1) * each, 1e-300),
            smooth=np.median(binned / square, axis=0),
            rms=rms,
        )


REPETITIONS = 60  # the spread of a statistic is then accurate to 9 %
SEED = 13  # seed of the repetitions: the same for every record
REJECTED = 1e-6  # p-value below which noise is rejected: five standard deviations, since the gamma tails are rough
TESTS = 3  # the repeated share, smoothness, and rms
NOISE_KNOWN = 1.2  # allowed rms of all judged cycles over that of the repetitions; true laws have 0.97 to 1.04


@dataclass(frozen=True)
class GoodnessOfFit:
    noise_m: float  # standard deviation of one position, from the record, m
    misfit: float  # rms of the residuals of the judged cycles over ``noise_m``
    lag1: float  # autocorrelation of neighbouring residuals; 0 where no slip can be judged
    repeat: float  # as in `Statistics`
    p_value: float | None  # under noise alone; None where nothing could be tested
    left_out: tuple[int, ...] = ()  # numbers of the excluded cycles; empty for several runs together

    @property
    def judged(self) -> bool:
        return self.p_value is not None

    @property
    def rejected(self) -> bool:
        return self.p_value is not None and self.p_value < REJECTED


@dataclass(frozen=True, eq=False)
class RunSlips:
    noise_m: float  # standard deviation of one position, m
    bins: SlipBins
    lag1: float  # autocorrelation of neighbouring residuals of the record
    of_record: Statistics
    null: Statistics  # of the repetitions
    judged_cycles: Mask  # (cycles,) which cycles of all runs these are
    left_out: tuple[int, ...]  # numbers of the run's excluded cycles


def draw_noise(
    noises: Sequence[PositionNoise], position: Array, velocity: Array, owner: Integers, blocks: Sequence[Block]
) -> Iterator[Array]:
    """Yield repetitions (n, B) of the noise of each run in each block, m, the same when called again."""
    rngs = [[np.random.default_rng((SEED, j, run)) for run in range(len(noises))] for j in range(REPETITIONS)]
    shifts = [[float(rng.uniform(-0.5, 0.5)) for rng in of_runs] for of_runs in rngs]
    for block in blocks:
        run, x, v = owner[block.rows], position[block.rows], velocity[block.rows]
        drawn = np.empty((run.size, REPETITIONS))
        for j, of_runs in enumerate(rngs):
            for k, (noise, rng) in enumerate(zip(noises, of_runs, strict=True)):
                of_run = run == k
                drawn[of_run, j] = noise.draw(x[of_run], v[of_run], rng, shifts[j][k])
        yield drawn


def judge(
    residual: Array,
    refit: Callable[[Repeat], Iterable[tuple[Block, Array]]],
    fit: Fit,
    motions: Sequence[MeasuredMotion],
    left_out: Mask,
) -> tuple[RunSlips, ...]:
    """Return the statistics of each run's slips with their null distribution.

    Residual and ``refit`` are of a fit without the cycles ``left_out``.
    """
    windows = fit.windows
    owner = np.repeat(windows.table[:, 5], windows.table[:, 3])
    position = windows.position + residual
    velocity = np.empty_like(position)
    noises = []
    for run, motion in enumerate(motions):
        samples_of_run = owner == run
        velocity[samples_of_run] = motion.velocity[windows.source[samples_of_run]]
        noises.append(estimate_noise(windows, residual, fit.inlier_cycles, motion, run))
    landings = np.array([cycle.landing for cycle in fit.cycles])
    judged = [~left_out & (windows.run == run) for run in range(len(motions))]
    bins = [SlipBins.cut(windows, landings, cycles, run) for run, cycles in enumerate(judged)]
    parts = []
    for block, refitted in refit(partial(draw_noise, noises, position, velocity, owner)):
        squares = cycle_squares(refitted, windows.rows[block.cycles])
        parts.append(
            (squares, *(sums for cut in bins for sums in (cut.sums(refitted, block), cut.sums(refitted**2, block))))
        )
    null_squares, *null_sums = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
    squares = cycle_squares(residual[:, None], windows.rows)
    return tuple(
        RunSlips(
            noise_m=noise.sd(velocity[owner == run]),
            bins=cut,
            lag1=cut.lag1(residual),
            of_record=cut.statistics(residual[:, None], squares[judged[run]]),
            null=cut.combine(null_sums[2 * run], null_sums[2 * run + 1], null_squares[judged[run]]),
            judged_cycles=judged[run],
            left_out=tuple(fit.cycles[k].number for k in np.flatnonzero(left_out & (windows.run == run))),
        )
        for run, (noise, cut) in enumerate(zip(noises, bins, strict=True))
    )


def goodness_of_fit(slips: Sequence[RunSlips]) -> tuple[GoodnessOfFit, tuple[GoodnessOfFit, ...]]:
    each = [
        GoodnessOfFit(
            noise_m=run.noise_m,
            misfit=float(run.of_record.rms[0]) / run.noise_m if run.noise_m > 0 else math.inf,
            lag1=run.lag1,
            repeat=float(run.of_record.repeat[0]),
            p_value=compute_p_value(run),
            left_out=run.left_out,
        )
        for run in slips
    ]
    if len(each) == 1:
        return each[0], tuple(each)
    share = np.array([run.bins.slips for run in slips], float)
    share /= max(share.sum(), 1.0)
    together = GoodnessOfFit(
        noise_m=math.sqrt(float(np.sum(share * [run.noise_m**2 for run in each]))),
        misfit=math.sqrt(float(np.sum(share * [run.misfit**2 for run in each]))),
        lag1=float(np.sum(share * [run.lag1 for run in each])),
        repeat=float(np.sum(share * [run.repeat for run in each])),
        p_value=_correct_p_value([run.p_value for run in each], len(each)),
    )
    return together, tuple(each)


def compute_p_value(slips: RunSlips) -> float | None:
    if not slips.bins.judged:
        return None
    begin, null = least_repeat(slips.bins), slips.null
    repeat, smooth, rms = (float(statistic[0]) for statistic in slips.of_record)
    tails = (
        tail_probability(repeat - begin, null.repeat - begin),
        tail_probability(smooth, null.smooth),
        tail_probability(rms / NOISE_KNOWN, null.rms),
    )
    return _correct_p_value(tails, TESTS)


def _correct_p_value(p_values: Sequence[float | None], tests: int) -> float | None:
    judged = [p for p in p_values if p is not None]
    return min(1.0, tests * min(judged)) if judged else None


def least_repeat(bins: SlipBins) -> float:
    """Return the smallest possible `repeat`, where its gamma distribution begins."""
    return -1 / max(bins.slips - 1, 1)


def tail_probability(value: float, null: Array) -> float | None:
    """Return the p-value under a gamma distribution with the moments of ``null``; None if all repetitions are equal."""
    mean, spread = float(np.mean(null)), float(np.std(null, ddof=1))
    # The mean of equal numbers differs from them by rounding, so their spread is not exactly 0.
    if not (mean > 0 and spread > ROUNDING * mean):
        return None
    return float(special.gammaincc((mean / spread) ** 2, max(value * mean / spread**2, 0.0)))


TIMES_TRIED = 120  # candidate times of a step in a cycle
LEAST_EXPLAINED = 0.9  # share of a cycle's excess mean square that a step must explain
# Other outlier cycles of a run, and their share, that are excluded: a touch of a hand, an undetected overtaking.
MOST_ODD, MOST_ODD_SHARE = 1, 0.1


def select_left_out(linear: LinearisedFit, windows: ShootingWindows, landings: Array, spoilt: Mask) -> Mask:
    """Return which of the ``spoilt`` cycles (cycles,) to exclude: those with a step, and others if they are few."""
    if not spoilt.any():
        return spoilt
    struck = _find_struck(linear, windows, landings, spoilt)
    odd = spoilt & ~struck
    for run in np.unique(windows.run[odd]):
        cycles = windows.run == run
        if np.sum(odd & cycles) > max(MOST_ODD, MOST_ODD_SHARE * np.sum(cycles)):
            odd &= ~cycles
    return np.asarray(struck | odd)


def _find_struck(linear: LinearisedFit, windows: ShootingWindows, landings: Array, spoilt: Mask) -> Mask:
    """Return the ``spoilt`` cycles whose excess residual one step explains nearly completely."""
    square = cycle_squares(linear.residual[:, np.newaxis], linear.rows)[:, 0]
    struck = np.zeros_like(spoilt)
    stick = np.repeat(windows.table[:, 1] == 1, windows.table[:, 3])
    for block, jacobian in linear.derivatives:
        for k in block.cycles.start + np.flatnonzero(spoilt[block.cycles]):
            rows = linear.rows[k]
            local = jacobian[
                rows.start - block.rows.start : rows.stop - block.rows.start, linear.priors.gradient.size :
            ]
            phase = np.where(stick[rows], 0, 1 + (windows.time[rows] >= landings[k]))
            steps = _steps(local[:, PerCycle.X_SLIP], local[:, PerCycle.V_SLIP], phase)
            excess = square[k] - float(np.median(square[windows.run == windows.run[k]]))
            usual_square, remaining = square[k] - excess, square[k] - _best_gain(linear, k, local, steps) / phase.size
            struck[k] = remaining < SPOILT * usual_square or remaining - usual_square < (1 - LEAST_EXPLAINED) * excess
    return struck


def _steps(x: Array, v: Array, phase: Integers) -> Array:
    """Return the response (n, TIMES_TRIED) to steps of the velocity in slip, and of the position in the other phases.

    ``x`` and ``v`` (n,) are the responses to the position and velocity at the start of the slip. The response to a step
    of the velocity is the combination of both that is 0 at the step.
    """
    begin = np.linspace(1, phase.size - 1, TIMES_TRIED).round().astype(np.int64)
    after = np.arange(phase.size)[:, np.newaxis] >= begin
    velocity = np.outer(v, x[begin]) - np.outer(x, v[begin])
    return np.asarray(after * np.where(phase[begin] == 1, velocity, phase[:, np.newaxis] == phase[begin]))


def _best_gain(linear: LinearisedFit, k: int, local: Array, columns: Array) -> float:
    """Return the decrease of a cycle's sum of squares by the best column, with the cycle's unknowns fitted."""
    residual, q = linear.residual[linear.rows[k]], local.shape[1]
    prior = np.diag(np.sqrt(linear.priors.local_precision[k] / max(linear.weights[k], 1e-300)))
    scale = np.sqrt(np.maximum(np.sum(local**2, axis=0) + np.diag(prior) ** 2, 1e-300))
    basis = np.linalg.qr(np.vstack([local, prior]) / scale)[0]
    projected = np.vstack([np.column_stack([residual, columns]), np.zeros((q, 1 + columns.shape[1]))])
    projected -= basis @ (basis.T @ projected)
    square = np.sum(projected[:, 1:] ** 2, axis=0)
    valid = square > 1e-9 * np.sum(columns**2, axis=0)
    return float(np.max((projected[:, 1:].T @ projected[:, 0]) ** 2 / np.where(valid, square, np.inf), initial=0.0))


PERIODS = (1.0, 2.0)  # over the slip speeds; the law's parameters absorb less than one
PERIODS_OF_TRAVEL = (2.0, 4.0)  # over the positions; a change of the spring absorbs most of one


def smallest_visible(fit: Fit, linearised: LinearisedFit, slips: Sequence[RunSlips]) -> tuple[float | None, ...]:
    """Return for each run the wave amplitude, % of Fs, detected in half of its repetitions; median over the waves.

    None if no slip is judged, nothing slips, or even Fs would not be detected, and for laws with memory.
    """
    motions, width = fit.problem.motions, fit.values.d if fit.problem.ramp else 0.0
    speeds = zip(fit.u[Global.V_DR :: PER_RUN], motions, strict=True)
    fastest = max(float(belt - motion.velocity.min()) - width for belt, motion in speeds)
    if fastest <= 0 or fit.law.rate:
        return (None,) * len(slips)
    waves = partial(_respond, fit, fastest, max(motion.travel for motion in motions))
    parts = [
        [sums for run in slips for sums in (run.bins.sums(response, block), run.bins.sums(response**2, block))]
        for block, response in linearised.refit(waves)
    ]
    sums = [np.concatenate(blocks) for blocks in zip(*parts, strict=True)]
    return tuple(_median_percent(run, sums[2 * k], sums[2 * k + 1]) for k, run in enumerate(slips))


def _median_percent(run: RunSlips, sums: Array, squares: Array) -> float | None:
    """Return the median amplitude, %, of waves with these sums in each bin; None if it is above 100 %."""
    if not run.bins.judged:
        return None
    typical = 100 * float(np.median([detectable_amplitude(run, *wave) for wave in zip(sums.T, squares.T, strict=True)]))
    return typical if typical < 100 else None


def detectable_amplitude(run: RunSlips, wave: Array, square: Array) -> float:
    """Return the amplitude of a wave, over Fs, at which half of a run's repetitions are rejected; inf without one."""
    bins, begin = run.bins, least_repeat(run.bins)
    sums, squares = wave[:, None], square[:, None]
    number, occupied = bins.residuals_and_bins
    mean, noise = sums / bins.count[:, None], run.noise_m**2 * float(np.sum(1 / bins.count))
    repeated = float(np.sum(bins.per_phase(mean) ** 2)) / (bins.slips - 1) / noise
    smooth = float(np.median(bins.per_slip(sums**2 / bins.count[:, None]) / occupied)) / run.noise_m**2
    amplitudes = (
        _amplitude(run.null.repeat - begin, repeated, float(np.sum(mean**2)) / noise),
        _amplitude(run.null.smooth, smooth, float(np.median(bins.per_slip(squares) / number)) / run.noise_m**2),
    )
    return min(amplitudes)


def _amplitude(null: Array, excess: float, variance: float) -> float:
    """Return the amplitude a at which a ratio, (mean of ``null`` + a^2 excess)/(1 + a^2 more), reaches its limit."""
    mean, spread = float(np.mean(null)), float(np.std(null, ddof=1))
    limit = float(special.gammainccinv((mean / spread) ** 2, REJECTED / TESTS)) * spread**2 / mean
    gain = excess - limit * variance
    return math.sqrt((limit - mean) / gain) if gain > 0 else math.inf


def _respond(fit: Fit, fastest: float, travel: float, blocks: Sequence[Block]) -> Iterator[Array]:
    """Yield the response (n, waves) of the positions in each block to waves as large as the friction, m."""
    for block in blocks:
        path = fit.path_in(block)
        if path is None:
            raise UnfollowableError
        yield tangents(path, _waves(path, fit.u, fastest, travel))


def _waves(path: Path, u: Array, fastest: float, travel: float) -> Array:
    F = np.exp(u.reshape(-1, PER_RUN)[path.run, Global.LOG_F])
    level = np.where(path.slips, path.side * path.level * F, 0.0)
    friction = np.where(path.slips, path.friction, 0.0)
    speed_phase = 2 * math.pi * path.slip_speed / fastest
    position_phase = 2 * math.pi * path.position / travel
    waves = [
        size * shape(number * argument)
        for size, argument, numbers in ((level, speed_phase, PERIODS), (friction, position_phase, PERIODS_OF_TRAVEL))
        for number in numbers
        for shape in (np.sin, np.cos)
    ]
    return np.stack(waves, axis=1)
