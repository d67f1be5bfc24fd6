"""Fits of the laws with memory: several starts of the lengths of the memory, through the passes of every law."""

from collections.abc import Sequence

from fitting.laws import Law
from fitting.model.memory import memory_tasks
from fitting.model.problem import Run
from fitting.search.exchange import best_end
from fitting.search.fit import Fit
from fitting.search.passes import finish


def fit_memory(law: Law, runs: Sequence[Run]) -> Fit | None:
    """Return the best fit of a law with memory; None where no start can be followed."""
    tasks = memory_tasks(law, runs)
    settled = best_end(tasks[0][0], [(start, None) for _, start in tasks])
    return None if settled is None else finish(settled) or settled
