"""A law fitted together with one departure, whose parameters become shared unknowns of the fit.

One linear step (`fitting.departures.scores`) takes the motion for what it was without the departure.  Here the motion
is followed with it: what the departure does is evaluated along the path before and is a force, a change of the belt's
speed or of the reading in the next.  A scanned scale is one more unknown.  The search runs on blocks of samples
(`fitting.departures.base`); a last step takes all of them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.compute.arrays import Array
from fitting.departures.base import Base
from fitting.departures.departure import Departure, Forcing
from fitting.departures.scores import Score, score
from fitting.departures.trajectory import Trajectory
from fitting.estimation import levenberg_marquardt
from fitting.estimation.fit import Fit
from fitting.estimation.levenberg_marquardt import LeastSquaresProblem
from fitting.estimation.linearised import LinearisedFit
from fitting.estimation.trajectory import least_squares
from fitting.model import parameters
from fitting.model.parameters import PER_RUN, Global, PerCycle
from fitting.sensitivity.columns import local_tangents, shared_tangents
from fitting.sensitivity.path import Path, follow

# Most steps of each pass, and the gain at which it stops.  After a pass the departure is evaluated anew.  The first
# pass takes the noise that the law's misfit suggests, the others the record's own.
PASSES, PASS = 8, (6, 1e-4)
TIMES = 4  # that the motion is followed before the last pass, with all samples: the path of the law alone is not near
LAST = 1e-3  # of the departure's size: a pass that changes it by less is the last
PARTS = (1.0, 0.5, 0.25, 0.1)  # of the linear step, from which the search starts
SCALE_STEP = 1e-4  # relative: derivative by the scale; at 1e-3 its curvature shows, at 1e-6 rounding of the path
SCALE_RANGE = 0.15  # relative: how far a scale may move from where the scan found it
BESIDE_BELT = 0.9995  # of the belt's speed: largest velocity at which a slip may start (`fitting.curve.spline_fit`)


@dataclass(frozen=True, eq=False)
class Refit:
    """Where the fit of a law with one departure ended.

    Attributes
    ----------
    law : int
    departure : Departure
    score : Score
        Coefficients of the departure, with errors at the solution; the gain is that over the fit without it.
    scale : float
        NaN for a departure without one.
    path : Path
        Its ``u`` and ``local`` are the other unknowns.
    linear : LinearisedFit
        At the solution; the departure's columns are the last of the shared ones.
    """

    law: int
    departure: Departure
    score: Score
    scale: float
    path: Path
    linear: LinearisedFit

    @property
    def residual(self) -> Array:
        """Model minus measurement, m, shape (N,)."""
        return self.linear.residual

    @property
    def usual_rms(self) -> float:
        """Geometric mean of the cycles' errors, m: a few spoilt cycles hardly move it."""
        square = [float(np.mean(self.residual[rows] ** 2)) for rows in self.linear.rows]
        return math.exp(0.5 * float(np.mean(np.log(square))))


def refit_with(fit: Fit, base: Base, departure: Departure, scale: float, noise: float) -> Refit | None:
    """Fit a law together with a departure.

    Parameters
    ----------
    fit : Fit
        Of the law alone.
    base : Base
        The same, linearised, with all samples.
    departure : Departure
    scale : float
        As scanned; NaN without one.
    noise : float
        Standard deviation of one measured position, m.

    Returns
    -------
    Refit or None
        None where the motion cannot be followed with it, or where nothing distinguishes it from what the law adjusts.
    """
    model = _Model(fit, base.thinned(), departure, scale)
    unknowns, local = model.start()
    for number in range(PASSES):
        found = model.search(unknowns, local, noise if number else 0.0)
        if found is None:
            return None
        size = float(np.hypot.reduce(model.coefficients(unknowns)))
        unknowns, local, before = found.u, found.local, size
        if abs(float(np.hypot.reduce(model.coefficients(unknowns))) - before) < LAST * before and number:
            break
    return _Model(fit, base, departure, scale).finish(unknowns, local, noise)


@dataclass(frozen=True)
class _Unknowns:
    """The unknowns of a search, apart: (13 runs,) of the runs, the coefficients, the scale."""

    u: Array
    coefficients: Array
    scale: float


class _Model:
    """A law with a departure: what is minimised, from where, and what it ends in."""

    def __init__(self, fit: Fit, base: Base, departure: Departure, scale: float) -> None:
        self._fit, self._base, self._near = fit, base, base
        self._departure, self._scale, self._scanned = departure, scale, math.isfinite(scale)
        self._task = least_squares(fit)
        self._more = departure.columns + (1 if self._scanned else 0)
        self._fastest = np.full(fit.local.shape, np.inf)
        if not fit.problem.ramp:  # a start beyond the belt's speed is a law's way out of a misfit
            speed = fit.u.reshape(-1, PER_RUN)[fit.windows.run, Global.V_DR]
            self._fastest[:, PerCycle.V_SLIP] = BESIDE_BELT * speed

    def start(self) -> tuple[Array, Array]:
        """Return shared and cycles' own unknowns, a part of the linear step on from where the law's fit ended."""
        places = list(self._fit.active)
        shared, local = np.concatenate([self._fit.u[places], np.zeros(self._more)]), self._fit.local.copy()
        first = self._fit.windows.starting_values(self._fit.problem.motions)
        fast = local[:, PerCycle.V_SLIP] > self._fastest[:, PerCycle.V_SLIP]
        own = slice(PerCycle.X_SLIP, PerCycle.V_SLIP + 1)
        local[fast, own] = first[fast, own]
        local = np.minimum(local, self._fastest)
        k = self._departure.columns
        forced = self._base.respond([self._departure.forcing(self._base.trajectory, self._scale)])
        linear = self._base.linear
        p = linear.shared.shape[1]
        precision = np.zeros((p + k, p + k))
        precision[:p, :p] = linear.prior_precision
        step, own_step = replace(
            linear,
            shared=np.ascontiguousarray(np.concatenate([linear.shared, forced], axis=1)),
            prior_precision=precision,
            prior_gradient=np.concatenate([linear.prior_gradient, np.zeros(k)]),
        ).step()
        step = np.concatenate([step, np.zeros(self._more - k)])
        problem = self.problem(0.0)
        best = None
        for part in PARTS:
            trial = np.clip(shared + part * step, problem.lower, problem.upper), local + part * own_step
            found = problem.evaluate(*trial, False)
            if found is not None:
                cost = levenberg_marquardt.cost(problem, *trial, found[0])
                if best is None or cost < best[0]:
                    best = cost, trial
        return (shared, local) if best is None else best[1]

    def problem(self, noise: float) -> LeastSquaresProblem:
        """Return what is minimised; 0 for the ``noise`` that the law's fit assumed."""
        reach = np.full(self._more, np.inf)
        if self._scanned:
            reach[-1] = SCALE_RANGE
        weights = self._base.linear.weights
        if noise > 0:
            weights = self._cycle_weights(noise) * self._base.block / noise**2
        return LeastSquaresProblem(
            evaluate=self._evaluate,
            rows=self._base.linear.rows,
            weights=weights,
            lower=np.concatenate([self._task.lower, -reach]),
            upper=np.concatenate([self._task.upper, reach]),
            prior=np.concatenate([self._task.prior, np.zeros(self._more)]),
            precision=np.concatenate([self._task.precision, np.zeros(self._more)]),
            local_prior=self._task.local_prior,
            local_precision=self._task.local_precision,
            local_upper=self._fastest,
        )

    def _cycle_weights(self, noise: float) -> Array:
        """Return weights of the cycles, less than 1 for one that fits far worse than the others, as in a law's fit."""
        linear = self._near.linear
        rms = np.array([math.sqrt(float(np.mean(linear.residual[rows] ** 2))) for rows in linear.rows])
        excess = rms / max(float(np.median(rms)), noise / math.sqrt(self._base.block))
        return np.minimum(2 / (1 + excess**2), 1.0)

    def coefficients(self, shared: Array) -> Array:
        """Return the departure's among the shared unknowns."""
        return self._apart(shared).coefficients

    def search(self, shared: Array, local: Array, noise: float) -> levenberg_marquardt.Solution | None:
        """Minimise with what the departure does along the path before; None where the motion cannot be followed."""
        found = levenberg_marquardt.minimise(self.problem(noise), shared, local, max_steps=PASS[0], tolerance=PASS[1])
        if found is None:
            return None
        near = self._follow(self._apart(found.u), found.local)
        if near is None:
            return None
        self._near = near
        return found

    def finish(self, shared: Array, local: Array, noise: float) -> Refit | None:
        """Search once more with all samples, from where the search on blocks ended, and take the errors there."""
        for _ in range(TIMES):
            near = self._follow(self._apart(shared), local)
            if near is None:
                return None
            self._near = near
        found = self.search(shared, local, noise)
        if found is None:
            return None
        problem, unknowns, followed = self.problem(noise), self._apart(found.u), self._near
        p, k = len(self._fit.active), self._departure.columns
        linear = replace(
            self._base.linear,
            shared=self._columns(followed, unknowns),
            local=local_tangents(followed.path),
            residual=followed.linear.residual,
            weights=problem.weights,
            prior_precision=np.diag(problem.precision),
            prior_gradient=problem.precision * (found.u - problem.prior),
            local_gradient=problem.local_precision * (found.local - problem.local_prior),
        )
        order = [*range(p), *range(p + k, p + self._more)]  # its own scale is adjusted besides
        without = replace(
            linear,
            shared=np.ascontiguousarray(linear.shared[:, order]),
            prior_precision=linear.prior_precision[np.ix_(order, order)],
            prior_gradient=linear.prior_gradient[order],
        )
        last = score(without, linear.shared[:, p : p + k], [k])[0]
        if last is None:
            return None
        before = replace(self._base.linear, weights=problem.weights).cost
        last = replace(last, coefficients=unknowns.coefficients, gain=before - linear.cost)
        return Refit(self._fit.law, self._departure, last, unknowns.scale, followed.path, linear)

    def _apart(self, shared: Array) -> _Unknowns:
        p, k = len(self._fit.active), self._departure.columns
        u = self._fit.u.copy()
        u[list(self._fit.active)] = shared[:p]
        scale = self._scale * (1 + float(shared[p + k])) if self._scanned else self._scale
        return _Unknowns(parameters.copy_shared(u), shared[p : p + k], scale)

    def _evaluate(self, shared: Array, local: Array, derivatives: bool) -> tuple[Array, Array] | None:
        """As `fitting.estimation.levenberg_marquardt.Evaluate`."""
        unknowns = self._apart(shared)
        followed = self._follow(unknowns, local)
        if followed is None:
            return None
        if not derivatives:
            return followed.linear.residual, np.empty((0, 0))
        own = local_tangents(followed.path)
        own[~self._base.counted] = 0.0
        return followed.linear.residual, np.concatenate([self._columns(followed, unknowns), own], axis=1)

    def _follow(self, unknowns: _Unknowns, local: Array) -> Base | None:
        """Follow the motion with the departure; None where it cannot be followed."""
        forcing = self._departure.forcing(self._near.trajectory, unknowns.scale)
        force, belt = (
            None if part is None else np.einsum("mk,k->m", part, unknowns.coefficients)
            for part in (forcing.acceleration, forcing.belt_speed)
        )
        near = self._near.path
        path = follow(near.windows, near.curve, unknowns.u, local, along=near, acceleration=force, belt_speed=belt)
        if path is None:
            return None
        known = self._base.trajectory
        trajectory = Trajectory.from_path(path, known.records, path.residual, known.revolution)
        residual = path.residual
        reading = self._departure.forcing(trajectory, unknowns.scale).reading
        if reading is not None:
            residual = residual + np.einsum("nk,k->n", reading, unknowns.coefficients)
        residual = np.where(self._base.counted, residual, 0.0)
        linear = replace(self._base.linear, residual=residual)
        return replace(self._base, linear=linear, path=path, trajectory=replace(trajectory, residual=residual))

    def _columns(self, base: Base, unknowns: _Unknowns) -> Array:
        """Return derivatives by the shared unknowns, the coefficients and the relative change of the scale."""
        forcing = self._departure.forcing(base.trajectory, unknowns.scale)
        forcings = [forcing]
        if self._scanned:
            beside = self._departure.forcing(base.trajectory, unknowns.scale * (1 + SCALE_STEP))
            along = unknowns.coefficients / (self._scale / unknowns.scale * SCALE_STEP)
            parts = [
                None if near is None or far is None else np.einsum("nk,k->n", far - near, along)[:, np.newaxis]
                for near, far in zip(forcing, beside, strict=True)
            ]
            forcings.append(Forcing(*parts))
        found = np.concatenate([shared_tangents(base.path, self._fit.active), base.respond(forcings)], axis=1)
        found[~base.counted] = 0.0
        return np.ascontiguousarray(found)
