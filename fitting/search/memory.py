"""Fits of the laws with memory: several starts of the lengths of the memory, through the passes of every law.

The rig of a start and its friction in slip are those of the regression, its load at rest that of the nearest law.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fitting import noise_levels
from fitting.laws import Law
from fitting.model import unknowns
from fitting.model.memory import MemoryProblem, memory_task, warm_start
from fitting.model.problem import Run, break_away_position
from fitting.model.unknowns import PER_RUN
from fitting.search.exchange import settle_from_starts
from fitting.search.fit import Fit, PassNoise
from fitting.search.passes import finish, fit_cycles
from rig_sim.friction.memory import BRISTLE, MEMORY_LAWS
from stickslip.compute.arrays import Array

SEARCHED_CYCLES = 8  # of each run, one after another, which choose among the starts: as many parameters and more
# Of the starts, over the travel: presliding of bristles, and D of rate and state.
PRESLIDING, LENGTHS = (1e-3, 1e-2, 1e-4), (2e-2, 2e-3, 2e-4)
STRIBECK = ("Fc", "Fs", "v_s")
B_OVER_FRICTION, A_OVER_B, V_S_OVER_SPEED = 0.1, 0.3, 0.3  # of the starts; the last over the fastest slip


def fit_memory(law: Law, runs: Sequence[Run], nearest: Fit, noise: Array | None = None) -> Fit | str:
    """Return the best fit of a law with memory, or why there is none; ``nearest`` is that of a law without.

    A few cycles choose among the starts; with the ``noise`` of a position (runs,), m, a law that is lost there is not
    fitted to the others.  The belt is taken as steady: bristles swing after a landing, which sticks show as a ripple.
    """
    if any(run.motion.compliance is not None for run in runs):
        return "laws with memory are not modelled on a belt that slows under load"
    steady = [replace(run, ripple=None) for run in runs]
    problem = MemoryProblem.of_law(law, steady)
    few_cycles = MemoryProblem.of_law(law, [_with_few_cycles(run) for run in steady])
    begun = list(starting_values(law, problem, nearest))
    tasks = [memory_task(law, few_cycles, values) for values, _ in begun]
    starts = [warm_start(task, u) for task, (_, u) in zip(tasks, begun, strict=True)]
    few = settle_from_starts(tasks[0], [(start, None) for start in starts])
    if few is None:
        return "its motion could not be computed"
    if noise is not None and few.geometric_mean_rms > noise_levels.LOST * float(np.max(noise)):
        return "it does not describe the first cycles"
    task = memory_task(law, problem, begun[0][0])
    noise_seen = PassNoise(few.noise.sigma, np.ones(len(task.problem.cycles)))
    start = fit_cycles(task, warm_start(task, few.u)._replace(q=few.q), noise_seen)
    settled = settle_from_starts(task, [(start, noise_seen), (start, None)])
    return "its motion could not be computed" if settled is None else finish(settled) or settled


def starting_values(law: Law, problem: MemoryProblem, nearest: Fit) -> Iterator[tuple[dict[str, float], Array]]:
    """Yield starts of a law's parameters and of the rig: friction in slip of the regression, lengths of two decades.

    Friction at rest is the load of the spring as the mass leaves the belt, at the ``nearest`` law's rest position: of
    weakly damped bristles the regression has far less, and from that s0 grows without end.
    """
    motion, p = problem.motions[0], unknowns.values(problem.start[:PER_RUN])
    fastest = float(np.max(motion.belt_speed - motion.velocity))
    sliding = p.F / (1.0 + p.shape * fastest)
    rig = nearest.values
    load = rig.K * (break_away_position(motion, problem.runs[0].cut) - rig.datum) + rig.damping * rig.v_dr
    rest = max(load, p.F, sliding)
    if MEMORY_LAWS[law.name].code == BRISTLE:
        for length in PRESLIDING:
            s0 = rest / (length * motion.travel)
            own = {"s0": s0, "s1": math.sqrt(s0), "Fc": sliding, "Fs": rest, "v_s": V_S_OVER_SPEED * fastest}
            yield own, problem.start
        steady = {name: value for name, value in nearest.law_values.items() if name in STRIBECK}
        if len(steady) == len(STRIBECK):  # its limit
            s0 = steady["Fs"] / (min(PRESLIDING) * motion.travel)
            yield {"s0": s0, "s1": math.sqrt(s0)} | steady, nearest.u
        return
    middle = 0.5 * (rest + sliding)
    b = B_OVER_FRICTION * middle
    for length in LENGTHS:
        yield {"F0": middle, "a": A_OVER_B * b, "b": b, "D": length * motion.travel}, problem.start


def _with_few_cycles(run: Run) -> Run:
    last = run.cut.used[:SEARCHED_CYCLES][-1].number
    return replace(run, cut=replace(run.cut, cycles=tuple(cycle for cycle in run.cut.cycles if cycle.number <= last)))
