"""A least-squares problem with unknowns shared by all cycles and unknowns of each cycle; its normal equations.

The cycles' own unknowns are eliminated from these (Schur complement), in plain loops
(`fitting.least_squares.elimination`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.least_squares import elimination
from stickslip.compute.arrays import Array, Integers, Mask, end_to_end
from stickslip.compute.compile import compiled

# Residuals (N,), m, and their derivatives if requested; None if the motion cannot be followed.
Evaluate = Callable[[Array, Array, bool], "tuple[Array, Derivatives | None] | None"]
MOST_AT_ONCE = 30_000  # residuals whose derivatives or repetitions are computed at a time: about 20 MB
MOST_KEPT = 8_000_000  # derivatives that are stored: 64 MB; others are computed again


class Block(NamedTuple):
    """Consecutive cycles, and their residuals."""

    cycles: slice
    rows: slice


def blocks_of(rows: Sequence[slice]) -> tuple[Block, ...]:
    stop = np.array([rows_of_cycle.stop for rows_of_cycle in rows])
    edges = [0, *(np.flatnonzero(np.diff((stop - 1) // MOST_AT_ONCE)) + 1).tolist(), stop.size]
    return tuple(Block(slice(a, b), slice(rows[a].start, rows[b - 1].stop)) for a, b in pairwise(edges))


def first_of(rows: Sequence[slice]) -> Integers:
    """Return the first residual of each cycle, and their number, shape (cycles + 1,)."""
    return np.array([*(rows_of_cycle.start for rows_of_cycle in rows), rows[-1].stop], np.int64)


class Derivatives:
    """Derivatives of residuals, block by block; ``derive`` returns (n, p + q), None if unfollowable."""

    def __init__(self, blocks: Sequence[Block], derive: "Callable[[Block], Array | None]") -> None:
        self.blocks, self.derive = blocks, derive
        self._stored: dict[int, Array] = {}
        self._room = MOST_KEPT

    def __iter__(self) -> Iterator[tuple[Block, Array]]:
        for number, block in enumerate(self.blocks):
            jacobian = self._stored.get(number)
            if jacobian is None:
                jacobian = self.derive(block)
                if jacobian is None:
                    raise UnfollowableError
                if jacobian.size <= self._room:
                    self._stored[number] = jacobian
                    self._room -= jacobian.size
            yield block, jacobian

    def columns(self, unknowns: slice = slice(None)) -> Array:
        return np.concatenate([jacobian[:, unknowns] for _, jacobian in self])

    def transform(self, change: Callable[[Array], Array]) -> "Derivatives":
        return Derivatives(self.blocks, partial(_change_part, self.derive, change))


def _change_part(
    derive: Callable[[Block], Array | None], change: Callable[[Array], Array], block: Block
) -> Array | None:
    jacobian = derive(block)
    return None if jacobian is None else change(jacobian)


class UnfollowableError(ArithmeticError):
    """The motion near a point cannot be followed."""


@dataclass(frozen=True, eq=False)
class LeastSquaresProblem:
    evaluate: Evaluate  # ``evaluate(u, l, derivatives)`` with u (p,), l (cycles, q)
    rows: tuple[slice, ...]  # which residuals belong to which cycle
    weights: Array  # (cycles,) 1/variance of each cycle's residuals, 1/m^2
    lower: Array  # (p,) bounds of u
    upper: Array
    prior: Array  # (p,) prior means of u and 1/sd^2; 0 where nothing is known
    precision: Array
    local_prior: Array  # (cycles, q) the same for the cycles' own unknowns
    local_precision: Array
    local_upper: Array | float = math.inf  # (cycles, q) of the cycles' own unknowns
    # ``evaluate_cycles(u, cycles)`` returns ``evaluate(nothing, l, derivatives)`` of these cycles alone, u held
    evaluate_cycles: Callable[[Array, Integers], Evaluate] | None = None

    def of_cycles(self, u: Array, cycles: Integers) -> "LeastSquaresProblem | None":
        """Return the problem of these cycles alone, u held; None of no cycles, or without ``evaluate_cycles``."""
        if self.evaluate_cycles is None or not cycles.size:
            return None
        nothing = np.empty(0)
        return LeastSquaresProblem(
            evaluate=self.evaluate_cycles(u, cycles),
            rows=end_to_end([self.rows[k] for k in cycles]),
            weights=self.weights[cycles],
            lower=nothing,
            upper=nothing,
            prior=nothing,
            precision=nothing,
            local_prior=self.local_prior[cycles],
            local_precision=self.local_precision[cycles],
            local_upper=np.broadcast_to(self.local_upper, self.local_prior.shape)[cycles],
        )

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        return self.first[:-1]

    @cached_property
    def first(self) -> Integers:
        return first_of(self.rows)

    @property
    def weight(self) -> Array:
        return np.repeat(self.weights, np.diff(self.first))


def cost(problem: LeastSquaresProblem, u: Array, local: Array, residual: Array) -> float:
    shared = 0.5 * float(np.sum(problem.precision * (u - problem.prior) ** 2))
    return shared + float(np.sum(cost_by_cycle(problem, local, residual)))


def cost_by_cycle(problem: LeastSquaresProblem, local: Array, residual: Array) -> Array:
    costs = np.sum(problem.local_precision * (local - problem.local_prior) ** 2, axis=1)
    costs += problem.weights * np.add.reduceat(residual**2, problem.starts)
    return np.asarray(0.5 * costs)


HELD_CURVATURE = 1e12  # added to the curvature of an unknown that must not move, over it
ROUNDING = 1e-14  # curvature after elimination over that before, below which it is rounding


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Gradient and Hessian in blocks; shapes (p,), (p, p), (c, q), (c, q, q), (c, p, q)."""

    g: Array
    H: Array
    gl: Array
    Hl: Array
    cross: Array
    cycle_g: Array  # (c, p): each cycle's share of g, without the priors of u
    cycle_curvature: Array  # (c, p, p): each cycle's share of H, likewise

    def shift(self, step: Array, local_step: Array) -> "NormalEquations":
        """Return the equations after steps (p,) and (c, q), with the same curvatures."""
        by_local = np.einsum("cpq,cq->cp", self.cross, local_step)
        return replace(
            self,
            g=self.g + np.einsum("ij,j->i", self.H, step) + by_local.sum(axis=0),
            gl=self.gl + np.einsum("cij,cj->ci", self.Hl, local_step) + np.einsum("cpq,p->cq", self.cross, step),
            cycle_g=self.cycle_g + np.einsum("cij,j->ci", self.cycle_curvature, step) + by_local,
        )


class Priors(NamedTuple):
    """Curvature (p, p) and gradient (p,) of the shared unknowns' priors, and 1/sd^2 and gradient (c, q) of the own."""

    precision: Array
    gradient: Array
    local_precision: Array
    local_gradient: Array


def priors(problem: LeastSquaresProblem, u: Array, local: Array) -> Priors:
    return Priors(
        np.diag(problem.precision),
        problem.precision * (u - problem.prior),
        problem.local_precision,
        problem.local_precision * (local - problem.local_prior),
    )


def normal_equations(
    first: Integers, weights: Array, residual: Array, derivatives: Derivatives, priors: Priors
) -> NormalEquations:
    """Sum residuals (N,) and their derivatives over cycles that begin at ``first`` (c + 1,)."""
    p, (c, q) = priors.gradient.size, priors.local_gradient.shape
    square, gradient = np.zeros((c, p + q, p + q)), np.zeros((c, p + q))
    for block, jacobian in derivatives:
        cycles, begin = block.cycles, first_rows(first, block)
        kernel(elimination.sum_products)(jacobian, residual[block.rows], begin, square[cycles], gradient[cycles])
    square *= weights[:, None, None]
    gradient *= weights[:, None]
    return NormalEquations(
        g=gradient[:, :p].sum(axis=0) + priors.gradient,
        H=square[:, :p, :p].sum(axis=0) + priors.precision,
        gl=gradient[:, p:] + priors.local_gradient,
        Hl=square[:, p:, p:] + priors.local_precision[:, :, None] * np.eye(q),
        cross=np.ascontiguousarray(square[:, :p, p:]),
        cycle_g=gradient[:, :p],
        cycle_curvature=square[:, :p, :p],
    )


class SchurComplement:
    """The normal equations with the cycles' unknowns eliminated; ``bounded`` (cycles, q) ones do not move."""

    def __init__(self, blocks: NormalEquations, damping: float = 0.0, bounded: Mask | None = None) -> None:
        c, q = blocks.gl.shape
        p = blocks.g.size
        raised = damping if bounded is None else np.where(bounded, HELD_CURVATURE, damping)
        Hl = blocks.Hl + (raised * np.einsum("cii->ci", blocks.Hl))[:, :, None] * np.eye(q)
        self._cross, self._raw = blocks.cross, np.diag(blocks.H)
        self._inverse, self._spread = np.empty((c, q, q)), np.empty((c, q, p))
        self.H = blocks.H + damping * np.diag(np.diag(blocks.H))
        kernel(elimination.invert)(Hl, self._inverse)
        kernel(elimination.eliminate)(self._cross, self._inverse, self.H, self._spread)

    @cached_property
    def covariance(self) -> Array:
        """Covariance (p, p) of the shared unknowns under the assumed noise."""
        scale, inverse = scaled_inverse(self.H, self._raw)
        return np.asarray(inverse * scale[:, None] * scale)

    @cached_property
    def _step_inverse(self) -> Array:
        """The inverse (p, p) without directions that are lost in rounding: a step along them is random."""
        scale, size, axes = scaled_axes(self.H, self._raw)
        rounding = ROUNDING * np.sum(np.abs(axes) * (np.sqrt(self._raw) * scale)[:, None], axis=0) ** 2
        half = axes * scale[:, None] / np.sqrt(np.where(size > rounding, size, np.inf))
        return np.asarray(np.einsum("ik,jk->ij", half, half))

    def by_cycle(self, cycle_curvature: Array) -> Array:
        """Return each cycle's information (c, p, p) on the shared unknowns, its own eliminated."""
        return np.asarray(cycle_curvature - np.einsum("cpq,cqr->cpr", self._cross, self._spread))

    def by_prior(self, precision: Array) -> Array:
        """Return the covariance (c, p, p) of each cycle's reduced gradient from the priors' 1/sd^2 (c, q)."""
        return np.asarray(np.einsum("cqp,cq,cqr->cpr", self._spread, precision, self._spread))

    def local_step(self, gl: Array) -> Array:
        """Return inv(Hl) gl, shape (cycles, q); of several gradients (cycles, q, n) each."""
        return np.asarray(np.einsum("cij,cj...->ci...", self._inverse, gl))

    def reduced_gradient(self, g: Array, pull: Array) -> Array:
        return np.asarray(g - np.einsum("cpq,cq...->p...", self._cross, pull))

    def reduced_gradients(self, cycle_g: Array, pull: Array) -> Array:
        """Return each cycle's share of the reduced gradient, without the priors of u."""
        return np.asarray(cycle_g - np.einsum("cpq,cq...->cp...", self._cross, pull))

    def newton_step(self, g: Array, gl: Array) -> tuple[Array, Array]:
        """Return the step of the shared (p,) and own unknowns (cycles, q); or with one axis more."""
        pull = self.local_step(gl)
        step = -np.einsum("ij,j...->i...", self._step_inverse, self.reduced_gradient(g, pull))
        return step, self.back_substitute(step, pull)

    def back_substitute(self, step: Array, pull: Array) -> Array:
        """Return the cycles' own step (cycles, q) for a shared one (p,); or (cycles, q, n) for (p, n)."""
        return np.asarray(-pull - np.einsum("cqp,p...->cq...", self._spread, step))


def eigen(matrix: Array) -> tuple[Array, Array]:
    turned, vectors = matrix.copy(), np.empty(matrix.shape)  # one layout: compiled once
    kernel(elimination.eigen)(turned, vectors)
    return np.diag(turned).copy(), vectors


def scaled_axes(H: Array, raw: Array) -> tuple[Array, Array, Array]:
    """Return units (p,) from the curvatures ``raw`` before elimination, and H's eigenvalues and axes in these units."""
    scale = 1 / np.sqrt(np.maximum(np.diag(H), np.maximum(ROUNDING * raw, 1e-100)))
    return scale, *eigen(np.clip(H * scale[:, None] * scale, -1.0, 1.0))  # rounding must not look like information


def scaled_inverse(H: Array, raw: Array) -> tuple[Array, Array]:
    """Return units (p,), and H's inverse in these units.

    A direction below rounding gets the variance of a prior, so that it does not look constrained.
    """
    scale, size, axes = scaled_axes(H, raw)
    half = axes / np.sqrt(np.maximum(size, 1e-15))
    return scale, np.asarray(np.einsum("ik,jk->ij", half, half))


def sum_gradients(first: Integers, residual: Array, derivatives: Derivatives, width: int) -> Array:
    """Return J'r of each cycle, (c, width), for residuals (N,)."""
    out = np.zeros((first.size - 1, width))
    for block, jacobian in derivatives:
        kernel(elimination.sum_gradients)(jacobian, residual[block.rows], first_rows(first, block), out[block.cycles])
    return out


def first_rows(first: Integers, block: Block) -> Integers:
    """Return the first rows (c + 1,) of a block's cycles within the block."""
    return np.asarray(first[block.cycles.start : block.cycles.stop + 1] - block.rows.start)


def kernel(function: Callable[..., None]) -> Callable[..., None]:
    return compiled(function, (elimination.__name__,))
