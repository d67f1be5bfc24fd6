"""The live analysis of a record while its samples arrive: motion, sticks and slips, belt, k/m, friction, cycles."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.live.friction import QuickFriction
from daq.live.motion import SHORTEST_PARABOLA, LiveFilter, LiveMotion, estimate_noise_density
from daq.live.overview import Overview
from daq.live.sticks import FEWEST_RECENT, NOISE, SLIP_SHARE, Slip, Spread, StickSlip, find_usual_speed
from daq.live.tail import NewSamples
from daq.runfile.rig import Rig
from stickslip.compute.arrays import Array, joined, rows

FEWEST_CYCLES = 4  # cycles that a fit needs: `fitting.judge.evidence`
FEW_CYCLES = 8  # cycles up to which every one must agree: `fitting.judge.screening`
# Time of the record between estimates, which take 1 % of a core.
ESTIMATE_EVERY_S = 2.0
MEMORY_S = 20.0  # span of motion from which the belt's speed is estimated before the first stick
MOST_RECENT = 20_000  # readings in this span
BELT_SPAN_S = 1.0  # span of the counts of the belt's encoder: 7.7 um counts then give the speed to 8 um/s
FEWEST_SLIPS = 2  # slips from which the window of the motion is chosen
USUAL_CYCLES = 9  # the last ones, for whose medians the window is chosen, so that four odd ones do not change it
MOST_BREAK_AWAYS = 4096  # stored: the last ones of a longer record


@dataclass(frozen=True)
class BeltSpeed:
    """The belt's speed, m/s or counts/s; NaN if unknown.

    ``source``: "encoder" (its own), "sticks" (mean velocity of the mass in the last ones), "motion" (the velocity that
        occurs most often), "calibration", or "".
    """

    value: float = math.nan
    source: str = ""


@dataclass(frozen=True)
class ForceBalance:
    """The force balance that converts motion into friction: F/m = a + k_over_m (x - x0) + c_over_m v."""

    k_over_m: float  # s^-2, m or counts, 1/s
    x0: float
    c_over_m: float
    mass: float  # kg; NaN if neither mass nor stiffness is known: then friction is per unit mass
    level_known: bool  # whether x0 is known; otherwise friction is shown up to a constant


class LiveAnalysis:
    """Analyse samples as they arrive.

    rate_hz: Nominal rate of the samples.
    window: Samples of a parabola to begin with.
    rig, unit: Calibration, and "m" or "count" of the positions; they may be set while samples arrive.
    belt: Current speed of the belt.
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
        self._spreads = {name: Spread() for name in ("stick_s", "slip_s", "drop", "break_away")}
        self._recent: deque[LiveMotion] = deque()
        self._belt_track: deque[tuple[float, float]] = deque()
        self._estimated_s, self._new = -math.inf, 0
        self._waiting: deque[NewSamples] = deque()  # until the belt's speed is known
        self._rate_hz = rate_hz
        self._density = 0.0
        self._cycles: deque[tuple[float, float, float]] = deque(maxlen=USUAL_CYCLES)  # duration, drop, stick before
        self._has_begun = False
        self._gap = False
        self._piece, self._returned_s = 0, -math.inf

    def feed(self, new: NewSamples) -> Array:
        """Return the motion at the times that a window now surrounds, as `motion_columns` does."""
        motion = self.filter.feed(new)
        if not self._has_begun:
            self._waiting.append(new)
        if new.belt is not None and new.time.size:
            self._track_belt(new)
        if not motion.time.size:
            return motion_columns(motion)
        self._recent.append(motion)
        while motion.time[-1] - self._recent[0].time[-1] > MEMORY_S:
            self._recent.popleft()
        while self._waiting and motion.time[-1] - self._waiting[0].time[-1] > MEMORY_S:
            self._waiting.popleft()
        self._new += motion.time.size
        if motion.time[-1] - self._estimated_s >= ESTIMATE_EVERY_S or (
            math.isnan(self.belt.value) and self._new >= FEWEST_RECENT
        ):
            self._estimated_s, self._new = float(motion.time[-1]), 0
            self._estimate()
        if not self._has_begun and math.isfinite(self.belt.value):
            motion = self._find_first_sticks()
        elif self._has_begun:
            self._follow(motion)
        # With a longer window, motion that has been returned is computed again.
        motion = rows(motion, motion.time > self._returned_s)
        rows_made = motion_columns(motion, self._piece)
        if motion.time.size:
            self._gap = not math.isfinite(motion.v[-1])
            self._returned_s, self._piece = float(motion.time[-1]), int(rows_made[4, -1])
        self.overview.add(rows_made)
        return rows_made

    def _find_first_sticks(self) -> LiveMotion:
        """Find sticks and slips from the first stored sample on, now that the belt's speed is known.

        Returned is their motion, computed again with a suitable window.
        """
        self._has_begun = True
        window = self.filter.find_quiet_window(joined(list(self._recent)), self._density, SLIP_SHARE / NOISE)
        self.filter = LiveFilter(self._rate_hz, window)
        motion = joined([self.filter.feed(piece) for piece in self._waiting])
        self._waiting.clear()
        self._follow(motion)
        return motion

    def _track_belt(self, new: NewSamples) -> None:
        if new.belt is None or new.fresh.any():
            self._belt_track.clear()
            return
        self._belt_track.append((float(new.time[-1]), float(new.belt[-1])))
        while self._belt_track[-1][0] - self._belt_track[0][0] > BELT_SPAN_S:
            self._belt_track.popleft()

    def _estimate(self) -> None:
        time, x = (np.concatenate([getattr(motion, name) for motion in self._recent]) for name in ("time", "x"))
        step = max(1, time.size // MOST_RECENT)
        time, x = time[::step], x[::step]
        too_few = time.size < FEWEST_RECENT and time[-1] - time[0] < ESTIMATE_EVERY_S
        if too_few or time.size < 2 * SHORTEST_PARABOLA:
            return
        self._density = estimate_noise_density(time, x)
        self.belt = self._estimate_belt_speed(find_usual_speed(time, x, self.filter.window // step))

    def _estimate_belt_speed(self, frequent_speed: float) -> BeltSpeed:
        if len(self._belt_track) > 1:
            (t0, x0), (t1, x1) = self._belt_track[0], self._belt_track[-1]
            if t1 > t0 and x1 != x0:
                return BeltSpeed((x1 - x0) / (t1 - t0), "encoder")
        sticks = self._sticks.belt_speed
        if math.isfinite(sticks) and not abs(frequent_speed - sticks) > SLIP_SHARE * abs(sticks):
            return BeltSpeed(sticks, "sticks")
        if math.isfinite(frequent_speed):
            return BeltSpeed(frequent_speed, "motion")
        if math.isfinite(self._calibrated):
            return BeltSpeed(self._calibrated, "calibration")
        return self.belt

    def _follow(self, motion: LiveMotion) -> None:
        errors = self.filter.estimate_errors(self._density)
        for slip in self._sticks.feed(motion, self.belt.value, self.filter.window, errors):
            self._add_slip(slip)

    def _add_slip(self, slip: Slip) -> None:
        forward = math.copysign(1.0, self.belt.value)
        if slip.stick_s > 0:
            self._spreads["stick_s"].add(slip.stick_s)
        self._spreads["slip_s"].add(slip.slip_s)
        self._spreads["drop"].add(slip.drop)
        self._spreads["break_away"].add(forward * slip.break_away_x)
        self.break_aways.append((slip.break_away, slip.break_away_x, slip.landing))
        self._friction.add(slip, self.belt.value, self.filter.half_s)
        if slip.stick_s > 0:
            self._cycles.append((slip.slip_s, slip.drop, slip.stick_s))
        if len(self._cycles) >= FEWEST_SLIPS:
            self.filter.fit_window_to_slips(self._density, *np.median(self._cycles, axis=0).tolist())

    @property
    def cycles(self) -> int:
        """Whole sticks with the slips after them."""
        return self._sticks.cycles

    @property
    def slips(self) -> int:
        """Slips between two sticks."""
        return self._spreads["slip_s"].n

    @property
    def state(self) -> str:
        """The state of the mass: "stick", "slip", "gap", or "moving" if the belt's speed is unknown."""
        if self._gap:
            return "gap"
        return self._sticks.state or "moving"

    @property
    def _calibrated(self) -> float:
        """The belt's speed of the calibration, in the unit of the positions; NaN without one."""
        return self.rig.belt_speed.value if self.rig.belt_speed is not None and self.unit == "m" else math.nan

    def estimate_balance(self) -> ForceBalance:
        """Return the force balance by the calibration and the slips."""
        fitted, _ = self._friction.estimate_k_over_m()
        rig = self.rig
        if self.unit != "m":
            return ForceBalance(fitted, 0.0, 0.0, math.nan, False)
        mass, stiffness = (math.nan if quantity is None else quantity.value for quantity in (rig.mass, rig.stiffness))
        calibrated = stiffness / mass
        k_over_m = calibrated if math.isfinite(calibrated) else fitted
        mass = mass if math.isfinite(mass) else stiffness / k_over_m
        c_over_m = rig.damping.value / mass if rig.damping is not None and math.isfinite(mass) else 0.0
        x0 = 0.0 if rig.x0 is None else rig.x0.value
        return ForceBalance(k_over_m, x0, c_over_m, mass, rig.datum is not None or rig.x0 is not None)

    def summarise(self) -> dict[str, Any]:
        """Return the results so far as a JSON document."""
        balance = self.estimate_balance()
        k_over_m, error = self._friction.estimate_k_over_m()
        return {
            "cycles": self.cycles,
            "enough": self.cycles >= FEWEST_CYCLES,
            "advice": advise(self.cycles),
            "belt": {
                "value": round_for_json(self.belt.value),
                "source": self.belt.source,
                "calibrated": round_for_json(self._calibrated),
            },
            "k_over_m": {"value": round_for_json(k_over_m), "stderr": round_for_json(error)},
            "balance": {name: round_for_json(value) for name, value in vars(balance).items()},
            "statistics": self._summarise_spreads(balance),
            "friction": self._build_curve(balance),
            "half_s": round_for_json(self.filter.half_s),
        }

    def _summarise_spreads(self, balance: ForceBalance) -> dict[str, dict[str, float | int | None]]:
        offset = {"break_away": math.copysign(1.0, self.belt.value) * balance.x0}
        statistics: dict[str, dict[str, float | int | None]] = {}
        for name, spread in self._spreads.items():
            shift = offset.get(name, 0.0)
            values = {"last": spread.last, "mean": spread.mean, "min": spread.low, "max": spread.high}
            statistics[name] = {
                key: round_for_json(value - shift) if spread.n else None for key, value in values.items()
            }
            statistics[name] |= {"n": spread.n, "sd": round_for_json(spread.sd)}
        return statistics

    def _build_curve(self, balance: ForceBalance) -> dict[str, Any] | None:
        curve = self._friction.estimate_curve(balance.k_over_m, balance.x0, balance.c_over_m, self.belt.value)
        if curve is None:
            return None
        mass = balance.mass if math.isfinite(balance.mass) else 1.0
        forward = math.copysign(1.0, self.belt.value)
        break_away = self._spreads["break_away"]
        load = balance.k_over_m * (forward * break_away.mean - balance.x0) + balance.c_over_m * self.belt.value
        return {
            "speed": [round_for_json(speed) for speed in curve.speed.tolist()],
            "F": [round_for_json(forward * mass * value) for value in curve.friction.tolist()],
            "sd": [round_for_json(mass * value) for value in curve.sd.tolist()],
            "slips": curve.slips,
            "break_away": round_for_json(forward * mass * load),
            "break_away_sd": round_for_json(mass * balance.k_over_m * break_away.sd),
        }


def motion_columns(motion: LiveMotion, piece: int = 0) -> Array:
    """Return time, x, v, a, and the number of the piece without holes, counted from ``piece`` on, (5, k)."""
    return np.array([motion.time, motion.x, motion.v, motion.a, piece + np.cumsum(motion.fresh)])


def advise(cycles: int) -> str:
    """Return as text whether so many cycles are enough for a verdict, and the effect of more of them."""
    if cycles < FEWEST_CYCLES:
        return f"a verdict needs at least {FEWEST_CYCLES} complete cycles"
    more = f"{4 * cycles} cycles would halve the standard errors"
    if cycles < FEW_CYCLES:
        return f"enough for a verdict, but a single bad cycle could change it; {more}"
    return f"enough for a verdict; {more}"


def round_for_json(value: float) -> float | None:
    """Return a number of seven digits for JSON; None if it is unknown."""
    return float(f"{value:.7g}") if math.isfinite(value) else None
