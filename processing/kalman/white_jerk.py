"""Fixed-interval smoothing of a motion of white jerk, on the recorded times, its noise levels by likelihood.

The jerk is taken for white noise of one density q over the whole record and the readings for independent, of one
variance r; both are those under which the record is most likely.  Every sample is estimated from all others, with
standard errors that are larger at the ends.  The first state is that of the first nine readings, with everything but
their speed unknown.  Equivalent to the quintic smoothing spline, and to a Savitzky-Golay window of `Motion.window`
samples where times are even.

Not modelled: corners of the velocity (they raise q for the whole record; `processing.stick_slip.smoother` models
them), and counts that hardly change (the errors of the readings are then correlated).

Source: H. E. Rauch, F. Tung and C. T. Striebel, AIAA J. 3 (1965) 1445.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from processing.kalman import motion_kernel
from processing.kalman.motion_kernel import state_size
from processing.polynomial import savgol
from processing.record.motion import Motion
from processing.record.noise import reading_step
from processing.record.series import Series, computed_once
from processing.record.stretches import representative_stretches
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

FIRST = 8  # samples after the first one


def first_state(time: Array, position: Array, variance: float, derivatives: int) -> Array:
    """Return the state before the first sample, the upper triangle of its covariance by rows, and its time, s.

    ``derivatives`` is 2 for x, v, a (`white_jerk`), 3 for x, v, a, j (`stick_slip`) and 1 for x, v and zeros there.  At
    least two readings are not NaN.
    """
    t, x = time[: FIRST + 1].tolist(), position[: FIRST + 1].tolist()  # so few are faster as plain numbers
    if math.isnan(sum(x)):
        readings = np.flatnonzero(~np.isnan(position))[: FIRST + 1]
        t, x = time[readings].tolist(), position[readings].tolist()
    k = len(x) - 1
    h = (t[k] - t[0]) / k
    slope = (x[k] - x[0]) / (t[k] - t[0])
    speeds = [(x[i + 1] - x[i]) / (t[i + 1] - t[i]) for i in range(k)]
    spread = 2 * max(math.sqrt(variance) / h, max(speeds) - slope, slope - min(speeds))
    size = 3 if derivatives == 2 else 4
    state = np.zeros(state_size(size))
    state[0], state[1], state[-1] = x[0] + slope * (time[0] - t[0]), slope, time[0]
    diagonal = size
    for d in range(derivatives + 1):
        state[diagonal] = (spread * h ** (1 - d)) ** 2
        diagonal += size - d
    return state


KERNELS = ("processing.kalman.motion_kernel",)
JERK = (0.0, 0.0, 0.0)  # order of the motion: x, v, a
STORED = motion_kernel.stored_size(len(JERK))
SCORES = 2 + 2 * len(JERK)  # numbers of a sample: `motion_kernel.backward`
SHORT = 8  # samples: pieces below are one parabola
BLOCK = 4096  # samples smoothed at a time
FIT_SAMPLES = 12_288  # samples the noise levels are fitted to
STRETCH = 2**8  # samples of one stretch of them, at first
ROBUST_STRETCH, ROBUST_SAMPLES = 2**10, 24_576  # the same for the robust fit; fewer samples miss landings
CLIP = 5.0  # standard deviations of an innovation: larger ones are outliers
OUTLYING = 0.1  # largest share of the samples that may be outliers, else they are motion
LOG_RHO = (-48.0, 12.0)  # range of log(q interval^5/r): from a nearly straight line to interpolation
# Standard deviations of a reading: largest misfit of a short record, which a mass that rests and is then dragged evenly
# exceeds, because the likelihood counts from the first motion on.
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
        """The same for the kernel: one label, no corner."""
        n = len(JERK)
        density, reading = np.array([self.jerk]), np.array([self.reading])
        return motion_kernel.Process(density, np.zeros(1), reading, np.full(1, n), np.full(1, n), np.zeros((1, n)))

    def rho(self, interval: float) -> float:
        """Return q interval^5/r, which decides how much is smoothed."""
        return self.jerk * interval**5 / self.reading


@computed_once
def fit(series: Series) -> Noise:
    """Fit the noise levels by maximum likelihood, to stretches spread over a long record.

    A record at rest has no jerk and the reading error of one count.
    """
    series = series.drop_missing()
    floor = least_variance(series)
    length = STRETCH
    while True:
        stretches = _pick_stretches(series, length)
        if not stretches:
            return Noise(math.exp(LOG_RHO[0]) * floor / series.interval**5, floor)
        log_rho, noise = _fit_scaled(series, stretches, floor)
        whole = len(stretches) * length < FIT_SAMPLES or length >= FIT_SAMPLES
        if whole or equivalent_window(math.exp(log_rho), 8 * length) < length / 4:
            break
        length *= 8
    n = series.time.size
    if n <= FIT_SAMPLES and equivalent_window(math.exp(log_rho), n) > n / 4:
        missed = float(np.mean((smooth(series, noise).position - series.origin - series.position) ** 2))
        if missed > MISSED**2 * noise.reading:
            _, noise = _fit_scaled(series, _pick_moving(series, series.pieces), floor)
    return noise


def _fit_scaled(series: Series, stretches: list[tuple[Array, Array]], floor: float) -> tuple[float, Noise]:
    """Return log rho of the greatest likelihood, and the noise there; a reading has at least the variance ``floor``.

    The least variance leaves the jerk as it is: a record that shows no noise would get an unlimited one at this rho.
    """
    # Not the median: where the belt moves whole counts a sample, most third differences are only rounding.
    third_difference = np.percentile(np.abs(np.concatenate([np.diff(position, 3) for _, position in stretches])), 90)
    scale = max(float(third_difference) ** 2 / 20, floor)  # near the variance of a reading, so that numbers stay near 1
    log_rho, reading = _maximise_likelihood([(time, position / math.sqrt(scale)) for time, position in stretches])
    reading *= scale
    jerk = math.exp(log_rho) * reading / series.interval**5
    return log_rho, Noise(jerk, max(reading, 0.25 * floor if reading_step(series) else floor))


def _pick_stretches(series: Series, length: int, samples: int = FIT_SAMPLES) -> list[tuple[Array, Array]]:
    """Return times, in sample intervals, and positions of many short stretches spread evenly over the record."""
    most = max(samples, 8 * length)
    return _pick_moving(series, representative_stretches(series, most, most // length))


def _pick_moving(series: Series, parts: Iterable[slice]) -> list[tuple[Array, Array]]:
    """Return times, in sample intervals, and positions of the parts that are not straight lines."""
    long_enough = [part for part in parts if part.stop - part.start >= 2 * SHORT]
    stretches = [
        (series.time[part] / series.interval, series.position[part] - series.position[part.start])
        for part in long_enough
    ]
    return [(time, position) for time, position in stretches if np.any(np.diff(position, 3))]


def _maximise_likelihood(stretches: list[tuple[Array, Array]]) -> tuple[float, float]:
    """Return log rho of the greatest likelihood and the variance of a reading there."""
    sums = _bind_likelihood(stretches, math.inf)

    def cost(log_rho: float, every: int) -> tuple[float, float]:
        """Return minus the log likelihood, up to a constant, and the variance of a reading at which it is least."""
        logarithms, squares, samples, _ = sums(log_rho, every)
        variance = max(squares / samples, 1e-30)
        return 0.5 * (samples * math.log(variance) + logarithms), variance

    few = max(len(stretches) // 16, 1)
    middle = minimise(lambda log_rho: cost(log_rho, few)[0], LOG_RHO, 6.0, 1.5)
    log_rho = minimise_locally(lambda log_rho: cost(log_rho, 1)[0], middle, 1.5)
    larger = np.arange(log_rho + 4.0, LOG_RHO[1], 4.0).tolist()
    if larger and min(cost(value, 1)[0] for value in larger) < cost(log_rho, 1)[0]:
        # The few stretches may miss fast motion that lasts a few per cent of the time.
        middle = minimise(lambda log_rho: cost(log_rho, 1)[0], LOG_RHO, 6.0, 1.5)
        log_rho = minimise_locally(lambda log_rho: cost(log_rho, 1)[0], middle, 1.5)
    return log_rho, cost(log_rho, 1)[1]


def _bind_likelihood(stretches: list[tuple[Array, Array]], most: float) -> Callable[[float, int], motion_kernel.Sums]:
    """Return `motion_kernel.sum_likelihood` of these stretches as a function of log rho and ``every``."""
    edges = np.cumsum([0, *(time.size for time, _ in stretches)])
    time, position = (np.concatenate(column) for column in zip(*stretches, strict=True))
    states = np.array([first_state(*stretch, 1.0, 2) for stretch in stretches])
    run = compiled(motion_kernel.sum_likelihood, KERNELS)
    return lambda log_rho, every: run(JERK, time, position, edges, every, math.exp(log_rho), states, most)


def fit_robustly(series: Series, sigma: float, widest: int) -> Noise:
    """Fit the density of the jerk without corners and outliers, for positions of standard deviation ``sigma``, m.

    The equivalent window has at most ``widest`` samples.
    """
    reading = max(sigma**2, least_variance(series))
    stretches = _pick_stretches(series, ROBUST_STRETCH, ROBUST_SAMPLES)
    log_rho = least_log_rho = 6 * math.log(EQUIVALENT / widest)
    if stretches:
        sums = _bind_likelihood([(time, position / math.sqrt(reading)) for time, position in stretches], CLIP**2)
        few = max(len(stretches) // 4, 1)
        middle = minimise(lambda log_rho: sum(sums(log_rho, few)[:2]), (least_log_rho, LOG_RHO[1]), 4.0, 1.5)
        log_rho = max(minimise_locally(lambda log_rho: sum(sums(log_rho, 1)[:2]), middle, 1.5), least_log_rho)
        while log_rho < LOG_RHO[1]:
            _, _, samples, clipped = sums(log_rho, 1)
            if clipped <= OUTLYING * samples:
                break
            log_rho += 1.0
    return Noise(math.exp(log_rho) * reading / series.interval**5, reading)


def filter_innovations(time: Array, position: Array, noise: Noise, stored: Array) -> Array:
    """Return 1/s and e/s of every sample of one piece, (n, 2): a view of ``stored``, which the filter overwrites."""
    state = first_state(time, position, noise.reading, 2)
    label, *no_corners = _label_alike(time.size)
    compiled(motion_kernel.forward, KERNELS)(JERK, time, position, label, *no_corners, noise.process, state, stored)
    return stored[:, STORED - 2 :]


def _label_alike(n: int) -> tuple[motion_kernel.Labels, Array, motion_kernel.Labels]:
    """Return one label for n samples, and times and kinds of no corners."""
    return np.zeros(n, np.uint8), np.empty(0), np.empty(0, np.uint8)


def least_variance(series: Series) -> float:
    """Return the least variance of a reading, m^2: that of its step (a count, or the last decimal) or of rounding."""
    rounding = 1e-15 * max(float(np.nanmax(np.abs(series.position))), abs(series.origin))
    return max(reading_step(series) ** 2 / 12, rounding**2, 1e-60)


def minimise(function: Callable[[float], float], bounds: tuple[float, float], step: float, width: float) -> float:
    """Return the minimum on a grid of ``step``, refined by golden section to ``width``."""
    grid = np.arange(bounds[0], bounds[1] + step / 2, step)
    index = int(np.argmin([function(float(value)) for value in grid]))
    low, high = float(grid[max(index - 1, 0)]), float(grid[min(index + 1, grid.size - 1)])
    golden = (math.sqrt(5) - 1) / 2
    left, right = high - golden * (high - low), low + golden * (high - low)
    f_left, f_right = function(left), function(right)
    while high - low > width:
        if f_left < f_right:
            high, right, f_right = right, left, f_left
            left = high - golden * (high - low)
            f_left = function(left)
        else:
            low, left, f_left = left, right, f_right
            right = low + golden * (high - low)
            f_right = function(right)
    return 0.5 * (low + high)


def minimise_locally(function: Callable[[float], float], middle: float, step: float) -> float:
    """Return the vertex of a parabola through three points ``step`` apart, moved until the middle one is lowest."""
    centre, (left, middle_value, right) = middle, (function(middle + k * step) for k in (-1, 0, 1))
    for _ in range(12):
        if left < middle_value:
            centre, left, middle_value, right = centre - step, function(centre - 2 * step), left, middle_value
        elif right < middle_value:
            centre, left, middle_value, right = centre + step, middle_value, right, function(centre + 2 * step)
        else:
            break
    bend = left - 2 * middle_value + right
    return centre + 0.5 * step * (left - right) / bend if bend > 0 else centre


def smooth(series: Series, noise: Noise) -> Motion:
    n = series.time.size
    motion = np.empty((6, n))
    rho = noise.rho(series.interval)
    overlap = samples_to_fade(rho)
    for piece in series.pieces:
        time, position = series.time[piece], series.position[piece]
        if time.size < SHORT:
            motion[:, piece] = fit_parabola(time, position, noise.reading)
        else:
            smooth_piece(time, position, noise, max(BLOCK, 4 * overlap), overlap, motion, piece.start)
    errors = np.maximum(motion[3:], 0.0, out=motion[3:])
    np.sqrt(errors, out=errors)
    window = equivalent_window(rho, n)
    return Motion.from_rows(series, motion[:3], errors, window=window, order=ORDER, method="rts")


def smooth_piece(
    time: Array,
    position: Array,
    noise: Noise,
    block: int,
    overlap: int,
    motion: Array,
    first: int = 0,
    scores: Array | None = None,
) -> None:
    """Write x, v, a and their variances of one piece into ``motion``, from its column ``first`` on.

    The smoother of each block starts ``overlap`` samples after it, so memory grows with the block only.  ``scores``
    (n, SCORES) receives the scores, if given; ``motion`` may then have no columns.
    """
    forward, backward = compiled(motion_kernel.forward, KERNELS), compiled(motion_kernel.backward, KERNELS)
    n = time.size
    stored = np.empty((min(block + overlap, n), STORED))
    process = noise.process
    sums = np.zeros((1, 4)), np.zeros((1, len(JERK), 2))  # evidence on the noise levels: not used
    state = first_state(time, position, noise.reading, 2)
    all_scores = np.empty((0, SCORES)) if scores is None else scores
    for begin in range(0, n, block):
        end = min(begin + block, n)
        stop = min(end + overlap, n)
        label, *no_corners = _label_alike(stop - begin)
        k = end - begin
        forward(JERK, time[begin:end], position[begin:end], label[:k], *no_corners, process, state, stored)
        forward(
            JERK,
            time[end:stop],
            position[end:stop],
            label[k:],
            *no_corners,
            process,
            state.copy(),
            stored[k:],
        )
        backward(
            *(
                JERK,
                time[begin:stop],
                label,
                *no_corners,
                process,
                stored[: stop - begin],
                k if motion.shape[1] else 0,
            ),
            *(motion, first + begin, *sums, all_scores[begin:end]),
        )


def samples_to_fade(rho: float, faded: float = motion_kernel.SETTLED) -> int:
    """Return after how many samples the start of a smoother has faded by exp(``faded``)."""
    return math.ceil(2 * faded / float(rho ** (1 / 6))) + 8


def equivalent_window(rho: float, n: int) -> int:
    """Return the odd window, at most ``n``, of the Savitzky-Golay filter that smooths as much."""
    window = min(EQUIVALENT / rho ** (1 / 6), float(n))
    return max(2 * (int(window) // 2) + 1 if window < n else n - 1 + n % 2, ORDER)


def fit_parabola(time: Array, position: Array, variance: float) -> Array:
    """Return motion and variances, (6, n), of a piece too short to filter: a polynomial of degree 2 at most.

    Missing readings are interpolated linearly, with infinite variance.
    """
    present = ~np.isnan(position)
    n = int(np.count_nonzero(present))
    degree = min(2, n - 1)
    values, norms = savgol.fit_uneven(time[present], position[present], n, degree)
    norms[degree + 1 :] = np.inf
    rows = np.concatenate((values, variance * norms**2))
    if present.all():
        return rows
    values = np.array([np.interp(time, time[present], row) for row in rows[:3]])
    return np.concatenate((values, np.full((3, time.size), np.inf)))
