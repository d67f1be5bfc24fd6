"""The estimation problem of a fit, linearised at its solution.

The response of the residuals to other noise, the information on an unknown that was not fitted, and the influence of
single cycles follow from the derivatives at the solution, without another search. The cost is
1/2 sum_c w_c |r_c|^2 and the priors' quadratic forms, as in `fitting.least_squares.levenberg_marquardt`; the unknowns
of each cycle are eliminated by the same `SchurComplement`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from fitting.least_squares import elimination
from fitting.least_squares.normal_equations import (
    Block,
    Derivatives,
    NormalEquations,
    Priors,
    SchurComplement,
    UnfollowableError,
    first_of,
    first_rows,
    kernel,
    normal_equations,
    priors,
)
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array, Integers, Mask

# Residuals (n, B) of each block, m, the same when called again.
Repeat = Callable[[Sequence[Block]], Iterable[Array]]
EXCLUDED_WEIGHT = 1e-6  # share of its weight that an excluded cycle keeps, so that its unknowns stay determined


class Scores(NamedTuple):
    """Gradient and curvature of the cost in d more unknowns, with all others fitted again."""

    gradient: Array  # (d,)
    information: Array  # (d, d)
    raw: Array  # (d,) curvature before elimination; the ratio to it says how identifiable an unknown is


def split_by_block(columns: Array, blocks: Sequence[Block]) -> Iterator[Array]:
    return (columns[block.rows] for block in blocks)


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    derivatives: Derivatives  # of the positions by the shared unknowns, and by those of their cycle
    residual: Array  # (N,) model minus measurement, m
    rows: tuple[slice, ...]  # the residuals of each cycle, one after another without a gap
    weights: Array  # (cycles,) 1/variance of each cycle's residuals, 1/m^2
    priors: Priors
    blocks: NormalEquations

    @classmethod
    def of(
        cls, derivatives: Derivatives, residual: Array, rows: tuple[slice, ...], weights: Array, priors: Priors
    ) -> "LinearisedFit":
        blocks = normal_equations(first_of(rows), weights, residual, derivatives, priors)
        return cls(derivatives, residual, rows, weights, priors, blocks)

    @classmethod
    def at(cls, fit: Fit) -> "LinearisedFit | None":
        task = fit.least_squares
        rows_weights_priors = fit.windows.rows, task.weights, priors(task, fit.q, fit.local)
        try:
            return cls.of(fit.derivatives, fit.residual, *rows_weights_priors)
        except UnfollowableError:
            return None

    def transform(self, change: Callable[[Array], Array], priors: Priors) -> "LinearisedFit":
        """Change the derivatives (n, p + q) of each block."""
        return self.of(self.derivatives.transform(change), self.residual, self.rows, self.weights, priors)

    @cached_property
    def first(self) -> Integers:
        """First residual of each cycle, and their number, shape (cycles + 1,)."""
        return first_of(self.rows)

    def _gradients(self, columns: Iterable[Array]) -> tuple[Array, Array]:
        """Return w J'C of blocks C (rows, n), for the shared (cycles, p, n) and the cycles' unknowns (cycles, q, n)."""
        pairs = zip(self.derivatives, columns, strict=True)
        parts = [self._product(jacobian, block_columns, block) for (block, jacobian), block_columns in pairs]
        gradients, p = np.concatenate(parts), self.priors.gradient.size
        return np.ascontiguousarray(gradients[:, :p]), np.ascontiguousarray(gradients[:, p:])

    def _product(self, jacobian: Array, columns: Array, block: Block) -> Array:
        """Return w L'R of each cycle of a block, shape (cycles, m, n), for L (rows, m) and R (rows, n)."""
        out = np.zeros((block.cycles.stop - block.cycles.start, jacobian.shape[1], columns.shape[1]))
        kernel(elimination.sum_cross)(jacobian, np.ascontiguousarray(columns), first_rows(self.first, block), out)
        out *= self.weights[block.cycles, None, None]
        return out

    @cached_property
    def reduced(self) -> SchurComplement:
        """The problem with the cycles' unknowns eliminated: ``H`` is the information on the shared ones."""
        return SchurComplement(self.blocks)

    @cached_property
    def _pull(self) -> Array:
        """The step (cycles, q) from the gradients of the cycles' unknowns alone."""
        return self.reduced.local_step(self.blocks.gl)

    @cached_property
    def gradients(self) -> Array:
        """Each cycle's gradient in the shared unknowns, shape (cycles, p)."""
        return self.reduced.reduced_gradients(self.blocks.cycle_g, self._pull)

    def refit(self, residuals: Repeat) -> Iterator[tuple[Block, Array]]:
        """Yield the residuals of B records after a linear fit from the true unknowns, block by block.

        They stay unchanged where the step raises the cost: derivatives fail at a jump of the motion, and in poorly
        constrained directions the step is rounding.
        """
        shared, local = self._gradients(residuals(self.derivatives.blocks))
        steps = self._steps(*self.reduced.newton_step(shared.sum(axis=0), local))
        weights = np.repeat(self.weights, np.diff(self.first))
        rise = sum(
            np.einsum("n,nb->b", weights[block.rows], after**2 - before**2)
            for block, before, after in self._move(residuals, steps)
        )
        for block, before, after in self._move(residuals, steps):
            yield block, np.where(rise <= 0, after, before)

    def _move(self, residuals: Repeat, steps: Array) -> Iterator[tuple[Block, Array, Array]]:
        """Yield the residuals (n, B) of each block before and after steps (cycles, p + q, B)."""
        for (block, jacobian), before in zip(self.derivatives, residuals(self.derivatives.blocks), strict=True):
            after = np.array(before, order="C")
            kernel(elimination.add_along)(jacobian, first_rows(self.first, block), steps[block.cycles], after)
            yield block, before, after

    def refit_columns(self, residuals: Array) -> Array:
        return np.concatenate([after for _, after in self.refit(partial(split_by_block, residuals))])

    def without(self, spoilt: Mask) -> "LinearisedFit":
        """Return the fit after a Gauss-Newton step without the ``spoilt`` cycles, or unchanged if that is worse."""
        weights = np.where(spoilt, EXCLUDED_WEIGHT * self.weights, self.weights)
        linear = self.of(self.derivatives, self.residual, self.rows, weights, self.priors)
        step, local_step = linear.reduced.newton_step(linear.blocks.g, linear.blocks.gl)
        steps = self._steps(step[:, None], local_step[:, :, None])
        residuals = [after[:, 0] for _, _, after in self._move(partial(split_by_block, self.residual[:, None]), steps)]
        refit = replace(linear, residual=np.concatenate(residuals), blocks=linear.blocks.shift(step, local_step))
        return refit if refit.cost <= linear.cost else self

    def _steps(self, step: Array, local_step: Array) -> Array:
        """Return steps (cycles, p + q, B) of all unknowns from those of the shared (p, B) and (cycles, q, B)."""
        return np.concatenate([np.broadcast_to(step, (len(self.rows), *step.shape)), local_step], axis=1)

    @property
    def cost(self) -> float:
        """Cost of the residuals alone, without the priors."""
        squares = np.add.reduceat(self.residual**2, self.first[:-1])
        return 0.5 * float(np.einsum("c,c...->...", self.weights, squares))

    def scores(self, columns: Array) -> Scores:
        """Return gradient and curvature in unknowns with position derivatives ``columns`` (N, d)."""
        columns = np.ascontiguousarray(columns)
        to_shared, to_local = self._gradients(split_by_block(columns, self.derivatives.blocks))
        pull = self.reduced.local_step(to_local)
        shared_pull = self.reduced.reduced_gradients(to_shared, pull).sum(axis=0)
        follow = np.einsum("ij,jd->id", self.reduced.covariance, shared_pull)
        square, gradient = (
            sum(
                self._product(columns[block.rows], other[block.rows], block).sum(axis=0)
                for block in self.derivatives.blocks
            )
            for other in (columns, self.residual[:, None])
        )
        shared = self.gradients.sum(axis=0) + self.priors.gradient
        return Scores(
            gradient=gradient[:, 0]
            - np.einsum("cqd,cq->d", to_local, self._pull)
            - np.einsum("id,i->d", follow, shared),
            information=square - np.einsum("cqd,cqe->de", to_local, pull) - np.einsum("id,ie->de", follow, shared_pull),
            raw=np.diag(square),
        )
