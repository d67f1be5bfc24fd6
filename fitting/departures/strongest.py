"""The departures that would explain the residual of a fit, each with the share of the misfit that it explains.

Every gain is that of one linear step (`fitting.departures.scores`).  A departure's frequency or wavelength is scanned
first, on a thinned record.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fitting.departures.base import Base
from fitting.departures.library import DEPARTURES
from fitting.departures.scores import LEAST_KEPT, Score, score, sigmas, solve
from fitting.forces.departure import Departure
from stickslip.compute.arrays import Array

# Least standard deviations and least fall of the cost of a departure that is reported.  On six records that one of
# the six laws describes, the best of all departures reached a gain of 6.
LEAST_SIGMAS, LEAST_GAIN = 4.0, 12.0
# Gain over the whole cost: a departure with less is not reported.  Rounding to counts is not white; a free curve that
# describes a record leaves patterns of counts, of which a belt ripple of 7 um/s explained 0.4 %.
LEAST_COST_SHARE = 0.01
# Gain short of the best, over it: departures so near explain the record equally well, and the one with the fewest
# parameters comes first.  A hard spring and friction by position at a wavelength of about the travel differ by 1 %.
EQUAL_GAIN = 0.04
SCALES_AT_ONCE = 16  # scales at a time: curvatures between all columns are made, and only those of one scale used
# Scales that are tried about the best of a scan, in steps between neighbours.
STEPS_BESIDE_BEST = (-0.5, -0.25, 0.0, 0.25, 0.5)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A departure with the scale and size by which it explains the most of a fit's misfit."""

    departure: Departure
    scale: float  # NaN for a departure without one
    size: Array  # (columns,) coefficients
    explained: float  # gain of one linear step over the misfit beyond the noise

    @property
    def parameters(self) -> int:
        return self.departure.columns + math.isfinite(self.scale)


def rank_candidates(bases: Sequence[Base], noise: float) -> list[Candidate]:
    """Return every departure that explains part of the misfit of a fit, the strongest first.

    Of those within `EQUAL_GAIN` of the strongest, the one with the fewest parameters is first.
    """
    best: dict[str, Candidate] = {}
    for candidate in (candidate for base in bases for candidate in find_candidates(base, noise)):
        name = candidate.departure.name
        if name not in best or candidate.explained > best[name].explained:
            best[name] = candidate
    ranked = sorted(best.values(), key=lambda candidate: -candidate.explained)
    equal = [candidate for candidate in ranked if candidate.explained > (1 - EQUAL_GAIN) * ranked[0].explained]
    return [*sorted(equal, key=lambda candidate: candidate.parameters), *ranked[len(equal) :]]


def find_candidates(base: Base, noise: float) -> list[Candidate]:
    """Return the departures that are significant on one fit; a drag dissipates energy."""
    thin, least = base.thinned(), max(LEAST_GAIN, LEAST_COST_SHARE * base.linear.cost)
    misfit = base.misfit_beyond_noise(noise)
    found = []
    for departure in DEPARTURES:
        scale, tried = best_scale(thin, departure)
        step = score_departure(base, departure, scale) if tried else None
        if step is None or (departure.drag is not None and not step.coefficients[0] > 0):
            continue
        if sigmas(step.log_p, tried * len(DEPARTURES)) > LEAST_SIGMAS and step.gain > least:
            found.append(Candidate(departure, scale, step.coefficients, step.gain / max(misfit, LEAST_GAIN)))
    return found


def score_departure(base: Base, departure: Departure, scale: float) -> Score | None:
    return score(base.linear, base.respond([departure.forcing(base.motion, scale)]))


def best_scale(base: Base, departure: Departure) -> tuple[float, int]:
    """Return the scale that explains most, NaN without one, and how many were tried."""
    if departure.scales is None:
        return np.nan, 1
    scales = departure.scales(base.motion)
    if scales.size == 0:
        return np.nan, 0
    if scales.size == 1:
        return float(scales[0]), 1
    gain = gains(base, departure, scales)
    top = int(np.argmax(gain))
    gaps = np.abs(np.diff(np.log(scales)))
    gap = float(np.min(gaps[max(top - 1, 0) : top + 1]))
    nearer = scales[top] * np.exp(np.array(STEPS_BESIDE_BEST) * gap)
    return float(nearer[np.argmax(gains(base, departure, nearer))]), scales.size


def gains(base: Base, departure: Departure, scales: Array) -> Array:
    """Return the decrease of the cost with the departure at each of the scales (n,); 0 where the fit adjusts it."""
    found = []
    for part in np.array_split(scales, math.ceil(scales.size / SCALES_AT_ONCE)):
        columns = base.respond([departure.forcing(base.motion, float(scale)) for scale in part])
        scores, shape = base.linear.scores(columns), (part.size, departure.columns)
        every = np.arange(columns.shape[1]).reshape(shape)
        information = scores.total_information[every[:, :, np.newaxis], every[:, np.newaxis]]
        size, raw, total = np.einsum("skk->sk", information), scores.raw.reshape(shape), scores.total.reshape(shape)
        # beside an unstable motion the response to a force grows beyond all numbers
        usable = np.isfinite(raw) & np.isfinite(size) & np.isfinite(total)
        kept = np.all(usable & (size > LEAST_KEPT * np.where(usable, raw, 0.0)), axis=1)
        gain = np.zeros(part.size)
        gain[kept] = 0.5 * np.sum(total[kept] * solve(information[kept], total[kept]), axis=1)
        found.append(gain)
    return np.concatenate(found)
