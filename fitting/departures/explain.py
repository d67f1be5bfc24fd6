"""Which assumption breaks: departures with which a law describes a record that no law describes alone.

A score test on the best law and on the free curve chooses the order in which departures are tried: a law that is wrong
by itself can hide a departure, and a free curve can take part of one up.  The driver then fits each together with a
law, whose motion follows the departure; a scanned scale is one more unknown.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fitting import noise_levels
from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.departures.base import Base, usual_rms
from fitting.departures.library import DEPARTURES
from fitting.departures.result import FittedDeparture, Scale
from fitting.departures.scores import log_probability, sigmas
from fitting.departures.strongest import LEAST_SIGMAS, Candidate, rank_candidates
from fitting.driver.fit import Fit
from fitting.driver.passes import finish, first_pass, regressed_start, settle
from fitting.driver.task import FitStart, Task
from fitting.estimation.covariance import covariances, without_level_errors
from fitting.estimation.derived import derived_parameters
from fitting.forces.force import Force
from stickslip.compute.arrays import Array
from stickslip.units import Measured

# Share of the misfit explained in one linear step: a departure with less is not fitted.  True departures but forces by
# the velocity explain 0.72 to 1; of LuGre contacts the strongest explained 0.1 to 1.
LEAST_EXPLAINED = 0.5
# Share of what the first that describes the record explains: one with more is fitted too, as one step does not tell
# them apart.  A spring that hardens by 1 % gained 0.94 of what friction by position did, and left 3.76 um instead of
# 4.07.
RIVAL_SHARE = 0.9
MOST_LAWS = 2  # laws that a departure is fitted with: the best, and the best of another curve
# Error over the noise: a search that then errs more is given up.  True departures are at 0.9 to 1.0; LuGre contacts are
# at 9 and more, and drag on a steep ramp took a minute to end at 3.
GIVEN_UP_ABOVE_NOISE = 2.0


@dataclass(frozen=True, eq=False)
class Refit:
    """A law fitted with one departure."""

    fit: Fit
    base: Base
    gain: float  # by how much the cost falls with it

    @property
    def force(self) -> Force:
        (force,) = self.fit.task.forces
        return force

    @property
    def size(self) -> Array:
        """The departure's unknowns: its coefficients, and the relative change of its scale."""
        return self.fit.q[self.fit.q.size - self.force.width :]

    @cached_property
    def spreads(self) -> Array:
        """Covariances of the coefficients by the sandwich and by the curvature, (2, columns, columns)."""
        first = self.fit.q.size - self.force.width
        own = slice(first, first + self.force.departure.columns)
        return np.array(covariances(self.fit))[:, own, own]

    @property
    def sigmas(self) -> float:
        size = self.force.coefficients(self.size)
        log_p = max(log_probability(size, spread, len(self.fit.rows)) for spread in self.spreads)
        return sigmas(log_p, len(DEPARTURES))

    @property
    def usual_rms(self) -> float:
        """Median of the cycles' errors, m."""
        return usual_rms(self.fit.residual, self.fit.rows)


def explain_misfit(
    fits: Sequence[Fit],
    curve: MeasuredCurve,
    records: Sequence[MeasuredMotion],
    noise: float,
    revolution: float | None,
    describes: Callable[[Refit], bool],
) -> tuple[FittedDeparture, ...]:
    """Return the departures with which a law describes a record that no law describes alone, the nearest first.

    fits: The laws, best first.
    records: Of each run.
    noise: Standard deviation of one measured position, m.
    revolution: Travel per revolution of the encoder, m; scanned where it is not known.
    describes: Whether noise may have made the residual of a refit.
    """
    refits: list[Refit] = []
    least = 0.0
    for candidate in _candidates(fits[0], curve, records, noise, revolution):
        if refits and not candidate.explained > least:
            break
        refit = fit_with(candidate, fits, noise)
        if refit is not None and describes(refit):
            refits.append(refit)
            least = least or RIVAL_SHARE * candidate.explained
    return tuple(_described(refit, noise, 1 - curve.confidence) for refit in sorted(refits, key=lambda r: r.usual_rms))


def _candidates(
    best: Fit, curve: MeasuredCurve, records: Sequence[MeasuredMotion], noise: float, revolution: float | None
) -> Iterator[Candidate]:
    """Yield what to fit, likeliest first, and then every drag.

    The test of a drag, on a law that has ended far away without it, is a poor guess, and its fit does not start there.
    """
    near = curve.chi < noise_levels.DESCRIBES  # there a share of the misfit says nothing
    bases = [Base.at(best, records, revolution)]
    if not near:
        bases.append(Base.at(curve.spline_fit, records, revolution, curve.linear))
    tried = []
    for candidate in rank_candidates([base for base in bases if base is not None], noise):
        if near or candidate.explained > LEAST_EXPLAINED:
            tried.append(candidate.departure)
            yield candidate
    for departure in DEPARTURES:
        if departure.drag is not None and departure not in tried:
            yield Candidate(departure, math.nan, np.zeros(departure.columns), 0.0)


def fit_with(candidate: Candidate, fits: Sequence[Fit], noise: float) -> Refit | None:
    """Fit a departure with the best laws; None where none reaches the noise."""
    refits = []
    curves: list[str] = []
    for fit in fits:
        if fit.law.formula not in curves and len(curves) < MOST_LAWS:
            curves.append(fit.law.formula)
            refit = _fit_with(candidate, fit, noise, tested=fit is fits[0])
            refits += [] if refit is None else [refit]
    best = min(refits, key=lambda refit: refit.usual_rms, default=None)
    return best if best is not None and best.usual_rms < noise_levels.DESCRIBES * noise else None


def _fit_with(candidate: Candidate, fit: Fit, noise: float, *, tested: bool) -> Refit | None:
    """Fit a law with a departure; None where it stays far from the noise, or the departure is not significant.

    The law that was ``tested`` starts at its end: another may have ended far away without the departure.
    """
    task = replace(fit.task, forces=(Force(candidate.departure, candidate.scale),))
    noises = np.full(fit.runs, noise)
    first = first_pass(task, _start(task, fit if tested else None, candidate.size))
    settled = None if first is None else settle(first, noises)
    if settled is None or settled.geometric_mean_rms > GIVEN_UP_ABOVE_NOISE * noise:
        return None
    finished = finish(settled, noises)
    base = None if finished is None else Base.at(finished, fit.problem.motions)
    if finished is None or base is None:
        return None
    linear = base.linear
    before = 0.5 * float(np.sum(np.add.reduceat(fit.residual**2, linear.first[:-1]) * linear.weights))
    refit = Refit(without_level_errors(finished), base, before - linear.cost)
    dissipates = candidate.departure.drag is None or refit.size[0] > 0
    return refit if dissipates and refit.sigmas > LEAST_SIGMAS else None


def _start(task: Task, end: Fit | None, size: Array) -> FitStart:
    """Return the end of a fit, or the regression, with the departure as tested; a drag is regressed too."""
    (force,), start = task.forces, regressed_start(task) if end is None else end.start
    if force.departure.drag is None:
        rest = start.q if end is not None else start.q[: -force.width]
        return start._replace(q=np.concatenate([rest, size, np.zeros(force.width - size.size)]))
    fastest = max(float(np.max(np.abs(motion.velocity))) for motion in task.problem.motions)
    table = force.departure.drag_table(fastest)
    u, drag = task.problem.start_with_drag(lambda v: np.interp(v, table.velocity, table.acceleration))
    return regressed_start(task)._replace(q=np.concatenate([u[list(task.places)], [max(drag, 0.0)]]))


def _described(refit: Refit, noise: float, alpha: float) -> FittedDeparture:
    """Convert a departure to the units of the rig."""
    departure, record = refit.force.departure, refit.fit.problem.motions[0]
    size = amplitude(refit.force.coefficients(refit.size), refit.spreads)
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
    """Return the coefficient, or the amplitude of a sine and a cosine, with the largest of its standard errors."""
    size = float(coefficients[0]) if coefficients.size == 1 else float(np.hypot(*coefficients))
    along = coefficients / size if size else np.full(coefficients.size, coefficients.size**-0.5)
    return Measured(size, math.sqrt(float(np.einsum("i,sij,j->s", along, spreads, along).max())))
