"""Velocity and acceleration while a recording runs: a parabola is fitted to a short window about each reading.

Its slope and curvature are velocity and acceleration at the middle of the window, so that they come half a window late.
`process smooth` estimates the velocity of the finished run, with corners at break-aways and landings, which these
parabolas round.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from daq.live.tail import NewSamples
from stickslip.compute.arrays import HOLE, Array, Mask, joined

# Length of the window before a slip has been seen.  Half leaves so much noise in the velocity of a camera that no
# stick is seen, double rounds the landings of a cycle of 0.5 s over a tenth of it.
WINDOW_S = 0.02
SHORTEST_PARABOLA = 5  # samples of a parabola
LONGEST_PARABOLA = 401  # samples of a parabola: twice as many take twice the time of a look at the journal
# Longest window, as a share of a slip and of a stick: a longer one hardly lies within one, and short sticks are then
# missed.  Half leaves more noise in the acceleration; with double, missed sticks make the slips, and so the window,
# longer and longer.
MOST_SHARE = 0.25
# Noise of the velocity, at most this share of the mean speed of slips.  In a noisy, slow record half makes slips a
# tenth longer, and with double a twentieth of them is missed.
QUIET_SHARE = 0.05
MOST_TRIED = 5000  # samples, the last ones, of which a window is tried that is longer than the noise
CHANGED = 1.25  # a better window takes the place of one that differs by so much; a smaller step gives the same to 5 %


@dataclass(frozen=True)
class LiveMotion:
    """Motion at k times, each array of shape (k,)."""

    time: Array
    x: Array  # the reading itself
    v: Array  # of the parabola; NaN where its window has a gap
    a: Array
    fresh: Mask  # true where nothing connects with the time before: at the first one of a segment, and after a hole


@dataclass(frozen=True)
class MotionErrors:
    """Standard deviations of a reading, of velocity and of acceleration, in the units of `LiveMotion`."""

    x: float
    v: float
    a: float


class LiveFilter:
    """Fit parabolas to samples as they come.

    rate_hz: Nominal rate of the samples.
    window: Samples of a parabola, odd; by default those of `WINDOW_S`.
    window: Samples of the next parabolas.
    """

    def __init__(self, rate_hz: float, window: int | None = None) -> None:
        self.window = window or samples_of(WINDOW_S, rate_hz)
        self._rate_hz = rate_hz
        self._begin()

    def _begin(self) -> None:
        self._time, self._x = np.empty(0), np.empty(0)
        self._next = -1  # place of the next middle of a window; -1: the first one of a segment

    @property
    def half_s(self) -> float:
        """Half of the window, s: so late the motion is, and so much it rounds a corner to either side."""
        return (self.window - 1) / 2 / self._rate_hz

    def feed(self, new: NewSamples) -> LiveMotion:
        """Return the motion at the times that a window now surrounds; those at a segment's ends stay unknown."""
        cuts = [0, *np.flatnonzero(new.fresh).tolist(), new.time.size]
        parts = []
        for start, stop in pairwise(cuts):
            if start < new.time.size and new.fresh[start]:
                self._begin()
            self._time = np.concatenate((self._time, new.time[start:stop]))
            self._x = np.concatenate((self._x, new.position[start:stop]))
            parts.append(self._made())
        return joined(parts)

    def _made(self) -> LiveMotion:
        """Return the motion at the middles that can be had now."""
        half = self.window // 2
        begins = self._next < 0
        first = half if begins else self._next
        stop = self._time.size - half
        if stop <= first:
            nothing = np.empty(0)
            return LiveMotion(nothing, nothing, nothing, nothing, np.empty(0, np.bool_))
        # A window that has grown reaches beyond the first sample of its segment at first.
        low = max(first, half)
        span = slice(low - half, stop + half)
        v, a = np.full((2, stop - first), math.nan)
        if stop > low:
            longest = 1.5 * self.window / self._rate_hz
            v[low - first :], a[low - first :] = parabolas(self._time[span], self._x[span], self.window, longest)
        fresh = np.diff(self._time[first:stop], prepend=self._time[max(0, first - 1)]) > HOLE / self._rate_hz
        fresh[0] |= begins
        motion = LiveMotion(self._time[first:stop], self._x[first:stop], v, a, fresh)
        kept = max(0, stop - LONGEST_PARABOLA // 2)
        self._time, self._x, self._next = self._time[kept:], self._x[kept:], stop - kept
        return motion

    def errors(self, density: float) -> MotionErrors:
        """Return the errors of the motion from readings whose noise has a density, m^2 s: variance over their rate."""
        window_s = self.window / self._rate_hz
        variances = density * self._rate_hz, 12 * density / window_s**3, 720 * density / window_s**5
        return MotionErrors(*map(math.sqrt, variances))

    def suit_slips(self, density: float, slip_s: float, drop: float, stick_s: float) -> None:
        """Choose the window for slips of a duration, s, and a drop, m, between sticks, in readings of a noise density.

        A parabola over 2h of a sine of amplitude A = drop/2 and angular frequency w = pi/slip_s has an acceleration
        that is wrong by A w^4 h^2/14 at most, and by the noise of 22.5 density/h^5 in the mean square.  The window
        makes the sum of both squares least: h^9 = (5/4) 22.5 density (14/(A w^4))^2.
        """
        curvature = drop / 2 * (math.pi / slip_s) ** 4 / 14
        half_s = (1.25 * 22.5 * density / curvature**2) ** (1 / 9)
        # So short that noise looks like slips it must not be, whatever is taken for slips.
        least_s = (12 * density * (slip_s / (QUIET_SHARE * drop)) ** 2) ** (1 / 3)
        self._choose(max(min(2 * half_s, MOST_SHARE * min(slip_s, stick_s)), least_s))

    def quiet_window(self, motion: LiveMotion, density: float, share: float) -> int:
        """Return the window, as short as now or longer, in which noise makes at most a share of the rms acceleration.

        The one of now where none does: then there is no acceleration but that of the noise.
        """
        time, x = motion.time[-MOST_TRIED:], motion.x[-MOST_TRIED:]
        trial = LiveFilter(self._rate_hz, self.window)
        while trial.window <= min(LONGEST_PARABOLA, time.size // 4):
            a = parabolas(time, x, trial.window, math.inf)[1]
            if trial.errors(density).a <= share * float(np.sqrt(np.mean(a * a))):
                return trial.window
            trial.window = round(1.5 * trial.window) | 1
        return self.window

    def _choose(self, window_s: float) -> None:
        wanted = samples_of(window_s, self._rate_hz)
        if not self.window / CHANGED <= wanted <= self.window * CHANGED:
            self.window = wanted


def noise_density(time: Array, x: Array) -> float:
    """Return the density of the noise of readings, m^2 s: variance over rate; ``time`` and ``x``, (n,), evenly spaced.

    The variance is that of third differences, of which slips are few.  Where most readings repeat the one before they
    are counts: one is wrong by a twelfth of its square, anew as often as it changes.
    """
    steps = np.diff(x)
    span = float(time[-1]) - float(time[0])
    moved = np.abs(steps[steps != 0])
    if 0 < moved.size < steps.size / 2:
        count = float(np.median(moved))
        return count * count / 12 * span / float(moved.size)
    sd = float(np.median(np.abs(np.diff(steps, 2)))) / 0.6745
    return sd * sd / 20 * span / float(time.size)


def samples_of(window_s: float, rate_hz: float) -> int:
    """Return an odd number of samples that last about ``window_s``, from `SHORTEST_PARABOLA` to `LONGEST_PARABOLA`."""
    return min(max(SHORTEST_PARABOLA, round(window_s * rate_hz) | 1), LONGEST_PARABOLA)


def parabolas(time: Array, position: Array, window: int, longest: float) -> Array:
    """Return velocity and acceleration by least-squares parabolas over every ``window`` samples.

    time, position: (n,) s, and m or counts; the times need not be even.
    window: Samples of each parabola, odd.
    longest: A window that lasts longer, s, has a gap: its motion is NaN.
    Returns: (2, n - window + 1) At the middle sample of each window.
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
    found = np.array([c1 / scale, 2 * c2 / scale**2])
    found[:, t[:, -1] - t[:, 0] > longest] = math.nan
    return found
