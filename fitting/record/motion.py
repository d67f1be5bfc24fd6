"""The measured motion in the fit's frame; belt speed, compliance and slip duration from the record.

Frame: metres, seconds from the record's first sample, a belt that runs towards +x.  A record of a backward belt is
mirrored; the physics is odd, so the same fit applies.  Samples that smoothing excluded as faults of the sensor are
omitted, and steps of the position that it found are removed.

Belt line.  A belt that slows in proportion to its load loses ``compliance`` metres a second per metre of spring
extension.  In stick the load is the spring force, so the belt's velocity against the mass's position is a line of slope
-compliance, independent of the friction law; the fit uses it as a prior.  Its error is the larger of two: for residuals
correlated within a smoothing window, and within a stick.  Not modelled: a compliance that is not proportional to the
load, or lags it.

Slip duration.  For most of a slip the mass is slower than half the belt's speed.  The slip is longer by the time that a
harmonic motion of the same height takes between that speed and the belt's.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.runfile.rig import Rig
from fitting import noise_levels
from fitting.least_squares.elimination import least_squares
from processing.record.kinematics import Kinematics
from processing.record.noise import smallest_step
from processing.record.setting import is_possible_speed
from stickslip.compute.arrays import HOLE, Array, pieces, runs
from stickslip.errors import DataError, InputError
from stickslip.units import Measured

# Standard deviation of an unknown rest position over the travel, about where friction is nowhere negative: with 3,
# which allows any fall of friction, the width of a ramp that a record determines to a tenth is unconstrained.
REST_SD = 0.5
LEAST_VARIATION = 2e-3  # residual variation, over the belt's speed, that gives a warning
VARIATION_SHOWN = 2.0  # residual variation over that from counting alone, below which there is none


@dataclass(frozen=True)
class BeltLine:
    """The belt's velocity against the mass's position in stick, with the record's signs."""

    speed: Measured  # m/s, signed, at ``middle``: errors of speed and slope are then independent
    slope: Measured  # d(velocity)/d(position), 1/s; -compliance
    middle: float  # m, the mean position of the samples
    speed_variation: float  # m/s, rms residual of the line, less the noise of counting

    @property
    def slows_under_load(self) -> bool:
        return -self.slope.value > noise_levels.SHOWN * self.slope.sd

    @property
    def is_unsteady(self) -> bool:
        return self.speed_variation > LEAST_VARIATION * abs(self.speed.value)

    def speed_without_load(self, rest: Measured) -> Measured:
        """Return the belt's speed where the spring is relaxed (``rest``, m)."""
        reach = rest.value - self.middle
        value = self.speed.value + self.slope.value * reach
        return Measured(value, math.hypot(self.speed.sd, math.hypot(self.slope.sd * reach, self.slope.value * rest.sd)))


def fit_belt_line(kinematics: Kinematics) -> BeltLine | None:
    """Fit the belt's line; None where the belt was not counted or no stick is long enough."""
    velocity, errors = kinematics.belt_velocity, kinematics.belt_velocity_errors
    if velocity is None or errors is None:
        return None
    half = kinematics.window // 2
    sticks = [np.arange(stick.first + half, stick.last + 1 - half) for stick in kinematics.sticks]
    sticks = [samples for samples in sticks if samples.size > kinematics.window]
    if not sticks:
        return None
    index = np.concatenate(sticks)
    x, v = kinematics.steady_position[index], velocity[index]
    middle = float(x.mean())
    columns = np.c_[np.ones_like(x), x - middle]
    line, rest = least_squares(columns, v)
    spread = np.maximum(_errors_by_window(columns, rest, kinematics.window), _errors_by_stick(columns, rest, sticks))
    noise = float(np.sqrt(np.mean(errors[index] ** 2)))
    residual_rms = float(np.sqrt(np.mean(rest**2)))
    variation = math.sqrt(max(residual_rms**2 - noise**2, 0.0)) if residual_rms > VARIATION_SHOWN * noise else 0.0
    pitch = kinematics.recording.rig.belt_metres_per_count
    scale = 0.0 if pitch is None else abs(pitch.sd / pitch.value)
    speed = Measured(float(line[0]), math.hypot(float(spread[0]), scale * float(line[0])))
    return BeltLine(speed, Measured(float(line[1]), float(spread[1])), middle, variation)


def _errors_by_window(columns: Array, rest: Array, window: int) -> Array:
    """Return standard errors for residuals correlated over ``window`` samples; orthogonal columns."""
    square = float(np.sum(rest**2)) / max(rest.size / window - 2, 1)
    return np.asarray(np.sqrt(square / np.sum(columns**2, axis=0)))


def _errors_by_stick(columns: Array, rest: Array, stick_samples: list[NDArray[np.int64]]) -> Array:
    """Return standard errors for residuals correlated within a stick; orthogonal columns."""
    ends = np.cumsum([stick.size for stick in stick_samples])[:-1]
    gradients = np.array([np.sum(block, axis=0) for block in np.split(columns * rest[:, None], ends)])
    correction = len(stick_samples) / max(len(stick_samples) - 1, 1)
    return np.asarray(np.sqrt(correction * np.sum(gradients**2, axis=0)) / np.sum(columns**2, axis=0))


ITERATIONS = 30  # towards the fixed point in `harmonic_share`: two gain a digit


def slip_duration(slow_s: float, travel: float, belt: float) -> float:
    """Return the duration of a slip, s; ``slow_s`` and ``travel`` are those below `SLIP_SPEED` of the ``belt``, m/s."""
    share = harmonic_share(belt * slow_s / travel if travel else math.inf)
    return slow_s * (math.pi + 2 * math.asin(share)) / (math.pi + 2 * math.asin(SLIP_SPEED * share))


def harmonic_share(ratio: float) -> float:
    """Return the belt's speed over the highest speed of a harmonic motion, at most 1.

    ``ratio`` is the belt's travel, while the motion is slower than half the belt, over the motion's height.
    """
    share = 0.0
    for _ in range(ITERATIONS):
        share = min(1.0, 2 * ratio / (math.pi + 2 * math.asin(SLIP_SPEED * share)))
    return share


SLIP_SPEED = 0.5  # speed of the mass over the belt's: slower than this, it slips
REST_SPEED = 0.05  # speed of the mass over the belt's: slower than this, it is at rest
SHORTEST_PHASE = 0.06  # shortest stick or slip, in slips (`MeasuredMotion.slip_s`); a longer hole may hide one


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """The measurement in the fit's frame; n is the number of samples that are not faults."""

    # (n,) s since `begin`; measured position (counted, m); smoothed position, velocity and acceleration (m, m/s, m/s^2)
    time: Array
    measured: Array
    position: Array
    velocity: Array
    acceleration: Array
    broken: NDArray[np.bool_]  # (n,) true where a sample does not follow the one before: gap, new segment or hole
    belt_speed: float  # m/s, > 0: a first value; the fit finds its own
    stated_speed: Measured | None  # m/s, in the record's own sign, whether used or not
    # calibrations: belt speed (m/s), spring's rest position in this record (m), damping c (N s/m)
    belt_prior: Measured | None
    datum_prior: Measured | None
    damping_prior: Measured | None
    mass: Measured | None  # kg, N/m
    stiffness: Measured | None
    sign: float  # -1.0 where the record was mirrored, else 1.0
    resolution: float  # standard deviation of one measured position, m: rounding or noise
    step: float  # smallest change of a measured position, m: one count, or the last printed decimal
    velocity_error: float  # standard error of the smoothed velocity, m/s; median over the record
    half_window: float  # half of the smoothing window, s: how far a corner is blurred
    slip_s: float  # about how long a slip lasts, s, a power of two (`rounded_slip`): the unit of all times in the fit
    samples_per_slip: float  # of the usual slip, from break-away to landing (`fitting.record.motion`)
    length_error: float = 0.0  # relative standard error of every length: that of the metres per count
    compliance: Measured | None = None  # belt speed lost per metre of spring stretch, 1/s, from the belt's counts
    belt_measured: bool = False  # whether the belt's counts are used: then a ramp cannot be a belt that slows
    speed_variation: float = 0.0  # m/s rms that load does not explain; 0 where not significant
    counted: bool = False  # whether an encoder counted the positions; else a camera or another sensor measured them
    rest_stated_as: str = "datum"  # how a rest position was given: "x0" or "datum"
    begin: float = 0.0  # s; time of the record's first sample on the record's clock

    @property
    def span(self) -> float:
        return float(self.time[-1] - self.time[0])

    @property
    def per_mass(self) -> bool:
        """Whether mass and stiffness are unknown, so that accelerations give no forces and c gives no c/m."""
        return self.mass is None and self.stiffness is None

    @property
    def travel(self) -> float:
        return float(np.ptp(self.position))


def from_kinematics(kinematics: Kinematics, rig: Rig, belt_speed: Measured | float | str | None) -> MeasuredMotion:
    """Bring a smoothed record into the fit's frame.

    A stated ``belt_speed`` (m/s, signed) precedes the belt's counts, which "channel" requires.
    """
    recording = kinematics.recording
    source = recording.where
    if recording.unit != "m":
        raise InputError(
            "positions are in counts because the metres per count are not known",
            source,
            f"add metres_per_count to a rig.toml, then run: daq replay {recording.source.name} --rig rig.toml "
            "-o NEW.h5",
            python="pass metres_per_count: daq.Recording.from_arrays(time, counts, metres_per_count='7.67 um')",
        )
    typed = Measured(float(belt_speed)) if isinstance(belt_speed, float | int) else belt_speed
    if isinstance(typed, Measured) and typed.value == 0:
        raise InputError(
            "belt speed is 0", "--belt-speed", "a belt at rest cannot cause stick-slip; give its speed in m/s"
        )
    resolution, step = _resolution(kinematics)
    used = _mark_used(kinematics)
    begin = float(kinematics.time[0])
    time, position, velocity = (
        kinematics.time[used] - begin,
        kinematics.steady_position[used],
        kinematics.velocity[used],
    )
    if np.ptp(position) < 20 * resolution:
        raise DataError(
            "no stick-slip was detected: the mass does not move", source, "record while the belt drives the mass"
        )
    channel = _fit_channel_line(kinematics, typed)
    stated = typed if isinstance(typed, Measured) else rig.belt_speed
    stick_speed = speed_in_sticks(kinematics)
    trusted_speed = stated if stated is not None and is_possible_speed(stated, stick_speed) else None
    speed = _belt_speed(kinematics, trusted_speed, stick_speed, typed=isinstance(typed, Measured))
    sign = math.copysign(1.0, speed)
    usual_interval = float(np.median(np.diff(kinematics.time)))
    rest = _rest_position(rig, recording.rig)
    slip, slow_s, travel = usual_slip(time, sign * position, sign * velocity < SLIP_SPEED * abs(speed))
    prior = trusted_speed
    if channel is not None:
        unknown = Measured(sign * float(np.min(sign * position)), REST_SD * float(np.ptp(position)))
        prior = channel.speed_without_load(unknown if rest is None else rest)
        prior = replace(prior, sd=math.hypot(prior.sd, _length_error(recording.rig) * prior.value))
    return MeasuredMotion(
        time=time,
        measured=sign * (kinematics.measured - (0.0 if kinematics.repaired else kinematics.offset))[used],
        position=sign * position,
        velocity=sign * velocity,
        acceleration=sign * kinematics.acceleration[used],
        broken=_mark_broken(kinematics, usual_interval, slip),
        belt_speed=abs(speed),
        stated_speed=stated,
        belt_prior=None if prior is None else Measured(abs(prior.value), prior.sd),
        datum_prior=None if rest is None else Measured(sign * rest.value, rest.sd),
        rest_stated_as="datum" if rig.x0 is None else "x0",
        damping_prior=rig.damping,
        mass=rig.mass,
        stiffness=rig.stiffness,
        sign=sign,
        resolution=resolution,
        step=step,
        velocity_error=float(np.median(kinematics.velocity_errors[used])),
        half_window=kinematics.window * usual_interval / 2,
        slip_s=rounded_slip(slip),
        samples_per_slip=slip_duration(slow_s, travel, abs(speed)) / usual_interval,
        length_error=_length_error(recording.rig),
        compliance=Measured(-channel.slope.value, channel.slope.sd)
        if channel is not None and channel.slows_under_load
        else None,
        belt_measured=channel is not None,
        speed_variation=0.0 if channel is None or not channel.is_unsteady else channel.speed_variation,
        counted=recording.count is not None,
        begin=begin,
    )


def usual_slip(time: Array, position: Array, slips: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return the usual duration of a slip, s: half of the travel in slips is in slips at least as long.

    Also return mean duration, s, and travel, m, of the slips with the middle half of the travel.
    """
    parts = runs(slips)
    last = time.size - 1
    if not parts:
        parts = [(0, time.size)]
    lengths = np.array([time[min(j, last)] - time[i] for i, j in parts])
    ways = np.array([np.ptp(position[i:j]) for i, j in parts])
    order = np.argsort(lengths)
    travelled = np.cumsum(ways[order])
    first, usual, last = np.searchsorted(travelled, travelled[-1] * np.array([0.25, 0.5, 0.75]))
    middle = order[first : last + 1]
    return float(lengths[order[usual]]), float(lengths[middle].mean()), float(ways[middle].mean())


def rounded_slip(usual_slip_s: float) -> float:
    """Return a power of two, 0.55 to 1.1 times the usual slip, s: it scales times without rounding."""
    return math.ldexp(1.0, round(math.log2(usual_slip_s * math.pi / 4)))


def _mark_used(kinematics: Kinematics) -> NDArray[np.bool_]:
    used = ~kinematics.missing
    for step in kinematics.losses:
        used[step.first : step.last] = False
    return used


def _mark_broken(kinematics: Kinematics, interval: float, slip: float) -> NDArray[np.bool_]:
    """Return which kept samples do not follow the one before; ``interval`` interval and ``slip`` duration, s."""
    time, used = kinematics.time, _mark_used(kinematics)
    whole = pieces(time, kinematics.recording.segment, interval)
    piece = np.repeat(np.arange(len(whole)), [part.stop - part.start for part in whole])[used]
    broken = np.ones(piece.size, np.bool_)
    broken[1:] = (np.diff(piece) > 0) | (np.diff(time[used]) > max(HOLE * interval, SHORTEST_PHASE * slip))
    return broken


def _fit_channel_line(kinematics: Kinematics, belt_speed: Measured | str | None) -> BeltLine | None:
    """Return the belt's line; None where its counts are not used or too few."""
    if isinstance(belt_speed, str) and belt_speed != "channel":
        raise InputError(f"belt speed is {belt_speed!r}", "--belt-speed", "use 'channel', or a speed in m/s")
    if belt_speed == "channel" and kinematics.belt_velocity is None:
        raise InputError(
            "the run has no belt counts",
            f"{kinematics.recording.where}, --belt-speed",
            "record with an encoder on the belt ([belt] channel = true on the simulated rig), or give a speed in m/s",
        )
    if belt_speed is not None and belt_speed != "channel":
        return None
    return fit_belt_line(kinematics)


def _length_error(rig: Rig) -> float:
    count = rig.metres_per_count
    return 0.0 if count is None else abs(count.sd / count.value)


def _resolution(kinematics: Kinematics) -> tuple[float, float]:
    """Return the standard deviation of a position (a counter's is its rounding) and its smallest step, m."""
    recording = kinematics.recording
    count = recording.rig.metres_per_count
    if recording.count is not None and count is not None:
        return abs(count.value) / math.sqrt(12), abs(count.value)
    position = recording.position[~kinematics.missing]
    rounding = 1e-9 * float(np.ptp(position))
    return max(kinematics.noise, rounding), smallest_step(position)


def speed_in_sticks(kinematics: Kinematics) -> float:
    """Return the median speed of the sticks, m/s, signed; NaN with fewer than `noise_levels.FEWEST`."""
    time, x = kinematics.time, kinematics.steady_position
    speeds = [
        (x[stick.last] - x[stick.first]) / (time[stick.last] - time[stick.first])
        for stick in kinematics.sticks
        if stick.last > stick.first
    ]
    return float(np.median(speeds)) if len(speeds) >= noise_levels.FEWEST else math.nan


def _belt_speed(kinematics: Kinematics, trusted: Measured | None, median: float, *, typed: bool) -> float:
    """Return a first belt speed, signed: as given, or from the sticks, the calibration or the start-up drag."""
    if trusted is not None and typed:
        return trusted.value
    if math.isfinite(kinematics.belt_speed) and kinematics.belt_speed != 0 and (trusted or not math.isfinite(median)):
        return float(kinematics.belt_speed)
    if math.isfinite(median):
        return median
    if trusted is not None and trusted.value != 0:
        return trusted.value
    # Constant friction ends in a sine that just reaches the belt's speed; the drag displaces its middle.
    used = ~kinematics.missing
    position, velocity = kinematics.steady_position[used], kinematics.velocity[used]
    middle = 0.5 * (position.max() + position.min())
    direction = 1.0 if middle >= position[0] else -1.0
    return direction * float(np.percentile(direction * velocity, 99.5))


def _rest_position(rig: Rig, recorded: Rig) -> Measured | None:
    """Return the spring's rest position in the recorded positions, m; a given datum was added to the readings."""
    if rig.datum is None:
        return rig.x0
    return Measured(recorded.offset - rig.datum.value, rig.datum.sd)
