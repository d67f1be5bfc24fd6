"""Every law fitted to the runs: searched on the thinned record, then polished on the whole one, in one process or more.

A ramp law starts a second time from its jump law, so the two of one curve are fitted one after the other; the three
curves know nothing of each other and may be fitted side by side.
"""

import logging
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from daq.base.compute.workers import workers
from fitting.data.frame import MeasuredMotion
from fitting.estimation import trajectory
from fitting.estimation.covariance import without_level_errors
from fitting.estimation.fit import Fit
from fitting.estimation.objective import fit_objective
from fitting.model.problem import EstimationProblem, Run
from rig_sim.friction.law import LAWS

logger = logging.getLogger(__name__)
LOCAL_MINIMUM = 0.995  # of a law's error: where its jump or ramp law errs less than that, it found a better place
# The same where noise is nearly all of the error: of 12,000 samples it moves an error by 0.0001 for each parameter.
LOCAL_MINIMUM_IN_NOISE = 0.9995
NOISE_ALONE = 1.2  # times the noise
OTHER_CURVE = 0.5  # of a law's error: where a law of another curve errs so much less, the law starts from there too
# Times the noise, of the best law's error after the first pass: beyond, the laws that err up to NEAR times as much
# start again.  The first pass of a true law leaves 0.5 to 10 times the noise, in harsh records up to 20, where it is
# lost 50 to 400.
LOST, NEAR = 20.0, 3.0
GIVE_UP_FACTOR = 30.0  # times the best law's error after the first pass: beyond, no more passes
# Times the best law's error: up to there a law is fitted to every sample, beyond only to the thinned record,
# which saves CPU time.  Chosen by trial; not swept.
FULL_RECORD_FACTOR = 10.0


def fit_laws(
    laws: Sequence[int],
    runs: Sequence[Run],
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
    scheduler: str | None = None,
) -> list[Fit]:
    """Fit laws to runs of one contact.

    Parameters
    ----------
    laws : sequence of int
    runs : sequence of Run
    jobs : int
        Processes; more than one for each curve are not started.
    progress : callable, optional
        Called with the number of laws searched.
    scheduler : str, optional
        Address of a dask scheduler whose workers do it instead.

    Returns
    -------
    list of Fit
        Jump laws before ramp laws, each by number; a law whose flow cannot be followed is missing.
    """
    curves: dict[str, list[int]] = {}
    for law in sorted(laws):
        curves.setdefault(LAWS[law].curve, []).append(law)
    found: list[Fit] = []
    with workers(min(jobs, len(curves)), scheduler) as each:
        done = 0
        for own, chain in zip(curves.values(), each(partial(_coarse_fits, runs=runs), curves.values()), strict=True):
            found += chain
            done += len(own)
            if progress is not None:
                progress(float(done))
        started = each(partial(_started_from_others, runs=runs, coarse=tuple(found)), curves.values())
        found = [fit for own in started for fit in own]
        for step, factor in ((_refined, GIVE_UP_FACTOR), (_final, FULL_RECORD_FACTOR)):
            limit = factor * min((fit.geometric_mean_rms for fit in found), default=0.0)
            chains = [[fit for fit in found if LAWS[fit.law].curve == curve] for curve in curves]
            found = [fit for own in each(partial(step, limit=limit), chains) for fit in own]
            for fit in found:
                logger.debug("%s: law %d, %.4g um", step.__name__.strip("_"), fit.law, 1e6 * fit.geometric_mean_rms)
    return sorted(found, key=lambda fit: (LAWS[fit.law].ramp, fit.law))


def _coarse_fits(laws: Sequence[int], runs: Sequence[Run]) -> list[Fit]:
    """Fit the laws of one curve roughly, the jump law first."""
    found: dict[int, Fit] = {}
    for law in laws:
        near = found.get(law - 1) if LAWS[law].ramp else None
        fit = trajectory.coarse_fit(EstimationProblem.build(law, runs), near)
        if fit is not None:
            found[law] = fit
    return list(found.values())


def _started_from_others(laws: Sequence[int], runs: Sequence[Run], coarse: Sequence[Fit]) -> list[Fit]:
    """Start the laws of one curve from the fits of other curves too, where these err much less, or are contained."""
    own = {fit.law: fit for fit in coarse if fit.law in laws}
    for law in laws:
        if LAWS[law].curve == "constant":
            continue  # it is contained in the others
        for near in coarse:
            related = LAWS[near.law].contact == LAWS[law].contact and LAWS[near.law].curve != LAWS[law].curve
            factor = LOCAL_MINIMUM if LAWS[near.law].curve == "constant" else OTHER_CURVE
            if related and (law not in own or near.geometric_mean_rms < factor * own[law].geometric_mean_rms):
                _keep_better(own, law, trajectory.coarse_fit(EstimationProblem.build(law, runs), near, alone=True))
    lowest = min(fit.geometric_mean_rms for fit in coarse)
    if lowest > LOST * _resolution([run.motion for run in runs]):
        for law, fit in list(own.items()):
            if fit.geometric_mean_rms < NEAR * lowest:
                _keep_better(own, law, trajectory.coarse_fit(fit.problem, fit, alone=True))
    for law in own:
        if LAWS[law].ramp and law - 1 in own:
            _contain(own, law)
    return list(own.values())


def _resolution(motions: Sequence[MeasuredMotion]) -> float:
    return max(motion.resolution for motion in motions)


def _refined(chain: Sequence[Fit], limit: float) -> list[Fit]:
    """Refine the laws of one curve whose error is below ``limit``; the others stay as they are."""
    found = {fit.law: fit for fit in _with_overtaking(chain)}
    for law, fit in list(found.items()):
        again = trajectory.refine(fit) if fit.geometric_mean_rms < limit else None
        found[law] = fit if again is None else again
    return _retried(found, limit, trajectory.fit_from)


def _with_overtaking(chain: Sequence[Fit]) -> Sequence[Fit]:
    """Return the fits of one curve with the cycles in which the mass overtakes the belt by one of them.

    A ramp law may describe such a cycle by a very low level, where its jump law shows that it is spoilt.
    """
    near = [fit for fit in chain if fit.geometric_mean_rms < LOST * _resolution(fit.problem.motions)]
    found = [trajectory.find_overtaking(fit) for fit in near]
    overtaking = np.any(found, axis=0)
    return [trajectory.with_overtaking(fit, overtaking) for fit in chain] if overtaking.any() else chain


def _retried(
    found: dict[int, Fit], limit: float, fit_from: Callable[[EstimationProblem, Fit], Fit | None]
) -> list[Fit]:
    """Fit a law again from its jump or ramp law where that errs less: it is stuck where the other finds a way.

    A ramp law contains its jump law.  A jump law can be as good as its ramp law only where the ramp is narrow, or where
    noise hides what it does.
    """
    for ramp in (law for law in found if LAWS[law].ramp and law - 1 in found):
        slowest = min(motion.belt_speed for motion in found[ramp].problem.motions)
        narrow = found[ramp].values.d < trajectory.NARROW_RAMP * slowest
        better, own = found[ramp].geometric_mean_rms, found[ramp - 1].geometric_mean_rms
        hidden = own < NOISE_ALONE * _resolution(found[ramp].problem.motions)
        factor = LOCAL_MINIMUM_IN_NOISE if hidden else LOCAL_MINIMUM
        if (narrow or hidden) and better < limit and better < factor * own:
            _keep_better(found, ramp - 1, fit_from(found[ramp - 1].problem, found[ramp]))
        _contain(found, ramp)
    return list(found.values())


def _contain(found: dict[int, Fit], ramp: int) -> None:
    """Make sure that a ramp law does not err more than its jump law."""
    jump = found[ramp - 1]
    if found[ramp].geometric_mean_rms > trajectory.CONTAINED * jump.geometric_mean_rms:
        _keep_better(found, ramp, trajectory.contain(found[ramp].problem, jump))


def _keep_better(found: dict[int, Fit], law: int, fit: Fit | None) -> None:
    """Take ``fit`` as the law's if it errs less than the one found."""
    if fit is not None and (law not in found or fit.geometric_mean_rms < found[law].geometric_mean_rms):
        found[law] = fit


def _final(chain: Sequence[Fit], limit: float) -> list[Fit]:
    """Fit the laws of one curve whose error is below ``limit`` to every sample; the others stay as they are.

    What all of them know is then without the errors of the levels.
    """
    found = {fit.law: trajectory.final_fit(fit) if fit.geometric_mean_rms < limit else fit for fit in chain}
    return [without_level_errors(fit, fit_objective(fit)) for fit in _retried(found, limit, _final_from)]


def _final_from(problem: EstimationProblem, near: Fit) -> Fit | None:
    """Fit one law to every sample from another's fit alone; None where that leads nowhere."""
    fit = trajectory.fit_from(problem, near)
    return None if fit is None else trajectory.final_fit(fit)
