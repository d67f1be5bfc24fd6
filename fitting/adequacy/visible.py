"""The smallest departure of friction that would be detected in half of all repetitions of a record.

What is not detected is not absent: a camera track passes under laws that an encoder would reject.  The departure is a
wave in the slip speed, with one or two periods over all speeds and constant amplitude, or in the position, with two or
four periods over the travel and in proportion to the friction.  The linear refit removes what the law's own parameters
absorb.  Half of all repetitions are rejected where what repeats, or what is smooth, with the wave's mean squares in it
reaches its limit (`fitting.adequacy.goodness`).  The median over the waves is a typical size.
Departures that a law nearly absorbs (half a period over all speeds, say) must be several times larger, and a wave that
it cannot follow at all is detected at half of the size.
"""

import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from fitting.adequacy.goodness import REJECTED, TESTS, RunSlips, least
from fitting.distributions import gamma_upper_quantile
from fitting.driver.fit import Fit
from fitting.estimation.linearised import LinearisedFit, Repeat
from fitting.least_squares.problem import Block, UnfollowableError
from fitting.model.parameters import PER_RUN, Global
from fitting.sensitivity.path import Path
from fitting.sensitivity.tangents import tangents
from stickslip.compute.arrays import Array

PERIODS = (1.0, 2.0)  # over the slip speeds; at half of one the law's parameters make up for nearly all
PERIODS_OF_TRAVEL = (2.0, 4.0)  # over the positions; at one a change of the spring makes up for most


def smallest_visible(fit: Fit, linearised: LinearisedFit, slips: Sequence[RunSlips]) -> tuple[float | None, ...]:
    """Return for each run the wave amplitude that half of its repetitions detect, % of Fs; median over the waves.

    None where no slip is judged, the motion cannot be followed, or even an amplitude of Fs would not be detected.
    """
    waves = departure_waves(fit, linearised.derivatives.blocks)
    if waves is None:
        return (None,) * len(slips)
    parts = [
        [part for run in slips for part in (run.bins.sums(left, block), run.bins.sums(left**2, block))]
        for block, left in linearised.refit(waves)
    ]
    sums = [np.concatenate(part) for part in zip(*parts, strict=True)]
    return tuple(_percent(run, sums[2 * k], sums[2 * k + 1]) for k, run in enumerate(slips))


def _percent(run: RunSlips, sums: Array, squares: Array) -> float | None:
    """Return the median amplitude, %, of waves with these sums in each bin; None where half would not be detected."""
    if not run.bins.judged:
        return None
    typical = 100 * float(np.median([half_seen(run, *wave) for wave in zip(sums.T, squares.T, strict=True)]))
    return typical if typical < 100 else None


def half_seen(run: RunSlips, wave: Array, square: Array) -> float:
    """Return the amplitude of a wave, of Fs, that rejects half of a run's repetitions; inf without one.

    ``wave`` and ``square`` (occupied bins,) are sums of the wave and of its square in each bin.
    """
    bins, begin = run.bins, least(run.bins)
    sums, squares = wave[:, None], square[:, None]
    number, occupied = bins.residuals_and_bins
    mean, noise = sums / bins.count[:, None], run.noise_m**2 * float(np.sum(1 / bins.count))
    repeated = float(np.sum(bins.per_phase(mean) ** 2)) / (bins.slips - 1) / noise
    smooth = float(np.median(bins.per_slip(sums**2 / bins.count[:, None]) / occupied)) / run.noise_m**2
    found = (
        _amplitude(run.null.repeat - begin, repeated, float(np.sum(mean**2)) / noise),
        _amplitude(run.null.smooth, smooth, float(np.median(bins.per_slip(squares) / number)) / run.noise_m**2),
    )
    return min(found)


def _amplitude(null: Array, excess: float, more: float) -> float:
    """Return the amplitude a at which a ratio, (mean of ``null`` + a^2 excess)/(1 + a^2 more), reaches its limit."""
    mean, spread = float(np.mean(null)), float(np.std(null, ddof=1))
    limit = gamma_upper_quantile(REJECTED / TESTS, mean, spread)
    gain = excess - limit * more
    return math.sqrt((limit - mean) / gain) if gain > 0 else math.inf


def departure_waves(fit: Fit, blocks: Sequence[Block]) -> Repeat | None:
    """Return the response of the positions to waves as large as the friction, (n, waves) of each block, m."""
    fastest, low, high = 0.0, math.inf, -math.inf
    for block in blocks:
        path = fit.path_in(block)
        if path is None:
            return None
        fastest = max(fastest, float(np.max(path.slip_speed, where=path.slips, initial=0.0)))
        low, high = min(low, float(path.position.min())), max(high, float(path.position.max()))
    return partial(_respond, fit, fastest, high - low) if fastest > 0 else None


def _respond(fit: Fit, fastest: float, travel: float, blocks: Sequence[Block]) -> Iterator[Array]:
    for block in blocks:
        path = fit.path_in(block)
        if path is None:
            raise UnfollowableError
        yield tangents(path, _waves(path, fit.u, fastest, travel))


def _waves(path: Path, u: Array, fastest: float, travel: float) -> Array:
    """Return the acceleration (M, waves) by each wave."""
    F = np.exp(u.reshape(-1, PER_RUN)[path.run, Global.LOG_F])
    level = np.where(path.slips, path.side * path.level * F, 0.0)
    friction = np.where(path.slips, path.friction, 0.0)
    turn = 2 * math.pi * path.slip_speed / fastest
    place = 2 * math.pi * path.position / travel
    waves = [
        size * shape(number * argument)
        for size, argument, numbers in ((level, turn, PERIODS), (friction, place, PERIODS_OF_TRAVEL))
        for number in numbers
        for shape in (np.sin, np.cos)
    ]
    return np.stack(waves, axis=1)
