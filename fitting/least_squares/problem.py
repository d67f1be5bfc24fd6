"""A least-squares problem of unknowns that all cycles share and of each cycle's own, and its objective."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stickslip.compute.arrays import Array, Integers, end_to_end

# Residuals (N,) m and, when asked for, their derivatives (N, p + q); None when the flow cannot be followed there.
Evaluate = Callable[[Array, Array, bool], tuple[Array, Array] | None]


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
        return np.array([rows.start for rows in self.rows], np.int64)

    @cached_property
    def first(self) -> Integers:
        """First residual of each cycle, and their number, shape (cycles + 1,)."""
        return np.append(self.starts, self.rows[-1].stop)

    @cached_property
    def owner(self) -> NDArray[np.int64]:
        """Cycle of each residual."""
        return np.repeat(np.arange(len(self.rows)), [rows.stop - rows.start for rows in self.rows])


def cost(problem: LeastSquaresProblem, u: Array, local: Array, residual: Array) -> float:
    shared = 0.5 * float(np.sum(problem.precision * (u - problem.prior) ** 2))
    return shared + float(np.sum(cost_by_cycle(problem, local, residual)))


def cost_by_cycle(problem: LeastSquaresProblem, local: Array, residual: Array) -> Array:
    own = np.sum(problem.local_precision * (local - problem.local_prior) ** 2, axis=1)
    own += problem.weights * np.add.reduceat(residual**2, problem.starts)
    return np.asarray(0.5 * own)
