"""The standard deviation of one position, estimated from the record itself, for any sensor.

Motion nearly cancels in a fourth divided difference of five neighbouring readings, on even times and on uneven ones;
their independent errors do not.  The median ignores corners and single faults.  A reading is no better than its step
(the pitch of an encoder, the last printed decimal of a table), whose rounding adds step^2/12 of variance: that is the
least, and all there is where a count hardly changes.

Not seen: errors that change slowly against the sample interval, as after a low-pass filter in the sensor.
"""

import math

import numpy as np

from processing.record.series import Series, computed_once
from stickslip.compute.arrays import Array, Integers, Mask

ORDER = 4  # of the differences: the third leave motion of 30 samples a second, the fifth gain nothing
MOST = 2**12  # differences looked at, spread over the record: their median is known to 2 %
NEIGHBOURS = 1, 1  # samples: the gaps inside a difference, least and widest
APART = 8, 16  # the same where readings are mostly rounding: up to 1.2 times what it adds; with 1, 3 up to 1.6 times
ROUNDED = 1.0  # steps: a smaller scatter is mostly rounding, which neighbours of a steady motion share in a pattern
# Steps of noise, at least, for a rounding error that has nothing to do with the motion: with less, it skews the steps
# of a slow motion, which are mostly 0 or 1 count, and repeats itself.  What is left of that falls as exp(-2 pi^2 n^2)
# with n steps of noise (B. Widrow, I. Kollar, Quantization Noise, 2008, ch. 5): at 0.25 it is 0.3, at 0.5 it is 0.007,
# and at 1 less than the scatter of any record.
DITHERED = 0.5
# Steps: how near whole multiples of a step the changes of rounded readings are, in the median; 0.25 where there is no
# step.  Counts times a pitch that were printed again, to a twentieth of the pitch or finer, are within 0.015.
NEAR_WHOLE = 0.02
FEW, MANY = 30, 1000  # multiples of the smallest change, whose own printing is the error of these times as many
VARIED = 0.05  # share of changes that must not be one step; those of a rounded motion differ
ULPS = 2.0  # of the largest reading: by how much a decimal, and the difference of two, are off where numbers hold them
# Of a step: rounding beyond which decimals are not seen.  Readings of any digits are as near whole steps as that one in
# ten times, and hundreds of them never; at 0.5 everything is a multiple.
SHOWN = 0.05
DECIMALS = 16  # powers of five that numbers hold
GOLDEN = 0.6180339887498949  # its multiples modulo 1 are spread evenly
NORMAL = 0.6744897501960817  # median of the absolute value of a standard normal number


@computed_once
def position_noise(series: Series) -> float:
    """Return the standard deviation of one position, m (or counts, as the positions are).

    series: The record.  Rest at its beginning and end, where no digit changes, is not looked at.
    Returns: 0 for a record without a pitch in which nothing changes.

    Notes
    -----
    Where a mass moves by 4.4 steps a sample, rounding errors repeat every five samples: differences of neighbours then
    scatter by up to 2.3 times what independent errors of that size would give.  Readings 8 to 16 samples apart, in
    ever another order, do not share the pattern.
    """
    step = reading_step(series)
    scatter = _scatter(series, step, NEIGHBOURS)
    if scatter < ROUNDED * step:
        scatter = min(scatter, _scatter(series, step, APART))  # at few samples a second the wider ones see the motion
    return max(scatter, step / math.sqrt(12))


@computed_once
def reading_step(series: Series) -> float:
    """Return the step that readings were rounded to: the pitch, or what they show; 0 for none.

    Where they move by many steps a sample their changes do not show it, but their decimals do.
    """
    known = series.readings()
    return series.pitch or smallest_step(known.position) or last_decimal(known)


def last_decimal(series: Series) -> float:
    """Return the power of ten of which all changes are multiples; 0 where numbers hold no such one, or at rest.

    A reading printed to 1e-9 m errs by 0.3e-9 m, however smooth the motion is.  In units of the record, which are
    powers of two, a power of ten is one of two over one of five: the largest of these is looked for.
    """
    x = series.position
    farthest = float(np.abs(x).max())
    if farthest == 0:
        return 0.0
    rounding = ULPS * float(np.spacing(max(farthest, abs(series.origin))))
    fives = 5.0 ** np.arange(DECIMALS)
    least, most = math.frexp(rounding / SHOWN)[1], math.frexp(farthest * fives[-1])[1]
    steps = (2.0 ** np.arange(least, most)[:, None] / fives).ravel()
    steps = -np.sort(-steps[(steps > rounding / SHOWN) & (steps <= farthest)])
    some = x[np.linspace(0, x.size - 1, min(FEW, x.size)).astype(int)]
    likely = steps[_whole(some, steps[:, None], rounding).all(axis=1)]
    return next((float(step) for step in likely if _whole(x, step, rounding).all()), 0.0)


def _whole(x: Array, step: Array | float, rounding: float) -> Mask:
    """Return where numbers are multiples of a step, as nearly as their rounding shows."""
    number = x / step
    return np.asarray(np.abs(number - np.rint(number)) <= rounding / step + np.spacing(np.abs(number)))


def smallest_step(position: Array) -> float:
    """Return the step that readings were rounded to, m; 0 where their changes are no multiples of one.

    It is first the smallest change between neighbours.  Where counts were turned into metres and printed with few
    decimals, that is off by a part of a decimal, and multiples of it by ever more: larger changes make it exact.

    A motion that changes by one and the same amount throughout, as a triangle does, shows no step.
    """
    steps = np.abs(np.diff(position))
    least = float(np.min(steps, where=steps > 0, initial=np.inf))
    if not math.isfinite(least):
        return 0.0
    some = steps[:: max(steps.size // MOST, 1)]
    changes = some[some > 0]
    if not changes.size:
        return least
    for most in (FEW, MANY, math.inf):
        near = changes[changes < most * least]
        whole = np.rint(near / least)
        least = float(np.sum(near * whole) / np.sum(whole**2)) if near.size else least
    number = changes / least
    rounded = np.median(np.abs(number - np.rint(number))) < NEAR_WHOLE and np.mean(np.rint(some / least) != 1) > VARIED
    return least if rounded else 0.0


def _scatter(series: Series, step: float, spacing: tuple[int, int]) -> float:
    """Return the robust scatter of fourth divided differences, m, each over the root of its squared weights' sum.

    On even times those of rounded readings are whole multiples of ``step`` over that root, of which a median would
    take one: each is moved by up to half of that, evenly.  ``spacing`` is the least and the widest gap between their
    readings.
    """
    x = series.position
    least, widest = spacing
    span = ORDER * widest
    first, last = int(np.argmax(x != x[0])), x.size - 1 - int(np.argmax((x != x[-1])[::-1]))  # changes
    stride = max((last - first) // MOST, 1)
    starts = np.concatenate([_starts(piece, first - span, last + span, span, stride) for piece in series.pieces])
    if not starts.size:
        return 0.0
    evenly = np.arange((ORDER + 1) * starts.size).reshape(ORDER + 1, -1) * GOLDEN % 1.0
    gaps = least + ((widest - least + 1) * evenly[1:]).astype(np.int64)
    near = starts + np.concatenate((np.zeros((1, starts.size), np.int64), np.cumsum(gaps, axis=0)))
    t = series.time[near]
    t = (t - t[0]) / series.interval
    inverse = np.ones_like(t)
    for j in range(ORDER + 1):
        for k in range(j):
            apart = t[j] - t[k]
            inverse[j] *= apart
            inverse[k] *= -apart
    weights = 1 / inverse
    values = x[near]
    found = (weights * (values - values[0])).sum(axis=0) + step * np.abs(weights).min(axis=0) * (evenly[0] - 0.5)
    return float(np.median(np.abs(found) / np.sqrt((weights**2).sum(axis=0)))) / NORMAL


def _starts(piece: slice, first: int, last: int, span: int, stride: int) -> Integers:
    """Return where differences over ``span`` samples begin in a piece, between the samples ``first`` and ``last``."""
    return np.arange(max(piece.start, first), min(piece.stop - 1, last) - span + 1, stride)
