"""Cycles in which the mass overtakes the belt after landing although its velocity does not show it."""

from dataclasses import replace

import numpy as np

from fitting.driver.fit import Fit
from fitting.driver.model import Model
from fitting.driver.passes import CYCLE_RESTART, first_pass, least_squares_problem
from fitting.driver.task import FitStart
from fitting.least_squares import levenberg_marquardt
from fitting.model.starts import cycle_starts
from stickslip.compute.arrays import Mask

# Share of a spoilt cycle's mean square beyond the usual one: less is left where the mass overtakes.
LEFT_BY_OVERTAKING = 0.5


def find_overtaking(at: Fit) -> Mask:
    """Return the spoilt cycles (cycles,) whose residual an unseen overtaking of the belt explains."""
    asked: Mask = at.windows.spoilt(at.residual) & ~at.windows.overtaking
    overtaking = np.zeros(asked.size, np.bool_)
    cycles = np.flatnonzero(asked)
    problem = at.task.problem.with_overtaking(asked)
    task, windows = replace(at.task, problem=problem), problem.windows(thinned=True)
    part = least_squares_problem(Model(task, windows, at.model.longest_step), at.noise, at.q).of_cycles(at.q, cycles)
    if part is None:
        return overtaking
    fresh = cycle_starts(windows, problem.motions, problem.cycles, at.u)[cycles]
    found = levenberg_marquardt.minimise(part, np.empty(0), fresh, **CYCLE_RESTART)
    if found is not None:
        run = at.windows.run
        usual = np.array([np.median(at.cycle_rms[run == own]) for own in run[cycles]]) ** 2
        left = windows.some(cycles).rms(found.residual) ** 2 - usual
        overtaking[cycles] = left < LEFT_BY_OVERTAKING * (at.cycle_rms[cycles] ** 2 - usual)
    return overtaking


def with_overtaking(at: Fit, overtaking: Mask) -> Fit | None:
    """Return the thinned record fitted with the belt overtaken in these cycles (cycles,) too."""
    problem = at.task.problem.with_overtaking(overtaking)
    fresh = cycle_starts(problem.windows(thinned=True), problem.motions, problem.cycles, at.u)
    local = np.where(overtaking[:, None], fresh, at.local)
    return first_pass(replace(at.task, problem=problem), FitStart(at.q, local), at.noise)
