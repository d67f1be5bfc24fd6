"""Sticks and slips while a recording runs: when the mass breaks away and lands, and the belt's speed, from the motion.

In a stick the mass moves near the belt's speed and hardly accelerates; under a ramp law it creeps, some per cent slower
as the load grows.  A slip begins where its velocity has left the belt's by half, and ends where the acceleration stays
small for `SETTLED` windows of the motion.  Break-away and landing are then read from the positions, by how they leave
the curve through the stick beside.  `process smooth` finds them by models of both kinds of motion.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from daq.live.motion import LiveMotion, MotionErrors
from stickslip.compute.arrays import Array, Mask, joined, rows

# Share of the belt's speed: farther from it the mass slips.  In every cycle of stick-slip it comes back, at more than
# 1.  Half takes noise, and the creep of a wide ramp, for slips; double misses the first slips of a record.
SLIP_SHARE = 0.5
# Share of the rms acceleration of slips: below it the mass sticks.  A mass that swings without sticking is below it
# for 4 % of half a period.  Half and twice change durations by 1 %.
STICK_SHARE = 0.1
NOISE = 4.0  # standard deviations: what is farther off is no noise; with half noise breaks sticks, double is 1 % late
# Windows of the motion at small acceleration after which a slip has ended.  Half sees sticks in the slips of a noisy
# record, double misses short sticks.
SETTLED = 1.5
BESIDE = 3.0  # windows of the motion from which the curve of a stick is drawn; half and twice agree to 2 % of a stick
# A slip leaves the stick as the square of time where friction drops at once, as its cube where it falls with speed, and
# lands as the square: when it is `LATER` times farther off tells when it did.  Half and twice agree to 1 % of a stick.
LATER, BREAKS, LANDS = 8.0, 2.5, 2.0
MOST_OF_SLIP = 1 << 16  # samples: a slip of more is no slip
FEWEST_RECENT = 1000  # readings from which the belt's speed is read before a stick has been seen, or 2 s of them
# The belt's speed before a stick has been seen: so many of the velocities lie within so much of it, relatively.  Of a
# mass that swings without sticking they are within 0.19 of its fastest; those of sticks for a third of the time that
# creep by 10 % are within 0.06.  Twice the share finds no sticks that last less than 0.4 of the time.
BELT_SHARE, BELT_SPREAD = 0.2, 0.15
NOWHERE = (math.nan, math.nan)  # time and position of what was not seen
RECENT = 5  # sticks over which the belt's speed is a median: half follows one odd stick, twice as many lag behind


@dataclass(frozen=True)
class Slip:
    """One slip between two sticks."""

    break_away: float  # their times, s
    landing: float
    stick_s: float  # duration of the stick before, NaN where its landing was not seen
    break_away_x: float  # position at the break-away, m or counts
    drop: float  # between the extremes of the positions from break-away to landing
    motion: LiveMotion  # from break-away to landing

    @property
    def slip_s(self) -> float:
        """Its duration."""
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

    def take(self, value: float) -> None:
        """Add a value."""
        self.n, self.last = self.n + 1, value
        off = value - self.mean
        self.mean += off / self.n
        self._squares += off * (value - self.mean)
        self.low, self.high = min(self.low, value), max(self.high, value)

    @property
    def sd(self) -> float:
        """Standard deviation, NaN of fewer than two."""
        return math.sqrt(self._squares / (self.n - 1)) if self.n > 1 else math.nan


class StickSlip:
    """Follow sticks and slips.

    state: "stick", "slip", or "" where neither is known.
    cycles: Sticks with the slip after them, both whole.
    belt_speed: The belt's speed, m/s or counts/s: the median of the mean velocities of the last `RECENT` sticks.  NaN
        before the first one.
    """

    def __init__(self) -> None:
        self.state = ""
        self.cycles = 0
        self.belt_speed = math.nan
        self._speeds: list[float] = []
        self._kept: list[LiveMotion] = []
        self._landing = self._break_away = NOWHERE
        self._still = self._between = 0  # samples at the belt's speed since the last slip, and others between them
        self._square, self._slipped = 0.0, 0  # mean square of the acceleration in slips, and of how many samples
        self._leaving = 0  # samples since the last one at the belt's speed

    def feed(self, motion: LiveMotion, belt_speed: float, window: int, errors: MotionErrors) -> list[Slip]:
        """Return the slips that have ended.

        motion: What came since the last call.
        belt_speed: The belt's speed as known so far.
        window: Samples of a parabola of the motion.
        errors: What the noise of the readings makes of the motion.
        """
        slips: list[Slip] = []
        slipping = np.abs(motion.v - belt_speed) > max(SLIP_SHARE * abs(belt_speed), NOISE * errors.v)
        with_belt = ~slipping & (np.abs(motion.a) <= self._small(motion, slipping, NOISE * errors.a))
        broken = motion.fresh | ~np.isfinite(motion.v)
        # 2: slips, 1: moves with the belt, 0: between them; -1: nothing is known.
        kind = np.where(broken, -1, np.where(slipping, 2, with_belt.astype(np.int8)))
        edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), kind.size]
        for first, stop in pairwise(edges):
            if first < stop:
                piece = rows(motion, slice(first, stop))
                slip = self._take(int(kind[first]), piece, window, belt_speed, errors.x)
                if slip is not None:
                    slips.append(slip)
        return slips

    def _small(self, motion: LiveMotion, slipping: Mask, noise: float) -> float:
        """Return the acceleration below which the mass sticks, and keep the mean square of that of slips."""
        a = motion.a[slipping & np.isfinite(motion.a)]
        if a.size:
            weight = a.size / (self._slipped + a.size)
            self._square += weight * (float(np.mean(a * a)) - self._square)
            self._slipped = min(self._slipped + a.size, MOST_OF_SLIP)
        usual = math.sqrt(self._square)
        return max(STICK_SHARE * usual, noise)

    def _take(self, kind: int, piece: LiveMotion, window: int, belt_speed: float, noise: float) -> Slip | None:
        if kind < 0:
            self._forget()
            return None
        self._kept.append(piece)
        n = piece.time.size
        self._settle(kind, n)
        self._leaving = 0 if kind == 1 else self._leaving + n
        if kind == 2:
            if self.state == "stick":
                self._broke_away(window)
            self.state = "slip"
            if sum(part.time.size for part in self._kept) > MOST_OF_SLIP:
                self._forget()
                self.state = "slip"
            return None
        if self.state == "stick":
            self._trim(round((BESIDE + 2) * window))
            return None
        if self._still < SETTLED * window:
            return None
        slip = self._landed(window, belt_speed, noise)
        self.state = "stick"
        self._trim(round((BESIDE + 2) * window))
        return slip

    def _settle(self, kind: int, n: int) -> None:
        """Count the samples at the belt's speed since the mass has been near it; noise may come between them."""
        if kind == 1:
            self._still += n
        elif self._still:
            self._between += n
        if kind == 2 or self._between > self._still / 2:
            self._still = self._between = 0

    def _forget(self) -> None:
        self.state, self._kept, self._still, self._between = "", [], 0, 0
        self._landing = self._break_away = NOWHERE

    def _trim(self, most: int) -> None:
        """Keep the last samples alone; a piece that begins before them stays whole."""
        total = sum(part.time.size for part in self._kept)
        while total - self._kept[0].time.size >= most:
            total -= self._kept.pop(0).time.size

    def _broke_away(self, window: int) -> None:
        """Place the break-away in what is kept, which ends in samples that do not move with the belt."""
        kept = joined(self._kept)
        last = max(3, kept.time.size - self._leaving - window // 2)
        beside = slice(max(0, last - round(BESIDE * window)), last)
        off = _about_stick(kept, beside, slice(beside.start, None))
        within = np.flatnonzero(off <= NOISE)
        on_it = int(within[-1]) if within.size else 0
        off_it = np.flatnonzero(off[on_it:] >= LATER * NOISE)
        later = int(off_it[0]) if off_it.size else 0
        at = beside.start + max(0, on_it - round(later / (LATER ** (1 / BREAKS) - 1)))
        self._break_away = float(kept.time[at]), float(kept.x[at])
        self._kept = [rows(kept, slice(at, None))]

    def _landed(self, window: int, belt_speed: float, noise: float) -> Slip | None:
        """Place the landing in what is kept, which ends in samples at the belt's speed."""
        kept = joined(self._kept)
        begin = kept.time.size - self._still - self._between
        beside = slice(min(begin + window // 2, kept.time.size - 4), None)
        off = _about_stick(kept, beside, slice(beside.start))
        off_it = np.flatnonzero(np.minimum(off[1:], off[:-1]) > NOISE)  # one alone may be noise
        at = int(off_it[-1]) + 2 if off_it.size else 0
        far = np.flatnonzero(off[:at] >= LATER * NOISE)
        earlier = at - 1 - int(far[-1]) if far.size else 0
        at = min(at + round(earlier / (LATER ** (1 / LANDS) - 1)), beside.start)
        self._kept = [rows(kept, slice(at, None))]
        landing = (float(kept.time[at]), float(kept.x[at])) if self.state == "slip" else NOWHERE
        (began, from_x), self._break_away = self._break_away, NOWHERE
        (before, where), self._landing = self._landing, landing
        if math.isnan(began) or math.isnan(landing[0]):
            return None
        slip_s, stick_s = landing[0] - began, began - before
        # A spike of the readings looks like a slip, but then the mass is where the belt has carried it.
        slid = abs(landing[1] - from_x - belt_speed * slip_s)
        if slid <= STICK_SHARE * abs(belt_speed) * slip_s + NOISE * noise:  # it creeps meanwhile
            self._landing = (before, where)
            return None
        if stick_s > 0:  # NaN where the landing before it was not seen
            self.cycles += 1
            self._speeds = [*self._speeds[1 - RECENT :], (from_x - where) / stick_s]
            self.belt_speed = float(np.median(self._speeds))
        motion = rows(kept, slice(0, at + 1))
        return Slip(began, landing[0], stick_s, from_x, float(np.ptp(motion.x)), motion)


def _about_stick(motion: LiveMotion, beside: slice, span: slice) -> Array:
    """Return how far positions are from the curve through those of a stick, in standard deviations of the prediction.

    The curve is a straight line; a parabola where its bend is beyond the noise: under a ramp law the mass creeps.
    """
    middle = motion.time[beside].mean()
    scale = max(float(np.ptp(motion.time[beside])), np.finfo(float).tiny)
    level = motion.x[beside][0]
    x = motion.x[beside] - level
    # Readings without noise lie on the curve to this.
    rounding = max(1e-12 * float(np.max(np.abs(motion.x))), np.finfo(float).tiny)
    for degree in (2, 1):
        inside, wanted = (np.vander((motion.time[which] - middle) / scale, degree + 1) for which in (beside, span))
        inverse = np.linalg.pinv(inside)
        coefficients = inverse @ x
        residual = x - inside @ coefficients
        sd = max(math.sqrt(float(residual @ residual) / max(1, residual.size - degree - 1)), rounding)
        if abs(coefficients[0]) > NOISE * sd * float(np.linalg.norm(inverse[0])):
            break
    predicted = sd * np.sqrt(1 + np.sum((wanted @ inverse) ** 2, axis=1))
    return np.asarray(np.abs(motion.x[span] - level - wanted @ coefficients) / predicted)


def usual_speed(time: Array, x: Array, span: int) -> float:
    """Return the velocity that occurs most often, NaN where none does, or rest does; ``time`` and ``x`` (n,).

    It is the middle of the interval, relatively the narrowest, that holds `BELT_SHARE` of the velocities over ``span``
    samples; where noise or counts leave none of these narrow enough, of twice as many, up to an eighth of the samples.
    """
    steps = np.abs(np.diff(x))
    count = float(np.min(steps, initial=np.inf, where=steps > 0))
    while span <= x.size / 8:
        least = count / float(time[span] - time[0])  # velocities are whole multiples of it
        v = np.sort((x[span:] - x[:-span]) / (time[span:] - time[:-span]))
        share = round(BELT_SHARE * v.size)
        low, high = v[: v.size - share], v[share:]
        middle = np.abs(low + high) / 2
        wide = np.full(middle.size, np.inf)  # an interval about rest is not narrow
        np.divide(high - low, middle, out=wide, where=low * high > 0)
        at = int(np.argmin(wide))
        if wide[at] <= BELT_SPREAD and least <= BELT_SPREAD * middle[at]:
            return float(low[at] + high[at]) / 2
        span *= 2
    return math.nan
