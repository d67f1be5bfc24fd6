"""Departures: violated assumptions with which a law describes a record that no law describes alone.

Score tests on the best law and on the free curve give the order in which departures are tried: a wrong law can hide a
departure, and a free curve can absorb part of one. The columns of a departure are projected off all unknowns of the fit
(`fitting.judge.linearised`), so one linear step gives its parameters and its gain. A frequency or wavelength is scanned
on a thinned record. Each departure is then fitted together with a law, as part of its motion; a scanned scale is one
more unknown.

Where no departure explains the record, random friction acts on the fitted motion, and all unknowns are fitted again, to
first order in it. Its correlation time is chosen such that the remaining residual, with the noise, has the correlation
time of the record's residual.

Source: D. R. Cox, D. V. Hinkley, Theoretical Statistics, 1974, 9.3 (score tests).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import special

from fitting import noise_levels
from fitting.judge.curve import MeasuredCurve
from fitting.judge.library import DEPARTURES
from fitting.judge.linearised import LinearisedFit
from fitting.judge.parameters import Parameter, covariances, derived_parameters, remove_level_errors
from fitting.model.flow import SEARCH_STEP
from fitting.model.forces import Departure, FittedMotion, Force, Forcing
from fitting.model.path import Path
from fitting.model.predict import FitStart, Model, Task
from fitting.model.problem import rest_calibration
from fitting.model.tangents import tangents
from fitting.record.motion import MeasuredMotion
from fitting.search.exchange import FAR_BEYOND_BEST, NEAR_BEST
from fitting.search.fit import Fit
from fitting.search.passes import finish, first_pass, settle, start_from_regression
from stickslip.compute.arrays import Array, autocorrelation_time
from stickslip.units import Measured


@dataclass(frozen=True)
class Scale:
    """The scanned frequency or wavelength of a departure."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class FittedDeparture:
    name: str
    sigmas: float  # significance in standard deviations, corrected for the number of trials
    parameter: str  # symbol of its size
    value: float
    stderr: float
    unit: str
    text: str  # what is different in the rig
    explained: float  # share of the misfit above the noise that it explains
    law: int | str  # the law that describes the record together with it
    parameters: Mapping[str, Parameter]  # of that law
    scale: Scale | None = None
    refitted: bool = True  # no other departure is reported

    def as_json(self) -> dict[str, Any]:
        names = ("name", "sigmas", "parameter", "value", "stderr", "unit", "text", "explained", "refitted", "law")
        row = {name: getattr(self, name) for name in names}
        row["parameters"] = {name: parameter.as_json() for name, parameter in self.parameters.items()}
        if self.scale is not None:
            row["scale"] = vars(self.scale)
        return row


@dataclass(frozen=True, eq=False)
class Base:
    fit: Fit
    linear: LinearisedFit
    path: Path
    motion: FittedMotion

    @classmethod
    def at(
        cls,
        fit: Fit,
        records: Sequence[MeasuredMotion],
        revolution: float | None = None,
        linear: LinearisedFit | None = None,
    ) -> "Base | None":
        """Linearise a fit; None where it cannot be followed. ``revolution``, m, is the encoder's, if calibrated."""
        linear, path = LinearisedFit.at(fit) if linear is None else linear, fit.path
        if linear is None or path is None or not math.isfinite(linear.cost):
            return None
        return cls(fit, linear, path, FittedMotion.from_path(path, records, linear.residual, revolution))

    def thinned(self) -> "Base":
        """Return the base on a thinned record, which suffices to choose a scale."""
        windows = self.fit.task.problem.windows(thinned=True)
        model = Model(self.fit.task, windows, SEARCH_STEP)
        residual = model.residual(self.fit.q, self.fit.local)
        if residual is None:
            return self
        thin = replace(self.fit, model=model, residual=residual)
        return Base.at(thin, self.motion.records, self.motion.revolution) or self

    def respond(self, forcings: Sequence[Forcing]) -> Array:
        """Return the response (N, all columns) of the positions to forcings of one kind."""
        acceleration, belt_speed, reading = (
            None if parts[0] is None else np.hstack(parts) for parts in zip(*forcings, strict=True)
        )
        if acceleration is None and belt_speed is None and reading is not None:
            return reading
        columns = acceleration if belt_speed is None else np.zeros_like(belt_speed)
        if columns is None:
            raise ValueError("a forcing without any effect")
        return tangents(self.path, columns, belt_speed=belt_speed, position=reading)

    def misfit_beyond_noise(self, noise: float) -> float:
        """Return the cost of the residuals above that of the noise, m."""
        expected = 0.5 * noise**2 * float(np.sum(self.linear.weights * np.diff(self.linear.first)))
        return max(self.linear.cost - expected, 0.0)


def median_rms(residual: Array, rows: Sequence[slice]) -> float:
    """Return the median of the cycles' rms, m, which is robust against outlier cycles."""
    return math.sqrt(float(np.median([np.mean(residual[cycle] ** 2) for cycle in rows])))


# Smallest curvature of a column after the projection, over that before: below it, the fit's unknowns absorb the column.
# Rounding gives 1e-11, quadratic drag 2e-7.
LEAST_KEPT = 1e-9
RIDGE = 1e-12  # added to a curvature, relative to it, so that two equal columns can be solved for


def log_probability(coefficients: Array, covariance: Array, cycles: int) -> float:
    """Return the log p-value of coefficients (k,) by Hotelling's T^2 of the cycles."""
    k, n = coefficients.size, cycles
    statistic = float(np.sum(coefficients * solve(covariance, coefficients)))
    probability = float(special.fdtrc(k, n - k, max(statistic * (n - k) / (k * (n - 1)), 0.0)))
    return math.log(probability) if probability > 0 else -math.inf


def sigmas(log_p: float, trials: float = 1.0) -> float:
    """Return the significance, in standard deviations, of a two-sided tail exp(log_p) after this number of trials."""
    log_tail = min(log_p + math.log(max(trials, 1.0)), 0.0) - math.log(2)
    if log_tail > -700:
        return max(-float(special.ndtri(math.exp(log_tail))), 0.0)
    return math.sqrt(-2 * log_tail - math.log(-2 * log_tail * 2 * math.pi))


def solve(matrix: Array, right: Array) -> Array:
    """Solve for one or two unknowns each, (..., k), in units of the diagonal of the matrices."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("...kk->...k", matrix), 1e-300))
    scaled = matrix * scale[..., :, np.newaxis] * scale[..., np.newaxis, :] + RIDGE * np.eye(scale.shape[-1])
    return np.asarray(scale * np.linalg.solve(scaled, (scale * right)[..., np.newaxis])[..., 0])


LEAST_COST_SHARE = 0.01  # smallest gain over the cost: patterns of rounded counts give 0.4 %
LEAST_GAIN = 12.0  # smallest gain of a reported departure; on a true law gains reach 6
SCALES_AT_ONCE = 16  # scales in one computation of curvatures, of which only those within a scale are used
# Scales tried near the best one of a scan, in steps of the scan.
STEPS_BESIDE_BEST = (-0.5, -0.25, 0.0, 0.25, 0.5)


@dataclass(frozen=True, eq=False)
class Candidate:
    departure: Departure
    scale: float  # NaN for a departure without one
    size: Array  # (columns,) coefficients
    explained: float  # gain of one linear step over the misfit beyond the noise


def rank_candidates(bases: Sequence[Base], noise: float) -> list[Candidate]:
    best: dict[str, Candidate] = {}
    for candidate in (candidate for base in bases for candidate in find_candidates(base, noise)):
        name = candidate.departure.name
        if name not in best or candidate.explained > best[name].explained:
            best[name] = candidate
    return sorted(best.values(), key=lambda candidate: -candidate.explained)


def find_candidates(base: Base, noise: float) -> list[Candidate]:
    """Return the departures that lower the cost by more than noise; a drag must dissipate energy."""
    thin, least_gain = base.thinned(), max(LEAST_GAIN, LEAST_COST_SHARE * base.linear.cost)
    misfit = base.misfit_beyond_noise(noise)
    candidates = []
    for departure in DEPARTURES:
        scale = find_best_scale(thin, departure)
        if scale is None:
            continue
        size, gain = (step[0] for step in linear_steps(base, departure, np.array([scale])))
        if gain > least_gain and (departure.drag is None or size[0] > 0):
            candidates.append(Candidate(departure, scale, size, float(gain) / max(misfit, LEAST_GAIN)))
    return candidates


def find_best_scale(base: Base, departure: Departure) -> float | None:
    """Return the scale with the largest gain; NaN for a departure without scale, None if the record is too short."""
    if departure.scales is None:
        return math.nan
    scales = departure.scales(base.motion)
    if scales.size == 0:
        return None
    if scales.size == 1:
        return float(scales[0])
    gain = linear_steps(base, departure, scales)[1]
    top = int(np.argmax(gain))
    gaps = np.abs(np.diff(np.log(scales)))
    gap = float(np.min(gaps[max(top - 1, 0) : top + 1]))
    nearby = scales[top] * np.exp(np.array(STEPS_BESIDE_BEST) * gap)
    return float(nearby[np.argmax(linear_steps(base, departure, nearby)[1])])


def linear_steps(base: Base, departure: Departure, scales: Array) -> tuple[Array, Array]:
    """Return coefficients (s, columns) and decrease of the cost (s,) at each scale; 0 where the fit absorbs them."""
    coefficients, gain = np.zeros((scales.size, departure.columns)), np.zeros(scales.size)
    for chunk in np.array_split(np.arange(scales.size), math.ceil(scales.size / SCALES_AT_ONCE)):
        columns = base.respond([departure.forcing(base.motion, float(scale)) for scale in scales[chunk]])
        scores, shape = base.linear.scores(columns), (chunk.size, departure.columns)
        column_of = np.arange(columns.shape[1]).reshape(shape)
        information = scores.information[column_of[:, :, np.newaxis], column_of[:, np.newaxis]]
        size, raw, gradient = (
            np.einsum("skk->sk", information),
            scores.raw.reshape(shape),
            scores.gradient.reshape(shape),
        )
        # the response of an unstable motion to a force overflows
        usable = np.isfinite(raw) & np.isfinite(size) & np.isfinite(gradient)
        distinct = np.all(usable & (size > LEAST_KEPT * np.where(usable, raw, 0.0)), axis=1)
        coefficients[chunk[distinct]] = -solve(information[distinct], gradient[distinct])
        gain[chunk[distinct]] = -0.5 * np.sum(gradient[distinct] * coefficients[chunk[distinct]], axis=1)
    return coefficients, gain


# Smallest share of the misfit explained in one linear step by a departure that is fitted; true ones, except drags,
# explain 0.72 to 1.
LEAST_EXPLAINED = 0.5
RIVAL_SHARE = 0.9  # smallest explained share over the first one's: one step does not distinguish such departures
MOST_LAWS = 2  # laws that a departure is fitted with: the best, and the best with another curve


@dataclass(frozen=True, eq=False)
class Refit:
    fit: Fit
    base: Base
    gain: float  # decrease of the cost

    @property
    def force(self) -> Force:
        (force,) = self.fit.task.forces
        return force

    @property
    def size(self) -> Array:
        """The departure's unknowns: its coefficients, and the relative change of its scale."""
        return self.fit.q[self.fit.q.size - self.force.width :]

    @cached_property
    def coefficient_covariances(self) -> Array:
        """Covariances of the coefficients from the sandwich and from the curvature, (2, columns, columns)."""
        first = self.fit.q.size - self.force.width
        coefficients = slice(first, first + self.force.departure.columns)
        return np.array(covariances(self.fit))[:, coefficients, coefficients]

    @property
    def sigmas(self) -> float:
        size = self.force.coefficients(self.size)
        log_p = max(log_probability(size, spread, len(self.fit.rows)) for spread in self.coefficient_covariances)
        return sigmas(log_p, len(DEPARTURES))

    @property
    def median_rms(self) -> float:
        return median_rms(self.fit.residual, self.fit.rows)


def explain_misfit(
    fits: Sequence[Fit],
    curve: MeasuredCurve,
    records: Sequence[MeasuredMotion],
    noise: float,
    revolution: float | None,
    describes: Callable[[Refit], bool],
) -> tuple[FittedDeparture, ...]:
    """Return departures with which a law describes the record, best first; ``noise`` and ``revolution`` are in m."""
    refits: list[Refit] = []
    least_explained = 0.0
    for candidate in _list_candidates(fits[0], curve, records, noise, revolution):
        if refits and not candidate.explained > least_explained:
            break
        refit = fit_departure(candidate, fits, noise)
        if refit is not None and describes(refit):
            refits.append(refit)
            least_explained = least_explained or RIVAL_SHARE * candidate.explained
    return tuple(_describe(refit, noise, 1 - curve.confidence) for refit in sorted(refits, key=lambda r: r.median_rms))


def _list_candidates(
    best: Fit, curve: MeasuredCurve, records: Sequence[MeasuredMotion], noise: float, revolution: float | None
) -> Iterator[Candidate]:
    """Yield candidates, largest gain first, then every drag, whose score test fails where the law fits poorly."""
    curve_describes = curve.chi < noise_levels.DESCRIBES  # then shares of the misfit are meaningless
    bases = [Base.at(best, records, revolution)]
    if not curve_describes:
        bases.append(Base.at(curve.spline_fit, records, revolution, curve.linear))
    tried_departures = []
    for candidate in rank_candidates([base for base in bases if base is not None], noise):
        if curve_describes or candidate.explained > LEAST_EXPLAINED:
            tried_departures.append(candidate.departure)
            yield candidate
    for departure in DEPARTURES:
        if departure.drag is not None and departure not in tried_departures:
            yield Candidate(departure, math.nan, np.zeros(departure.columns), 0.0)


def fit_departure(candidate: Candidate, fits: Sequence[Fit], noise: float) -> Refit | None:
    """Fit a departure with the best laws; None if no fit reaches the noise."""
    refits: list[Refit] = []
    curves: list[str] = []
    for fit in fits:
        if fit.law.formula not in curves and len(curves) < MOST_LAWS:
            curves.append(fit.law.formula)
            least = min((refit.median_rms for refit in refits), default=math.inf)
            refit = _fit_law_with_departure(candidate, fit, noise, least, tested=fit is fits[0])
            refits += [] if refit is None else [refit]
    best = min(refits, key=lambda refit: refit.median_rms, default=None)
    return best if best is not None and best.median_rms < noise_levels.DESCRIBES * noise else None


def _fit_law_with_departure(
    candidate: Candidate, fit: Fit, noise: float, least: float, *, tested: bool
) -> Refit | None:
    """Fit a law with a departure, from the law's fit if ``tested``; None if far from the noise or not significant.

    One that is far from the ``least`` error of another law with it, m, after the first pass is not settled.
    """
    task = replace(fit.task, forces=(Force(candidate.departure, candidate.scale),))
    noises = np.full(fit.runs, noise)
    first = first_pass(task, _start_with_departure(task, fit if tested else None, candidate.size))
    if first is None or first.geometric_mean_rms > FAR_BEYOND_BEST * least:
        return None
    settled = settle(first, noises)
    if settled is None or settled.geometric_mean_rms > NEAR_BEST * noise:
        return None
    finished = finish(settled, noises)
    if finished is None or finished.geometric_mean_rms > NEAR_BEST * noise:
        return None
    base = Base.at(finished, fit.problem.motions)
    if base is None:
        return None
    # A law that fits poorly was fitted only to the thinned record.
    alone, linear = fit.residual if fit.finished else fit.residual_in(finished.windows, fit.local), base.linear
    if alone is None:
        return None
    before = replace(linear, residual=alone).cost
    refit = Refit(remove_level_errors(finished), base, before - linear.cost)
    dissipates = candidate.departure.drag is None or refit.size[0] > 0
    return refit if dissipates and refit.sigmas > noise_levels.SHOWN else None


def _start_with_departure(task: Task, end: Fit | None, size: Array) -> FitStart:
    (force,), start = task.forces, start_from_regression(task) if end is None else end.start
    if force.departure.drag is None:
        rest = start.q if end is not None else start.q[: -force.width]
        return start._replace(q=np.concatenate([rest, size, np.zeros(force.width - size.size)]))
    fastest = max(float(np.max(np.abs(motion.velocity))) for motion in task.problem.motions)
    table = force.departure.drag_table(fastest)
    u, drag = task.problem.start_with_drag(lambda v: np.interp(v, table.velocity, table.acceleration))
    return start_from_regression(task)._replace(q=np.concatenate([u[list(task.places)], [max(drag, 0.0)]]))


def _describe(refit: Refit, noise: float, alpha: float) -> FittedDeparture:
    departure, record = refit.force.departure, refit.fit.problem.motions[0]
    size = amplitude(refit.force.coefficients(refit.size), refit.coefficient_covariances)
    parameter, unit = departure.parameter, departure.unit
    if departure.with_mass is not None and record.mass is not None:
        parameter, unit = departure.with_mass
        size = Measured(size.value * record.mass.value, size.sd * record.mass.value)
    misfit = refit.gain + refit.base.misfit_beyond_noise(noise)
    scale = refit.force.scale_of(refit.size)
    return FittedDeparture(
        name=departure.name,
        sigmas=refit.sigmas,
        parameter=parameter,
        value=size.value,
        stderr=size.sd,
        unit=unit,
        text=departure.says(counted=record.counted),
        explained=min(refit.gain / misfit, 1.0) if misfit > 0 else 0.0,
        law=refit.fit.law.key,
        parameters=derived_parameters(refit.fit, record, alpha),
        scale=Scale(departure.scale, scale, departure.scale_unit) if math.isfinite(scale) else None,
    )


def amplitude(coefficients: Array, spreads: Array) -> Measured:
    """Return the coefficient, or the amplitude of a sine and a cosine, with the larger standard error."""
    size = float(coefficients[0]) if coefficients.size == 1 else float(np.hypot(*coefficients))
    along = coefficients / size if size else np.full(coefficients.size, coefficients.size**-0.5)
    return Measured(size, math.sqrt(float(np.einsum("i,sij,j->s", along, spreads, along).max())))


DRAWS, SEED = 6, 5  # the same draws for every record; the size is then accurate to a factor of two or three
HARMONICS = 64  # sines in one draw
# Correlation times of the friction over that of the residual, which is longer, since inertia smooths a force.
TIMES_TRIED = (1.0, 0.5, 0.25, 0.125, 0.0625)


def fluctuation_share(
    base: Base, repeated: float, count_repeated: Callable[[Array], Array], noise: float
) -> float | None:
    """Return the standard deviation of random friction over the friction at rest.

    None if a larger share of the residual (``repeated``) repeats from slip to slip than under random friction, or if
    the motion is unstable.
    """
    linear, path = base.linear, base.path
    excess = median_rms(linear.residual, linear.rows) ** 2 - noise**2
    if not excess > 0:
        return None
    rng = np.random.default_rng(SEED)
    white = noise * rng.standard_normal((linear.residual.size, DRAWS))
    friction = np.where(path.stuck, 0.0, path.friction)[:, None]
    steps = np.diff(path.windows.time)
    correlation = _correlation_time(linear.residual, base)
    sizes: list[tuple[float, float]] = []
    repeat = -math.inf
    for share in TIMES_TRIED:
        time = share * correlation * float(np.median(steps[steps > 0])) / math.sqrt(2 * math.pi)
        response = base.respond([Forcing(acceleration=friction * _draw_correlated(path.time, time, rng))])
        refitted = linear.refit_columns(response)
        unit_rms = float(np.median([median_rms(draw, linear.rows) for draw in refitted.T]))
        if math.isfinite(unit_rms) and unit_rms > 0:
            size = math.sqrt(excess) / unit_rms
            simulated = size * refitted + white
            times = [_correlation_time(draw, base) for draw in simulated.T]
            sizes.append((abs(math.log(float(np.median(times)) / correlation)), size))
            repeat = max(repeat, float(np.max(count_repeated(simulated))))
    if not sizes or repeated > repeat:
        return None
    return min(sizes)[1] * base.fit.values.F / _friction_at_rest(base.fit)


def _friction_at_rest(fit: Fit) -> float:
    """Return friction at the break-aways, m/s^2, from the spring's stretch: the level of a wrong law is arbitrary."""
    rows_of_first_run = [rows for rows, run in zip(fit.rows, fit.windows.run, strict=True) if run == 0]
    highest = float(np.mean([np.max(fit.windows.position[rows]) for rows in rows_of_first_run]))
    return fit.values.K * (highest - rest_calibration(fit.problem.runs[0]).value)


def _correlation_time(residual: Array, base: Base) -> float:
    """Return the correlation time in samples."""
    return autocorrelation_time([residual[rows] for rows in base.linear.rows])


def _draw_correlated(time: Array, correlation: float, rng: np.random.Generator) -> Array:
    """Return random numbers (M, DRAWS) of unit variance at times, s, with a Gaussian correlation."""
    rate = rng.standard_normal((HARMONICS, DRAWS)) / correlation
    phase = rng.uniform(0.0, 2 * math.pi, (HARMONICS, DRAWS))
    total = np.zeros((time.size, DRAWS))
    for frequency, shift in zip(rate, phase, strict=True):
        total += np.cos(time[:, None] * frequency + shift)
    return math.sqrt(2 / HARMONICS) * total
