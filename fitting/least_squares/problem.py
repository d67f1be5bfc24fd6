"""A least-squares problem of unknowns that all cycles share and of each cycle's own, and its objective."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stickslip.compute.arrays import Array, Integers, end_to_end

# Residuals (N,) m and, when asked for, their derivatives; None when the flow cannot be followed there.
Evaluate = Callable[[Array, Array, bool], "tuple[Array, Derivatives | None] | None"]
MOST_AT_ONCE = 30_000  # residuals whose derivatives or repetitions are made at a time: some 20 MB
MOST_KEPT = 8_000_000  # derivatives kept: 64 MB; others are made anew each time


class Block(NamedTuple):
    """Consecutive cycles, and their residuals."""

    cycles: slice
    rows: slice


def blocks_of(rows: Sequence[slice]) -> tuple[Block, ...]:
    """Divide cycles with residuals ``rows`` into blocks of about `MOST_AT_ONCE` residuals."""
    stop = np.array([own.stop for own in rows])
    edges = [0, *(np.flatnonzero(np.diff((stop - 1) // MOST_AT_ONCE)) + 1).tolist(), stop.size]
    return tuple(Block(slice(a, b), slice(rows[a].start, rows[b - 1].stop)) for a, b in pairwise(edges))


def first_of(rows: Sequence[slice]) -> Integers:
    """Return the first residual of each cycle, and their number, shape (cycles + 1,)."""
    return np.array([*(own.start for own in rows), rows[-1].stop], np.int64)


class Derivatives:
    """The derivatives of residuals by the shared and own unknowns, made block by block: of a long record they are many.

    ``derive`` returns those of a block, (n, p + q), or None where the motion cannot be followed.
    """

    def __init__(self, blocks: Sequence[Block], derive: "Callable[[Block], Array | None]") -> None:
        self.blocks, self.derive = blocks, derive
        self._kept: dict[int, Array] = {}
        self._room = MOST_KEPT

    def __iter__(self) -> Iterator[tuple[Block, Array]]:
        for number, block in enumerate(self.blocks):
            part = self._kept.get(number)
            if part is None:
                part = self.derive(block)
                if part is None:
                    raise UnfollowableError
                if part.size <= self._room:
                    self._kept[number] = part
                    self._room -= part.size
            yield block, part

    def columns(self, unknowns: slice = slice(None)) -> Array:
        """Return the derivatives (N, k) by some of the unknowns."""
        return np.concatenate([part[:, unknowns] for _, part in self])

    def changed(self, change: Callable[[Array], Array]) -> "Derivatives":
        """Return the same with each block's derivatives changed."""

        def derive(block: Block) -> Array | None:
            part = self.derive(block)
            return None if part is None else change(part)

        return Derivatives(self.blocks, derive)


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
    # (cycles, q) upper bounds of the cycles' own unknowns, to which a longer step is cut
    local_upper: Array | float = math.inf
    # ``some(u, cycles)`` returns ``evaluate(nothing, l, derivatives)`` of these cycles alone, u held.  Without it no
    # cycle is followed by itself.
    some: Callable[[Array, Integers], Evaluate] | None = None

    def of_cycles(self, u: Array, cycles: Integers) -> "LeastSquaresProblem | None":
        """Return the problem of these cycles (indices) alone, u (p,) held; None of no cycles, or without ``some``."""
        if self.some is None or not cycles.size:
            return None
        nothing = np.empty(0)
        return LeastSquaresProblem(
            evaluate=self.some(u, cycles),
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
        """First residual of each cycle; the cycles' rows are contiguous."""
        return self.first[:-1]

    @cached_property
    def first(self) -> Integers:
        """First residual of each cycle, and their number, shape (cycles + 1,)."""
        return first_of(self.rows)

    @property
    def weight(self) -> Array:
        """Weight (N,) of each residual."""
        return np.repeat(self.weights, np.diff(self.first))


def cost(problem: LeastSquaresProblem, u: Array, local: Array, residual: Array) -> float:
    shared = 0.5 * float(np.sum(problem.precision * (u - problem.prior) ** 2))
    return shared + float(np.sum(cost_by_cycle(problem, local, residual)))


def cost_by_cycle(problem: LeastSquaresProblem, local: Array, residual: Array) -> Array:
    own = np.sum(problem.local_precision * (local - problem.local_prior) ** 2, axis=1)
    own += problem.weights * np.add.reduceat(residual**2, problem.starts)
    return np.asarray(0.5 * own)
