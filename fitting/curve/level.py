"""Whether a record determines the level of its friction curve, and the level that is assumed where it does not.

The motion determines K datum + friction.  Without a calibrated datum only effects proportional to friction separate the
two: levels that scatter between cycles or wear, a ramp's creep, a belt that slows under load.  Without any of these,
moving curve and datum together leaves the motion unchanged to the last digit; a search then ended anywhere in that
valley, even at negative friction, and the curve was 50 to 100 % off, in a band of 2 to 50 %.

So the level is then assumed, not fitted: the spring is taken as relaxed where a record begins at rest below the middle
of the motion, otherwise at the lowest position, so that friction is nowhere negative.  The band and the parameters of
forms include the uncertainty of the rest position (`REST_SD`).
"""

from collections.abc import Sequence

import numpy as np

from fitting.driver.fit import Fit
from fitting.least_squares import elimination
from fitting.model.parameters import PER_RUN, Global, PerCycle
from fitting.model.problem import Run
from fitting.sensitivity.path import Curve
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled
from stickslip.units import Measured

# Standard deviation of an assumed rest position, over the record's travel.  Friction that falls by a fifth stretches
# the spring to 2.5 travels, where the start-up is not recorded.  Only the band and the intervals depend on it.
REST_SD = 3.0
# Variance over what noise gives them: how much the levels must scatter to separate datum and friction.  At 4 their
# noise makes the level's standard error a seventh too small.  Encoder records with 3 % scatter have 1e2 and more.
SCATTER_SHOWN = 4.0
NARROWEST_MOVED = 0.1  # width of a ramp after a move, over that before


def rest_prior(run: Run, sd: float = REST_SD) -> Measured:
    """Return the prior of the spring's rest position, m; without a calibration ``sd`` travels wide."""
    motion = run.motion
    if motion.datum_prior is not None:
        return motion.datum_prior
    lowest, highest = float(motion.position.min()), float(motion.position.max())
    first = float(motion.position[0])
    released = run.cut.starts_at_rest and first < 0.5 * (lowest + highest)
    return Measured(first if released else lowest, sd * motion.travel)


def assumed_rest(fit: Fit) -> Measured | None:
    """Return the rest position to assume where the levels do not scatter (`law_scatters`).

    None where a calibration determines the level: of a rest position, or of the sticking speed where the load changes
    it.
    """
    yields = fit.law.ramp or Global.COMPLIANCE in fit.places
    for motion in fit.problem.motions:
        if motion.datum_prior is not None or (yields and (motion.belt_measured or motion.belt_prior is not None)):
            return None
    return rest_prior(fit.problem.runs[0])


def law_scatters(fit: Fit, noise: Array) -> bool:
    """Return whether the levels of the usual cycles scatter by more than noise and misfit explain.

    They must move the spring, stretched by friction at the belt's speed, by more than ``noise`` (runs,), m: rounding to
    counts, which is not white, makes levels scatter by a fifth of that.  Levels are compared within a run: the mean of
    each trades against the run's own rest position.
    """
    usual, run = fit.inlier_cycles, fit.windows.run[fit.inlier_cycles]
    if usual.sum() < np.unique(run).size + 1:
        return False
    stretch = float(fit.task.friction(fit.q, np.array([fit.values.v_dr]))[0]) / fit.values.K
    inverse = np.empty_like(fit.solution.blocks.Hl)
    compiled(elimination.invert, (elimination.__name__,))(fit.solution.blocks.Hl, inverse)
    by_noise = float(np.mean(inverse[usual, PerCycle.LEVEL, PerCycle.LEVEL]))
    level = fit.solution.local[usual, PerCycle.LEVEL]
    own = [level[run == number] - np.mean(level[run == number]) for number in np.unique(run)]
    seen = float(np.sum(np.concatenate(own) ** 2)) / (level.size - len(own))
    return bool(seen > SCATTER_SHOWN * by_noise and seen * stretch**2 > float(np.max(noise)) ** 2)


def moved_to(u: Array, coefficients: Array, rest: Measured, *, ramp: bool) -> tuple[Array, Array]:
    """Return unknowns (13 runs,) and a curve (n,) that give the same motion with another rest position.

    Other runs' rest positions move equally. On a ramp the slope of friction in stick and the speed where slip begins
    stay.
    """
    rise = u[Global.K] * (u[Global.DATUM] - rest.value)
    moved = u.copy()
    moved[Global.DATUM :: PER_RUN] += rest.value - u[Global.DATUM]
    moved[Global.V_DR :: PER_RUN] -= u[Global.COMPLIANCE] * (rest.value - u[Global.DATUM])
    if ramp:
        wider = u[Global.D] * max(rise / coefficients[0], NARROWEST_MOVED - 1)
        moved[Global.D :: PER_RUN] += wider
        moved[Global.V_DR :: PER_RUN] += wider
    return moved, coefficients + rise


def unseen(places: Sequence[int], curve: Curve, u: Array) -> Array:
    """Return the moves of the unknowns at ``places`` (p,) that hide a move of the first run's rest position."""
    if curve.spline is None:
        raise ValueError("this is a law's curve: its level is not free")
    K, D, compliance = (float(u[slot]) for slot in (Global.K, Global.D, Global.COMPLIANCE))
    wider = -K * D / float(curve.spline.coefficients[0]) if curve.ramp else 0.0
    moves = {Global.DATUM: 1.0, Global.D: wider, Global.V_DR: wider - compliance}
    found = np.array([moves.get(Global(place % PER_RUN), 0.0) for place in places])
    found[list(places).index(Global.DATUM)] = 0.0
    return found
