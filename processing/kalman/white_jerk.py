"""Fixed-interval smoothing of a motion of white jerk, on the recorded times, its noise levels by likelihood.

The jerk is taken for white noise of one density q over the whole record and the readings for independent, of one
variance r; both are those under which the record is most likely.  Every sample then is estimated from all others, with
standard errors that are larger at the ends.  Equivalent to the quintic smoothing spline, and to a Savitzky-Golay
window of `Motion.window` samples where times are even.

Not modelled: corners of the velocity (they raise q for the whole record: `processing.segmentation.smoother` knows
them), and counts that hardly change (the readings then err together).  Near a corner the innovations are large;
the standard errors there are scaled up by how much.

Source: H. E. Rauch, F. Tung and C. T. Striebel, AIAA J. 3 (1965) 1445.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from processing.kalman import motion_kernel
from processing.kalman.first_state import first_state
from processing.polynomial import uneven
from processing.record.motion import Motion
from processing.record.noise import reading_step
from processing.record.series import Series, computed_once
from processing.record.stretches import representative_stretches
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

KERNELS = ("processing.kalman.motion_kernel",)
JERK = (0.0, 0.0, 0.0)  # order of the motion: x, v, a
STORED = motion_kernel.stored_size(len(JERK))
SCORES = 2 + 2 * len(JERK)  # numbers of a sample: `motion_kernel.backward`
SHORT = 8  # samples: pieces below are one parabola
BLOCK = 4096  # samples smoothed at a time
FIT_SAMPLES = 12_288  # samples the noise levels are fitted to
STRETCH = 2**8  # samples of one stretch of them, at first
# Likewise of the fit without corners and outlying readings.  Of a minute with 34 slips, half as many samples miss
# landings, and the density is up to ten times too low; by these it is within a sixth of that by all samples.
ROBUST_STRETCH, ROBUST_SAMPLES = 2**10, 24_576
# Standard deviations of an innovation beyond which it is one of these: with 20, spikes of 2 to 30 mm in 1 mm of noise
# pass for jerk, and one in five of them is found.
CLIP = 5.0
# Of the samples: the most that are such.  Where sticks are read without noise, all of every slip may be; 19 spikes a
# second are a twentieth of 400 readings.  At half, frozen stretches count as motion, at twice a fifth of a record.
OUTLYING = 0.1
LOG_RHO = (-48.0, 12.0)  # of q interval^5/r: from what hardly bends to interpolation
# Times the standard deviation of a reading that a record of less than four windows may lie off its smoothed motion.
# The likelihood is that of the record from its first motion on: a mass that rests and is then dragged evenly is a
# straight line to it, and the whole record was smoothed to one, 20 times the noise off its readings.
MISSED = 3.0
ORDER = 5  # of the spline
EQUIVALENT = 9.0  # window times rho**(1/6) of the Savitzky-Golay filter of order 4 that resembles the smoother


@dataclass(frozen=True)
class Noise:
    """Density of the white jerk, m^2/s^5, and variance of a reading, m^2."""

    jerk: float
    reading: float

    @cached_property
    def process(self) -> motion_kernel.Process:
        """The noise as the kernel takes it: one label, no corner."""
        n = len(JERK)
        density, reading = np.array([self.jerk]), np.array([self.reading])
        return motion_kernel.Process(density, np.zeros(1), reading, np.full(1, n), np.full(1, n), np.zeros((1, n)))

    def rho(self, interval: float) -> float:
        """Return what decides how much is smoothed: q interval^5/r."""
        return self.jerk * interval**5 / self.reading


@computed_once
def fit(series: Series) -> Noise:
    """Find the noise levels of greatest likelihood.

    Of a long record, stretches spread over it are looked at.  A record at rest has no jerk and errs by a count.
    """
    series = series.readings()
    floor = least_variance(series)
    length = STRETCH
    while True:
        stretches = _stretches(series, length)
        if not stretches:
            return Noise(math.exp(LOG_RHO[0]) * floor / series.interval**5, floor)
        log_rho, reading = _scaled(series, stretches, floor)
        whole = len(stretches) * length < FIT_SAMPLES or length >= FIT_SAMPLES
        if whole or equivalent_window(math.exp(log_rho), 8 * length) < length / 4:
            break
        length *= 8
    n = series.time.size
    noise = Noise(math.exp(log_rho) * reading / series.interval**5, reading)
    if n <= FIT_SAMPLES and equivalent_window(math.exp(log_rho), n) > n / 4:
        missed = float(np.mean((smooth(series, noise).position - series.origin - series.position) ** 2))
        if missed > MISSED**2 * reading:
            log_rho, reading = _scaled(series, _moving(series, series.pieces), floor)
            noise = Noise(math.exp(log_rho) * reading / series.interval**5, reading)
    return noise


def _scaled(series: Series, stretches: list[tuple[Array, Array]], floor: float) -> tuple[float, float]:
    """Return log rho of the greatest likelihood and the variance of a reading there, m^2, at least the floor's."""
    # not the median: where the belt moves whole counts a sample, most third differences are nothing but rounding
    third = np.percentile(np.abs(np.concatenate([np.diff(position, 3) for _, position in stretches])), 90)
    scale = max(float(third) ** 2 / 20, floor)  # near the variance of a reading, so that numbers stay near 1
    log_rho, reading = _likeliest([(time, position / math.sqrt(scale)) for time, position in stretches])
    return log_rho, max(reading * scale, 0.25 * floor if reading_step(series) else floor)


def _stretches(series: Series, length: int, samples: int = FIT_SAMPLES) -> list[tuple[Array, Array]]:
    """Return times, in sample intervals, and positions of stretches spread evenly over the record.

    Many short ones, so that a motion that mostly rests is seen at work too.
    """
    most = max(samples, 8 * length)
    return _moving(series, representative_stretches(series, most, most // length))


def _moving(series: Series, parts: Iterable[slice]) -> list[tuple[Array, Array]]:
    """Return times, in sample intervals, and positions of the parts in which the readings do more than rise evenly."""
    long = [own for own in parts if own.stop - own.start >= 2 * SHORT]
    every = [(series.time[own] / series.interval, series.position[own] - series.position[own.start]) for own in long]
    return [(time, position) for time, position in every if np.any(np.diff(position, 3))]


def _likeliest(stretches: list[tuple[Array, Array]]) -> tuple[float, float]:
    """Return log rho of the greatest likelihood and the variance of a reading there."""
    sums = _summed(stretches, math.inf)

    def cost(log_rho: float, every: int) -> tuple[float, float]:
        """Return minus the log likelihood, up to a constant, and the variance of a reading at which it is least."""
        logarithms, squares, samples, _ = sums(log_rho, every)
        variance = max(squares / samples, 1e-30)
        return 0.5 * (samples * math.log(variance) + logarithms), variance

    few = max(len(stretches) // 16, 1)
    middle = lowest(lambda log_rho: cost(log_rho, few)[0], LOG_RHO, 6.0, 1.5)
    log_rho = vertex(lambda log_rho: cost(log_rho, 1)[0], middle, 1.5)
    above = np.arange(log_rho + 4.0, LOG_RHO[1], 4.0).tolist()
    if above and min(cost(value, 1)[0] for value in above) < cost(log_rho, 1)[0]:
        # Where the mass moves fast for a few per cent of the time, the few stretches may hold none of that.
        middle = lowest(lambda log_rho: cost(log_rho, 1)[0], LOG_RHO, 6.0, 1.5)
        log_rho = vertex(lambda log_rho: cost(log_rho, 1)[0], middle, 1.5)
    return log_rho, cost(log_rho, 1)[1]


def _summed(stretches: list[tuple[Array, Array]], most: float) -> Callable[[float, int], motion_kernel.Sums]:
    """Return what gives the sums of `motion_kernel.sum_likelihood` for a log rho, over every so many-th stretch."""
    edges = np.cumsum([0, *(time.size for time, _ in stretches)])
    time, position = (np.concatenate(own) for own in zip(*stretches, strict=True))
    states = np.array([first_state(*stretch, 1.0, 2) for stretch in stretches])
    run = compiled(motion_kernel.sum_likelihood, KERNELS)
    return lambda log_rho, every: run(JERK, time, position, edges, every, math.exp(log_rho), states, most)


def robust_fit(series: Series, sigma: float, widest: int) -> Noise:
    """Find the density of the jerk of greatest likelihood, corners and outlying readings left out.

    ``sigma`` is the standard deviation of a position; the equivalent window has ``widest`` samples at most.
    """
    reading = max(sigma**2, least_variance(series))
    stretches = _stretches(series, ROBUST_STRETCH, ROBUST_SAMPLES)
    log_rho = least = 6 * math.log(EQUIVALENT / widest)
    if stretches:
        sums = _summed([(time, position / math.sqrt(reading)) for time, position in stretches], CLIP**2)
        few = max(len(stretches) // 4, 1)
        middle = lowest(lambda log_rho: sum(sums(log_rho, few)[:2]), (least, LOG_RHO[1]), 4.0, 1.5)
        log_rho = max(vertex(lambda log_rho: sum(sums(log_rho, 1)[:2]), middle, 1.5), least)
        while log_rho < LOG_RHO[1]:
            _, _, samples, clipped = sums(log_rho, 1)
            if clipped <= OUTLYING * samples:
                break
            log_rho += 1.0
    return Noise(math.exp(log_rho) * reading / series.interval**5, reading)


def innovations(time: Array, position: Array, noise: Noise, stored: Array) -> Array:
    """Return 1/s and e/s of every sample of one piece, (n, 2): inverse variance, and it times the innovation e.

    They are the last columns of ``stored``, (n, STORED), which the filter overwrites.
    """
    state = first_state(time, position, noise.reading, 2)
    label, *none = _unmarked(time.size)
    compiled(motion_kernel.forward, KERNELS)(JERK, time, position, label, *none, noise.process, state, stored)
    return stored[:, STORED - 2 :]


def _unmarked(n: int) -> tuple[motion_kernel.Labels, Array, motion_kernel.Labels]:
    """Return the labels of n samples alike, and times and kinds of no corners."""
    return np.zeros(n, np.uint8), np.empty(0), np.empty(0, np.uint8)


def least_variance(series: Series) -> float:
    """Return the least variance of a reading, m^2: that of the step it was rounded to, or of the numbers' own rounding.

    The step is a count, or what a table's last decimal is worth.
    """
    rounding = 1e-15 * max(float(np.nanmax(np.abs(series.position))), abs(series.origin))
    return max(reading_step(series) ** 2 / 12, rounding**2, 1e-60)


def lowest(function: Callable[[float], float], bounds: tuple[float, float], step: float, width: float) -> float:
    """Return where a function of one number is least: on a grid of ``step``, then by golden section to ``width``."""
    grid = np.arange(bounds[0], bounds[1] + step / 2, step)
    at = int(np.argmin([function(float(value)) for value in grid]))
    low, high = float(grid[max(at - 1, 0)]), float(grid[min(at + 1, grid.size - 1)])
    golden = (math.sqrt(5) - 1) / 2
    one, two = high - golden * (high - low), low + golden * (high - low)
    f_one, f_two = function(one), function(two)
    while high - low > width:
        if f_one < f_two:
            high, two, f_two = two, one, f_one
            one = high - golden * (high - low)
            f_one = function(one)
        else:
            low, one, f_one = one, two, f_two
            two = low + golden * (high - low)
            f_two = function(two)
    return 0.5 * (low + high)


def vertex(function: Callable[[float], float], middle: float, step: float) -> float:
    """Return where a smooth function of one number is least: the vertex of a parabola through three places.

    The places are ``step`` apart, and are moved until the middle one is the lowest (or twelve steps away).
    """
    at, (low, here, high) = middle, (function(middle + k * step) for k in (-1, 0, 1))
    for _ in range(12):
        if low < here:
            at, low, here, high = at - step, function(at - 2 * step), low, here
        elif high < here:
            at, low, here, high = at + step, here, high, function(at + 2 * step)
        else:
            break
    bend = low - 2 * here + high
    return at + 0.5 * step * (low - high) / bend if bend > 0 else at


def smooth(series: Series, noise: Noise) -> Motion:
    """Smooth the record with given noise levels."""
    n = series.time.size
    motion = np.empty((6, n))
    rho = noise.rho(series.interval)
    behind = reach(rho)
    for piece in series.pieces:
        time, position = series.time[piece], series.position[piece]
        if time.size < SHORT:
            motion[:, piece] = parabola(time, position, noise.reading)
        else:
            smooth_piece(time, position, noise, max(BLOCK, 4 * behind), behind, motion, piece.start)
    errors = np.maximum(motion[3:], 0.0, out=motion[3:])
    np.sqrt(errors, out=errors)
    window = equivalent_window(rho, n)
    return Motion.from_rows(series, motion[:3], errors, window=window, order=ORDER, method="rts")


def smooth_piece(
    time: Array,
    position: Array,
    noise: Noise,
    block: int,
    behind: int,
    motion: Array,
    first: int = 0,
    scores: Array | None = None,
) -> None:
    """Write x, v, a and their variances of one piece into ``motion``, from its column ``first`` on.

    Memory for the filter grows with the block alone: the smoother of a block starts ``behind`` samples after it, and
    what lies further on has faded by then.  ``scores`` (n, SCORES) gets those of the samples, where it is given;
    ``motion`` may then have no columns.
    """
    forward, backward = compiled(motion_kernel.forward, KERNELS), compiled(motion_kernel.backward, KERNELS)
    n = time.size
    stored = np.empty((min(block + behind, n), STORED))
    known = noise.process
    sums = np.zeros((1, 4)), np.zeros((1, len(JERK), 2))  # how well the noise levels fit: not asked for
    state = first_state(time, position, noise.reading, 2)
    scored = np.empty((0, SCORES)) if scores is None else scores
    for begin in range(0, n, block):
        end = min(begin + block, n)
        far = min(end + behind, n)
        label, *none = _unmarked(far - begin)
        k = end - begin
        forward(JERK, time[begin:end], position[begin:end], label[:k], *none, known, state, stored)
        forward(JERK, time[end:far], position[end:far], label[k:], *none, known, state.copy(), stored[k:])
        backward(
            *(JERK, time[begin:far], label, *none, known, stored[: far - begin], k if motion.shape[1] else 0),
            *(motion, first + begin, *sums, scored[begin:end]),
        )


def reach(rho: float, faded: float = motion_kernel.SETTLED) -> int:
    """Return after how many samples what a smoother starts from has faded, by e to the power of ``faded``."""
    return math.ceil(2 * faded / float(rho ** (1 / 6))) + 8


def equivalent_window(rho: float, n: int) -> int:
    """Return the odd window of the Savitzky-Golay filter that smooths as much, at most ``n``."""
    window = min(EQUIVALENT / rho ** (1 / 6), float(n))
    return max(2 * (int(window) // 2) + 1 if window < n else n - 1 + n % 2, ORDER)


def parabola(time: Array, position: Array, variance: float) -> Array:
    """Return motion and variances, (6, n), of a piece too short to filter: one polynomial, of degree 2 at most.

    Where a reading is missing it is a line between those beside it, of unknown error.
    """
    known = ~np.isnan(position)
    n = int(np.count_nonzero(known))
    degree = min(2, n - 1)
    values, norms = uneven.fit(time[known], position[known], n, degree)
    norms[degree + 1 :] = np.inf
    found = np.concatenate((values, variance * norms**2))
    if known.all():
        return found
    values = np.array([np.interp(time, time[known], row) for row in found[:3]])
    return np.concatenate((values, np.full((3, time.size), np.inf)))
