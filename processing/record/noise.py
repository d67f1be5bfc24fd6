"""The standard deviation of one position, estimated from the record itself, for any sensor.

Motion nearly cancels in a fourth divided difference of five neighbouring readings, on even times and on uneven ones;
their independent errors do not.  The median ignores corners and single faults.  Rounding to the step of a reading (the
pitch of an encoder, the last printed decimal of a table) adds step^2/12 of variance: that is the least noise, and all
of it where a count hardly changes.

Not detected: errors that change slowly compared with the sample interval, as after a low-pass filter in the sensor.
"""

import math

import numpy as np

from processing.record.series import Series, computed_once
from stickslip.compute.arrays import Array, Integers, Mask

ORDER = 4  # of the differences: the third leave motion of 30 samples a second, the fifth gain nothing
MOST = 2**12  # differences used, spread over the record: their median is accurate to 2 %
NEIGHBOURS = 1, 1  # samples: the gaps inside a difference, least and widest
APART = 8, 16  # the same where readings are mostly rounding, which neighbours share in a pattern
ROUNDED = 1.0  # steps: a smaller scatter is mostly rounding
# Steps of noise that make the rounding error independent of the motion: the rest of the dependence falls as
# exp(-2 pi^2 n^2) with n steps (B. Widrow, I. Kollar, Quantization Noise, 2008, ch. 5).
DITHERED = 0.5
NEAR_WHOLE = 0.02  # steps: median distance of the changes of rounded readings from multiples; 0.25 without a step
FEW, MANY = 30, 1000  # multiples of the smallest change, refined in turn by larger changes
VARIED = 0.05  # share of changes that must not be one step; those of a rounded motion differ
ULPS = 2.0  # of the largest reading: rounding error of a decimal, and of the difference of two
SHOWN = 0.05  # of a step: rounding error above which decimals are not detected
DECIMALS = 16  # powers of five that a number can hold
GOLDEN = 0.6180339887498949  # its multiples modulo 1 are spread evenly
NORMAL = 0.6744897501960817  # median of the absolute value of a standard normal number


@computed_once
def position_noise(series: Series) -> float:
    """Return the standard deviation of one position, m or counts; 0 for a record without a pitch that never changes.

    Rest at the beginning and the end is not used.  Rounding errors of neighbours can repeat in a pattern, and then
    scatter by up to 2.3 times as much as independent ones; readings 8 to 16 samples apart do not share it.
    """
    step = reading_step(series)
    scatter = _measure_scatter(series, step, NEIGHBOURS)
    if scatter < ROUNDED * step:
        scatter = min(scatter, _measure_scatter(series, step, APART))  # wide differences may contain motion
    return max(scatter, step / math.sqrt(12))


@computed_once
def reading_step(series: Series) -> float:
    """Return the step that readings were rounded to: the pitch, else the one in their changes or decimals; else 0."""
    readings = series.drop_missing()
    return series.pitch or smallest_step(readings.position) or last_decimal(readings)


def last_decimal(series: Series) -> float:
    """Return the largest power of ten of which all positions are multiples; 0 if there is none, or at rest.

    In units of the record, which are powers of two, a power of ten is a power of two over one of five.
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
    sample = x[np.linspace(0, x.size - 1, min(FEW, x.size)).astype(int)]
    likely = steps[_are_multiples(sample, steps[:, None], rounding).all(axis=1)]
    return next((float(step) for step in likely if _are_multiples(x, step, rounding).all()), 0.0)


def _are_multiples(x: Array, step: Array | float, rounding: float) -> Mask:
    """Return where numbers are multiples of a step, to within their rounding."""
    number = x / step
    return np.asarray(np.abs(number - np.rint(number)) <= rounding / step + np.spacing(np.abs(number)))


def smallest_step(position: Array) -> float:
    """Return the step that readings were rounded to, m; 0 if their changes are not multiples of one.

    The smallest change between neighbours is off by part of a printed decimal; larger changes refine it.  A motion with
    equal changes throughout, such as a triangle, has no step.
    """
    steps = np.abs(np.diff(position))
    least = float(np.min(steps, where=steps > 0, initial=np.inf))
    if not math.isfinite(least):
        return 0.0
    thinned = steps[:: max(steps.size // MOST, 1)]
    changes = thinned[thinned > 0]
    if not changes.size:
        return least
    for most in (FEW, MANY, math.inf):
        near = changes[changes < most * least]
        whole = np.rint(near / least)
        least = float(np.sum(near * whole) / np.sum(whole**2)) if near.size else least
    number = changes / least
    rounded = (
        np.median(np.abs(number - np.rint(number))) < NEAR_WHOLE and np.mean(np.rint(thinned / least) != 1) > VARIED
    )
    return least if rounded else 0.0


def _measure_scatter(series: Series, step: float, spacing: tuple[int, int]) -> float:
    """Return the robust scatter of fourth divided differences, m, each over the root sum of squares of its weights.

    ``spacing`` is the least and the widest gap between their readings.  Differences of rounded readings are multiples
    of ``step``, so each is shifted by up to half a step, evenly spread, before the median.
    """
    x = series.position
    least, widest = spacing
    span = ORDER * widest
    first, last = int(np.argmax(x != x[0])), x.size - 1 - int(np.argmax((x != x[-1])[::-1]))  # changes
    stride = max((last - first) // MOST, 1)
    starts = np.concatenate([_pick_starts(piece, first - span, last + span, span, stride) for piece in series.pieces])
    if not starts.size:
        return 0.0
    spread = np.arange((ORDER + 1) * starts.size).reshape(ORDER + 1, -1) * GOLDEN % 1.0
    gaps = least + ((widest - least + 1) * spread[1:]).astype(np.int64)
    samples = starts + np.concatenate((np.zeros((1, starts.size), np.int64), np.cumsum(gaps, axis=0)))
    t = series.time[samples]
    t = (t - t[0]) / series.interval
    inverse = np.ones_like(t)
    for j in range(ORDER + 1):
        for k in range(j):
            gap = t[j] - t[k]
            inverse[j] *= gap
            inverse[k] *= -gap
    weights = 1 / inverse
    values = x[samples]
    differences = (weights * (values - values[0])).sum(axis=0) + step * np.abs(weights).min(axis=0) * (spread[0] - 0.5)
    return float(np.median(np.abs(differences) / np.sqrt((weights**2).sum(axis=0)))) / NORMAL


def _pick_starts(piece: slice, first: int, last: int, span: int, stride: int) -> Integers:
    """Return the first samples of differences over ``span`` samples in a piece, from ``first`` to ``last``."""
    return np.arange(max(piece.start, first), min(piece.stop - 1, last) - span + 1, stride)
