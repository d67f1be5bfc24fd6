"""Fits of the laws with memory: several starts of the lengths of the memory, through the passes of every law."""

from collections.abc import Sequence
from dataclasses import replace

from fitting.laws import Law
from fitting.model.memory import memory_tasks
from fitting.model.problem import Run
from fitting.search.exchange import best_end
from fitting.search.fit import Fit
from fitting.search.passes import finish


def fit_memory(law: Law, runs: Sequence[Run]) -> Fit | str:
    """Return the best fit of a law with memory, or why there is none.

    The belt is taken as steady: bristles swing after a landing, which sticks show as a ripple.
    """
    if any(run.motion.compliance is not None for run in runs):
        return "a belt that slows under load is not modelled with memory"
    tasks = memory_tasks(law, [replace(run, ripple=None) for run in runs])
    settled = best_end(tasks[0][0], [(start, None) for _, start in tasks])
    return "its motion cannot be followed" if settled is None else finish(settled) or settled
