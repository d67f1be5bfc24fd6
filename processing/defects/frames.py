"""Frames lost or doubled among even times, and the findings on faults of a sensor.

A camera or a logger that numbers frames on arrival, instead of recording when they were taken, makes even times of
uneven ones.  Where a mass moves by several standard deviations of a position between two frames, a lost frame shows as
a step of twice its neighbours, two lost ones as three times, and a doubled frame as no step at all.  Where a step is
between one and eight standard deviations, only the share of lost frames shows, in the skewness of the steps.  Smaller
steps hide lost frames.  A doubled frame repeats the noise of the one before it: where noise is several printed steps,
equal readings are rare, and their expected number follows from readings one, two and three steps apart.
"""

import math
from dataclasses import dataclass

import numpy as np

from processing.defects import frame_kernel
from processing.polynomial.even import is_even
from processing.record.motion import Fault, Finding
from processing.record.noise import DITHERED
from processing.record.series import PositionStep, Series
from processing.record.setting import is_possible_speed
from stickslip.compute.arrays import Array, runs
from stickslip.compute.compile import compiled
from stickslip.units import Measured, with_error

KERNELS = ("processing.defects.frame_kernel",)

# Standard deviations of a step that the usual step must have to be compared.  At 5 noise makes 1 in 1,000 usual steps
# none, and 4 of those compared, because a short step makes the mean of those beside it longer: every sound record of
# 70,000 even steps of 7 standard deviations of a position is "doubled", at 5.5 some are, at 6 none.  At 10 steps must
# be twice as long as at 5.
CLEAR = 6.0
NEAR = 0.35  # of the usual step: how near a multiple a step must lie
SHARE = 1e-3  # of the steps compared, at least
FEWEST = 5  # steps, at least, in a short record
SUMS, OF_KERNEL, UNCLEAR = 16, 11, 5  # numbers; those of the kernel; the first of its steps that are not clear
REPEATED = 2.0  # printed steps of noise that are needed to search for repeated readings
# Ratio of readings one step apart to those two apart; noise of 2 steps gives 1.2, and it is small where half of the
# printed step was taken for the step.
REGULAR = 0.8
LONGEST_REPEAT = 3  # equal steps in a row: more are a sensor that held its value, or a mass at rest
UNLIKELY = 5.0  # standard deviations of the number of equal readings
SHORT = 32  # samples: half of the shortest piece
SKEW = 0.02  # share of lost frames: noise can look like a smaller one
# Largest share that curvature of the motion can imitate, in relative bends (root mean square) cubed; slips of 14 to 20
# samples make 12.
BENT = 14.0
SIGNIFICANT = 4.0  # standard deviations of that share


@dataclass(frozen=True)
class FrameCount:
    """Steps compared, and how many frames are missing or doubled among them."""

    compared: int
    lost: int
    doubled: int

    @property
    def share(self) -> float:
        """Share of lost frames, 0 to 1."""
        return self.lost / (self.compared + self.lost) if self.lost else 0.0


def step_sums(series: Series, samples: slice, noise: float, step: float) -> Array:
    """Return the sums for `count_frames`, (16,), over some samples of a record, with missing readings interpolated.

    Pieces with uneven times are skipped, since those show where frames are missing.  ``step`` is the step that readings
    are rounded to, m, or 0.
    """
    sums = np.zeros(SUMS)
    present = ~np.isnan(series.position)
    parts = [slice(max(piece.start, samples.start), min(piece.stop, samples.stop)) for piece in series.pieces]
    even = [part for part in parts if part.stop - part.start > 2 * SHORT and is_even(series.time[part])]
    reading = series.position
    bridged = reading if present.all() else np.interp(series.time, series.time[present], reading[present])
    for part in even:
        least = CLEAR * math.sqrt(2) * noise
        kernel_sums = np.zeros(OF_KERNEL)
        compiled(frame_kernel.count_steps, KERNELS)(bridged[part], noise, least, NEAR, kernel_sums)
        valid = OF_KERNEL if noise >= DITHERED * step else UNCLEAR
        sums[:valid] += kernel_sums[:valid]
        if noise >= REPEATED * step > 0:
            steps = np.rint(np.abs(np.diff(reading[part])) / step)
            sums[OF_KERNEL:] += _count_equal_readings(steps[~np.isnan(steps)])
    return sums


def _count_equal_readings(steps: Array) -> Array:
    """Return the number of steps, of those of 0 in short runs, and of those of 1, 2 and 3 printed steps."""
    equal = sum(last - first for first, last in runs(steps == 0) if last - first <= LONGEST_REPEAT)
    return np.array([steps.size, equal, *(np.count_nonzero(steps == number) for number in (1, 2, 3))], float)


def count_frames(sums: Array) -> FrameCount:
    """Return the frames lost or doubled, from the sums over a record."""
    compared, once, twice, never, backward = (int(value) for value in sums[:5])
    lost, doubled = once + 2 * twice - backward, never - once
    few = max(FEWEST, SHARE * compared)
    steps, equal, first, second, third = (float(value) for value in sums[OF_KERNEL:])
    usual = (15 * first - 6 * second + third) / 20  # each is those up and those down; the parabola of degree 4 at 0
    repeated = round(equal - usual)
    if first > REGULAR * second and repeated > max(
        FEWEST, SHARE * steps, UNLIKELY * math.sqrt(2.3 * abs(usual) + equal)
    ):
        return FrameCount(int(steps) - repeated, 0, repeated)
    if lost <= few and doubled <= few and sums[6] > 0 and compared < sums[7]:
        # Steps of twice the usual length skew the distribution by the share of lost frames; noise does not.  Moments
        # are about the mean, because usual steps selected for their length are too long.
        number, cubes = float(sums[7]), float(sums[6])
        mean, square = float(sums[8]) / number, float(sums[9]) / number
        share = (float(sums[5]) - 3 * square * float(sums[8]) + 2 * number * mean**3) / cubes
        error = math.sqrt(6 * number * square**3) / cubes
        bent = BENT * (max(float(sums[10]), 0.0) / cubes) ** 1.5
        if share > max(SKEW, SIGNIFICANT * error, bent):
            return FrameCount(int(sums[7]), round(share * float(sums[7])), 0)
    return FrameCount(compared, lost if lost > few else 0, doubled if doubled > few else 0)


def sensor_findings(faults: tuple[Fault, ...], frames: FrameCount, samples: int) -> list[Finding]:
    """Return the findings of a record: spikes, frozen stretches, frames lost or doubled.

    A frame that is lost or doubled makes a spike of a neighbour, so that many spikes are not reported.
    """
    findings = []
    spikes = sum(fault.samples for fault in faults if fault.kind == "spike")
    if spikes > frames.lost + frames.doubled:
        text = f"{_count(spikes, 'sample')} omitted because they are outliers (spikes or drop-outs)"
        findings.append(Finding("spikes", text, float(spikes), 0.0))
    frozen = [fault.samples for fault in faults if fault.kind == "frozen"]
    if frozen:
        text = f"the sensor froze {_count(len(frozen), 'time')} while the mass moved"
        findings.append(Finding("frozen", f"{text}: {_count(sum(frozen), 'sample')} omitted", float(sum(frozen)), 0.0))
    for name, number in (("dropped", frames.lost), ("doubled", frames.doubled)):
        if number:
            share = number / (frames.compared + number)
            findings.append(
                Finding(
                    f"{name}-frames",
                    f"about {100 * share:.1f} % of the frames are {name} although the time stamps are evenly "
                    f"spaced ({number} of {frames.compared} steps), so times and speeds are wrong by the same "
                    "factor; record the time of every frame",
                    share,
                    0.0,
                )
            )
    share = sum(fault.samples for fault in faults) / samples
    if share > MUCH:
        findings.append(
            Finding("faulty-sensor", f"{100 * share:.0f} % of the samples are faulty: check the sensor", share, MUCH)
        )
    return findings


def step_findings(steps: list[PositionStep], frames: FrameCount, unit: str, *, repaired: bool) -> list[Finding]:
    """Return the finding of steps of the datum; steps of counts are lost counts instead.

    Frames lost or doubled among even times are steps of the position too: then none is reported.
    """
    shifts = [step for step in steps if not step.counts]
    if not shifts or frames.lost or frames.doubled:
        return []
    largest = max(shifts, key=lambda step: abs(step.size)).size
    text = (
        f"the position jumps {_count(len(shifts), 'time')} (largest {largest:.3g} {unit}), perhaps because a "
        "camera was moved or a wheel slipped. The jumps are "
        + ("corrected" if repaired else "marked, and removed from the velocity and the fit")
    )
    return [Finding("position-steps", text, largest, 0.0)]


def drift_finding(time: Array, position: Array, unit: str) -> Finding | None:
    """Return the drift of a record that is one straight line, from means over parts of it; None if not significant."""
    t = time - time.mean()
    slope = float(t @ position / (t @ t))
    residual = position - position.mean() - slope * t
    error = float(np.sqrt(residual @ residual / (t.size - 2) / (t @ t)))
    travel = slope * float(np.ptp(time))
    if abs(slope) <= SIGNIFICANT_DRIFT * error or np.abs(residual).max() > STRAIGHT * abs(travel):
        return None
    text = (
        f"the position drifts by {slope:.3g} {unit}/s and the mass never slips: either the counter drifts "
        "while the mass is at rest, or the belt always drags the mass"
    )
    return Finding("drift", text, slope, 0.0, abs(slope) / error if error > 0 else math.inf)


def belt_findings(stated: Measured | None, speed: float, unit: str) -> list[Finding]:
    """Return the finding of a stated belt speed that differs from the speed of the sticks (NaN without one)."""
    if stated is None:
        return []
    text = f"belt speed: {stated.value:.4g} m/s was stated, "
    if unit != "m":
        text += "but the positions are in counts (no metres_per_count)"
        if math.isfinite(speed) and stated.value:
            text += (
                f". The sticks have {speed:.5g} counts/s, which is this speed if a count is "
                f"{stated.value / speed:.4g} m"
            )
        return [Finding("belt-speed-unit", text)]
    if is_possible_speed(stated, speed) or not math.isfinite(speed):
        return []
    text += f"but the speed of the sticks is {speed:.4g} m/s, which is used"
    sd = with_error(stated).sd
    return [Finding("belt-speed", text, speed, stated.value, abs(speed - stated.value) / sd if sd else math.nan)]


STRAIGHT = 0.05  # of the travel: largest distance of a part from the line; one slip in eight sticks moves it farther
SIGNIFICANT_DRIFT = 5.0  # standard deviations of the rate
MUCH = 0.2  # share of faulty samples: with more, the rest no longer records the motion between them


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' if number != 1 else ''}"
