"""The smallest departure of friction that would be detected in half of all repetitions of a record.

What is not detected is not absent: a camera track passes under laws that an encoder would reject.  The departure is a
wave in the slip speed, with one or two periods over all speeds and constant amplitude, or in the position, with two or
four periods over the travel and in proportion to the friction.  The linear refit removes what the law's own parameters
absorb.  Each wave's amplitude is raised until half of the repetitions are rejected; their median is a typical size.
Departures that a law nearly absorbs (half a period over all speeds, say) must be several times larger, and a wave that
it cannot follow at all is detected at half of the size.
"""

import math
from collections.abc import Sequence

import numpy as np

from fitting.adequacy.goodness import REJECTED, RunSlips, least
from fitting.adequacy.statistics import cycle_squares
from fitting.driver.fit import Fit
from fitting.estimation.linearised import LinearisedFit
from fitting.model.parameters import PER_RUN, Global
from fitting.sensitivity.tangents import tangents
from stickslip.compute.arrays import Array

PERIODS = (1.0, 2.0)  # over the slip speeds; at half of one the law's parameters make up for nearly all
PERIODS_OF_TRAVEL = (2.0, 4.0)  # over the positions; at one a change of the spring makes up for most
SMALLEST, LARGEST = 1e-6, 1.0  # amplitudes looked between, of Fs; a larger one is none that friction can have
# Repetitions of which one is counted: half of 30 is known to 0.1, and the share rises steeply through it.
COUNTED_EVERY = 2
BISECTIONS = 12  # bisections: to 0.4 %


def smallest_visible(fit: Fit, linearised: LinearisedFit, slips: Sequence[RunSlips]) -> tuple[float | None, ...]:
    """Return for each run the wave amplitude that half of its repetitions detect, % of Fs; median over the waves.

    None where no slip is judged, the motion cannot be followed, or even an amplitude of Fs would not be detected.
    """
    waves = departure_waves(fit)
    if waves is None:
        return (None,) * len(slips)
    left = linearised.refit(waves)
    squares = cycle_squares(left, linearised.rows)
    return tuple(_percent([half_seen(own, *wave) for wave in zip(left.T, squares.T, strict=True)]) for own in slips)


def _percent(sizes: Sequence[float]) -> float | None:
    """Return the median amplitude, %; None where half of the waves would not be detected."""
    typical = 100 * float(np.median(sizes))
    return typical if math.isfinite(typical) else None


def departure_waves(fit: Fit) -> Array | None:
    """Return the response of the positions to waves as large as the friction, shape (N, waves), m."""
    path = fit.path
    if path is None or not path.slips.any():
        return None
    F = np.exp(fit.u.reshape(-1, PER_RUN)[path.run, Global.LOG_F])
    level = np.where(path.slips, path.side * path.level * F, 0.0)
    friction = np.where(path.slips, path.friction, 0.0)
    turn = 2 * math.pi * path.slip_speed / float(np.max(path.slip_speed[path.slips]))
    place = 2 * math.pi * path.position / float(np.ptp(path.position))
    waves = [
        size * shape(number * argument)
        for size, argument, numbers in ((level, turn, PERIODS), (friction, place, PERIODS_OF_TRAVEL))
        for number in numbers
        for shape in (np.sin, np.cos)
    ]
    return tangents(path, np.stack(waves, axis=1))


def half_seen(own: RunSlips, wave: Array, by_cycle: Array) -> float:
    """Return the amplitude of a wave (N,), of Fs, that rejects half of a run's repetitions; inf without one."""
    if not own.judged:
        return math.inf
    draws = slice(None, None, COUNTED_EVERY)
    sums, squares = own.bins.sums(wave[:, None]), own.bins.sums(wave[:, None] ** 2)
    whole, null_whole = float(np.mean(by_cycle[own.counted])), own.null_cycles.rms[draws] ** 2
    repeat, smooth, rms = own.limits(REJECTED)

    def share(size: float) -> float:
        # What noise and wave have in common is left out of the squares: it is small against their sum.
        found = own.bins.combine(own.null_sums[:, draws] + size * sums, own.null_squares[:, draws] + size**2 * squares)
        rejected = (found.repeat - least(own.bins) > repeat) | (found.smooth > smooth)
        return float(np.mean(rejected | (null_whole + size**2 * whole > rms**2)))

    if not share(LARGEST) > 0.5:
        return math.inf
    low, high = math.log(SMALLEST), math.log(LARGEST)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if share(math.exp(middle)) > 0.5 else (middle, high)
    return math.exp(0.5 * (low + high))
