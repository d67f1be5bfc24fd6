"""Sticks and slips while a recording runs: when the mass breaks away and lands, and the belt's speed, from the motion.

In a stick the mass moves near the belt's speed and hardly accelerates; under a ramp law it creeps, some per cent slower
as the load grows.  A slip begins where its velocity differs from the belt's by half, and ends where the acceleration
stays small for `SETTLED` windows of the motion.  Break-away and landing are then located in the positions, by their
deviation from the curve through the neighbouring stick.  `process smooth` finds them by models of both kinds of motion.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from daq.live.motion import LiveMotion, MotionErrors
from stickslip.compute.arrays import Array, Mask, joined, rows

# Share of the belt's speed: farther from it the mass slips, as distinct from noise and the creep of a wide ramp.
SLIP_SHARE = 0.5
# Share of the rms acceleration of slips: below it the mass sticks.  A mass that swings without sticking is below it
# for 4 % of half a period.
STICK_SHARE = 0.1
NOISE = 4.0  # standard deviations: a larger deviation is not noise
# Windows of the motion at small acceleration after which a slip has ended.
SETTLED = 1.5
STICK_WINDOWS = 3.0  # windows of the motion to which the curve of a stick is fitted
# A slip leaves the stick as the square of time if friction drops at once, as its cube if it falls with speed, and lands
# as the square: the time at which it is `LATER` times farther off gives the time of break-away or landing.
LATER, BREAKS, LANDS = 8.0, 2.5, 2.0
MOST_OF_SLIP = 1 << 16  # samples: a longer motion is not a slip
FEWEST_RECENT = 1000  # readings, or 2 s of them, from which the belt's speed is estimated before the first stick
# The belt's speed before the first stick: this share of the velocities lies within this relative distance of it.  Those
# of a mass that swings without sticking are within 0.19 of its fastest; those of sticks for a third of the time that
# creep by 10 % are within 0.06.
BELT_SHARE, BELT_SPREAD = 0.2, 0.15
UNSEEN = (math.nan, math.nan)  # time and position of an event that was not seen
RECENT = 5  # sticks over which the belt's speed is a median, so that two odd ones do not change it


@dataclass(frozen=True)
class Slip:
    break_away: float  # their times, s
    landing: float
    stick_s: float  # duration of the stick before, NaN if its landing was not seen
    break_away_x: float  # position at the break-away, m or counts
    drop: float  # between the extremes of the positions from break-away to landing
    motion: LiveMotion  # from break-away to landing

    @property
    def slip_s(self) -> float:
        """Duration, s."""
        return self.landing - self.break_away


@dataclass
class Spread:
    """Number, last value, mean, standard deviation and range of the values so far, one at a time (Welford 1962)."""

    n: int = 0
    last: float = math.nan
    mean: float = 0.0
    low: float = math.inf
    high: float = -math.inf
    _squares: float = field(default=0.0, repr=False)

    def add(self, value: float) -> None:
        self.n, self.last = self.n + 1, value
        deviation = value - self.mean
        self.mean += deviation / self.n
        self._squares += deviation * (value - self.mean)
        self.low, self.high = min(self.low, value), max(self.high, value)

    @property
    def sd(self) -> float:
        """Standard deviation, NaN of fewer than two."""
        return math.sqrt(self._squares / (self.n - 1)) if self.n > 1 else math.nan


class StickSlip:
    """Follow sticks and slips.

    state: "stick", "slip", or "" if unknown.
    cycles: Sticks with the slip after them, both complete.
    belt_speed: The belt's speed, m/s or counts/s: the median of the mean velocities of the last `RECENT` sticks; NaN
        before the first one.
    """

    def __init__(self) -> None:
        self.state = ""
        self.cycles = 0
        self.belt_speed = math.nan
        self._speeds: list[float] = []
        self._kept: list[LiveMotion] = []
        self._landing = self._break_away = UNSEEN
        self._still = self._between = 0  # samples at the belt's speed since the last slip, and others between them
        self._square, self._slipped = 0.0, 0  # mean square of the acceleration in slips, and of how many samples
        self._leaving = 0  # samples since the last one at the belt's speed

    def feed(self, motion: LiveMotion, belt_speed: float, window: int, errors: MotionErrors) -> list[Slip]:
        """Return the slips that have ended.

        motion: New motion since the last call.
        belt_speed: The belt's speed as known so far.
        window: Samples of a parabola of the motion.
        errors: Standard deviations of the motion from the noise of the readings.
        """
        slips: list[Slip] = []
        slipping = np.abs(motion.v - belt_speed) > max(SLIP_SHARE * abs(belt_speed), NOISE * errors.v)
        with_belt = ~slipping & (np.abs(motion.a) <= self._small_acceleration(motion, slipping, NOISE * errors.a))
        broken = motion.fresh | ~np.isfinite(motion.v)
        # 2: slips, 1: moves with the belt, 0: between them; -1: unknown.
        kind = np.where(broken, -1, np.where(slipping, 2, with_belt.astype(np.int8)))
        edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), kind.size]
        for first, stop in pairwise(edges):
            if first < stop:
                piece = rows(motion, slice(first, stop))
                slip = self._take_piece(int(kind[first]), piece, window, belt_speed, errors.x)
                if slip is not None:
                    slips.append(slip)
        return slips

    def _small_acceleration(self, motion: LiveMotion, slipping: Mask, noise: float) -> float:
        """Return the limit of the acceleration of a stick, and update the mean square of that of slips."""
        a = motion.a[slipping & np.isfinite(motion.a)]
        if a.size:
            weight = a.size / (self._slipped + a.size)
            self._square += weight * (float(np.mean(a * a)) - self._square)
            self._slipped = min(self._slipped + a.size, MOST_OF_SLIP)
        usual = math.sqrt(self._square)
        return max(STICK_SHARE * usual, noise)

    def _take_piece(self, kind: int, piece: LiveMotion, window: int, belt_speed: float, noise: float) -> Slip | None:
        if kind < 0:
            self._forget()
            return None
        self._kept.append(piece)
        n = piece.time.size
        self._settle(kind, n)
        self._leaving = 0 if kind == 1 else self._leaving + n
        if kind == 2:
            if self.state == "stick":
                self._place_break_away(window)
            self.state = "slip"
            if sum(part.time.size for part in self._kept) > MOST_OF_SLIP:
                self._forget()
                self.state = "slip"
            return None
        if self.state == "stick":
            self._trim(round((STICK_WINDOWS + 2) * window))
            return None
        if self._still < SETTLED * window:
            return None
        slip = self._place_landing(window, belt_speed, noise)
        self.state = "stick"
        self._trim(round((STICK_WINDOWS + 2) * window))
        return slip

    def _settle(self, kind: int, n: int) -> None:
        """Count the samples at the belt's speed since the mass has been near it; noise may interrupt them."""
        if kind == 1:
            self._still += n
        elif self._still:
            self._between += n
        if kind == 2 or self._between > self._still / 2:
            self._still = self._between = 0

    def _forget(self) -> None:
        self.state, self._kept, self._still, self._between = "", [], 0, 0
        self._landing = self._break_away = UNSEEN

    def _trim(self, most: int) -> None:
        """Keep only the last samples; a piece that begins before them stays whole."""
        total = sum(part.time.size for part in self._kept)
        while total - self._kept[0].time.size >= most:
            total -= self._kept.pop(0).time.size

    def _place_break_away(self, window: int) -> None:
        """Locate the break-away in the stored motion, which ends in samples that do not move with the belt."""
        stretch = joined(self._kept)
        last = max(3, stretch.time.size - self._leaving - window // 2)
        stick = slice(max(0, last - round(STICK_WINDOWS * window)), last)
        deviation = _deviation_from_stick(stretch, stick, slice(stick.start, None))
        inside = np.flatnonzero(deviation <= NOISE)
        last_inside = int(inside[-1]) if inside.size else 0
        outside = np.flatnonzero(deviation[last_inside:] >= LATER * NOISE)
        n_later = int(outside[0]) if outside.size else 0
        break_away = stick.start + max(0, last_inside - round(n_later / (LATER ** (1 / BREAKS) - 1)))
        self._break_away = float(stretch.time[break_away]), float(stretch.x[break_away])
        self._kept = [rows(stretch, slice(break_away, None))]

    def _place_landing(self, window: int, belt_speed: float, noise: float) -> Slip | None:
        """Locate the landing in the stored motion, which ends in samples at the belt's speed."""
        stretch = joined(self._kept)
        begin = stretch.time.size - self._still - self._between
        stick = slice(min(begin + window // 2, stretch.time.size - 4), None)
        deviation = _deviation_from_stick(stretch, stick, slice(stick.start))
        outside = np.flatnonzero(np.minimum(deviation[1:], deviation[:-1]) > NOISE)  # a single one may be noise
        landed_at = int(outside[-1]) + 2 if outside.size else 0
        far_outside = np.flatnonzero(deviation[:landed_at] >= LATER * NOISE)
        n_earlier = landed_at - 1 - int(far_outside[-1]) if far_outside.size else 0
        landed_at = min(landed_at + round(n_earlier / (LATER ** (1 / LANDS) - 1)), stick.start)
        self._kept = [rows(stretch, slice(landed_at, None))]
        landing = (float(stretch.time[landed_at]), float(stretch.x[landed_at])) if self.state == "slip" else UNSEEN
        (begin_s, from_x), self._break_away = self._break_away, UNSEEN
        (last_landing_s, last_landing_x), self._landing = self._landing, landing
        if math.isnan(begin_s) or math.isnan(landing[0]):
            return None
        slip_s, stick_s = landing[0] - begin_s, begin_s - last_landing_s
        # A spike of the readings looks like a slip, but then the mass has moved with the belt.
        slid = abs(landing[1] - from_x - belt_speed * slip_s)
        if slid <= STICK_SHARE * abs(belt_speed) * slip_s + NOISE * noise:  # it may creep
            self._landing = (last_landing_s, last_landing_x)
            return None
        if stick_s > 0:  # NaN if the landing before it was not seen
            self.cycles += 1
            self._speeds = [*self._speeds[1 - RECENT :], (from_x - last_landing_x) / stick_s]
            self.belt_speed = float(np.median(self._speeds))
        motion = rows(stretch, slice(0, landed_at + 1))
        return Slip(begin_s, landing[0], stick_s, from_x, float(np.ptp(motion.x)), motion)


def _deviation_from_stick(motion: LiveMotion, stick: slice, span: slice) -> Array:
    """Return how far positions are from the curve through a stick, in standard deviations of the prediction.

    The curve is a straight line, or a parabola if its curvature exceeds the noise: under a ramp law the mass creeps.
    """
    middle = motion.time[stick].mean()
    scale = max(float(np.ptp(motion.time[stick])), np.finfo(float).tiny)
    level = motion.x[stick][0]
    x = motion.x[stick] - level
    # Readings without noise are on the curve to within this.
    rounding = max(1e-12 * float(np.max(np.abs(motion.x))), np.finfo(float).tiny)
    for degree in (2, 1):
        in_stick, in_span = (np.vander((motion.time[part] - middle) / scale, degree + 1) for part in (stick, span))
        inverse = np.linalg.pinv(in_stick)
        coefficients = inverse @ x
        residual = x - in_stick @ coefficients
        sd = max(math.sqrt(float(residual @ residual) / max(1, residual.size - degree - 1)), rounding)
        if abs(coefficients[0]) > NOISE * sd * float(np.linalg.norm(inverse[0])):
            break
    predicted = sd * np.sqrt(1 + np.sum((in_span @ inverse) ** 2, axis=1))
    return np.asarray(np.abs(motion.x[span] - level - in_span @ coefficients) / predicted)


def find_usual_speed(time: Array, x: Array, span: int) -> float:
    """Return the velocity that occurs most often, NaN if none does, or rest does; ``time`` and ``x`` (n,).

    It is the middle of the interval, relatively the narrowest, that contains `BELT_SHARE` of the velocities over
    ``span`` samples; if because of noise or counts none of these is narrow enough, of twice as many, up to an eighth of
    the samples.
    """
    steps = np.abs(np.diff(x))
    count = float(np.min(steps, initial=np.inf, where=steps > 0))
    while span <= x.size / 8:
        smallest = count / float(time[span] - time[0])  # velocities are whole multiples of it
        v = np.sort((x[span:] - x[:-span]) / (time[span:] - time[:-span]))
        share = round(BELT_SHARE * v.size)
        low, high = v[: v.size - share], v[share:]
        middle = np.abs(low + high) / 2
        relative_width = np.full(middle.size, np.inf)  # an interval around rest is not narrow
        np.divide(high - low, middle, out=relative_width, where=low * high > 0)
        narrowest = int(np.argmin(relative_width))
        if relative_width[narrowest] <= BELT_SPREAD and smallest <= BELT_SPREAD * middle[narrowest]:
            return float(low[narrowest] + high[narrowest]) / 2
        span *= 2
    return math.nan
