"""The departures that would explain the residual of a fit, the strongest first.

Every gain is that of one linear step (`fitting.departures.scores`).  A departure's frequency or wavelength is scanned
first, on a thinned record.
"""

import math
from dataclasses import dataclass

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.departures.base import Base
from fitting.departures.library import departures
from fitting.departures.result import FoundDeparture, Scale
from fitting.departures.scores import LEAST_KEPT, RIDGE, Score, score, sigmas
from fitting.estimation.linearised import LinearisedFit
from fitting.forces.departure import Departure
from stickslip.compute.arrays import Array
from stickslip.units import Measured

# Least standard deviations and least fall of the cost of a departure that is reported.  On six records that one of
# the six laws describes, the best of all departures reached a gain of 6.
LEAST_SIGMAS, LEAST_GAIN = 4.0, 12.0
# Gain over the whole cost: a departure with less is not reported.  Rounding to counts is not white; a free curve that
# describes a record leaves patterns of counts, of which a belt ripple of 7 um/s explained 0.4 %.
LEAST_COST_SHARE = 0.01
# Gain short of the best, over it: departures so near explain the record equally well, and the one with the fewest
# parameters comes first.  A hard spring and friction by position at a wavelength of about the travel differ by 1 %.
EQUAL_GAIN = 0.04
SAME_SCALE = 0.01  # relative difference of two scales: a search moves a scale by more
SCALES_AT_ONCE = 16  # scales at a time: curvatures between all columns are made, and only those of one scale used
# Scales that are tried about the best of a scan, in steps between neighbours.
STEPS_BESIDE_BEST = (-0.5, -0.25, 0.0, 0.25, 0.5)


@dataclass(frozen=True, eq=False)
class Tested:
    departure: Departure
    scale: float
    score: Score
    sigmas: float

    @property
    def at(self) -> tuple[Departure, float, Array]:
        return self.departure, self.scale, self.score.coefficients

    @property
    def parameters(self) -> int:
        return self.departure.columns + (1 if math.isfinite(self.scale) else 0)

    @property
    def possible(self) -> bool:
        """Whether its sign is physically possible: a drag dissipates energy."""
        return self.departure.drag is None or bool(self.score.coefficients[0] > 0)

    def near(self, other: "Tested") -> bool:
        """Whether both are the same departure at the same scale, so that searches from them agree."""
        if self.departure is not other.departure:
            return False
        return not math.isfinite(self.scale) or abs(math.log(self.scale / other.scale)) < SAME_SCALE


def strongest(base: Base) -> list[Tested]:
    """Test every departure on a fit that does not describe the record; return the significant ones, strongest first.

    They are ordered by their gain; of those within 4 % of the best, the one with the fewest parameters is first.
    """
    thin, every = base.thinned(), departures()
    chosen = []
    for departure in every:
        scale, tried = best_scale(thin, departure)
        if tried:
            chosen.append((departure, scale, tried * len(every)))
    columns = base.respond([departure.forcing(base.trajectory, scale) for departure, scale, _ in chosen])
    scores = score(base.linear, columns, [departure.columns for departure, _, _ in chosen])
    every_tested = [
        Tested(departure, scale, one, sigmas(one.log_p, tried))
        for (departure, scale, tried), one in zip(chosen, scores, strict=True)
        if one is not None
    ]
    least = max(LEAST_GAIN, LEAST_COST_SHARE * base.linear.cost)
    shown = [
        tested
        for tested in every_tested
        if tested.sigmas > LEAST_SIGMAS and tested.score.gain > least and tested.possible
    ]
    shown.sort(key=lambda tested: -tested.score.gain)
    if shown:
        equal = [tested for tested in shown if tested.score.gain > (1 - EQUAL_GAIN) * shown[0].score.gain]
        equal.sort(key=lambda tested: tested.parameters)
        shown[: len(equal)] = equal
    return shown


def best_scale(base: Base, departure: Departure) -> tuple[float, int]:
    """Return the scale that explains most, NaN without one, and how many were tried."""
    if departure.scales is None:
        return np.nan, 1
    scales = departure.scales(base.trajectory)
    if scales.size == 0:
        return np.nan, 0
    gain = gains(base, departure, scales)
    top = int(np.argmax(gain))
    if scales.size == 1:
        return float(scales[0]), 1
    gaps = np.abs(np.diff(np.log(scales)))
    gap = float(np.min(gaps[max(top - 1, 0) : top + 1]))
    nearer = scales[top] * np.exp(np.array(STEPS_BESIDE_BEST) * gap)
    return float(nearer[np.argmax(gains(base, departure, nearer))]), scales.size


def gains(base: Base, departure: Departure, scales: Array) -> Array:
    """Return the decrease of the cost with the departure at each of the scales (n,)."""
    return np.concatenate(
        [
            _gains(base, departure, scales[first : first + SCALES_AT_ONCE])
            for first in range(0, scales.size, SCALES_AT_ONCE)
        ]
    )


def _gains(base: Base, departure: Departure, scales: Array) -> Array:
    columns = base.respond([departure.forcing(base.trajectory, float(scale)) for scale in scales])
    scores = base.linear.scores(columns)
    shape = (scales.size, departure.columns)
    every = np.arange(columns.shape[1]).reshape(shape)
    information = scores.total_information[every[:, :, np.newaxis], every[:, np.newaxis]]
    size, raw, total = np.einsum("skk->sk", information), scores.raw.reshape(shape), scores.total.reshape(shape)
    # beside an unstable motion the response to a force grows beyond all numbers
    usable = np.isfinite(raw) & np.isfinite(size) & np.isfinite(total)
    kept = np.all(usable & (size > LEAST_KEPT * np.where(usable, raw, 0.0)), axis=1)
    unit = 1 / np.sqrt(size[kept])
    total = total[kept] * unit
    information = information[kept] * unit[:, :, np.newaxis] * unit[:, np.newaxis]
    information += RIDGE * np.eye(departure.columns)
    gain = np.zeros(scales.size)
    gain[kept] = 0.5 * np.sum(total * np.linalg.solve(information, total[:, :, np.newaxis])[:, :, 0], axis=1)
    return gain


def misfit_beyond_noise(linear: LinearisedFit, noise: Array | float) -> float:
    """Return the cost of the residuals above that of the noise, which a departure can at most explain."""
    weights = np.repeat(linear.weights, np.diff(linear.first))
    return max(0.5 * float(np.sum(weights * (linear.residual**2 - np.square(noise)))), 0.0)


def describe(tested: Tested, record: MeasuredMotion, excess: float) -> FoundDeparture:
    """Convert a departure to the units of the rig."""
    departure, coefficients = tested.departure, tested.score.coefficients
    size = amplitude(coefficients, tested.score.covariance)
    parameter, unit = departure.parameter, departure.unit
    if departure.with_mass is not None and record.mass is not None:
        parameter, unit = departure.with_mass
        size = Measured(size.value * record.mass.value, size.sd * record.mass.value)
    known = math.isfinite(tested.scale)
    return FoundDeparture(
        name=departure.name,
        sigmas=tested.sigmas,
        parameter=parameter,
        value=size.value,
        stderr=size.sd,
        unit=unit,
        text=departure.says(counted=record.counted),
        scale=Scale(departure.scale, tested.scale, departure.scale_unit) if known else None,
        gain=tested.score.gain,
        explained=min(tested.score.gain / excess, 1.0) if excess > 0 else 0.0,
    )


def amplitude(coefficients: Array, covariance: Array) -> Measured:
    """Return the coefficient, or the amplitude of a sine and a cosine, with its standard error."""
    if coefficients.size == 1:
        return Measured(float(coefficients[0]), math.sqrt(float(covariance[0, 0])))
    size = float(np.hypot(*coefficients))
    along = coefficients / size if size > 0 else np.full(coefficients.size, math.sqrt(0.5))
    return Measured(size, math.sqrt(float(along @ covariance @ along)))
