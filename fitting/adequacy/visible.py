"""The smallest departure of friction that would be detected in half of all repetitions of a record.

What is not detected is not absent: a camera track passes under laws that an encoder would reject.  The departure is a
wave in the slip speed, with one or two periods over all speeds and constant amplitude, or in the position, with two or
four periods over the travel and in proportion to the friction.  What the law's own parameters absorb of it is projected
off.  The rest repeats from slip to slip: the squared means over the phases of a slip, over the spread between slips,
are Fisher's F, and half of all repetitions exceed its limit where the mean does.  The median over the waves is a
typical size.
Departures that a law nearly absorbs (half a period over all speeds, say) must be several times larger, and a wave that
it cannot follow at all is detected at half of the size.

Source: D. R. Cox, D. V. Hinkley, Theoretical Statistics, 1974, 9.3 (score tests).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fitting.adequacy.goodness import REJECTED, TESTS, RunSlips
from fitting.adequacy.statistics import SlipBins
from fitting.distributions import fisher_quantile
from fitting.driver.fit import Fit
from fitting.estimation.linearised import LinearisedFit
from fitting.model.parameters import PER_RUN, Global
from fitting.sensitivity.tangents import tangents
from stickslip.compute.arrays import Array

PERIODS = (1.0, 2.0)  # over the slip speeds; at half of one the law's parameters make up for nearly all
PERIODS_OF_TRAVEL = (2.0, 4.0)  # over the positions; at one a change of the spring makes up for most


def smallest_visible(fit: Fit, linearised: LinearisedFit, slips: Sequence[RunSlips]) -> tuple[float | None, ...]:
    """Return for each run the wave amplitude that half of its repetitions detect, % of Fs; median over the waves.

    None where no slip is judged, the motion cannot be followed, or even an amplitude of Fs would not be detected.
    """
    waves = departure_waves(fit)
    if waves is None:
        return (None,) * len(slips)
    weights = linearised.weights.copy()
    for run in slips:
        weights[run.counted] = run.noise_m**-2 if run.noise_m > 0 else 0.0
    information = np.einsum("cdd->cd", replace(linearised, weights=weights).scores(waves).information)
    return tuple(_percent(information[run.counted].sum(axis=0), run) for run in slips)


def _percent(information: Array, run: RunSlips) -> float | None:
    """Return the median amplitude, %; None where half of the waves would not be detected."""
    typical = 100 * half_seen(float(np.median(information)), run.bins) if run.bins.judged else math.inf
    return typical if typical < 100 else None


def half_seen(information: float, bins: SlipBins) -> float:
    """Return the amplitude of a wave with this information (1/variance) that rejects half of all repetitions."""
    noncentrality = bins.bins * (fisher_quantile(1 - REJECTED / TESTS, bins.bins, bins.bins * (bins.slips - 1)) - 1)
    return math.sqrt(noncentrality / information) if information > 0 else math.inf


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
