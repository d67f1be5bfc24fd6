"""A fit's estimation problem made linear about its solution, for what is asked once the fit is done.

How would the residuals change with other noise, what does the record show of an unknown that was not fitted, how do
single cycles pull at the estimates: all of it follows from the derivatives at the solution, without another search.

The cost is 1/2 sum_c w_c |r_c|^2 and the priors' quadratic forms, as in
`fitting.least_squares.levenberg_marquardt`; the unknowns of each cycle are eliminated by their Schur complement.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daq.base.compute.arrays import Array, Integers, Mask
from daq.base.compute.compile import compiled
from fitting.driver.fit import TaskFit
from fitting.least_squares import elimination
from fitting.least_squares.normal_equations import scaled_inverse

WEIGHT_LEFT = 1e-6  # share of its weight left to a cycle that does not count: its own unknowns stay determined


@dataclass(frozen=True, eq=False)
class Scores:
    """Gradient and curvature of the cost in d more unknowns, those of the fit eliminated.

    Where the fit is at its minimum, the estimate of one unknown is -total / total information, and the cost would
    fall by half of total^2 / total information.  A cycle left out takes its own score and information with it.

    Attributes
    ----------
    score : (cycles, d) f8
        Each cycle's gradient.
    information : (cycles, d, d) f8
        Each cycle's curvature.
    prior_score, prior_information : (d,), (d, d) f8
        The same of the priors of the shared unknowns.
    raw : (d,) f8
        Curvature of each unknown alone, before elimination: how much of it is left says how far it is distinguishable.
    """

    score: Array
    information: Array
    prior_score: Array
    prior_information: Array
    raw: Array

    @property
    def total(self) -> Array:
        """Gradient (d,) of the whole cost."""
        return np.asarray(self.score.sum(axis=0) + self.prior_score)

    @property
    def total_information(self) -> Array:
        """Curvature (d, d) of the whole cost."""
        return np.asarray(self.information.sum(axis=0) + self.prior_information)


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """Derivatives, residuals and priors of an estimation problem at its solution.

    Attributes
    ----------
    shared : (N, p) f8
        Derivatives of the predicted positions with respect to the shared unknowns.
    local : (N, q) f8
        The same for the unknowns of the cycle that a position belongs to.
    residual : (N,) f8
        Model minus measurement, m.
    rows : tuple of slice
        The residuals of each cycle, one after another without a gap.
    weights : (cycles,) f8
        1/variance of each cycle's residuals, 1/m^2.
    prior_precision, prior_gradient : (p, p), (p,) f8
        Curvature and gradient of the shared unknowns' priors.
    local_precision, local_gradient : (cycles, q) f8
        The same for the cycles' own, whose priors are independent.
    """

    shared: Array
    local: Array
    residual: Array
    rows: tuple[slice, ...]
    weights: Array
    prior_precision: Array
    prior_gradient: Array
    local_precision: Array
    local_gradient: Array

    @classmethod
    def at(cls, fit: TaskFit) -> "LinearisedFit | None":
        """Linearise a fit; None where the motion cannot be followed there."""
        jacobian, task = fit.jacobian, fit.problem
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
        """First residual of each cycle, and how many there are, shape (cycles + 1,)."""
        return np.array([*(rows.start for rows in self.rows), self.rows[-1].stop], np.int64)

    @cached_property
    def _inverse(self) -> Array:
        """Inverse curvatures (cycles, q, q) of the cycles' own unknowns."""
        q = self.local.shape[1]
        own = self._product(self.local, self.local) + self.local_precision[:, :, None] * np.eye(q)
        inverse = np.empty_like(own)
        _kernel(elimination.invert)(own, inverse)
        return inverse

    def _product(self, left: Array, right: Array) -> Array:
        """Return w L'R of each cycle, shape (cycles, m, n), for L (N, m) and R (N, n)."""
        out = np.zeros((len(self.rows), left.shape[1], right.shape[1]))
        _kernel(elimination.sum_cross)(left, np.ascontiguousarray(right), self.first, out)
        out *= self.weights[:, None, None]
        return out

    def _reduced(self, cross: Array, own: Array, other: Array) -> Array:
        """Return cross (cycles, m, n) less what goes by way of the cycles' own unknowns.

        ``own`` (cycles, m, q) and ``other`` (cycles, q, n) are the products with the derivatives by these.
        """
        follow = np.einsum("cij,cjn->cin", self._inverse, other)
        return np.asarray(cross - np.einsum("cmi,cin->cmn", own, follow))

    @cached_property
    def _own(self) -> Array:
        """Products (cycles, p, q) of the derivatives with respect to shared and own unknowns."""
        return self._product(self.shared, self.local)

    def information(self) -> tuple[Array, Array]:
        """Return the curvature of the shared unknowns, the cycles' own eliminated.

        Returns
        -------
        each : (cycles, p, p) f8
            Each cycle's.
        total : (p, p) f8
            Their sum and the curvature of the priors.
        """
        return self._information

    @cached_property
    def _information(self) -> tuple[Array, Array]:
        own = self._own
        each = self._reduced(self._product(self.shared, self.shared), own, np.swapaxes(own, 1, 2))
        return each, each.sum(axis=0) + self.prior_precision

    @cached_property
    def covariance(self) -> Array:
        """Inverse (p, p) of the total information: covariance of the shared unknowns for white noise."""
        _, total = self.information()
        raw = np.einsum("cpp->p", self._product(self.shared, self.shared)) + np.diag(self.prior_precision)
        scale, inverse = scaled_inverse(total, raw)
        return np.asarray(inverse * scale[:, None] * scale)

    def gradients(self) -> Array:
        """Return each cycle's gradient in the shared unknowns, shape (cycles, p), its own unknowns eliminated."""
        return self._gradients(self.shared)

    def _gradients(self, columns: Array) -> Array:
        """Return each cycle's gradient (cycles, m) in unknowns with the derivatives ``columns`` (N, m)."""
        residual = self.residual[:, None]
        pull = self._product(self.local, residual) + self.local_gradient[:, :, None]
        return self._reduced(self._product(columns, residual), self._product(columns, self.local), pull)[:, :, 0]

    def refit(self, residuals: Array) -> Array:
        """Return what a linear fit of all unknowns leaves of other residuals.

        Parameters
        ----------
        residuals : (N, B) f8
            Of B records whose true unknowns are those of the fit, such as noise alone, m: the priors hold at the
            solution.

        Returns
        -------
        (N, B) f8
            As they were where the step would raise the cost: a search that ended beside a jump of the motion has no
            derivatives there.
        """
        pull = self._product(self.local, residuals)
        gradient = self._reduced(self._product(self.shared, residuals), self._own, pull).sum(axis=0)
        step = -np.einsum("ij,jb->ib", self.covariance, gradient)
        pull += np.einsum("cpq,pb->cqb", self._own, step)
        own = -np.einsum("cij,cjb->cib", self._inverse, pull)
        shared = np.broadcast_to(step, (len(self.rows), *step.shape))
        out = np.array(residuals, order="C")
        self._add(shared, own, out)
        return np.where(self._squares(out) <= self._squares(residuals), out, residuals)

    def step(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Return the Gauss-Newton step of the shared (p,) and of the cycles' own unknowns (cycles, q).

        ``damping`` adds that share of its own to every shared unknown's curvature (Levenberg-Marquardt).
        """
        _, total = self.information()
        raw = np.einsum("cpp->p", self._product(self.shared, self.shared)) + np.diag(self.prior_precision)
        scale, inverse = scaled_inverse(total + damping * np.diag(np.diag(total)), raw)
        gradient = self.gradients().sum(axis=0) + self.prior_gradient
        step = -scale * np.einsum("ij,j->i", inverse, scale * gradient)
        pull = self._product(self.local, self.residual[:, None])[:, :, 0] + self.local_gradient
        own = np.einsum("cij,cj->ci", self._inverse, pull + np.einsum("cpq,p->cq", self._own, step))
        return np.asarray(step), np.asarray(-own)

    def without(self, spoilt: Mask) -> "LinearisedFit":
        """Return the fit one Gauss-Newton step on, without the weight of some cycles (cycles,).

        As it was where that raises the cost of the others: there the derivatives do not hold.
        """
        others = replace(self, weights=np.where(spoilt, WEIGHT_LEFT * self.weights, self.weights))
        step, own = others.step()
        out = self.residual[:, None].copy()
        self._add(np.broadcast_to(step[:, None], (len(self.rows), step.size, 1)), own[:, :, None], out)
        moved = replace(others, residual=out[:, 0])
        return moved if moved.cost <= others.cost else self

    def _add(self, shared: Array, own: Array, out: Array) -> None:
        """Add what steps of shared (cycles, p, B) and own unknowns (cycles, q, B) do to positions ``out`` (N, B)."""
        for columns, steps in ((self.shared, shared), (self.local, own)):
            _kernel(elimination.add_along)(columns, self.first, np.ascontiguousarray(steps), out)

    @property
    def cost(self) -> float:
        """Cost of the residuals alone, without the priors."""
        return 0.5 * float(self._squares(self.residual))

    def _squares(self, residuals: Array) -> Array:
        """Return the weighted sum of squares of residuals (N, ...), shape (...)."""
        return np.asarray(np.einsum("c,c...->...", self.weights, np.add.reduceat(residuals**2, self.first[:-1])))

    def scores(self, columns: Array) -> Scores:
        """Return gradient and curvature in further unknowns, shared and own unknowns eliminated.

        Parameters
        ----------
        columns : (N, d) f8
            Derivatives of the predicted positions with respect to them.
        """
        columns = np.ascontiguousarray(columns)
        each, _ = self.information()
        raw = self._product(columns, columns)
        to_local = self._product(self.local, columns)
        beside = self._reduced(self._product(self.shared, columns), self._own, to_local)
        own = self._reduced(raw, np.swapaxes(to_local, 1, 2), to_local)
        follow = np.einsum("ij,jd->id", self.covariance, beside.sum(axis=0))
        back = np.einsum("id,cie->cde", follow, beside)
        own += np.einsum("id,cij,je->cde", follow, each, follow, optimize=True) - back - np.swapaxes(back, 1, 2)
        return Scores(
            score=self._gradients(columns) - np.einsum("id,ci->cd", follow, self.gradients()),
            information=own,
            prior_score=-np.einsum("id,i->d", follow, self.prior_gradient),
            prior_information=np.einsum("id,ij,je->de", follow, self.prior_precision, follow),
            raw=np.einsum("cdd->d", raw),
        )


def _kernel(function: Callable[..., None]) -> Callable[..., None]:
    return compiled(function, (elimination.__name__,))
