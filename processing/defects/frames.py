"""Frames lost or doubled without a trace: times on an even grid, and steps of twice, or none of, the usual length.

A camera or a logger that numbers what arrives, instead of stamping when it was taken, makes even times of uneven ones.
Where a mass moves by several standard deviations of a position between two frames, a lost frame shows as a step of
twice those beside it, two lost ones as three times, and a doubled frame as no step at all.  Where a step is between
one and eight standard deviations, only the share of lost frames shows, in the skewness of the steps.  Smaller steps
hide lost frames.  A doubled frame repeats the noise of the one before it: where noise is several printed steps, equal
readings are rare, and about as many as readings one, two and three steps apart lead one to expect.
"""

import math
from dataclasses import dataclass

import numpy as np

from processing.defects import frame_kernel
from processing.polynomial.even_grid import is_even
from processing.record.noise import DITHERED
from processing.record.series import Series
from stickslip.compute.arrays import Array, runs
from stickslip.compute.compile import compiled

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
REPEATED = 2.0  # printed steps of noise, at least: at 1 the readings one to three steps apart mislead by 2 % of all
# Readings one step apart over those two apart, at least: noise of 2 steps gives 1.2.  Where a few readings were
# set half way between their neighbours, as spikes are, half of the printed step passes for it: odd steps are then rare.
REGULAR = 0.8
LONGEST_REPEAT = 3  # equal steps in a row: longer is a sensor that held its value, or a mass at rest
UNLIKELY = 5.0  # standard deviations of the number of equal readings; none of 48 clean cameras has as many
SHORT = 32  # samples: half of the shortest piece looked at
SKEW = 0.02  # share of frames below which noise could look like them; clean cameras of 0.2 mm reach 0.024
# What a motion that bends within the steps looked at can make of the share at most, in relative bends (root mean
# square) cubed.  Slips of 14 to 20 samples make 12 at most, lost frames themselves bend by half of the root of their
# share: at twice, a share above 0.1 is not found.
BENT = 14.0
SIGNIFICANT = 4.0  # standard deviations of that share; 30 clean cameras of 0.2 mm reach 2.1


@dataclass(frozen=True)
class FrameCount:
    """Steps compared, and how many frames are missing or doubled among them."""

    compared: int
    lost: int
    doubled: int

    @property
    def share(self) -> float:
        """Share of all frames that were lost, 0 to 1."""
        return self.lost / (self.compared + self.lost) if self.lost else 0.0


def step_sums(series: Series, own: slice, noise: float, step: float) -> Array:
    """Return the sums that `count_frames` needs, (16,), over the samples ``own`` of a record.

    They are 0 for a piece whose times are not even: there the times show where frames are missing.  Where readings are
    missing (NaN) a line stands for them.

    noise, step: Standard deviation of one position, and the step that readings are rounded to (0: none), m.
    """
    sums = np.zeros(SUMS)
    known = ~np.isnan(series.position)
    parts = [slice(max(piece.start, own.start), min(piece.stop, own.stop)) for piece in series.pieces]
    even = [part for part in parts if part.stop - part.start > 2 * SHORT and is_even(series.time[part])]
    reading = series.position
    bridged = reading if known.all() else np.interp(series.time, series.time[known], reading[known])
    for part in even:
        least = CLEAR * math.sqrt(2) * noise
        found = np.zeros(OF_KERNEL)
        compiled(frame_kernel.count_steps, KERNELS)(bridged[part], noise, least, NEAR, found)
        valid = OF_KERNEL if noise >= DITHERED * step else UNCLEAR
        sums[:valid] += found[:valid]
        if noise >= REPEATED * step > 0:
            steps = np.rint(np.abs(np.diff(reading[part])) / step)
            sums[OF_KERNEL:] += _equal_readings(steps[~np.isnan(steps)])
    return sums


def _equal_readings(steps: Array) -> Array:
    """Return how many steps there are, how many are 0 in short runs, and how many are 1, 2 and 3 printed ones."""
    equal = sum(last - first for first, last in runs(steps == 0) if last - first <= LONGEST_REPEAT)
    return np.array([steps.size, equal, *(np.count_nonzero(steps == number) for number in (1, 2, 3))], float)


def count_frames(sums: Array) -> FrameCount:
    """Return the frames lost or doubled, from the sums over all of a record."""
    compared, one, two, none, back = (int(value) for value in sums[:5])
    lost, doubled = one + 2 * two - back, none - one
    few = max(FEWEST, SHARE * compared)
    steps, equal, first, second, third = (float(value) for value in sums[OF_KERNEL:])
    usual = (15 * first - 6 * second + third) / 20  # each is those up and those down; the parabola of degree 4 at 0
    repeated = round(equal - usual)
    if first > REGULAR * second and repeated > max(
        FEWEST, SHARE * steps, UNLIKELY * math.sqrt(2.3 * abs(usual) + equal)
    ):
        return FrameCount(int(steps) - repeated, 0, repeated)
    if lost <= few and doubled <= few and sums[6] > 0 and compared < sums[7]:
        # Steps of twice the usual length skew the distribution by the share of frames lost; noise does not.  It is
        # taken about the mean: usual steps chosen because they are long are too long, and shift it.
        number, cubes = float(sums[7]), float(sums[6])
        mean, square = float(sums[8]) / number, float(sums[9]) / number
        share = (float(sums[5]) - 3 * square * float(sums[8]) + 2 * number * mean**3) / cubes
        error = math.sqrt(6 * number * square**3) / cubes
        bent = BENT * (max(float(sums[10]), 0.0) / cubes) ** 1.5
        if share > max(SKEW, SIGNIFICANT * error, bent):
            return FrameCount(int(sums[7]), round(share * float(sums[7])), 0)
    return FrameCount(compared, lost if lost > few else 0, doubled if doubled > few else 0)
