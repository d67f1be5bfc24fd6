"""Noise levels of a motion that sticks and slips, the mean snap before its landings, and refined switching times.

Noise.  Process noise of each part, readings, and resets at corners: each level is brought to its greatest likelihood
by a fixed-point iteration, whose sums the backward pass of the smoother computes (`processing.kalman.stick_slip`).

Snap.  Friction rises ever faster as the mass approaches the belt's speed, and equally at every landing.  Assuming a
mean snap of 0 there delays every landing: by a tenth of a millisecond on the bench, with an error of 1 mm/s in the
velocity before it.  One landing cannot separate its time from its snap; many determine the snap they share.  The
predicted samples are linear in the means, so those of greatest likelihood solve normal equations, in which the
uncertain time of each landing shifts the velocity after it.

Switching times.  Those of greatest likelihood, each with the spread of its likelihood.
"""

import math
from dataclasses import replace

import numpy as np

from processing.kalman import corner_kernel, motion_kernel, white_jerk
from processing.kalman.stick_slip import (
    CUT,
    JUMP_DERIVATIVE,
    JUMP_KIND,
    JUMPS,
    KINDS,
    LABELS,
    LAND,
    LANDING,
    LEAVING,
    MEET,
    MET,
    NEAR_LANDING,
    NEAR_ONSET,
    ONSET,
    REST,
    RIDE,
    SLIP,
    SNAP,
    STICK,
    STOP,
    STORED,
    NoiseLevels,
)
from processing.kalman.white_jerk import first_state
from processing.record.motion import Motion
from processing.record.series import Series
from processing.stick_slip.corners import (
    KERNELS,
    FilterStretch,
    Labels,
    SwitchingTimes,
    drop_corners,
    label_after,
    pick_fit_stretches,
    split_stretches,
)
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

UNEVEN = [RIDE, MET, LEAVING]  # labels of a stick on a belt that does not run evenly
# Labels that share one reading variance: slips, sticks on an even belt (whose counts round equally), uneven ones.
READING_GROUPS = ([label for label in range(LABELS) if label not in (STICK, REST, *UNEVEN)], [STICK], UNEVEN)
# Of the largest reading variance: the least of another label, since one sensor read all of them; below 1e-10 rounding
# can make the covariance of a stick negative.
DIGITS = 1e-8
UNSCORED = np.empty((0, 2 + 2 * len(SNAP)))


class Workspace:
    """Memory for the stored predictions of the filters, reused because new pages cost more than filtering."""

    def __init__(self) -> None:
        self._buffer = np.empty(0)

    def array(self, n: int, columns: int) -> Array:
        """Return an uninitialised array (n, columns), which overwrites the one returned before."""
        if self._buffer.size < n * columns:
            self._buffer = np.empty(n * columns)
        return self._buffer[: n * columns].reshape(n, columns)


def guess_levels(series: Series, noise: white_jerk.Noise, pilot: Motion, unit: float) -> NoiseLevels:
    """Guess the levels, all of which are re-estimated later.

    Near a landing the snap has the strength of the white jerk of the first motion at the bandwidth of its smoother, and
    is weaker by powers of e away from it, like the levels fitted on the bench of docs/velocity.md.
    """
    rate = (noise.jerk / (noise.reading * series.interval)) ** (1 / 6)
    rough = noise.jerk * rate**2
    density = np.full(LABELS, rough * math.exp(-6))
    density[LANDING : LANDING + 4] = density[CUT : CUT + 4] = rough * np.exp([0.0, -1.0, -3.0, -5.0])
    density[ONSET : ONSET + 4] = density[LEAVING] = rough * math.exp(-5)
    density[MET] = rough
    density[[STICK, REST]] = 0.0
    stride = max(series.time.size // 2**14, 1)
    peak = float(np.percentile(np.abs(pilot.acceleration[::stride]), 99))
    step = 0.1 * float(np.percentile(np.abs(pilot.velocity[::stride]), 99))
    jerk = 8 * peak / unit
    reset = np.array([0.01 * peak, peak / unit, peak, jerk, step, peak, jerk, peak, jerk]) ** 2
    return NoiseLevels(density, np.zeros(LABELS), np.full(LABELS, noise.reading), reset, peak)


def label_stretch(series: Series, times: SwitchingTimes, stretch: FilterStretch) -> Labels:
    time, label = series.time[stretch.samples], np.empty(stretch.samples.stop - stretch.samples.start, np.uint8)
    corner_times, kind = times.time[stretch.corners], times.kind[stretch.corners]
    compiled(corner_kernel.label_samples, KERNELS)(time, corner_times, kind, stretch.first, times.unit, label)
    return label


def filter_stretch(
    series: Series, times: SwitchingTimes, levels: NoiseLevels, stretch: FilterStretch, workspace: Workspace
) -> tuple[Labels, Array]:
    """Filter a stretch of n samples; return its labels, (n,), and the predictions, (n, STORED)."""
    time, position = series.time[stretch.samples], series.position[stretch.samples]
    corner_times, kind = times.time[stretch.corners], times.kind[stretch.corners]
    label, stored = label_stretch(series, times, stretch), workspace.array(time.size, STORED)
    derivatives = 1 if stretch.first in (STICK, REST) else 3
    state = first_state(time, position, float(levels.reading_variance[stretch.first]), derivatives)
    compiled(motion_kernel.forward, KERNELS)(
        SNAP, time, position, label, corner_times, kind, levels.process, state, stored
    )
    return label, stored


def log_likelihood(s: Array, scaled: Array) -> Array:
    """Return the log likelihood of each sample, up to a constant, from 1/s and e/s, (n,); 0 for a missing reading."""
    if not (s > 0).all():
        s = np.where(s > 0, s, 1.0)
    return np.asarray(0.5 * (np.log(s) - scaled**2 / s))


def smooth_stretch(
    series: Series,
    times: SwitchingTimes,
    levels: NoiseLevels,
    stretch: FilterStretch,
    workspace: Workspace,
    motion: Array | None = None,
) -> tuple[Labels, Array, Array]:
    """Filter and smooth a stretch, into ``motion`` if given; return its labels and the sums for noise and jumps."""
    label, stored = filter_stretch(series, times, levels, stretch, workspace)
    corner_times, kind = times.time[stretch.corners], times.kind[stretch.corners]
    noise, steps = np.zeros((LABELS, 4)), np.zeros((KINDS, len(SNAP), 2))
    wanted = 0 if motion is None else label.size
    if motion is None:
        motion = np.empty((6, 0))
    back, time = compiled(motion_kernel.backward, KERNELS), series.time[stretch.samples]
    process = levels.process
    back(
        SNAP,
        time,
        label,
        corner_times,
        kind,
        process,
        stored,
        wanted,
        motion,
        stretch.samples.start,
        noise,
        steps,
        UNSCORED,
    )
    return label, noise, steps[JUMP_KIND, JUMP_DERIVATIVE]


def reestimate_noise(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    iterations: int,
    *,
    null_model: bool = False,
) -> NoiseLevels:
    """Return noise levels under which the record, or one without corners (``null_model``), is more likely.

    Each iteration filters, smooths, and multiplies each level by its `_ratio`.
    """
    used = pick_fit_stretches(series, times)
    if null_model:
        times = drop_corners(times, np.ones(times.time.size, bool))
        used = [FilterStretch(stretch.samples, SLIP, slice(0, 0)) for stretch in used]
    least = 0.25 * white_jerk.least_variance(series)
    for _ in range(iterations):
        noise, steps = np.zeros((LABELS, 4)), np.zeros((JUMPS, 2))
        for stretch in used:
            sums = smooth_stretch(series, times, levels, stretch, workspace)
            noise += sums[1]
            steps += sums[2]
        density = levels.process_density * _ratio(levels.process_density, noise[:, 0], noise[:, 1])
        density[CUT : CUT + 4] = density[LANDING : LANDING + 4]
        reading = levels.reading_variance.copy()
        for group in READING_GROUPS:
            if noise[group, 3].any():
                reading[group] = max(reading[group][0] * noise[group, 2].sum() / noise[group, 3].sum(), least)
        reading = np.maximum(reading, DIGITS * reading.max())
        reset = levels.reset_variance * _ratio(levels.reset_variance, steps[:, 0], steps[:, 1])
        levels = replace(levels, process_density=density, reading_variance=reading, reset_variance=reset)
    return levels


def _ratio(level: Array, square: Array, expected: Array) -> Array:
    """Return the factor of MacKay's fixed point under a Gamma prior of half a degree of freedom; 1 without samples."""
    ratio = (level * square + 0.5) / (level * expected + 0.5)
    return np.asarray(np.clip(ratio, 1e-4, 1e4))


def null_model(levels: NoiseLevels) -> NoiseLevels:
    """Return levels with one process density, for a record without corners."""
    return replace(
        levels,
        process_density=np.full(LABELS, levels.process_density[LANDING + 1]),
        mean_snap=np.zeros(LABELS),
        reading_variance=np.full(LABELS, levels.reading_variance[SLIP]),
    )


def merge_levels(even: NoiseLevels, riding: NoiseLevels) -> NoiseLevels:
    """Return the levels ``even`` with those of sticks on an uneven belt from ``riding``."""
    density, reading, reset = even.process_density.copy(), even.reading_variance.copy(), even.reset_variance.copy()
    density[UNEVEN], reading[UNEVEN] = riding.process_density[UNEVEN], riding.reading_variance[UNEVEN]
    reset[2:4] = riding.reset_variance[2:4]
    return replace(even, process_density=density, reading_variance=reading, reset_variance=reset)


PARTS = len(NEAR_LANDING)
BEFORE, BEHIND = 1 / 3, 1 / 12  # of a slip: samples used before and after a landing
OPEN = 1.5  # standard deviations by which the time of a landing may be wrong
MOST = 64  # landings used


def learn_mean_snap(series: Series, times: SwitchingTimes, levels: NoiseLevels) -> NoiseLevels:
    """Return the levels with the mean snap of a slip's parts near its landing on an even belt.

    With n landings the means are (n - 1)/n of those of greatest likelihood, since one landing contains no information.
    """
    unit = times.unit
    landings = np.flatnonzero(times.kind == LAND)
    if landings.size < 2:
        return levels
    landing_variance = np.array([0.0, (OPEN * levels.peak * float(np.median(times.sd[landings]))) ** 2, 0.0, 0.0])
    noise = levels.process
    edges = np.concatenate((-unit * np.array(NEAR_LANDING)[::-1], [0.0]))
    parts = np.array([SLIP, *range(LANDING + PARTS - 1, LANDING - 1, -1), STICK], np.uint8)
    gram, rhs = np.zeros((PARTS, PARTS)), np.zeros(PARTS)
    run = compiled(corner_kernel.accumulate_normal_equations, KERNELS)
    starts = np.array([piece.start for piece in series.pieces])
    seen = 0
    for k in landings[np.unique(np.linspace(0, landings.size - 1, MOST).astype(int))].tolist():
        landing = float(times.time[k])
        piece = series.pieces[int(np.searchsorted(series.time[starts], landing, side="right")) - 1]
        begin, end = landing - BEFORE * unit, landing + BEHIND * unit
        if k:
            begin = max(begin, float(times.time[k - 1]))
        if k + 1 < times.time.size:
            end = min(end, float(times.time[k + 1]))
        i, j = piece.start + np.searchsorted(series.time[piece], (begin, end))
        if j - i < 16 or landing - begin < unit * NEAR_LANDING[-1]:
            continue
        time, position = series.time[i:j], series.position[i:j]
        state = first_state(time, position, float(levels.reading_variance[SLIP]), 3)
        run(SNAP, time, position, state, landing, edges, parts, noise, landing_variance, gram, rhs)
        seen += 1
    if seen < 2:
        return levels
    full = gram + np.tril(gram, -1).T
    means = np.linalg.solve(full + np.diag(np.diag(full) / (seen - 1) + 1e-300), rhs)
    mean_snap = levels.mean_snap.copy()
    mean_snap[LANDING : LANDING + PARTS] = means[::-1]
    return replace(levels, mean_snap=mean_snap)


# Empirical: widens the standard deviation of a landing's likelihood, whose noise levels were fitted with it in place,
# so that about 95 % of the true velocities near landings lie within two errors (benchmarks/velocity_seeds.py).
SHARP = 1.7
LEAST = 6  # samples on either side of the range in which a corner is searched, at least


def refine_switching_times(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, width: float
) -> SwitchingTimes:
    """Return the most likely switching times, with their standard deviations.

    ``width`` scales the range that is searched: 1 at first, less when a time is nearly known.
    """
    run = compiled(corner_kernel.refine_switching_times, KERNELS)
    unit, noise = times.unit, levels.process
    finest = series.interval / 4 if width >= 1 else 0.0
    new_at, new_sd = times.time.copy(), times.sd.copy()
    near, far = unit * np.array(NEAR_LANDING), unit * np.array(NEAR_ONSET)
    landing = [SLIP, LANDING + 3, LANDING + 2, LANDING + 1, LANDING]
    onset = [ONSET, ONSET + 1, ONSET + 2, ONSET + 3, SLIP]
    for stretch in split_stretches(series, times):
        if stretch.corners.start == stretch.corners.stop:
            continue
        time, position = series.time[stretch.samples], series.position[stretch.samples]
        _, stored = filter_stretch(series, times, levels, stretch, workspace)
        corner_times, kinds = times.time[stretch.corners], times.kind[stretch.corners]
        before = np.concatenate(([time[0]], corner_times[:-1]))
        following = np.concatenate((corner_times[1:], [time[-1]]))
        bounds = np.stack(
            (corner_times - 0.45 * (corner_times - before), corner_times + 0.45 * (following - corner_times)), axis=1
        )  # never past a neighbour
        first = np.array([stretch.first, *(label_after(int(kind)) for kind in kinds[:-1])])
        for kind, state in sorted({*zip(kinds.tolist(), first.tolist(), strict=True)}):
            pick = np.flatnonzero((kinds == kind) & (first == state))
            if kind in (LAND, STOP, MEET):
                edges = np.concatenate((-near[::-1], [0.0]))
                parts = [*landing, {LAND: STICK, STOP: REST, MEET: MET}[kind]]
                corner, half, back, forth = 4, unit / 64, unit / 64, unit / 12
                if kind == MEET:
                    edges, parts = np.append(edges, far[0]), [*parts, RIDE]
            else:
                edges, parts = np.concatenate(([0.0], far)), [state, *onset]
                corner, half, back, forth = 0, unit / 16, unit / 64, unit / 8
                if state == RIDE:
                    edges, parts, corner = np.concatenate(([-far[0]], edges)), [RIDE, LEAVING, *onset], 1
            half = max(width * half, series.interval)
            back, forth = (max(picked_bounds, LEAST * series.interval) for picked_bounds in (back, forth))
            picked_times, picked_bounds = corner_times[pick], bounds[pick]
            reach = np.stack(
                (
                    np.maximum(picked_times - half - back, picked_bounds[:, 0]),
                    np.minimum(picked_times + half + forth, picked_bounds[:, 1]),
                ),
                axis=1,
            )
            estimates = np.empty((pick.size, 2))
            run(
                *(
                    SNAP,
                    time,
                    position,
                    stored,
                    kind,
                    picked_times,
                    picked_bounds,
                    np.searchsorted(time, reach),
                    (half / 4, finest),
                ),
                *(edges, np.array(parts, np.uint8), corner, noise, estimates),
            )
            new_at[stretch.corners.start + pick] = estimates[:, 0]
            new_sd[stretch.corners.start + pick] = estimates[:, 1] * (SHARP if kind in (LAND, STOP) else 1.0)
    return replace(times, time=new_at, sd=new_sd)
