"""Fits of the laws with memory: several starts of the lengths of the memory, through the passes of every law.

The steady friction of a start, and the rig, are those of the nearest law without memory.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fitting import noise_levels
from fitting.laws import Law
from fitting.model.memory import memory_task, start_beside
from fitting.model.problem import Run
from fitting.search.exchange import best_end
from fitting.search.fit import Fit
from fitting.search.passes import finish
from rig_sim.friction.memory import BRISTLE, MEMORY_LAWS
from stickslip.compute.arrays import Array

SEARCHED_CYCLES = 8  # of each run, one after another, which choose among the starts: as many parameters and more
# Of the starts, over the travel: presliding of bristles, and D of rate and state.
PRESLIDING, LENGTHS = (1e-3, 1e-2, 1e-4), (2e-2, 2e-3, 2e-4)
B_OVER_FRICTION, A_OVER_B = 0.1, 0.3  # of the starts; the former where friction does not fall


def fit_memory(law: Law, runs: Sequence[Run], nearest: Fit, noise: Array | None = None) -> Fit | str:
    """Return the best fit of a law with memory, or why there is none; ``nearest`` is that of a law without.

    A few cycles choose among the starts; with the ``noise`` of a position (runs,), m, a law that is lost there is not
    fitted to the others.  The belt is taken as steady: bristles swing after a landing, which sticks show as a ripple.
    """
    if any(run.motion.compliance is not None for run in runs):
        return "a belt that slows under load is not modelled with memory"
    steady = [replace(run, ripple=None) for run in runs]
    values = list(starting_values(law, nearest))
    task = memory_task(law, [_with_few_cycles(run) for run in steady], values[0])
    starts = [start_beside(memory_task(law, task.problem.runs, own), nearest.u) for own in values]
    few = best_end(task, [(start, None) for start in starts])
    if few is None:
        return "its motion cannot be followed"
    if noise is not None and few.geometric_mean_rms > noise_levels.LOST * float(np.max(noise)):
        return "it does not describe the first cycles"
    task = memory_task(law, steady, values[0])
    settled = best_end(task, [(start_beside(task, few.u)._replace(q=few.q), None)])
    return "its motion cannot be followed" if settled is None else finish(settled) or settled


def starting_values(law: Law, nearest: Fit) -> Iterator[dict[str, float]]:
    """Yield starts of a law's parameters: the steady friction of another law, and lengths of two decades."""
    motion = nearest.problem.motions[0]
    fastest = float(np.max(motion.belt_speed - motion.velocity))
    speeds = np.linspace(0.0, fastest, 101)
    friction = nearest.task.friction(nearest.q, speeds)
    rest, sliding = float(friction[0]), float(friction[-1])
    if MEMORY_LAWS[law.name].code == BRISTLE:
        fallen = np.flatnonzero(friction < sliding + (rest - sliding) / math.e)
        v_s = float(speeds[fallen[0]]) if fallen.size else fastest
        for length in PRESLIDING:
            s0 = rest / (length * motion.travel)
            yield {"s0": s0, "s1": math.sqrt(s0), "Fc": sliding, "Fs": rest, "v_s": v_s}
        return
    fall = float(friction[10] - sliding) / math.log(10)  # by e-folds of the speed
    b = fall / (1 - A_OVER_B) if fall > 0 else B_OVER_FRICTION * rest
    level = sliding + (1 - A_OVER_B) * b * math.log(fastest / (law.fix or {})["v0"])
    for length in LENGTHS:
        yield {"F0": level, "a": A_OVER_B * b, "b": b, "D": length * motion.travel}


def _with_few_cycles(run: Run) -> Run:
    last = run.cut.used[:SEARCHED_CYCLES][-1].number
    return replace(run, cut=replace(run.cut, cycles=tuple(cycle for cycle in run.cut.cycles if cycle.number <= last)))
