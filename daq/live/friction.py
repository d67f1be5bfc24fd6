"""The friction curve while a recording runs, without a law: the force balance of the slips, with k/m from the slips.

In a slip m a = F - k (x - x0) - c v.  The mass passes each relative velocity twice, on its way down and on its way
back, at different positions: what the acceleration then differs by is due to the spring.  So k/m is a regression of the
acceleration on the position, beside any smooth function of the relative velocity.  Then F/m = a + k/m (x - x0) + c/m v,
averaged in bins of the slip speed.

Not modelled: parabolas that round a slip, a belt that slows, drags other than c v.  `fit-friction` fits trajectories.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from daq.live.sticks import Slip
from stickslip.compute.arrays import Array

SLIPS = 24  # the last ones, of which the curve is made: half as many err by 1.4 times as much, twice as many lag behind
PER_SLIP = 400  # samples kept of a slip: with half of them noise counts 1.4 times as much
# Knots of the function of speed beside which k/m is fitted, closer at low speeds, where friction changes most.  Half
# and twice give the same k/m to 0.02 %.
KNOTS = 16
# Share of the belt's speed: k/m is fitted at higher slip speeds, past ramps and what parabolas round.  Half errs by
# 0.1 % with a ramp, double gives the same.
RAMP_SHARE = 0.2
BINS = 24  # bins of the curve, narrow at low speeds, where friction changes most
FEWEST_IN_BIN = 3  # samples of a slip
FEWEST_SLIPS = 3  # with fewer there is no scatter to speak of


@dataclass(frozen=True)
class QuickCurve:
    """Friction against slip speed."""

    speed: Array  # (k,) slip speed, m/s or counts/s
    friction: Array  # (k,) mean over the slips, per unit mass, and standard deviation between them (NaN of one)
    sd: Array
    slips: int  # slips of which it is made


class QuickFriction:
    """Collect slips; estimate k/m and the curve of the last `SLIPS` ones."""

    def __init__(self) -> None:
        self._slips: deque[tuple[Array, Array, Array]] = deque(maxlen=SLIPS)
        self._k_over_m: deque[tuple[float, float]] = deque(maxlen=SLIPS)

    def take(self, slip: Slip, belt_speed: float, half_s: float) -> None:
        """Add a slip, less ``half_s`` at either end, where parabolas round its corners."""
        t = slip.motion.time
        own = np.flatnonzero((t > slip.break_away + half_s) & (t < slip.landing - half_s))
        own = own[:: max(1, math.ceil(own.size / PER_SLIP))]
        x, v, a = slip.motion.x[own], slip.motion.v[own], slip.motion.a[own]
        known = np.isfinite(v)
        w = v[known] - belt_speed
        away = np.abs(w) > RAMP_SHARE * abs(belt_speed)
        if np.count_nonzero(away) < 2 * KNOTS:
            return
        self._slips.append((x[known], w, a[known]))
        found = regressed(x[known][away], w[away], a[known][away])
        # The acceleration of a parabola over 2h is x'' + x h^2/14, and x is about -k/m x''.
        self._k_over_m.append((found, found**2 * half_s**2 / 14))

    def k_over_m(self) -> tuple[float, float]:
        """Return k/m, s^-2, and its standard error; NaN where it is not known.

        The median of the slips, each corrected for the rounding of its parabolas: one that a hand has touched does not
        move it.  The error is that of the median by the scatter between slips, and the correction itself.
        """
        estimates = np.array(self._k_over_m).reshape(-1, 2)
        estimates = estimates[np.isfinite(estimates[:, 0])]
        if len(estimates) < FEWEST_SLIPS:
            return math.nan, math.nan
        corrected, correction = estimates.sum(axis=1), float(np.median(estimates[:, 1]))
        middle = float(np.median(corrected))
        spread = 1.4826 * float(np.median(np.abs(corrected - middle)))
        error = math.hypot(1.253 * spread / math.sqrt(len(estimates)), correction)
        return (middle, error) if middle > 0 else (math.nan, math.nan)

    def curve(self, k_over_m: float, x0: float, c_over_m: float, belt_speed: float) -> QuickCurve | None:
        """Return the curve per unit mass; None before there is a slip."""
        if not self._slips or math.isnan(k_over_m):
            return None
        x, w, a = (np.concatenate([slip[k] for slip in self._slips]) for k in range(3))
        which = np.repeat(np.arange(len(self._slips)), [slip[0].size for slip in self._slips])
        speed, friction = np.abs(w), a + k_over_m * (x - x0) + c_over_m * (w + belt_speed)
        fastest = float(speed.max())
        place = np.minimum((BINS * np.sqrt(speed / fastest)).astype(np.intp), BINS - 1)
        size = (len(self._slips), BINS)
        key = which * BINS + place
        number, of_speed, of_friction = (
            np.bincount(key, weights, size[0] * BINS).reshape(size) for weights in (None, speed, friction)
        )
        enough = number >= FEWEST_IN_BIN
        number = np.where(enough, number, 1)
        slips = enough.sum(axis=0)
        shown = slips > 0
        mean = np.where(enough, of_friction / number, 0).sum(axis=0)[shown] / slips[shown]
        off = np.where(enough[:, shown], (of_friction / number)[:, shown] - mean, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            sd = np.sqrt((off**2).sum(axis=0) / (slips[shown] - 1))
        sd[slips[shown] < 2] = math.nan
        at = np.where(enough, of_speed / number, 0).sum(axis=0)[shown] / slips[shown]
        return QuickCurve(at, mean, sd, len(self._slips))


def regressed(x: Array, w: Array, a: Array) -> float:
    """Return k/m, s^-2, of one slip by least squares: the acceleration by position and a linear spline of the speed.

    x, w, a: (n,) Position, m or counts; relative velocity and acceleration in its units a second.
    Returns: NaN where the slip does not pass its velocities twice.
    """
    speed, span = np.abs(w), float(np.ptp(x))
    if not (speed.max() > 0 and span > 0):
        return math.nan
    at = (KNOTS - 1) * np.sqrt(speed / speed.max())
    left = np.minimum(at.astype(np.intp), KNOTS - 2)
    share = at - left
    columns = np.zeros((w.size, KNOTS + 1))
    rows = np.arange(w.size)
    columns[rows, left] = 1 - share
    columns[rows, left + 1] = share
    columns[:, KNOTS] = (x - x.mean()) / span
    used = columns.any(axis=0)
    found, _, rank, _ = np.linalg.lstsq(columns[:, used], a, rcond=None)
    return -float(found[-1]) / span if rank == np.count_nonzero(used) else math.nan
