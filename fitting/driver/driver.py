"""Tasks fitted to the same runs: which start from where others ended, and which are worth every sample.

Three levels of error decide.  A task that errs more than `LOST` times the resolution after its first pass may start
from others too.  One that errs `GIVEN_UP` times as much as the best one then is not settled, one that errs `NEAR` times
as much as the best one when settled is fitted to the thinned record alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fitting.driver.curves import LawCurve
from fitting.driver.fit import TaskFit
from fitting.driver.noise import PassNoise
from fitting.driver.passes import finish, first_pass, regressed_start, restarted_windows, settle
from fitting.driver.task import FitStart, Task, law_task
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import Run
from rig_sim.friction.law import LAWS

# Times the resolution, after the first pass: at half true laws are started again for nothing, at twice a ramp law that
# ended in a poor minimum is not.
LOST = 3.0
# Times the best error after the first pass.  True laws reach 20 there in harsh records; twice costs time alone.
GIVEN_UP = 30.0
NEAR = 10.0  # times the best error; no law that errs 5 times as much was in a set, and at 20 every sample costs time
# Times the error of the best, where that is lost: what errs less starts again.  At half a wrong law is judged by a poor
# minimum, at twice laws that cannot be the nearest take time.
RIVAL = 3.0
DONATES = 0.8  # of a task's error: another that errs less gives it a start; at 0.95 neighbours in noise do
NARROW = 0.02  # of the first width of a ramp that starts next to none, where it starts at its jump law's end
CONTAINED = 1.0005  # times the error of the curve that it contains: a ramp that errs more is in a poor minimum


def fit(task: Task) -> TaskFit | None:
    """Fit one task from its regression; None where the motion cannot be followed from there."""
    found = fit_all([task])
    return found[0] if found else None


def fit_from(task: Task, start: FitStart, noise: PassNoise) -> TaskFit | None:
    """Fit one task from where a fit ended, whose noise it takes; None where the motion cannot be followed."""
    first = first_pass(task, start, noise)
    settled = None if first is None else settle(first)
    return None if settled is None else finish(settled) or settled


def fit_beside(task: Task, others: Sequence[TaskFit]) -> TaskFit | None:
    """Fit one task that may also start where others ended; the error after the first pass decides."""
    tried = [first_pass(task, start_beside(task, other), other.noise) for other in others]
    tried.append(first_pass(task, regressed_start(task)))
    for first in sorted((one for one in tried if one is not None), key=lambda one: one.rms):
        settled = settle(first)
        if settled is not None:
            return finish(settled) or settled
    return None


def fit_laws(laws: Sequence[int], runs: Sequence[Run]) -> list[TaskFit]:
    """Fit laws to runs of one contact; a law whose motion cannot be followed is missing.

    All six are searched, whichever are asked for: what one leaves does not depend on which others compete.
    """
    tasks = [law_task(law, runs) for law in sorted(LAWS) if law > 0]
    asked = set(laws)
    return fit_all(tasks, lambda task: isinstance(task.curve, LawCurve) and task.curve.law in asked)


def fit_all(tasks: Sequence[Task], asked: Callable[[Task], bool] = lambda _: True) -> list[TaskFit]:
    """Fit tasks to the same runs, and return those ``asked`` for in the order given.

    A curve that contains another comes after it.  Each starts from the regression and, where another errs less after
    its first pass, from there too.
    """
    first = [first_pass(task, regressed_start(task)) for task in tasks]
    for k, task in enumerate(tasks):
        far = LOST * max(motion.resolution for motion in task.problem.motions)
        for donor in _donors(task, k, first):
            own = first[k]
            if own is None or (far < own.rms and donor.rms < DONATES * own.rms):
                trial = first_pass(task, start_beside(task, donor))
                if trial is not None and (own is None or trial.rms < own.rms):
                    first[k] = trial
    found = _again([one for one in first if one is not None])
    limit = GIVEN_UP * min((one.rms for one in found), default=0.0)
    found = _contained([one if one.rms > limit else settle(one) or one for one in found], settle)
    limit = NEAR * min((one.rms for one in found), default=0.0)
    wanted = [one for one in found if asked(one.task)]
    needed = [one for one in found if asked(one.task) or any(_is_ramp_of(other, one) for other in wanted)]
    needed = _contained([one if one.rms > limit else finish(one) or one for one in needed], finish)
    return [one for one in needed if asked(one.task)]


def start_beside(task: Task, donor: TaskFit, narrow: float = 1.0) -> FitStart:
    """Return where a task starts beside another's end: shared unknowns and windows as there, and the same friction.

    A ramp that starts next to none has ``narrow`` of its first width.
    """
    u, (_, n, m) = donor.u, task.widths
    mine, other = task.curve, donor.task.curve
    if isinstance(mine, LawCurve) and isinstance(other, LawCurve):
        u = task.problem.start_near(other.law, u)
        if mine.ramp and not other.ramp:
            u[Global.D :: PER_RUN] *= narrow
    elif mine.ramp and not other.ramp:
        u[Global.D :: PER_RUN] = narrow * task.problem.start[Global.D :: PER_RUN]
    u = np.clip(u, task.problem.lower, task.problem.upper)
    shared = u[list(task.places)]
    theta = mine.near(lambda s: donor.task.friction(donor.q, s), shared) if n else np.empty(0)
    return FitStart(np.concatenate([shared, theta, np.zeros(m)]), donor.local)


def _donors(task: Task, k: int, first: Sequence[TaskFit | None]) -> list[TaskFit]:
    """Return from where a task may start besides: its own curve without a ramp, and the other that errs least."""
    others = [one for j, one in enumerate(first) if j != k and one is not None]
    inner = [one for one in others if task.curve.is_ramp_of(one.task.curve)]
    best = sorted((one for one in others if one not in inner), key=lambda one: one.rms)[:1]
    return [*inner, *best]


def _again(found: list[TaskFit]) -> list[TaskFit]:
    """Let tasks start again with their windows at the smoothed motion, where even the best of them is lost."""
    lowest = min((one.rms for one in found), default=0.0)
    out = []
    for one in found:
        lost = LOST * max(motion.resolution for motion in one.task.problem.motions)
        trial = first_pass(one.task, restarted_windows(one)) if lowest > lost and one.rms < RIVAL * lowest else None
        out.append(trial if trial is not None and trial.rms < one.rms else one)
    return out


def _is_ramp_of(one: TaskFit, other: TaskFit) -> bool:
    return one.task.curve.is_ramp_of(other.task.curve)


def _contained(found: list[TaskFit], again: Callable[[TaskFit], TaskFit | None]) -> list[TaskFit]:
    """Let a ramp that errs more than the same curve without it start from there; it contains that."""
    out: list[TaskFit] = []
    for one in found:
        best = one
        for inner in (other for other in found if _is_ramp_of(one, other)):
            if best.rms > CONTAINED * inner.rms:
                trial = _moved(one, start_beside(one.task, inner, NARROW), inner.noise)
                better = None if trial is None else again(trial)
                if better is not None and better.rms < best.rms:
                    best = better
        out.append(best)
    return out


def _moved(at: TaskFit, start: FitStart, noise: PassNoise) -> TaskFit | None:
    """Return a fit's thinned record at another start; None where the motion cannot be followed there."""
    return first_pass(at.task, start, replace(noise, fade_sd=None))
