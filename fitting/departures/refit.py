"""A law or a free curve fitted together with one departure, whose parameters become shared unknowns of the fit.

One linear step (`fitting.departures.scores`) assumes the motion without the departure.  The driver follows the motion
with it: a scanned scale is one more unknown.
"""

from dataclasses import dataclass, replace

import numpy as np

from fitting.departures.base import usual_rms
from fitting.departures.scores import Score, log_probability, score
from fitting.driver.driver import best_end
from fitting.driver.fit import Fit
from fitting.driver.noise import PassNoise
from fitting.driver.passes import finish, regressed_start
from fitting.driver.task import FitStart, Task
from fitting.estimation.linearised import LinearisedFit
from fitting.forces.departure import Departure
from fitting.forces.force import Force
from fitting.law import Law
from fitting.sensitivity.path import Path
from stickslip.compute.arrays import Array

# Error over the noise: a search that then errs more is given up.  True departures are at 0.9 to 1.0; LuGre contacts are
# at 9 and more, and drag on a steep ramp took a minute to end at 3.
GIVEN_UP_ABOVE_NOISE = 2.0


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit with one departure."""

    law: Law | None  # none for the free curve
    departure: Departure
    score: Score  # coefficients of the departure, with errors at the solution; the gain is that over the fit without it
    scale: float  # NaN for a departure without one
    path: Path  # its ``u`` and ``local`` are the other unknowns
    linear: LinearisedFit  # at the solution; the departure's columns are the last of the shared ones

    @property
    def residual(self) -> Array:
        """Model minus measurement, m, shape (N,)."""
        return self.linear.residual

    @property
    def usual_rms(self) -> float:
        """Median of the cycles' errors, m."""
        return usual_rms(self.residual, self.linear.rows)


def refit_with(
    host: Fit,
    law: Law | None,
    departure: Departure,
    scale: float,
    size: Array,
    noise: Array,
    *,
    hurried: bool = False,
) -> Refit | None:
    """Fit a law, or the free curve (``law`` None), with a departure of the tested ``scale`` and ``size``.

    None where the motion cannot be followed, stays far from the noise, or the departure cannot be told from what the
    law adjusts. The search starts from the fit without it, with the departure as tested, and from the regression; a
    ``hurried`` one tries one start.
    """
    task = replace(host.task, forces=(Force(departure, scale),))
    starts = _starts(task, host, size, law)
    settled = best_end(task, starts[:1] if hurried else starts, noise)
    if settled is None or settled.geometric_mean_rms > GIVEN_UP_ABOVE_NOISE * float(np.max(noise)):
        return None
    fit = finish(settled, noise)
    if fit is None or usual_rms(fit.residual, fit.windows.rows) > GIVEN_UP_ABOVE_NOISE * float(np.max(noise)):
        return None
    return _judged(fit, host, law, noise)


def _starts(task: Task, host: Fit, size: Array, law: Law | None) -> list[tuple[FitStart, PassNoise | None]]:
    """Return the starts of the search, likeliest first."""
    (force,) = task.forces
    more = np.concatenate([size, np.zeros(force.width - size.size)])
    tested = FitStart(np.concatenate([host.q, more]), host.local)
    regressed = regressed_start(task)
    if law is None:
        return [(tested, None)]
    if force.departure.drag is None:
        return [(tested, None), (regressed._replace(q=np.concatenate([regressed.q[: -force.width], more])), None)]
    fastest = max(float(np.max(np.abs(motion.velocity))) for motion in task.problem.motions)
    table = force.departure.drag_table(fastest)
    u, drag = task.problem.start_with_drag(lambda v: np.interp(v, table.velocity, table.acceleration))
    begin = np.concatenate([u[list(task.places)], [max(drag, 0.0)]])
    return [(regressed._replace(q=begin), None), (tested, None)]


def _judged(fit: Fit, host: Fit, law: Law | None, noise: Array) -> Refit | None:
    """Return a fit with the errors of its departure; None where the law adjusts it, or a drag is negative."""
    (force,) = fit.task.forces
    linear, path = LinearisedFit.at(fit), fit.path
    if linear is None or path is None:
        return None
    first, k = fit.q.size - force.width, force.departure.columns
    size = fit.q[first:]
    order = [*range(first), *range(first + k, fit.q.size)]  # its own scale is adjusted besides
    without = replace(
        linear,
        shared=np.ascontiguousarray(linear.shared[:, order]),
        prior_precision=linear.prior_precision[np.ix_(order, order)],
        prior_gradient=linear.prior_gradient[order],
    )
    errors = score(without, linear.shared[:, first : first + k], [k])[0]
    coefficients = force.coefficients(size)
    if errors is None or (force.departure.drag is not None and not coefficients[0] > 0):
        return None
    before = 0.5 * float(np.sum(np.add.reduceat(host.residual**2, linear.first[:-1]) * linear.weights))
    log_p = log_probability(coefficients, errors.covariance, len(linear.rows))
    errors = replace(errors, coefficients=coefficients, gain=before - linear.cost, log_p=log_p)
    return Refit(law, force.departure, errors, force.scale_of(size), path, linear)
