"""A fit's estimation problem made linear about its solution.

The response of the residuals to other noise, the data's constraint on an unknown that was not fitted, and the pull of
single cycles all follow from the derivatives at the solution, without another search.

The cost is 1/2 sum_c w_c |r_c|^2 and the priors' quadratic forms, as in `fitting.least_squares.levenberg_marquardt`;
the unknowns of each cycle are eliminated by the same `SchurComplement`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fitting.driver.fit import Fit
from fitting.least_squares import elimination
from fitting.least_squares.normal_equations import NormalEquations, SchurComplement, kernel
from stickslip.compute.arrays import Array, Integers, Mask

WEIGHT_LEFT = 1e-6  # share of its weight left to a cycle that does not count: its own unknowns stay determined


@dataclass(frozen=True, eq=False)
class Scores:
    """Gradient and curvature of the cost in d more unknowns, those of the fit eliminated.

    At a minimum, the estimate of one unknown is -total / total information, and its gain half of total^2 / total
    information; omitting a cycle removes its score and information.
    """

    score: Array  # (cycles, d) each cycle's gradient
    information: Array  # (cycles, d, d) each cycle's curvature
    prior_score: Array  # (d,) the same of the priors of the shared unknowns
    prior_information: Array
    # (d,) curvature of each unknown alone, before elimination: how much of it is left says how far it is
    # distinguishable
    raw: Array

    @property
    def total(self) -> Array:
        return np.asarray(self.score.sum(axis=0) + self.prior_score)

    @property
    def total_information(self) -> Array:
        return np.asarray(self.information.sum(axis=0) + self.prior_information)


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """Derivatives, residuals and priors of an estimation problem at its solution."""

    shared: Array  # (N, p) derivatives of the predicted positions with respect to the shared unknowns
    local: Array  # (N, q) the same for the unknowns of the cycle that a position belongs to
    residual: Array  # (N,) model minus measurement, m
    rows: tuple[slice, ...]  # the residuals of each cycle, one after another without a gap
    weights: Array  # (cycles,) 1/variance of each cycle's residuals, 1/m^2
    prior_precision: Array  # (p, p) curvature and gradient of the shared unknowns' priors
    prior_gradient: Array
    local_precision: Array  # (cycles, q) the same for the cycles' own, whose priors are independent
    local_gradient: Array

    @classmethod
    def at(cls, fit: Fit) -> "LinearisedFit | None":
        """Linearise a fit; None where the motion cannot be followed there."""
        jacobian, task = fit.jacobian, fit.least_squares
        if jacobian is None:
            return None
        u = fit.q
        residual, p = fit.residual, u.size
        return cls(
            shared=np.ascontiguousarray(jacobian[:, :p]),
            local=np.ascontiguousarray(jacobian[:, p:]),
            residual=residual,
            rows=fit.windows.rows,
            weights=task.weights,
            prior_precision=np.diag(task.precision),
            prior_gradient=task.precision * (u - task.prior),
            local_precision=task.local_precision,
            local_gradient=task.local_precision * (fit.local - task.local_prior),
        )

    @cached_property
    def first(self) -> Integers:
        """First residual of each cycle, and their number, shape (cycles + 1,)."""
        return np.array([*(rows.start for rows in self.rows), self.rows[-1].stop], np.int64)

    def _product(self, left: Array, right: Array) -> Array:
        """Return w L'R of each cycle, shape (cycles, m, n), for L (N, m) and R (N, n)."""
        out = np.zeros((len(self.rows), left.shape[1], right.shape[1]))
        kernel(elimination.sum_cross)(left, np.ascontiguousarray(right), self.first, out)
        out *= self.weights[:, None, None]
        return out

    @cached_property
    def blocks(self) -> NormalEquations:
        residual = self.residual[:, None]
        curvature, own = self._product(self.shared, self.shared), self._product(self.local, self.local)
        cycle_g = self._product(self.shared, residual)[:, :, 0]
        return NormalEquations(
            g=cycle_g.sum(axis=0) + self.prior_gradient,
            H=curvature.sum(axis=0) + self.prior_precision,
            gl=self._product(self.local, residual)[:, :, 0] + self.local_gradient,
            Hl=own + self.local_precision[:, :, None] * np.eye(own.shape[1]),
            cross=self._product(self.shared, self.local),
            cycle_g=cycle_g,
            cycle_curvature=curvature,
        )

    @cached_property
    def reduced(self) -> SchurComplement:
        """The same with the cycles' own unknowns eliminated: ``H`` is the information on the shared ones."""
        return SchurComplement(self.blocks)

    @cached_property
    def information(self) -> Array:
        """Each cycle's information on the shared unknowns, its own eliminated, (cycles, p, p)."""
        return self.reduced.by_cycle(self.blocks.cycle_curvature)

    @property
    def covariance(self) -> Array:
        """Covariance (p, p) of the shared unknowns for white noise."""
        return self.reduced.covariance

    @cached_property
    def _pull(self) -> Array:
        """The step (cycles, q) by the gradients of the cycles' own unknowns alone."""
        return self.reduced.local_step(self.blocks.gl)

    @cached_property
    def gradients(self) -> Array:
        """Each cycle's gradient in the shared unknowns, its own eliminated, shape (cycles, p)."""
        return self.reduced.reduced_gradients(self.blocks.cycle_g, self._pull)

    def refit(self, residuals: Array) -> Array:
        """Return the residuals (N, B), m, of a linear fit to B records with the fit's true unknowns, such as noise.

        Unchanged where the step would raise the cost: at a jump of the motion the derivatives fail.
        """
        gradient = self._product(self.shared, residuals).sum(axis=0)
        out = self._moved(residuals, *self.reduced.newton_step(gradient, self._product(self.local, residuals)))
        return np.where(self._squares(out) <= self._squares(residuals), out, residuals)

    def without(self, spoilt: Mask) -> "LinearisedFit":
        """Return the fit after a Gauss-Newton step without some cycles (cycles,), or as it was if that is worse."""
        others = replace(self, weights=np.where(spoilt, WEIGHT_LEFT * self.weights, self.weights))
        step, own = others.reduced.newton_step(others.blocks.g, others.blocks.gl)
        moved = replace(others, residual=self._moved(self.residual[:, None], step[:, None], own[:, :, None])[:, 0])
        return moved if moved.cost <= others.cost else self

    def _moved(self, residuals: Array, step: Array, own: Array) -> Array:
        """Return residuals (N, B) after steps of the shared (p, B) and the cycles' own unknowns (cycles, q, B)."""
        out = np.array(residuals, order="C")
        shared = np.broadcast_to(step, (len(self.rows), *step.shape))
        for columns, steps in ((self.shared, shared), (self.local, own)):
            kernel(elimination.add_along)(columns, self.first, np.ascontiguousarray(steps), out)
        return out

    @property
    def cost(self) -> float:
        """Cost of the residuals alone, without the priors."""
        return 0.5 * float(self._squares(self.residual))

    def _squares(self, residuals: Array) -> Array:
        """Return the weighted sum of squares of residuals (N, ...), shape (...)."""
        return np.asarray(np.einsum("c,c...->...", self.weights, np.add.reduceat(residuals**2, self.first[:-1])))

    def scores(self, columns: Array) -> Scores:
        """Return gradient and curvature in further unknowns with position derivatives ``columns`` (N, d)."""
        columns = np.ascontiguousarray(columns)
        raw, to_local = self._product(columns, columns), self._product(self.local, columns)
        pull = self.reduced.local_step(to_local)
        beside = self.reduced.reduced_gradients(self._product(self.shared, columns), pull)
        own = raw - np.einsum("cqd,cqe->cde", to_local, pull)
        gradient = self._product(columns, self.residual[:, None])[:, :, 0]
        gradient -= np.einsum("cqd,cq->cd", to_local, self._pull)
        follow = np.einsum("ij,jd->id", self.covariance, beside.sum(axis=0))
        back = np.einsum("id,cie->cde", follow, beside)
        own += np.einsum("id,cij,je->cde", follow, self.information, follow, optimize=True)
        own -= back + np.swapaxes(back, 1, 2)
        return Scores(
            score=gradient - np.einsum("id,ci->cd", follow, self.gradients),
            information=own,
            prior_score=-np.einsum("id,i->d", follow, self.prior_gradient),
            prior_information=np.einsum("id,ij,je->de", follow, self.prior_precision, follow),
            raw=np.einsum("cdd->d", raw),
        )
