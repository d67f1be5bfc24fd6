"""A law or a free curve fitted together with one departure, whose parameters become shared unknowns of the fit.

One linear step (`fitting.departures.scores`) takes the motion for what it was without the departure.  Here the motion
is followed with it: what the departure does is evaluated along the path before and is a force, a change of the belt's
speed or of the reading in the next.  A force by the mass's own velocity is followed with the motion itself: a guide's
changes where the mass turns round, which it does at another time in the next.  A scanned scale is one more unknown.
The search runs on blocks of samples (`fitting.departures.base`); a last step takes all of them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.base.compute.arrays import Array
from fitting.departures.base import Base, usual_rms
from fitting.departures.definition.departure import Departure, Forcing
from fitting.departures.definition.fitted_motion import FittedMotion
from fitting.departures.host import Host
from fitting.departures.scores import Score, log_probability, score
from fitting.estimation.fit import cycle_weights
from fitting.estimation.linearised import LinearisedFit
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.problem import LeastSquaresProblem, cost
from fitting.model.parameters import PerCycle
from fitting.sensitivity.columns import local_tangents
from fitting.sensitivity.flow import LONGEST_STEP, SEARCH_STEP
from fitting.sensitivity.path import Curve, Path, follow

# Most steps of each pass, and the gain at which it stops.  After a pass the departure is evaluated anew.  The first
# pass takes the noise that the law's misfit suggests, the others the record's own.
PASSES, WHOLE_PASSES, PASS = 8, 3, (8, 1e-4)  # on blocks, on all samples
# Of the first step of a pass.  The valley of a law with a departure is longer than that of the law: at 1e-4, which
# suits laws, friction by the position of the mass crept from 0.027 to 0.029 in six passes, on its way to 0.054.
DAMPING = 1e-6
HELD = 2  # passes in which the departure keeps the size that its test gave, and all else follows
CLOSE = 1.05  # times the noise of a block: no other start is tried.  Searches that had stopped early left 1.2 or more
TIMES = 4  # that the motion is followed before the last pass, with all samples: the path of the law alone is not near
# Free passes, and times the noise: a search that then errs more, or would at the rate of its last pass, is given up.
# True departures are at 0.9 to 1.0 after one free pass; LuGre contacts went from 47 to 44 and stayed there.
HOPELESS = 3, 4.0
HURRIED = 1, 2.0  # the same where another law already describes the record with the departure
# The same of a drag, after its first pass.  True ones, from the regression, are then at 2 to 4, because a block's mean
# position is that of the law's motion; LuGre contacts are at 9 and more.
HOPELESS_DRAG = 0, 8.0
DRAG_PASS = (40, 1e-5)  # with all samples; of 8 steps a strong guide without a datum stopped 0.6 % short
LOST = 2.0  # times the noise, after a pass with all samples: drag on a steep ramp took 60 s of CPU to end at 3
LAST = 1e-3  # of the departure's size: a pass that changes it by less is the last
PARTS = (1.0, 0.5, 0.25, 0.1)  # of the linear step, from which the search starts
SCALE_STEP = 1e-4  # relative: derivative by the scale; at 1e-3 its curvature shows, at 1e-6 rounding of the path
SCALE_RANGE = 0.15  # relative: how far a scale may move from where the scan found it


@dataclass(frozen=True, eq=False)
class Refit:
    """Where a fit with one departure ended.

    Attributes
    ----------
    law : int or None
        None for the free curve.
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

    law: int | None
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
        """Median of the cycles' errors, m."""
        return usual_rms(self.residual, self.linear.rows)


def refit_with(
    host: Host, base: Base, departure: Departure, scale: float, size: Array, noise: float, *, hurried: bool = False
) -> Refit | None:
    """Fit a law or the free curve together with a departure.

    Parameters
    ----------
    host : Host
        The fit without it.
    base : Base
        The same, linearised, with all samples.
    departure : Departure
    scale : float
        As scanned; NaN without one.
    size : (k,) f8
        The departure's coefficients as tested.
    noise : float
        Standard deviation of one measured position, m.
    hurried : bool
        Give up early and try one start alone: something already describes the record, or is likely to.

    Returns
    -------
    Refit or None
        None where the motion cannot be followed with it, or where nothing distinguishes it from what the law adjusts.

    Notes
    -----
    The search starts from the law's fit with the departure as tested and, where that ends above the noise, from a
    linear step away from the law's fit; from the regression alone where that fit is astray (`Host.astray`).  A drag is
    regressed together with the law instead, and then tried as tested.
    """
    thinned = base.thinned()
    best: levenberg_marquardt.Solution | None = None
    least = math.inf
    drag = departure.drag is not None and host.basis is None
    starts = (_Model.regressed, _Model.tested) if drag else (_Model.tested, _Model.stepped)
    limits = HOPELESS_DRAG if drag else HURRIED if hurried else HOPELESS
    for start in starts[:1] if hurried or (host.astray and not drag) else starts:
        model = _Model(host, thinned, departure, scale, SEARCH_STEP)
        found = _descend(model, *start(model, size), noise, limits)
        rms = math.inf if found is None else usual_rms(found.residual, model.rows)
        if rms < least:
            best, least = found, rms
        if least < (limits[1] if drag else CLOSE) * model.noise(noise):
            break
    whole = _Model(host, base, departure, scale, LONGEST_STEP)
    if best is None or (drag and not whole.coefficients(best.u)[0] > 0):
        return None
    return whole.finish(best.u, best.local, noise)


def _descend(
    model: "_Model", unknowns: Array, local: Array, held: int, noise: float, hopeless: tuple[int, float] = HOPELESS
) -> levenberg_marquardt.Solution | None:
    """Search pass by pass; None where the motion cannot be followed, or where it stays far from the noise."""
    found, rms = None, math.inf
    far = hopeless[1] * model.noise(noise)
    for number in range(held + PASSES):
        found = model.search(unknowns, local, noise if number else 0.0, held=number < held)
        if found is None:
            return None
        before, unknowns, local = model.coefficients(unknowns), found.u, found.local
        if number < held:
            continue
        last, rms = rms, usual_rms(found.residual, model.rows)
        settled = number > 0 and _settled(before, model.coefficients(unknowns))
        left = max(held + hopeless[0] - number, 0)
        if rms > far and (settled or left == 0 or rms * (rms / last) ** left > far):
            return None
        if settled:
            break
    return found


def _settled(before: Array, after: Array) -> bool:
    """Return whether a pass has changed the departure's size by next to nothing."""
    return float(np.sum((after - before) ** 2)) <= LAST**2 * float(np.sum(before**2))


@dataclass(frozen=True)
class _Unknowns:
    """The unknowns of a search, apart: (13 runs,) of the runs, the curve, the departure's coefficients, its scale."""

    u: Array
    curve: Curve
    coefficients: Array
    scale: float


class _Model:
    """A law with a departure: what is minimised, from where, and what it ends in."""

    def __init__(self, host: Host, base: Base, departure: Departure, scale: float, longest_step: float) -> None:
        self._host, self._base, self._near, self._longest_step = host, base, base, longest_step
        self._departure, self._scale, self._scanned = departure, scale, math.isfinite(scale)
        self._more = departure.columns + (1 if self._scanned else 0)
        self._drag = departure.drag_table(float(np.max(np.abs(base.trajectory.velocity))))

    def tested(self, size: Array) -> tuple[Array, Array, int]:
        """Return shared and own unknowns of the law's fit, a departure of that size, and the passes that hold it.

        Where the law alone is astray, those of the regression.
        """
        host = self._host
        shared, local = host.shared, host.local
        if host.astray:
            shared, local = host.problem.start[list(host.places)], host.first
        return np.concatenate([shared, size, np.zeros(self._more - size.size)]), np.minimum(local, host.fastest), HELD

    def regressed(self, _: Array) -> tuple[Array, Array, int]:
        """Return the same, a drag regressed together with the law from the smoothed motion."""
        u, size = self._host.problem.start_with_drag(
            lambda v: np.interp(v, self._drag.velocity, self._drag.acceleration)
        )
        return np.append(u[list(self._host.places)], size), np.minimum(self._host.first, self._host.fastest), 0

    def stepped(self, _: Array) -> tuple[Array, Array, int]:
        """Return the same, a part of the linear step on from where the law's fit ended, with no pass to hold it."""
        host = self._host
        shared, local = np.concatenate([host.shared, np.zeros(self._more)]), host.local.copy()
        fast, own = host.too_fast, slice(PerCycle.X_SLIP, PerCycle.V_SLIP + 1)
        local[fast, own] = host.first[fast, own]
        local = np.minimum(local, host.fastest)
        forced = self._base.respond([self._departure.forcing(self._base.trajectory, self._scale)])
        step, own_step = self._base.linear.with_shared(forced).step()
        step = np.concatenate([step, np.zeros(self._more - self._departure.columns)])
        problem = self.problem(0.0)
        best = None
        for part in PARTS:
            trial = np.clip(shared + part * step, problem.lower, problem.upper), local + part * own_step
            found = problem.evaluate(*trial, False)
            if found is not None:
                value = cost(problem, *trial, found[0])
                if best is None or value < best[0]:
                    best = value, trial
        return (*((shared, local) if best is None else best[1]), 0)

    def problem(self, noise: float) -> LeastSquaresProblem:
        """Return what is minimised; 0 for the ``noise`` that the law's fit assumed."""
        reach = np.where(np.arange(self._more) < self._departure.columns, np.inf, SCALE_RANGE)
        least = -reach if self._departure.drag is None else np.zeros(self._more)  # a drag takes energy
        weights = self._base.linear.weights
        if noise > 0:
            weights = self._cycle_weights(noise) * self._base.block / noise**2
        return LeastSquaresProblem(
            evaluate=self._evaluate,
            rows=self._base.linear.rows,
            weights=weights,
            lower=np.concatenate([self._host.task.lower, least]),
            upper=np.concatenate([self._host.task.upper, reach]),
            prior=np.concatenate([self._host.task.prior, np.zeros(self._more)]),
            precision=np.concatenate([self._host.task.precision, np.zeros(self._more)]),
            local_prior=self._host.task.local_prior,
            local_precision=self._host.task.local_precision,
            local_upper=self._host.fastest,
        )

    def _cycle_weights(self, noise: float) -> Array:
        """Return weights of the cycles, less than 1 for one that fits far worse than the others, as in a law's fit."""
        linear = self._near.linear
        rms = np.array([math.sqrt(float(np.mean(linear.residual[rows] ** 2))) for rows in linear.rows])
        return cycle_weights(rms, max(float(np.median(rms)), self.noise(noise)))

    @property
    def rows(self) -> tuple[slice, ...]:
        """The residuals of each cycle."""
        return self._base.linear.rows

    def noise(self, one: float) -> float:
        """Return the standard deviation of a block's position where that of one is given."""
        return one / math.sqrt(self._base.block)

    def coefficients(self, shared: Array) -> Array:
        """Return the departure's among the shared unknowns."""
        return self._apart(shared).coefficients

    def search(
        self, shared: Array, local: Array, noise: float, *, held: bool = False, limits: tuple[int, float] = PASS
    ) -> levenberg_marquardt.Solution | None:
        """Minimise with what the departure does along the path before; None where the motion cannot be followed.

        Where it is ``held``, size and scale of the departure stay.
        """
        problem = self.problem(noise)
        if held:
            kept = np.arange(shared.size) >= self._host.shared.size
            problem = replace(
                problem, lower=np.where(kept, shared, problem.lower), upper=np.where(kept, shared, problem.upper)
            )
        found = levenberg_marquardt.minimise(
            problem, shared, local, max_steps=limits[0], tolerance=limits[1], damping=DAMPING
        )
        if found is None:
            return None
        near = self._follow(self._apart(found.u), found.local)
        if near is None:
            return None
        self._near = near
        return found

    def finish(self, shared: Array, local: Array, noise: float) -> Refit | None:
        """Search with all samples, from where the search on blocks ended, and take the errors there."""
        for _ in range(TIMES):
            near = self._follow(self._apart(shared), local)
            if near is None:
                return None
            self._near = near
        for number in range(WHOLE_PASSES):
            brief = number == 0 or self._departure.drag is None
            found = self.search(shared, local, noise, limits=PASS if brief else DRAG_PASS)
            if found is None or usual_rms(found.residual, self.rows) > LOST * noise:
                return None
            last, shared, local = self.coefficients(shared), found.u, found.local
            if _settled(last, self.coefficients(shared)):
                break
        problem, unknowns, followed = self.problem(noise), self._apart(shared), self._near
        p, k = self._host.shared.size, self._departure.columns
        linear = replace(
            self._base.linear,
            shared=self._columns(followed, unknowns),
            local=local_tangents(followed.path),
            residual=followed.linear.residual,
            weights=problem.weights,
            prior_precision=np.diag(problem.precision),
            prior_gradient=problem.precision * (shared - problem.prior),
            local_gradient=problem.local_precision * (local - problem.local_prior),
        )
        order = [*range(p), *range(p + k, p + self._more)]  # its own scale is adjusted besides
        without = replace(
            linear,
            shared=np.ascontiguousarray(linear.shared[:, order]),
            prior_precision=linear.prior_precision[np.ix_(order, order)],
            prior_gradient=linear.prior_gradient[order],
        )
        errors = score(without, linear.shared[:, p : p + k], [k])[0]
        if errors is None:
            return None
        before = replace(self._base.linear, weights=problem.weights).cost
        log_p = log_probability(unknowns.coefficients, errors.covariance, len(self.rows))
        errors = replace(errors, coefficients=unknowns.coefficients, gain=before - linear.cost, log_p=log_p)
        return Refit(self._host.law, self._departure, errors, unknowns.scale, followed.path, linear)

    def _apart(self, shared: Array) -> _Unknowns:
        p, k = self._host.shared.size, self._departure.columns
        u, curve = self._host.apart(shared[:p])
        scale = self._scale * (1 + float(shared[p + k])) if self._scanned else self._scale
        return _Unknowns(u, curve, shared[p : p + k], scale)

    def _evaluate(self, shared: Array, local: Array, derivatives: bool) -> tuple[Array, Array] | None:
        """As `fitting.least_squares.problem.Evaluate`."""
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
        near, force, belt, drag = self._near.path, None, None, self._drag
        if self._departure.drag is None:
            forcing = self._departure.forcing(self._near.trajectory, unknowns.scale)
            force, belt = (
                None if part is None else np.einsum("mk,k->m", part, unknowns.coefficients)
                for part in (forcing.acceleration, forcing.belt_speed)
            )
        else:
            drag = drag._replace(acceleration=float(unknowns.coefficients[0]) * drag.acceleration)
        path = follow(
            near.windows,
            unknowns.curve,
            unknowns.u,
            local,
            along=near,
            acceleration=force,
            belt_speed=belt,
            drag=drag,
            longest_step=self._longest_step,
        )
        if path is None:
            return None
        known, residual = self._base.trajectory, path.residual
        trajectory = FittedMotion.from_path(path, known.records, residual, known.revolution)
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
        found = np.concatenate([self._host.columns(base.path), base.respond(forcings)], axis=1)
        found[~base.counted] = 0.0
        return np.ascontiguousarray(found)
