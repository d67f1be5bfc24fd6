"""What the live view says of a record while its samples come: motion, sticks and slips, belt, k/m, friction, cycles."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.live.friction import QuickFriction
from daq.live.motion import SHORTEST_PARABOLA, LiveFilter, LiveMotion, noise_density
from daq.live.overview import Overview
from daq.live.sticks import FEWEST_RECENT, NOISE, SLIP_SHARE, Slip, Spread, StickSlip, usual_speed
from daq.live.tail import NewSamples
from daq.runfile.rig import Rig
from stickslip.compute.arrays import Array, joined, rows

FEWEST_CYCLES = 4  # cycles that a fit takes: `fitting.selection.evidence`
FEW_CYCLES = 8  # cycles so few that every one must agree: `fitting.selection.screening`
# Time of the record between estimates: half takes 1 % of a core more, double shows a new belt speed as much later.
ESTIMATE_EVERY_S = 2.0
MEMORY_S = 20.0  # span of motion from which the belt's speed is read before a stick has been seen
MOST_RECENT = 20_000  # readings of these
BELT_SPAN_S = 1.0  # span of the counts of the belt's own encoder: 7.7 um counts then read to 8 um/s
FEWEST_SLIPS = 2  # from which the window of the motion is chosen
USUAL_CYCLES = 9  # the last ones, whose medians the window suits: half follow two odd ones, twice as many lag behind
MOST_BREAK_AWAYS = 4096  # remembered; of a longer record the last ones


@dataclass(frozen=True)
class BeltSpeed:
    """The belt's speed, m/s or counts/s; NaN while it is not known.

    ``source``: "encoder" (its own), "sticks" (mean velocity of the mass in the last ones), "motion" (the velocity that
    occurs most often), "calibration", or "".
    """

    value: float = math.nan
    source: str = ""


@dataclass(frozen=True)
class ForceBalance:
    """What turns motion into friction: F/m = a + k_over_m (x - x0) + c_over_m v."""

    k_over_m: float  # s^-2, m or counts, 1/s
    x0: float
    c_over_m: float
    mass: float  # kg; NaN where neither mass nor stiffness is known: then friction is per unit mass
    level_known: bool  # whether x0 is known; where it is not, friction is shown up to a constant


class LiveAnalysis:
    """Take samples as they come, and say what is known so far.

    rate_hz: Nominal rate of the samples.
    window: Samples of a parabola to begin with.
    rig, unit: Calibration, and "m" or "count" of the positions; they may be set while samples come.
    belt: Of the belt, now.
    overview: Rows of the whole record as `feed` returns them, thinned.
    break_aways: Time, s, and position of the last `MOST_BREAK_AWAYS` ones, and time of the landing after each.
    """

    def __init__(self, rate_hz: float, window: int | None = None) -> None:
        self.rig, self.unit = Rig(), "count"
        self.filter = LiveFilter(rate_hz, window)
        self.belt = BeltSpeed()
        self.overview = Overview(5)
        self.break_aways: deque[tuple[float, float, float]] = deque(maxlen=MOST_BREAK_AWAYS)
        self._sticks = StickSlip()
        self._friction = QuickFriction()
        self._of = {name: Spread() for name in ("stick_s", "slip_s", "drop", "break_away")}
        self._recent: deque[LiveMotion] = deque()
        self._belt_track: deque[tuple[float, float]] = deque()
        self._estimated, self._new = -math.inf, 0
        self._waiting: deque[NewSamples] = deque()  # until the belt's speed is known
        self._rate_hz = rate_hz
        self._density = 0.0
        self._cycles: deque[tuple[float, float, float]] = deque(maxlen=USUAL_CYCLES)  # duration, drop, stick before
        self._began = False
        self._gap = False
        self._piece, self._told = 0, -math.inf

    def feed(self, new: NewSamples) -> Array:
        """Take samples; return the motion at the times that a window now surrounds, as `columns` does."""
        motion = self.filter.feed(new)
        if not self._began:
            self._waiting.append(new)
        if new.belt is not None and new.time.size:
            self._belt_moved(new)
        if not motion.time.size:
            return columns(motion)
        self._recent.append(motion)
        while motion.time[-1] - self._recent[0].time[-1] > MEMORY_S:
            self._recent.popleft()
        while self._waiting and motion.time[-1] - self._waiting[0].time[-1] > MEMORY_S:
            self._waiting.popleft()
        self._new += motion.time.size
        if motion.time[-1] - self._estimated >= ESTIMATE_EVERY_S or (
            math.isnan(self.belt.value) and self._new >= FEWEST_RECENT
        ):
            self._estimated, self._new = float(motion.time[-1]), 0
            self._estimate()
        if not self._began and math.isfinite(self.belt.value):
            motion = self._begin()
        elif self._began:
            self._follow(motion)
        # With a longer window, motion that has been returned is made once more.
        motion = rows(motion, motion.time > self._told)
        made = columns(motion, self._piece)
        if motion.time.size:
            self._gap = not math.isfinite(motion.v[-1])
            self._told, self._piece = float(motion.time[-1]), int(made[4, -1])
        self.overview.take(made)
        return made

    def _begin(self) -> LiveMotion:
        """Look for sticks and slips from the first sample on that is remembered, now that the belt's speed is known.

        Returned is their motion, made anew with a window that suits.
        """
        self._began = True
        window = self.filter.quiet_window(joined(list(self._recent)), self._density, SLIP_SHARE / NOISE)
        self.filter = LiveFilter(self._rate_hz, window)
        anew = joined([self.filter.feed(piece) for piece in self._waiting])
        self._waiting.clear()
        self._follow(anew)
        return anew

    def _belt_moved(self, new: NewSamples) -> None:
        if new.belt is None or new.fresh.any():
            self._belt_track.clear()
            return
        self._belt_track.append((float(new.time[-1]), float(new.belt[-1])))
        while self._belt_track[-1][0] - self._belt_track[0][0] > BELT_SPAN_S:
            self._belt_track.popleft()

    def _estimate(self) -> None:
        time, x = (np.concatenate([getattr(part, name) for part in self._recent]) for name in ("time", "x"))
        step = max(1, time.size // MOST_RECENT)
        time, x = time[::step], x[::step]
        few = time.size < FEWEST_RECENT and time[-1] - time[0] < ESTIMATE_EVERY_S
        if few or time.size < 2 * SHORTEST_PARABOLA:
            return
        self._density = noise_density(time, x)
        self.belt = self._belt_speed(usual_speed(time, x, self.filter.window // step))

    def _belt_speed(self, usual: float) -> BeltSpeed:
        if len(self._belt_track) > 1:
            (t0, x0), (t1, x1) = self._belt_track[0], self._belt_track[-1]
            if t1 > t0 and x1 != x0:
                return BeltSpeed((x1 - x0) / (t1 - t0), "encoder")
        sticks = self._sticks.belt_speed
        if math.isfinite(sticks) and not abs(usual - sticks) > SLIP_SHARE * abs(sticks):
            return BeltSpeed(sticks, "sticks")
        if math.isfinite(usual):
            return BeltSpeed(usual, "motion")
        if math.isfinite(self._calibrated):
            return BeltSpeed(self._calibrated, "calibration")
        return self.belt

    def _follow(self, motion: LiveMotion) -> None:
        errors = self.filter.errors(self._density)
        for slip in self._sticks.feed(motion, self.belt.value, self.filter.window, errors):
            self._slipped(slip)

    def _slipped(self, slip: Slip) -> None:
        forward = math.copysign(1.0, self.belt.value)
        if slip.stick_s > 0:
            self._of["stick_s"].take(slip.stick_s)
        self._of["slip_s"].take(slip.slip_s)
        self._of["drop"].take(slip.drop)
        self._of["break_away"].take(forward * slip.break_away_x)
        self.break_aways.append((slip.break_away, slip.break_away_x, slip.landing))
        self._friction.take(slip, self.belt.value, self.filter.half_s)
        if slip.stick_s > 0:
            self._cycles.append((slip.slip_s, slip.drop, slip.stick_s))
        if len(self._cycles) >= FEWEST_SLIPS:
            self.filter.suit_slips(self._density, *np.median(self._cycles, axis=0).tolist())

    @property
    def cycles(self) -> int:
        """Whole sticks with the slips after them."""
        return self._sticks.cycles

    @property
    def slips(self) -> int:
        """Slips between two sticks."""
        return self._of["slip_s"].n

    @property
    def state(self) -> str:
        """What the mass does: "stick", "slip", "gap", or "moving" where the belt's speed is not known."""
        if self._gap:
            return "gap"
        return self._sticks.state or "moving"

    @property
    def _calibrated(self) -> float:
        """The belt's speed of the calibration, in the unit of the positions; NaN without one."""
        return self.rig.belt_speed.value if self.rig.belt_speed is not None and self.unit == "m" else math.nan

    def balance(self) -> ForceBalance:
        """Return what turns the motion into friction, with what the calibration and the slips tell."""
        found, _ = self._friction.k_over_m()
        rig = self.rig
        if self.unit != "m":
            return ForceBalance(found, 0.0, 0.0, math.nan, False)
        mass, stiffness = (math.nan if of is None else of.value for of in (rig.mass, rig.stiffness))
        known = stiffness / mass
        k_over_m = known if math.isfinite(known) else found
        mass = mass if math.isfinite(mass) else stiffness / k_over_m
        c_over_m = rig.damping.value / mass if rig.damping is not None and math.isfinite(mass) else 0.0
        x0 = 0.0 if rig.x0 is None else rig.x0.value
        return ForceBalance(k_over_m, x0, c_over_m, mass, rig.datum is not None or rig.x0 is not None)

    def summary(self) -> dict[str, Any]:
        """Return what is known so far as a JSON document."""
        balance = self.balance()
        k_over_m, error = self._friction.k_over_m()
        return {
            "cycles": self.cycles,
            "enough": self.cycles >= FEWEST_CYCLES,
            "advice": advice(self.cycles),
            "belt": {
                "value": number(self.belt.value),
                "source": self.belt.source,
                "calibrated": number(self._calibrated),
            },
            "k_over_m": {"value": number(k_over_m), "stderr": number(error)},
            "balance": {name: number(value) for name, value in vars(balance).items()},
            "statistics": self._statistics(balance),
            "friction": self._friction_curve(balance),
            "half_s": number(self.filter.half_s),
        }

    def _statistics(self, balance: ForceBalance) -> dict[str, dict[str, float | int | None]]:
        offset = {"break_away": math.copysign(1.0, self.belt.value) * balance.x0}
        statistics: dict[str, dict[str, float | int | None]] = {}
        for name, of in self._of.items():
            less = offset.get(name, 0.0)
            values = {"last": of.last, "mean": of.mean, "min": of.low, "max": of.high}
            statistics[name] = {key: number(value - less) if of.n else None for key, value in values.items()}
            statistics[name] |= {"n": of.n, "sd": number(of.sd)}
        return statistics

    def _friction_curve(self, balance: ForceBalance) -> dict[str, Any] | None:
        curve = self._friction.curve(balance.k_over_m, balance.x0, balance.c_over_m, self.belt.value)
        if curve is None:
            return None
        mass = balance.mass if math.isfinite(balance.mass) else 1.0
        forward = math.copysign(1.0, self.belt.value)
        break_away = self._of["break_away"]
        load = balance.k_over_m * (forward * break_away.mean - balance.x0) + balance.c_over_m * self.belt.value
        return {
            "w": [number(-forward * speed) for speed in curve.speed.tolist()],
            "F": [number(mass * value) for value in curve.friction.tolist()],
            "sd": [number(mass * value) for value in curve.sd.tolist()],
            "slips": curve.slips,
            "break_away": number(mass * load),
            "break_away_sd": number(mass * balance.k_over_m * break_away.sd),
        }


def columns(motion: LiveMotion, piece: int = 0) -> Array:
    """Return time, x, v, a, and the number of the piece without holes, counted from ``piece`` on, (5, k)."""
    return np.array([motion.time, motion.x, motion.v, motion.a, piece + np.cumsum(motion.fresh)])


def advice(cycles: int) -> str:
    """Return in words whether so many cycles are enough for a verdict, and what more of them bring."""
    if cycles < FEWEST_CYCLES:
        return f"a verdict needs {FEWEST_CYCLES} whole cycles at least"
    more = f"{4 * cycles} cycles would halve the standard errors"
    if cycles < FEW_CYCLES:
        return f"enough for a verdict, but one disturbed cycle may decide it; {more}"
    return f"enough for a verdict; {more}"


def number(value: float) -> float | None:
    """Return a number of seven digits for JSON; None where it is not known."""
    return float(f"{value:.7g}") if math.isfinite(value) else None
