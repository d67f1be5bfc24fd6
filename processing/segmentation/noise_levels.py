"""Noise levels of a motion that sticks and slips: process noise of each part, readings, and resets at corners.

Each level is brought to its greatest likelihood by a fixed point of its own, which the smoother's backward pass yields
(`processing.kalman.stick_slip`).
"""

import math
from dataclasses import replace

import numpy as np

from processing.kalman import corner_kernel, motion_kernel, white_jerk
from processing.kalman.first_state import first_state
from processing.kalman.stick_slip import (
    CUT,
    JUMPS,
    KINDS,
    LABELS,
    LANDING,
    LEAVING,
    MET,
    ONSET,
    REST,
    RIDE,
    SLIP,
    SNAP,
    STICK,
    STORED,
    NoiseLevels,
    summed_by_jump,
)
from processing.record.motion import Motion
from processing.record.series import Series
from processing.segmentation.switching_times import (
    KERNELS,
    FilterStretch,
    Labels,
    SwitchingTimes,
    fit_stretches,
    without,
)
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

UNEVEN = [RIDE, MET, LEAVING]  # labels of a stick on a belt that does not run evenly
# Labels that share one reading variance: slips, sticks on an even belt (whose counts round alike), uneven ones.
READING_GROUPS = ([label for label in range(LABELS) if label not in (STICK, REST, *UNEVEN)], [STICK], UNEVEN)
# Of the largest reading variance: the least of another label.  One sensor read all of them, and where a slip at few
# samples takes 0.8 mm of misfit for noise, a stick read to a nanometre, 1e-12 of that variance, leaves only rounding of
# the covariance that it takes over from the slip.  Of 150 records without noise that made variances negative in 9; at
# 1e-11 in 2, from 1e-10 to 1e-6 in none.
DIGITS = 1e-8
UNSCORED = np.empty((0, 2 + 2 * len(SNAP)))


class Workspace:
    """Memory for what the filters write down, used again and again: fresh pages cost more than filtering."""

    def __init__(self) -> None:
        self._held = np.empty(0)

    def array(self, n: int, columns: int) -> Array:
        """Return an array (n, columns) of any content; the one returned before is overwritten."""
        if self._held.size < n * columns:
            self._held = np.empty(n * columns)
        return self._held[: n * columns].reshape(n, columns)


def first_levels(series: Series, noise: white_jerk.Noise, pilot: Motion, unit: float) -> NoiseLevels:
    """Guess the levels; all are re-estimated from the record.

    Near a landing the snap is as strong as a white jerk of the first motion's density makes it at the smoother's own
    bandwidth, and weaker by powers of e away from it, about as the levels fitted on the bench of docs/velocity.md.
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
    """Return the part of the motion that each sample of a stretch lies in."""
    time, label = series.time[stretch.own], np.empty(stretch.own.stop - stretch.own.start, np.uint8)
    at, kind = times.at[stretch.corners], times.kind[stretch.corners]
    compiled(corner_kernel.label_samples, KERNELS)(time, at, kind, stretch.first, times.unit, label)
    return label


def filter_stretch(
    series: Series, times: SwitchingTimes, levels: NoiseLevels, stretch: FilterStretch, workspace: Workspace
) -> tuple[Labels, Array]:
    """Filter a stretch of n samples; return its labels, (n,), and what was expected of each sample, (n, STORED)."""
    time, position = series.time[stretch.own], series.position[stretch.own]
    at, kind = times.at[stretch.corners], times.kind[stretch.corners]
    label, stored = label_stretch(series, times, stretch), workspace.array(time.size, STORED)
    known = 1 if stretch.first in (STICK, REST) else 3
    state = first_state(time, position, float(levels.reading_variance[stretch.first]), known)
    compiled(motion_kernel.forward, KERNELS)(SNAP, time, position, label, at, kind, levels.process, state, stored)
    return label, stored


def log_likelihood(s: Array, scaled: Array) -> Array:
    """Return the log likelihood of each sample, up to a constant, from 1/s and e/s, (n,); of a missing reading 0."""
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
    """Filter a stretch of n samples and smooth it.

    motion: Gets x, v, a and their variances of the stretch.
    Returns: Sums that tell how well each noise level fits (`processing.kalman.motion_kernel.backward`).
    """
    label, stored = filter_stretch(series, times, levels, stretch, workspace)
    at, kind = times.at[stretch.corners], times.kind[stretch.corners]
    noise, steps = np.zeros((LABELS, 4)), np.zeros((KINDS, len(SNAP), 2))
    wanted = 0 if motion is None else label.size
    if motion is None:
        motion = np.empty((6, 0))
    back, time = compiled(motion_kernel.backward, KERNELS), series.time[stretch.own]
    known = levels.process
    back(SNAP, time, label, at, kind, known, stored, wanted, motion, stretch.own.start, noise, steps, UNSCORED)
    return label, noise, summed_by_jump(steps)


def reestimate_noise(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    iterations: int,
    *,
    null_model: bool = False,
) -> NoiseLevels:
    """Return noise levels under which the record is more likely.

    iterations: Of the fixed point: filter, smooth, and multiply each level by its `_ratio`.
    null_model: As if the record had no corners.
    """
    used = fit_stretches(series, times)
    if null_model:
        times = without(times, np.ones(times.at.size, bool))
        used = [FilterStretch(stretch.own, SLIP, slice(0, 0)) for stretch in used]
    least = 0.25 * white_jerk.least_variance(series)
    for _ in range(iterations):
        noise, steps = np.zeros((LABELS, 4)), np.zeros((JUMPS, 2))
        for stretch in used:
            own = smooth_stretch(series, times, levels, stretch, workspace)
            noise += own[1]
            steps += own[2]
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
    """Return the factor that brings a level nearer to its greatest likelihood.

    MacKay's fixed point under a Gamma prior of half a degree of freedom: 1 where a label has no samples.
    """
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


def merged(even: NoiseLevels, riding: NoiseLevels) -> NoiseLevels:
    """Return the levels of sticks on an even belt with those of sticks on a belt that does not run evenly."""
    density, reading, reset = even.process_density.copy(), even.reading_variance.copy(), even.reset_variance.copy()
    density[UNEVEN], reading[UNEVEN] = riding.process_density[UNEVEN], riding.reading_variance[UNEVEN]
    reset[2:4] = riding.reset_variance[2:4]
    return replace(even, process_density=density, reading_variance=reading, reset_variance=reset)
