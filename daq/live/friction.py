"""The friction curve while a recording runs, without a law: the force balance of the slips, with k/m from the slips.

In a slip m a = F - k (x - x0) - c v.  The mass passes each relative velocity twice, on its way down and on its way
back, at different positions: the difference of acceleration is due to the spring.  So k/m is a regression of the
acceleration on the position, together with any smooth function of the relative velocity.  Then F/m = a + k/m (x - x0)
+ c/m v, averaged in bins of the slip speed.

Not modelled: parabolas that round a slip, a belt that slows, drags other than c v.  `fit-friction` fits trajectories.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from daq.live.sticks import Slip
from stickslip.compute.arrays import Array

SLIPS = 24  # the last ones, from which the curve is made: fewer are noisier, more are out of date
PER_SLIP = 400  # samples of a slip that are kept, at most
# Knots of the function of speed that is fitted with k/m, closer at low speeds, where friction changes most.
KNOTS = 16
# Share of the belt's speed: k/m is fitted at higher slip speeds, past ramps and corners rounded by parabolas.
RAMP_SHARE = 0.2
BINS = 24  # bins of the curve, narrow at low speeds, where friction changes most
FEWEST_IN_BIN = 3  # samples of a slip in a bin of its mean
FEWEST_SLIPS = 3  # for a standard error from their scatter


@dataclass(frozen=True)
class QuickCurve:
    speed: Array  # (k,) slip speed, m/s or counts/s
    friction: Array  # (k,) mean over the slips, per unit mass, and standard deviation between them (NaN of one)
    sd: Array
    slips: int  # number of slips in it


class QuickFriction:
    """Collects slips; estimates k/m and the curve from the last `SLIPS` ones."""

    def __init__(self) -> None:
        self._slips: deque[tuple[Array, Array, Array]] = deque(maxlen=SLIPS)
        self._k_over_m: deque[tuple[float, float]] = deque(maxlen=SLIPS)

    def add(self, slip: Slip, belt_speed: float, half_s: float) -> None:
        """Add a slip, without ``half_s`` at either end, where parabolas round its corners."""
        t = slip.motion.time
        inside = np.flatnonzero((t > slip.break_away + half_s) & (t < slip.landing - half_s))
        inside = inside[:: max(1, math.ceil(inside.size / PER_SLIP))]
        x, v, a = slip.motion.x[inside], slip.motion.v[inside], slip.motion.a[inside]
        finite = np.isfinite(v)
        w = v[finite] - belt_speed
        fast = np.abs(w) > RAMP_SHARE * abs(belt_speed)
        if np.count_nonzero(fast) < 2 * KNOTS:
            return
        self._slips.append((x[finite], w, a[finite]))
        k_over_m = fit_k_over_m(x[finite][fast], w[fast], a[finite][fast])
        # The acceleration of a parabola over 2h is x'' + x h^2/14, and x is about -k/m x''.
        self._k_over_m.append((k_over_m, k_over_m**2 * half_s**2 / 14))

    def estimate_k_over_m(self) -> tuple[float, float]:
        """Return k/m, s^-2, and its standard error; NaN if unknown.

        The median of the slips, each corrected for the rounding of its parabolas: a single disturbed slip does not
        change it.  The error is that of the median by the scatter between slips, and the correction itself.
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

    def estimate_curve(self, k_over_m: float, x0: float, c_over_m: float, belt_speed: float) -> QuickCurve | None:
        """Return the curve per unit mass; None before the first slip."""
        if not self._slips or math.isnan(k_over_m):
            return None
        x, w, a = (np.concatenate([slip[k] for slip in self._slips]) for k in range(3))
        slip_number = np.repeat(np.arange(len(self._slips)), [slip[0].size for slip in self._slips])
        speed, friction = np.abs(w), a + k_over_m * (x - x0) + c_over_m * (w + belt_speed)
        fastest = float(speed.max())
        bin_number = np.minimum((BINS * np.sqrt(speed / fastest)).astype(np.intp), BINS - 1)
        size = (len(self._slips), BINS)
        key = slip_number * BINS + bin_number
        number, sum_speed, sum_friction = (
            np.bincount(key, weights, size[0] * BINS).reshape(size) for weights in (None, speed, friction)
        )
        enough = number >= FEWEST_IN_BIN
        number = np.where(enough, number, 1)
        slips = enough.sum(axis=0)
        occupied = slips > 0
        mean = np.where(enough, sum_friction / number, 0).sum(axis=0)[occupied] / slips[occupied]
        deviation = np.where(enough[:, occupied], (sum_friction / number)[:, occupied] - mean, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            sd = np.sqrt((deviation**2).sum(axis=0) / (slips[occupied] - 1))
        sd[slips[occupied] < 2] = math.nan
        mean_speed = np.where(enough, sum_speed / number, 0).sum(axis=0)[occupied] / slips[occupied]
        return QuickCurve(mean_speed, mean, sd, len(self._slips))


def fit_k_over_m(x: Array, w: Array, a: Array) -> float:
    """Return k/m, s^-2, of one slip by least squares; NaN if the slip does not pass its velocities twice.

    The acceleration is fitted by position and a linear spline of the speed; ``x``, ``w`` and ``a``, (n,), are position,
    m or counts, relative velocity and acceleration in its units a second.
    """
    speed, span = np.abs(w), float(np.ptp(x))
    if not (speed.max() > 0 and span > 0):
        return math.nan
    knot = (KNOTS - 1) * np.sqrt(speed / speed.max())
    lower = np.minimum(knot.astype(np.intp), KNOTS - 2)
    share = knot - lower
    columns = np.zeros((w.size, KNOTS + 1))
    rows = np.arange(w.size)
    columns[rows, lower] = 1 - share
    columns[rows, lower + 1] = share
    columns[:, KNOTS] = (x - x.mean()) / span
    used = columns.any(axis=0)
    coefficients, _, rank, _ = np.linalg.lstsq(columns[:, used], a, rcond=None)
    return -float(coefficients[-1]) / span if rank == np.count_nonzero(used) else math.nan
