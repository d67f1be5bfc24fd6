"""A fit's estimation problem made linear about its solution.

The response of the residuals to other noise, the constraint of the data on an unknown that was not fitted, and the
influence of single cycles follow from the derivatives at the solution, without another search. The cost is
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
WEIGHT_LEFT = 1e-6  # share of its weight left to a cycle that does not count: its own unknowns stay determined


class Scores(NamedTuple):
    """Gradient and curvature of the cost in d more unknowns, with all others fitted again."""

    gradient: Array  # (d,)
    information: Array  # (d, d)
    raw: Array  # (d,) curvature before elimination; the share that is left says how distinguishable an unknown is


def cut(columns: Array, blocks: Sequence[Block]) -> Iterator[Array]:
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
        known = fit.windows.rows, task.weights, priors(task, fit.q, fit.local)
        try:
            return cls.of(fit.derivatives, fit.residual, *known)
        except UnfollowableError:
            return None

    def changed(self, change: Callable[[Array], Array], priors: Priors) -> "LinearisedFit":
        """Change the derivatives (n, p + q) of each block."""
        return self.of(self.derivatives.changed(change), self.residual, self.rows, self.weights, priors)

    @cached_property
    def first(self) -> Integers:
        """First residual of each cycle, and their number, shape (cycles + 1,)."""
        return first_of(self.rows)

    def _gradients(self, columns: Iterable[Array]) -> tuple[Array, Array]:
        """Return w J'C of blocks C (rows, n) by the shared (cycles, p, n) and the cycles' unknowns (cycles, q, n)."""
        parts = [self._product(part, own, block) for (block, part), own in zip(self.derivatives, columns, strict=True)]
        both, p = np.concatenate(parts), self.priors.gradient.size
        return np.ascontiguousarray(both[:, :p]), np.ascontiguousarray(both[:, p:])

    def _product(self, left: Array, right: Array, block: Block) -> Array:
        """Return w L'R of each cycle of a block, shape (cycles, m, n), for L (rows, m) and R (rows, n)."""
        out = np.zeros((block.cycles.stop - block.cycles.start, left.shape[1], right.shape[1]))
        kernel(elimination.sum_cross)(left, np.ascontiguousarray(right), first_rows(self.first, block), out)
        out *= self.weights[block.cycles, None, None]
        return out

    @cached_property
    def reduced(self) -> SchurComplement:
        """The problem with the cycles' unknowns eliminated: ``H`` is the information on the shared ones."""
        return SchurComplement(self.blocks)

    @cached_property
    def _pull(self) -> Array:
        """The step (cycles, q) by the gradients of the cycles' unknowns alone."""
        return self.reduced.local_step(self.blocks.gl)

    @cached_property
    def gradients(self) -> Array:
        """Each cycle's gradient in the shared unknowns, shape (cycles, p)."""
        return self.reduced.reduced_gradients(self.blocks.cycle_g, self._pull)

    def refit(self, residuals: Repeat) -> Iterator[tuple[Block, Array]]:
        """Yield the residuals of B records after a linear fit from its true unknowns, block by block.

        Unchanged where the step raises the cost: at a jump of the motion the derivatives fail, and along what the
        unknowns hardly change the step is rounding.
        """
        shared, own = self._gradients(residuals(self.derivatives.blocks))
        steps = self._steps(*self.reduced.newton_step(shared.sum(axis=0), own))
        weights = np.repeat(self.weights, np.diff(self.first))
        rise = sum(
            np.einsum("n,nb->b", weights[block.rows], moved**2 - drawn**2)
            for block, drawn, moved in self._move(residuals, steps)
        )
        for block, drawn, moved in self._move(residuals, steps):
            yield block, np.where(rise <= 0, moved, drawn)

    def _move(self, residuals: Repeat, steps: Array) -> Iterator[tuple[Block, Array, Array]]:
        """Yield the residuals (n, B) of each block before and after steps (cycles, p + q, B)."""
        for (block, part), drawn in zip(self.derivatives, residuals(self.derivatives.blocks), strict=True):
            moved = np.array(drawn, order="C")
            kernel(elimination.add_along)(part, first_rows(self.first, block), steps[block.cycles], moved)
            yield block, drawn, moved

    def refit_columns(self, residuals: Array) -> Array:
        return np.concatenate([left for _, left in self.refit(partial(cut, residuals))])

    def without(self, spoilt: Mask) -> "LinearisedFit":
        """Return the fit after a Gauss-Newton step without some cycles, or as it was if that is worse."""
        weights = np.where(spoilt, WEIGHT_LEFT * self.weights, self.weights)
        others = self.of(self.derivatives, self.residual, self.rows, weights, self.priors)
        step, own = others.reduced.newton_step(others.blocks.g, others.blocks.gl)
        steps = self._steps(step[:, None], own[:, :, None])
        moved = [after[:, 0] for _, _, after in self._move(partial(cut, self.residual[:, None]), steps)]
        found = replace(others, residual=np.concatenate(moved), blocks=others.blocks.moved(step, own))
        return found if found.cost <= others.cost else self

    def _steps(self, step: Array, own: Array) -> Array:
        """Return steps (cycles, p + q, B) of all unknowns from those of the shared (p, B) and (cycles, q, B)."""
        return np.concatenate([np.broadcast_to(step, (len(self.rows), *step.shape)), own], axis=1)

    @property
    def cost(self) -> float:
        """Cost of the residuals alone, without the priors."""
        squares = np.add.reduceat(self.residual**2, self.first[:-1])
        return 0.5 * float(np.einsum("c,c...->...", self.weights, squares))

    def scores(self, columns: Array) -> Scores:
        """Return gradient and curvature in unknowns with position derivatives ``columns`` (N, d)."""
        columns = np.ascontiguousarray(columns)
        to_shared, to_local = self._gradients(cut(columns, self.derivatives.blocks))
        pull = self.reduced.local_step(to_local)
        beside = self.reduced.reduced_gradients(to_shared, pull).sum(axis=0)
        follow = np.einsum("ij,jd->id", self.reduced.covariance, beside)
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
            information=square - np.einsum("cqd,cqe->de", to_local, pull) - np.einsum("id,ie->de", follow, beside),
            raw=np.diag(square),
        )
