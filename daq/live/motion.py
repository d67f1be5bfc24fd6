"""Velocity, acceleration, and stick or slip while a recording runs: estimates for the eye, from the past alone.

A parabola is fitted to the last `WINDOW_S` of positions; its value, slope and curvature at the middle of the window are
position, velocity and acceleration, half a window late.  `process smooth` estimates the velocity of the finished run,
with corners at break-aways and landings, which these parabolas round.
"""

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from daq.base.compute.arrays import Array
from daq.live.tail import NewSamples
from daq.runfile.rig import Rig

# Half has five times the noise in the acceleration, double rounds the landings of a cycle of 0.5 s over a tenth of it.
WINDOW_S = 0.02
FEWEST = 5  # samples of a parabola
STICK_SHARE = 0.03  # of the belt's speed: within it a mass that moves with the belt sticks
MEMORY_S = 20.0  # of motion from which the belt's speed and k/m are read where nobody measured them
SLIP_SHARE = 0.2  # of the belt's speed: beyond it the mass slips, past the rounding of break-away and landing
BELT_BINS = 60  # of the range of velocities; the fullest one must hold `BELT_SHARE` of them
BELT_SHARE = 0.15
LEAST_SAMPLES = 200
# Velocities of a slip are compared within so many bins: half lets friction vary within one, double leaves bins that a
# slip passes once.
SLIP_BINS = 40


@dataclass(frozen=True)
class LiveMotion:
    """Estimates at k times, each of shape (k,); NaN where a window has a gap.

    Attributes
    ----------
    time : s
    x, v, a : m, m/s and m/s^2; or counts, counts/s and counts/s^2
    stick : bool
    """

    time: Array
    x: Array
    v: Array
    a: Array
    stick: np.typing.NDArray[np.bool_]


class LiveFilter:
    """Fit parabolas to samples as they come.

    Parameters
    ----------
    rate_hz : float
        Nominal rate of the samples.

    Attributes
    ----------
    belt_speed : float
        m/s; NaN until it is known: from the calibration, else the velocity that occurs most often.
    k_over_m : float
        s^-2; NaN until it is known: from mass and stiffness, else from the slips, whose velocities each occur twice, at
        different positions: what the acceleration then differs by is due to the spring.
    """

    def __init__(self, rate_hz: float) -> None:
        self._window = max(FEWEST, round(WINDOW_S * rate_hz) | 1)
        self._longest = 1.5 * self._window / rate_hz
        self._time, self._position = np.empty(0), np.empty(0)
        self._recent: deque[LiveMotion] = deque()
        self.belt_speed = self.k_over_m = math.nan

    def feed(self, new: NewSamples) -> LiveMotion:
        """Return the motion at the times that a window now surrounds; those before a segment's end stay unknown."""
        cuts = [0, *np.flatnonzero(new.fresh).tolist(), new.time.size]
        parts = []
        for start, stop in pairwise(cuts):
            if start < new.time.size and new.fresh[start]:
                self._time, self._position = np.empty(0), np.empty(0)
            self._time = np.concatenate((self._time, new.time[start:stop]))
            self._position = np.concatenate((self._position, new.position[start:stop]))
            if self._time.size >= self._window:
                parts.append(parabolas(self._time, self._position, self._window, self._longest))
                self._time, self._position = self._time[1 - self._window :], self._position[1 - self._window :]
        time, x, v, a = np.concatenate(parts, axis=1) if parts else np.empty((4, 0))
        stick = np.abs(v - self.belt_speed) < STICK_SHARE * abs(self.belt_speed)
        motion = LiveMotion(time, x, v, a, stick)
        if time.size:
            self._recent.append(motion)
            while self._recent[-1].time[-1] - self._recent[0].time[0] > MEMORY_S:
                self._recent.popleft()
        return motion

    def estimate(self, rig: Rig) -> None:
        """Estimate `belt_speed` and `k_over_m` from the last `MEMORY_S`, where the calibration does not hold them."""
        x, v, a = (np.concatenate([getattr(part, name) for part in self._recent] or [[]]) for name in "xva")
        known = np.isfinite(v)
        x, v, a = x[known], v[known], a[known]
        if rig.belt_speed is not None and rig.metres_per_count is not None:
            self.belt_speed = rig.belt_speed.value
        elif v.size >= LEAST_SAMPLES:
            self.belt_speed = _most_frequent(v, self.belt_speed)
        if rig.mass is not None and rig.stiffness is not None:
            self.k_over_m = rig.stiffness.value / rig.mass.value
        else:
            slips = np.abs(v - self.belt_speed) > SLIP_SHARE * abs(self.belt_speed)
            if np.count_nonzero(slips) >= LEAST_SAMPLES:
                self.k_over_m = _spring(x[slips], v[slips], a[slips], self.k_over_m)


def _most_frequent(v: Array, otherwise: float) -> float:
    """Return the velocity that occurs most often; ``otherwise`` where none does, or rest does."""
    place, width = _bins(v, BELT_BINS)
    inside = place == np.argmax(np.bincount(place))
    speed = float(np.median(v[inside]))
    return speed if abs(speed) > 1.5 * width and inside.mean() >= BELT_SHARE else otherwise


def _spring(x: Array, v: Array, a: Array, otherwise: float) -> float:
    """Return k/m, s^-2, by regression of the acceleration on the position among samples of about equal velocity."""
    place, _ = _bins(v, SLIP_BINS)
    number = np.maximum(np.bincount(place, minlength=SLIP_BINS), 1)
    x = x - (np.bincount(place, x, SLIP_BINS) / number)[place]
    a = a - (np.bincount(place, a, SLIP_BINS) / number)[place]
    spread = float(np.sum(x * x))
    found = -float(np.sum(x * a)) / spread if spread > 0 else math.nan
    return found if found > 0 else otherwise


def _bins(v: Array, bins: int) -> tuple[np.typing.NDArray[np.intp], float]:
    """Return in which of ``bins`` equal parts of their range the values lie, and the width of one."""
    width = float(np.ptp(v)) / bins
    if width == 0:
        return np.zeros(v.size, np.intp), 0.0
    return np.minimum(((v - v.min()) / width).astype(np.intp), bins - 1), width


def parabolas(time: Array, position: Array, window: int, longest: float) -> Array:
    """Return time, position, velocity and acceleration by least-squares parabolas over every ``window`` samples.

    Parameters
    ----------
    time, position : (n,) float64
        s, and m or counts; the times need not be even.
    window : int
        Samples of each parabola, odd.
    longest : float
        A window that lasts longer, s, has a gap: its motion is NaN.

    Returns
    -------
    (4, n - window + 1) float64
        At the middle sample of each window.
    """
    middle = window // 2
    t = np.lib.stride_tricks.sliding_window_view(time, window)
    x = np.lib.stride_tricks.sliding_window_view(position, window)
    at, level = t[:, middle : middle + 1], x[:, middle : middle + 1]
    scale = np.maximum((t[:, -1:] - t[:, :1]) / 2, np.finfo(float).tiny)
    u, y = (t - at) / scale, x - level
    powers = [np.sum(u**k, axis=1) for k in range(5)]
    moments = [np.sum(u**k * y, axis=1) for k in range(3)]
    normal = np.array([[powers[i + j] for j in range(3)] for i in range(3)])
    p, q, r = np.linalg.solve(np.moveaxis(normal, 2, 0), np.array(moments).T[..., None])[..., 0].T
    width = scale[:, 0]
    found = np.array([at[:, 0], level[:, 0] + p, q / width, 2 * r / width**2])
    found[1:, t[:, -1] - t[:, 0] > longest] = math.nan
    return found
