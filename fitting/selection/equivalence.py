"""A ramp and a jump on a belt that slows under load make the same motion.

Without the belt's counts the two are one observable (`rig_sim.flow.modes`, droop): a belt that loses 1 % of its speed
at the load Fs turns law 5 into a perfect law 6.  So the jump law of the nearest ramp also competes on a belt whose
compliance is fitted, and pays for it as the ramp pays for its width.  Runs at several belt speeds can separate the two:
a ramp has the same width at every speed, while each run has its own compliance.

A ramp acts in a few samples of a cycle.  Where noise hides them it fits no better and is ranked lower for its extra
parameter, although the interval of its width contains wide ramps.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fitting.driver.driver import WORSE, fit_from
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

# Speed that a belt may lose under the load Fs, over its own: a ramp that may be narrower may be such a belt.
WIDEST_BELT_LOSS = 0.03
# Difference in log error: a hyperbola on a compliant belt and a ramp differ by less, for all that long records show it.
# Chosen; half and twice decide the same on 26 records.
SAME_ERROR = 0.05


def fit_on_compliant_belt(fits: Sequence[Fit], runs: Sequence[Run], alpha: float, *, sustained: bool) -> Fit | None:
    """Fit the jump law of the nearest ramp on a belt that slows under load.

    None where the belt was measured, the ramp is wider than any belt's loss, or its jump law fits as well.
    """
    if any(run.motion.belt_measured for run in runs):
        return None
    kernels = [fit for fit in fits if fit.law.has_kernel]
    pairs = [(jump, ramp) for jump in kernels for ramp in kernels if ramp.law.is_ramp_of(jump.law)]
    if not pairs:
        return None
    jump, near = min(pairs, key=lambda pair: pair[1].geometric_mean_rms)
    if jump.geometric_mean_rms <= WORSE * near.geometric_mean_rms:
        return None
    if _width(near, runs, alpha, sustained=sustained)[0] > WIDEST_BELT_LOSS:
        return None
    compliance = near.values.d * near.values.K / near.values.F
    u = near.u.copy()
    u[Global.COMPLIANCE :: PER_RUN] = compliance
    compliant = [replace(run, motion=replace(run.motion, compliance=Measured(compliance, compliance))) for run in runs]
    task = law_task(jump.law, compliant)
    fit = fit_from(task, FitStart(u[list(task.places)], near.local), near.noise.without_fade)
    return None if fit is None else without_level_errors(fit)


def with_indistinct_contacts(
    chosen: ModelSet,
    fits: Mapping[Law, Fit],
    errors: Mapping[Law, Array],
    runs: Sequence[Run],
    alpha: float,
    *,
    sustained: bool,
) -> ModelSet:
    """Return the set with both of a jump and its ramp where the record does not distinguish them.

    It does not where the jump law is fitted on a belt that slows under load, or where the ramp may be wider than the
    loss of any belt, and neither errs plainly more.

    fits: The laws that describe the record.
    errors: The log errors of each (units,).
    """
    members = list(chosen.members)
    pairs = [(jump, ramp) for jump in fits.values() for ramp in fits.values() if ramp.law.is_ramp_of(jump.law)]
    for jump, ramp in pairs:
        if (jump.law in members) == (ramp.law in members):
            continue
        member, other = (jump, ramp) if jump.law in members else (ramp, jump)
        if float(np.mean(errors[other.law] - errors[member.law])) > SAME_ERROR:
            continue
        if slows_under_load(jump) or _width(ramp, runs, alpha, sustained=sustained)[1] > WIDEST_BELT_LOSS:
            place = 0 if other is jump and members[0] == ramp.law else len(members)
            members.insert(place, other.law)
    return replace(chosen, members=tuple(members))


def slows_under_load(fit: Fit) -> bool:
    """Return whether a fit is on a belt whose compliance was fitted, not measured."""
    return any(motion.compliance is not None and not motion.belt_measured for motion in fit.problem.motions)


def _width(ramp: Fit, runs: Sequence[Run], alpha: float, *, sustained: bool) -> tuple[float, float]:
    """Return the interval of a ramp's width over the slowest belt's speed; all widths where it is undetermined."""
    width = derived.derived_parameters(ramp, runs[0].motion, alpha, sustained=sustained).get("d")
    speed = min(run.motion.belt_speed for run in runs)
    return (0.0, math.inf) if width is None else (width.lo / speed, width.hi / speed)
