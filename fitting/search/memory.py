"""Fits of the laws with memory: several starts of the lengths of the memory, through the passes of every law.

The rig of a start and its friction in slip are those of the regression, its load at rest that of the nearest law.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from operator import itemgetter

import numpy as np

from fitting import noise_levels
from fitting.laws import Law, hold_confounded, natural_size
from fitting.model import unknowns
from fitting.model.memory import STICK_SPEED, MemoryProblem, Sizes, encode, memory_task, middle_of_slip, warm_start
from fitting.model.problem import Run, break_away_position
from fitting.model.unknowns import PER_RUN
from fitting.search.exchange import settle_from_starts
from fitting.search.fit import Fit, PassNoise
from fitting.search.passes import finish, fit_cycles
from rig_sim.friction import pair
from rig_sim.friction.memory import BRISTLE, MEMORY_LAWS
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

SEARCHED_CYCLES = 8  # of each run, one after another, which choose among the starts: as many parameters and more
# Of the starts, over the travel: presliding of bristles, and D of rate and state.
PRESLIDING, LENGTHS = (1e-3, 1e-2, 1e-4), (2e-2, 2e-3, 2e-4)
TRIED = (1.0, 0.1, 0.01, 0.001)  # values of a rate's parameters over their sizes by unit: lengths from the travel down
MOST_TRIALS, SEED = 256, 0
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
    if not begun:
        return "no initial values were found that follow the measured slips; set them with --start"
    tasks = [memory_task(law, few_cycles, values) for values, _ in begun]
    starts = [warm_start(task, u) for task, (_, u) in zip(tasks, begun, strict=True)]
    few = settle_from_starts(
        tasks[0], [(start, None) for start in starts], smallest_other_error=nearest.geometric_mean_rms
    )
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
    if law.own_memory:
        yield from ((values, problem.start) for values in own_starts(law, problem))
        return
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


def own_starts(law: Law, problem: MemoryProblem) -> list[dict[str, float]]:
    """Return first values of a law of one's own: the nearest to friction along the measured slips.

    For trial values of the rate's parameters the state follows the measured motion, and the other parameters are
    fitted to the measured force.
    """
    size, motion, p = Sizes.of(problem), problem.motions[0], unknowns.values(problem.start[:PER_RUN])
    cycles = problem.runs[0].cut.used[:SEARCHED_CYCLES]
    first, last = middle_of_slip(motion, cycles[0]), cycles[-1].slip[1]
    sliding = np.zeros(motion.time.size, np.bool_)
    for cycle in cycles:
        sliding[slice(*cycle.slip)] = True
    seen, time, v = sliding[first:last], motion.time[first:last], motion.velocity[first:last]
    position, acceleration = motion.position[first:last], motion.acceleration[first:last]
    force = (acceleration + p.damping * v + p.K * (position - p.datum))[seen]
    speed = np.where(seen, np.maximum(motion.belt_speed - v, STICK_SPEED * size.belt), STICK_SPEED * size.belt)
    law = hold_confounded(law, size.friction, size.speed)[1]
    formulas, fixed, names = encode(law, size), dict(law.fix or {}), law.parameters
    follow = compiled(pair.friction_along, (pair.__name__,), _nrt=False)
    friction, slopes = np.empty(time.size), np.empty((time.size, len(names)))

    def along(values: dict[str, float]) -> tuple[Array, Array] | None:
        """Return friction less the force, over its size, and its derivatives by the free parameters at a held state."""
        with np.errstate(all="ignore"):
            follow(formulas, np.array([(fixed | values)[name] for name in names]), time, speed, friction, slopes)
        columns = slopes[seen][:, [names.index(name) for name in law.free]] / size.friction
        error = (friction[seen] - force) / size.friction
        return (error, columns) if np.all(np.isfinite(error)) and np.all(np.isfinite(columns)) else None

    natural = {name: natural_size(law, name, size.friction, size.speed) for name in law.free} | dict(law.start or {})
    tried = [name for name in law.free if name in law.state_rate.parameters and name not in (law.start or {})]
    linear = [k for k, name in enumerate(law.free) if name not in tried and name not in (law.start or {})]
    found: list[tuple[float, dict[str, float]]] = []
    trials = list(product(TRIED, repeat=len(tried)))
    if len(trials) > MOST_TRIALS:
        trials = [trials[k] for k in np.random.default_rng(SEED).choice(len(trials), MOST_TRIALS, replace=False)]
    for shares in trials:
        values = natural | {name: share * natural[name] for name, share in zip(tried, shares, strict=True)}
        if (now := along(values)) is None:
            continue
        step = np.linalg.lstsq(now[1][:, linear], -now[0], rcond=None)[0]
        moved = {law.free[k]: values[law.free[k]] + float(change) for k, change in zip(linear, step, strict=True)}
        for own in (values | moved, values):
            ends = along(own) if law.allows(own) else None
            if ends is not None:
                found.append((float(np.mean(ends[0] ** 2)), own))
                break
    found.sort(key=itemgetter(0))
    return [values for _, values in found[: len(LENGTHS)]]


def _with_few_cycles(run: Run) -> Run:
    last = run.cut.used[:SEARCHED_CYCLES][-1].number
    return replace(run, cut=replace(run.cut, cycles=tuple(cycle for cycle in run.cut.cycles if cycle.number <= last)))
