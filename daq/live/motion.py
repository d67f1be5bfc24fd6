"""Velocity and acceleration while a recording runs: a parabola is fitted to a short window around each reading.

Its slope and curvature are velocity and acceleration at the middle of the window, so they arrive half a window late.
`process smooth` estimates the velocity of the finished run, with corners at break-aways and landings, which these
parabolas round.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from daq.live.tail import NewSamples
from stickslip.compute.arrays import HOLE, Array, Mask, joined

# Length of the window before the first slip: long enough for the noise of a camera, short enough for cycles of 0.5 s.
WINDOW_S = 0.02
SHORTEST_PARABOLA = 5  # samples
LONGEST_PARABOLA = 401  # samples, to limit the time of a look at the journal
# Longest window, as a share of a slip and of a stick: a longer one misses short sticks, which makes the slips, and so
# the window, longer and longer.
MOST_SHARE = 0.25
# Noise of the velocity, at most this share of the mean speed of slips, so that slips of a noisy, slow record are found.
QUIET_SHARE = 0.05
MOST_TRIED = 5000  # the last samples, on which a longer window is tried
CHANGED = 1.25  # factor by which a better window must differ to be used


@dataclass(frozen=True)
class LiveMotion:
    """Motion at k times, each array of shape (k,)."""

    time: Array
    x: Array  # the reading itself
    v: Array  # of the parabola; NaN where its window has a gap
    a: Array
    fresh: Mask  # true where the previous time is not connected: at the start of a segment, and after a hole


@dataclass(frozen=True)
class MotionErrors:
    """Standard deviations of a reading, of velocity and of acceleration, in the units of `LiveMotion`."""

    x: float
    v: float
    a: float


class LiveFilter:
    """Fit parabolas to samples as they arrive.

    rate_hz: Nominal rate of the samples.
    window: Samples of the next parabolas, odd; initially those of `WINDOW_S` by default.
    """

    def __init__(self, rate_hz: float, window: int | None = None) -> None:
        self.window = window or count_samples(WINDOW_S, rate_hz)
        self._rate_hz = rate_hz
        self._restart()

    def _restart(self) -> None:
        self._time, self._x = np.empty(0), np.empty(0)
        self._next = -1  # place of the next middle of a window; -1: the first one of a segment

    @property
    def half_s(self) -> float:
        """Half of the window, s: the delay of the motion, and the rounding of a corner to either side."""
        return (self.window - 1) / 2 / self._rate_hz

    def feed(self, new: NewSamples) -> LiveMotion:
        """Return the motion at the times that a window now surrounds; those at a segment's ends stay unknown."""
        cuts = [0, *np.flatnonzero(new.fresh).tolist(), new.time.size]
        parts = []
        for start, stop in pairwise(cuts):
            if start < new.time.size and new.fresh[start]:
                self._restart()
            self._time = np.concatenate((self._time, new.time[start:stop]))
            self._x = np.concatenate((self._x, new.position[start:stop]))
            parts.append(self._compute_motion())
        return joined(parts)

    def _compute_motion(self) -> LiveMotion:
        """Return the motion at the middles that are complete now."""
        half = self.window // 2
        begins = self._next < 0
        first = half if begins else self._next
        stop = self._time.size - half
        if stop <= first:
            empty = np.empty(0)
            return LiveMotion(empty, empty, empty, empty, np.empty(0, np.bool_))
        # A window that has grown reaches beyond the first sample of its segment at first.
        low = max(first, half)
        span = slice(low - half, stop + half)
        v, a = np.full((2, stop - first), math.nan)
        if stop > low:
            longest = 1.5 * self.window / self._rate_hz
            v[low - first :], a[low - first :] = fit_parabolas(self._time[span], self._x[span], self.window, longest)
        fresh = np.diff(self._time[first:stop], prepend=self._time[max(0, first - 1)]) > HOLE / self._rate_hz
        fresh[0] |= begins
        motion = LiveMotion(self._time[first:stop], self._x[first:stop], v, a, fresh)
        n_dropped = max(0, stop - LONGEST_PARABOLA // 2)
        self._time, self._x, self._next = self._time[n_dropped:], self._x[n_dropped:], stop - n_dropped
        return motion

    def estimate_errors(self, density: float) -> MotionErrors:
        """Return the errors of the motion from readings whose noise has a density, m^2 s: variance over their rate."""
        window_s = self.window / self._rate_hz
        variances = density * self._rate_hz, 12 * density / window_s**3, 720 * density / window_s**5
        return MotionErrors(*map(math.sqrt, variances))

    def fit_window_to_slips(self, density: float, slip_s: float, drop: float, stick_s: float) -> None:
        """Choose the window for slips of a duration, s, and a drop, m, between sticks, in readings of a noise density.

        A parabola over 2h of a sine of amplitude A = drop/2 and angular frequency w = pi/slip_s has an acceleration
        that is wrong by A w^4 h^2/14 at most, and by the noise of 22.5 density/h^5 in the mean square.  The window
        makes the sum of both squares least: h^9 = (5/4) 22.5 density (14/(A w^4))^2.
        """
        curvature = drop / 2 * (math.pi / slip_s) ** 4 / 14
        half_s = (1.25 * 22.5 * density / curvature**2) ** (1 / 9)
        # It must not be so short that noise looks like slips, however slips are defined.
        least_s = (12 * density * (slip_s / (QUIET_SHARE * drop)) ** 2) ** (1 / 3)
        self._choose(max(min(2 * half_s, MOST_SHARE * min(slip_s, stick_s)), least_s))

    def find_quiet_window(self, motion: LiveMotion, density: float, share: float) -> int:
        """Return the window, as short as now or longer, in which noise makes at most a share of the rms acceleration.

        The one of now where none does: then there is no acceleration but that of the noise.
        """
        time, x = motion.time[-MOST_TRIED:], motion.x[-MOST_TRIED:]
        trial = LiveFilter(self._rate_hz, self.window)
        while trial.window <= min(LONGEST_PARABOLA, time.size // 4):
            a = fit_parabolas(time, x, trial.window, math.inf)[1]
            if trial.estimate_errors(density).a <= share * float(np.sqrt(np.mean(a * a))):
                return trial.window
            trial.window = round(1.5 * trial.window) | 1
        return self.window

    def _choose(self, window_s: float) -> None:
        wanted_samples = count_samples(window_s, self._rate_hz)
        if not self.window / CHANGED <= wanted_samples <= self.window * CHANGED:
            self.window = wanted_samples


def estimate_noise_density(time: Array, x: Array) -> float:
    """Return the density of the noise of readings, m^2 s: variance over rate; ``time`` and ``x``, (n,), evenly spaced.

    The variance is that of third differences, of which slips are few.  If most readings repeat the previous one they
    are counts: the variance of one is a twelfth of its square, independent at each change.
    """
    steps = np.diff(x)
    span = float(time[-1]) - float(time[0])
    moved = np.abs(steps[steps != 0])
    if 0 < moved.size < steps.size / 2:
        count = float(np.median(moved))
        return count * count / 12 * span / float(moved.size)
    sd = float(np.median(np.abs(np.diff(steps, 2)))) / 0.6745
    return sd * sd / 20 * span / float(time.size)


def count_samples(window_s: float, rate_hz: float) -> int:
    """Return an odd number of samples that last about ``window_s``, from `SHORTEST_PARABOLA` to `LONGEST_PARABOLA`."""
    return min(max(SHORTEST_PARABOLA, round(window_s * rate_hz) | 1), LONGEST_PARABOLA)


def fit_parabolas(time: Array, position: Array, window: int, longest: float) -> Array:
    """Return velocity and acceleration, (2, n - window + 1), at the middle sample of each window of a parabola.

    ``time`` and ``position``, (n,), are in s, and m or counts; the times need not be even.  ``window`` is odd; a window
    longer than ``longest``, s, has a gap, and its motion is NaN.
    """
    middle = window // 2
    t = np.lib.stride_tricks.sliding_window_view(time, window)
    x = np.lib.stride_tricks.sliding_window_view(position, window)
    scale = np.maximum((t[:, -1] - t[:, 0]) / 2, np.finfo(float).tiny)
    u = (t - t[:, middle, None]) / scale[:, None]
    y = x - x[:, middle, None]
    u2 = u * u
    ones = np.ones(window)
    p1, p2 = u @ ones, u2 @ ones
    p3, p4 = (np.einsum("ij,ij->i", u2, other) for other in (u, u2))
    m0, m1, m2 = y @ ones, np.einsum("ij,ij->i", u, y), np.einsum("ij,ij->i", u2, y)
    # The normal equations of y = c0 + c1 u + c2 u^2, without c0.
    s11, s12, s22 = p2 - p1 * p1 / window, p3 - p1 * p2 / window, p4 - p2 * p2 / window
    r1, r2 = m1 - p1 * m0 / window, m2 - p2 * m0 / window
    determinant = s11 * s22 - s12 * s12
    c1, c2 = (r1 * s22 - r2 * s12) / determinant, (r2 * s11 - r1 * s12) / determinant
    # At the middle u = 0: the slope is c1, the curvature 2 c2.
    derivatives = np.array([c1 / scale, 2 * c2 / scale**2])
    derivatives[:, t[:, -1] - t[:, 0] > longest] = math.nan
    return derivatives
