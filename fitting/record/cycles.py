r"""Division of a record into cycles: window A from break-away to mid-stick, window B from there to the next break-away.

::

    v  ____                ________________            belt speed
           \              /        |       \
            \            /         |        \
             \__________/          |         \___
          |<------- A ------------>|<-- B -->|  |<-- A of the next cycle

The break-away is random and in no window: window B ends a tenth of a slip before it, and window A starts when the mass
is slower than the belt by a twentieth of its speed.  A *cycle* is a break-away with the window B before it and the
window A after it.  Both have the same kinetic level, because the level is new after each landing.

Only the velocity is used, even if the smoother has fitted corners (`Kinematics.corners`): methods without corners, and
a mass that only grazes the belt (laws 1 and 2), have nothing else.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting import noise_levels
from fitting.record.motion import REST_SPEED, SHORTEST_PHASE, SLIP_SPEED, MeasuredMotion
from stickslip.compute.arrays import Array, Mask, runs

# Times below are in slips (`MeasuredMotion.slip_s`).
BEFORE_BREAK_AWAY = 0.1  # omitted before a break-away, where the smoothed corner of camera tracks is random
LEFT_BELT_BY = 0.05  # speed below the belt's, over it, at which a slip's window begins
OVERTAKES_BY = 0.02  # speed above the plateau, over the belt's, at which the mass overtakes it
LONGEST_TURN = 1.0  # time at rest, above which the belt stands; a sliding mass is at rest only while it turns
ROUNDING = 1e-3  # rounding of times over the usual interval: 1e-6 after a week at 10 kHz
FEWEST_AT_REST = 8  # samples needed to fit a line that detects rest
WIDEST_SLACK = 0.25  # error of that line's slope, over the belt's speed, above which rest cannot be detected
SCATTER_AT_REST = 2.0  # scatter about that line over the noise, above which the mass moves
SUSTAINED_SHARE = 0.15  # share of the record in sticks, below which the mass only grazes the belt
SLIP_DECELERATION = 4.0  # over `STILL_ACCELERATION`, above which a drag is a slip: dragged on a ramp 3, in a slip 5
MOST_CYCLES = 200  # cycles fitted; with as many the errors of calibrations are usually larger than those of the fit
STILL_ACCELERATION = 0.05  # acceleration over a slip's, below which the mass sticks or crosses the top of a sine


@dataclass(frozen=True)
class Cycle:
    """One break-away and its windows; sample ranges are half open, and empty where a window is missing."""

    number: int  # 1, 2, 3 ... in order of time.
    break_away: float  # break-away and return to the belt, s, of the smoothed motion
    landing: float
    stick: tuple[int, int]  # (first, end) samples of window B (before the break-away) and window A (after it)
    slip: tuple[int, int]
    overtakes: bool = False  # the belt after landing, with more load than friction holds
    flag: str = ""  # why it is not used: "gap", "rest" (the belt stood), "excluded", "short", "surplus"; or ""


@dataclass(frozen=True)
class CycleSegmentation:
    cycles: tuple[Cycle, ...]  # in order of time, used or not
    plateau_fraction: float  # share of the record spent in stick, without the drag of the start-up and rests
    starts_at_rest: bool  # whether the record begins before the belt does
    drag: tuple[int, int]  # (first, end) samples of the start-up drag; empty when the record does not begin at rest

    @property
    def sustained(self) -> bool:
        return self.plateau_fraction >= SUSTAINED_SHARE

    @property
    def shows_belt(self) -> bool:
        """Whether the mass moves with the belt at any time: in sticks, or in the start-up drag."""
        return self.sustained or (self.uses_start and self.drag != (0, 0))

    @property
    def used(self) -> tuple[Cycle, ...]:
        return tuple(cycle for cycle in self.cycles if not cycle.flag)

    @property
    def surplus(self) -> int:
        return sum(cycle.flag == "surplus" for cycle in self.cycles)

    @property
    def uses_start(self) -> bool:
        """Whether the record begins at rest and its first cycle, which includes the drag, is used."""
        return self.starts_at_rest and bool(self.cycles) and not self.cycles[0].flag


def segment_cycles(motion: MeasuredMotion, excluded: frozenset[int] = frozenset()) -> CycleSegmentation:
    """Divide a record into cycles; none if the mass is never slower than half the belt's speed."""
    time, v, a = motion.time, motion.velocity, motion.acceleration
    n = time.size
    shortest = max(3, round(SHORTEST_PHASE * motion.slip_s / float(np.median(np.diff(time)))))
    slips = [(i, j) for i, j in runs(v < SLIP_SPEED * motion.belt_speed) if j - i >= shortest]
    if not slips:
        return CycleSegmentation((), 0.0, False, (0, 0))
    at_rest = np.abs(v) < REST_SPEED * motion.belt_speed
    starts_at_rest = slips[0][0] == 0 and (bool(at_rest[: min(shortest, n)].all()) or _rests(motion, slips[0][1]))
    rests = [(i, j) for i, j in runs(at_rest) if time[j - 1] - time[i] > LONGEST_TURN * motion.slip_s]
    slipping = np.zeros(n, np.bool_)
    for stretch in slips:
        slipping[slice(*stretch)] = True
    for stretch in rests:
        slipping[slice(*stretch)] = False
    strongest = float(np.percentile(np.abs(a[slipping]), 95)) if slipping.any() else 0.0
    threshold = STILL_ACCELERATION * strongest

    begins, ends = zip(*slips, strict=True)
    onsets, landings = _onsets(a, begins, threshold), _landings(a, ends, threshold)
    if starts_at_rest and len(slips) > 1:
        onsets[1:2] = _onsets(
            a, begins[1:2], threshold + _creep_deceleration(motion, landings[0], begins[1], threshold)
        )
    resting = _overlap(onsets, landings, rests)
    sticks = list(zip(landings, [*onsets[1:], n], strict=True))
    middles = [(i + j) // 2 for i, j in sticks]

    cycles: list[Cycle] = []
    drag = (0, 0)
    for k, (begin, end) in enumerate(slips):
        if k == 0 and begin == 0:
            continue  # the start-up, or a slip whose beginning was not recorded
        onset = onsets[k]
        last = _sample_from(motion, time[onset] - BEFORE_BREAK_AWAY * motion.slip_s)
        if k == 0:
            first = _find_calm(motion, onset, threshold)
        elif k == 1 and starts_at_rest:
            settle = max(SHORTEST_PHASE * motion.slip_s, motion.half_window)
            first = _sample_from(motion, time[min(landings[0], n - 1)] + settle)
        else:
            first = _find_stick(motion, middles[k - 1], last)
        stick = (first, last) if last - first >= shortest else (onset, onset)
        if motion.broken[stick[0] + 1 : stick[1]].any():
            stick = (onset, onset)
        if k == 1 and starts_at_rest and stick[1] > stick[0]:
            drag = stick
        slip_begin = onset + int(np.argmax(v[onset : begin + 1] < v[onset] - LEFT_BELT_BY * motion.belt_speed))
        slip = (slip_begin, min(middles[k], n))
        if end >= n or landings[k] >= n:
            continue  # the record ends inside this slip
        flag = ""
        if motion.broken[slip[0] + 1 : slip[1]].any():
            flag = "gap"
        elif resting[k]:
            flag = "rest"
        elif slip[1] - slip[0] < 2 * shortest:
            flag = "short"
        number = len(cycles) + 1
        if number in excluded:
            flag = "excluded"
        overtakes = _overtakes(motion, landings[k], sticks[k][1])
        cycles.append(Cycle(number, float(time[onset]), float(time[landings[k]]), stick, slip, overtakes, flag))

    stuck = sum(
        float(time[min(j, n - 1)] - time[min(i, n - 1)])
        for k, (i, j) in enumerate(sticks)
        if not (k == 0 and starts_at_rest)
    )
    first = min(sticks[0][1], n - 1) if starts_at_rest else 0
    span = float(time[-1] - time[first] - sum(time[j - 1] - time[i] for i, j in rests if i >= first))
    return CycleSegmentation(_flag_surplus(cycles), stuck / span if span > 0 else 0.0, starts_at_rest, drag)


def _flag_surplus(cycles: Sequence[Cycle]) -> tuple[Cycle, ...]:
    used = [k for k, cycle in enumerate(cycles) if not cycle.flag]
    chosen = {used[k] for k in np.linspace(0, len(used) - 1, min(MOST_CYCLES, len(used))).round().astype(int)}
    return tuple(
        cycle if cycle.flag or k in chosen else replace(cycle, flag="surplus") for k, cycle in enumerate(cycles)
    )


def _sample_from(motion: MeasuredMotion, time: float) -> int:
    """Return the first sample at or after a time (s), less `ROUNDING`."""
    return int(np.searchsorted(motion.time, time - ROUNDING * motion.span / motion.time.size))


def _rests(motion: MeasuredMotion, end: int) -> bool:
    """Return whether a line through the first positions, up to sample ``end`` at most, is flat within its error."""
    last = min(_sample_from(motion, motion.time[0] + 0.5 * LONGEST_TURN * motion.slip_s), end)
    if last < FEWEST_AT_REST:
        return False
    t, x = motion.time[:last] - motion.time[:last].mean(), motion.measured[:last]
    spread = float(np.sum(t**2))
    slope = float(np.sum(t * (x - x.mean()))) / spread
    slack = max(REST_SPEED * motion.belt_speed, noise_levels.SHOWN * motion.resolution / math.sqrt(spread))
    flat = abs(slope) < slack < WIDEST_SLACK * motion.belt_speed
    return flat and float(np.std(x)) < SCATTER_AT_REST * motion.resolution


def _find_calm(motion: MeasuredMotion, onset: int, threshold: float) -> int:
    """Return the first sample of the initial stick, after a start-up too short to be a slip."""
    restless = np.flatnonzero(np.abs(motion.acceleration[:onset]) > threshold)
    if not restless.size:
        return 0
    return _sample_from(motion, motion.time[restless[-1]] + motion.half_window)


def _find_stick(motion: MeasuredMotion, middle: int, last: int) -> int:
    """Return the first stick sample from ``middle`` on: a long overtaking may last past the middle."""
    v = motion.velocity[middle:last]
    if v.size < 4:
        return middle
    fast_samples = np.flatnonzero(v - np.median(v[v.size // 2 :]) > OVERTAKES_BY * motion.belt_speed)
    if not fast_samples.size:
        return middle
    return _sample_from(motion, motion.time[middle + fast_samples[-1]] + motion.half_window)


def _overtakes(motion: MeasuredMotion, landing: int, end: int) -> bool:
    """Return whether the velocity after the landing peaks above the plateau by more than smoothing explains."""
    begin = _sample_from(motion, motion.time[landing] + 2 * motion.half_window)
    settled_velocity = motion.velocity[(begin + end) // 2 : end]
    if settled_velocity.size < 3 or begin >= end:
        return False
    peak = float(motion.velocity[begin : (begin + end) // 2].max(initial=-np.inf))
    return peak - float(np.median(settled_velocity)) > OVERTAKES_BY * motion.belt_speed


def _creep_deceleration(motion: MeasuredMotion, landing: int, begin: int, threshold: float) -> float:
    """Return the deceleration, m/s^2, while the belt drags the mass from rest to ``begin``; 0 where it is a slip's."""
    first = _sample_from(motion, motion.time[landing] + max(SHORTEST_PHASE * motion.slip_s, motion.half_window))
    decelerations = motion.acceleration[first : (first + begin) // 2]
    slowing = -float(np.median(decelerations)) if decelerations.size else 0.0
    return slowing if threshold < slowing < SLIP_DECELERATION * threshold else 0.0


def _onsets(a: Array, begins: Sequence[int], threshold: float) -> list[int]:
    """Return the last samples before ``begins`` without deceleration, or 0."""
    steady_samples = np.concatenate(([0], np.flatnonzero(a > -threshold)))
    return [int(i) for i in steady_samples[np.searchsorted(steady_samples, begins, side="right") - 1]]


def _landings(a: Array, ends: Sequence[int], threshold: float) -> list[int]:
    """Return the first samples from ``ends`` on without acceleration, or the record's length."""
    steady_samples = np.append(np.flatnonzero(a < threshold), a.size)
    return [int(i) for i in steady_samples[np.searchsorted(steady_samples, ends)]]


def _overlap(begins: Sequence[int], ends: Sequence[int], rests: Sequence[tuple[int, int]]) -> Mask:
    """Return whether each stretch shares samples with a rest; rests are in order."""
    first, last = np.array(rests, np.int64).reshape(-1, 2).T
    return np.asarray(np.searchsorted(first, ends) > np.searchsorted(last, begins, side="right"))
