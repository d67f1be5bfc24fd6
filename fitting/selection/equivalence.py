"""Equivalent laws: a narrow ramp and a jump on a belt that slows under load make the same motion.

Without the belt's counts the two are one observable (`rig_sim.flow.modes`, droop): a belt that loses 1 % of its speed
at the load Fs turns law 5 into a perfect law 6.  So where a ramp law is in the set and its ramp is not wider than the
speed drop of a realistic belt, its jump law is fitted again with a belt compliance, and joins the set if its error is
then not larger.  Wider ramps exceed the loss of any belt drive.  Runs at several belt speeds can separate the two: a
ramp has the same width at every speed, while each run has its own compliance.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fitting.driver.driver import fit_from
from fitting.driver.fit import Fit
from fitting.driver.task import FitStart, law_task
from fitting.estimation import derived
from fitting.estimation.covariance import without_level_errors
from fitting.law import Law
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import Run
from fitting.selection.evidence import ModelSet
from stickslip.compute.arrays import Array
from stickslip.units import Measured

WIDEST_BELT_LOSS = 0.03  # speed that a belt may lose under the load Fs, over its own
WIDEST_BY_RIPPLE = 0.08  # width over the belt's speed of a ramp that a belt with 3 % ripple can imitate
# Rms of the drag over that of the whole record; on a steady belt it stays below.  Half and twice decide the same on 26
# records.
UNSTEADY_DRAG = 1.3
# Width over the belt's speed: a ramp that may be wider is not excluded.  At 1 mm of noise the interval reaches 0.1 to
# 0.3; on an encoder's records 0.001 to 0.02, so that half or twice the limit changes none.
OPEN_RAMP = 0.05
# Width over the belt's speed: a narrower ramp is a jump.  It is left within 0.1 ms; an encoder's records show widths
# from 0.001 to 0.02 on.  In harsh records of law 3 one cycle in 21 ends in a better minimum under law 4, at widths to
# 0.0012.
CLOSED = 2e-3
# Score beyond what the ramp's parameters cost: a ramp law that errs plainly more than its jump law stays out.
# Chosen; half and twice decide the same on 26 records.
RAMP_SCORE_MARGIN = 4.0
# Difference in log error: a hyperbola on a compliant belt and a ramp differ by less.  As above.
SAME = 0.05


def equivalent_jump_law(fits: Sequence[Fit], members: Sequence[Law], runs: Sequence[Run]) -> Fit | None:
    """Fit the jump law of a narrow ramp on a compliant belt.

    None where a belt was measured, the set's best ramp is not narrow, or its jump law is already in the set, not
    requested or does not converge.
    """
    if any(run.motion.belt_measured for run in runs):
        return None
    own = [fit.law for fit in fits if fit.law.has_kernel]
    ramp = next((law for law in members if law in own and law.ramp), None)
    jump = next((law for law in own if ramp and ramp.is_ramp_of(law)), None)
    if jump is None or jump in members:
        return None
    near = next(fit for fit in fits if fit.law == ramp)
    if near.values.d > WIDEST_BELT_LOSS * min(run.motion.belt_speed for run in runs):
        return None
    compliance = near.values.d * near.values.K / near.values.F
    u = near.u.copy()
    u[Global.COMPLIANCE :: PER_RUN] = compliance
    compliant = [replace(run, motion=replace(run.motion, compliance=Measured(compliance, compliance))) for run in runs]
    task = law_task(jump, compliant)
    fit = fit_from(task, FitStart(u[list(task.places)], near.local), near.noise.without_fade)
    return None if fit is None else without_level_errors(fit)


def closed_ramps(fits: Sequence[Fit]) -> list[tuple[Law, Law]]:
    """Return (jump law, ramp law) where the ramp is as narrow as it may be: both are then the same model.

    The smaller error of the ramp law is then due to the minimiser: it is not evidence for a ramp.
    """
    return [
        (jump.law, fit.law)
        for fit in fits
        for jump in fits
        if fit.law.is_ramp_of(jump.law) and fit.values.d < CLOSED * min(m.belt_speed for m in fit.problem.motions)
    ]


def mean_excess(twin: Array, ramp: Array) -> float:
    """Return the mean difference of log errors (units,) of the twin and the ramp law."""
    return float(np.mean(twin - ramp))


def explained_by_belt_ripple(ramp: Fit, drag: Array, runs: Sequence[Run]) -> bool:
    """Return whether the ramp of constant friction (law 2) may be a belt whose speed varies.

    Where the mass never sticks again, jump and ramp differ in the start-up drag alone, in which a varying belt speed
    looks like a ramp. It may be one if the ramp is not wider than such a variation, and if the drag (log error of its
    pieces) fits worse than the rest, which does not depend on the belt.
    """
    noise = max(run.motion.resolution for run in runs)
    rest = math.hypot(ramp.geometric_mean_rms, noise)  # as the log errors are floored
    narrow = ramp.values.d <= WIDEST_BY_RIPPLE * min(run.motion.belt_speed for run in runs)
    measured = any(run.motion.belt_measured for run in runs)
    return not measured and bool(narrow) and float(np.median(drag)) > math.log(UNSTEADY_DRAG * rest)


def with_open_ramps(
    chosen: ModelSet, fits: Sequence[Fit], runs: Sequence[Run], alpha: float, samples: float, *, sustained: bool
) -> ModelSet:
    """Return the set with each ramp law, next to its jump law, whose ramp the data cannot show to be narrow.

    A ramp acts in a few samples of a cycle. Where noise hides them it fits no better and is ranked lower for its extra
    parameter, although the interval of its width contains wide ramps. ``samples`` are the evidence's effective samples.
    """
    if all(run.motion.belt_measured for run in runs):
        return chosen
    open_width = OPEN_RAMP * min(run.motion.belt_speed for run in runs)
    found = {fit.law: fit for fit in fits}
    joining = []
    for law in chosen.members:
        ramp = next((fit for fit in fits if fit.law.is_ramp_of(law)), None)
        if ramp is None or law not in found or ramp.law in chosen.members:
            continue
        extra = ramp.law_parameters - found[law].law_parameters
        if chosen.score[ramp.law] - chosen.score[law] > extra * math.log(max(samples, 1.0)) + RAMP_SCORE_MARGIN:
            continue
        width = derived.derived_parameters(ramp, runs[0].motion, alpha, sustained=sustained).get("d")
        if width is None or width.hi > open_width:
            joining.append(ramp.law)
    return replace(chosen, members=(*chosen.members, *joining))
