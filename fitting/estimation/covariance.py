"""Intervals: a sandwich over cycles, calibrations as priors, t quantile.

Residuals of a wrong-by-a-little model are alike within a cycle and independent between cycles, so the spread of the
cycles' own gradients says how far the estimate would move with other cycles.  With few cycles the sandwich can come out
too small; the curvature at the noise level rms x sqrt(correlation time) is the floor.
"""

import math
from collections.abc import Callable

import numpy as np

from daq.compute.arrays import Array
from daq.runfile.rig import Measured
from fitting.data.frame import MeasuredMotion
from fitting.estimation.levenberg_marquardt import SchurComplement, eigen
from fitting.estimation.result import Parameter
from fitting.estimation.trajectory import Fit
from fitting.model.parameters import (
    COSINE,
    DAMPING,
    DATUM,
    GIVE,
    LOG_F,
    OMEGA,
    PER_RUN,
    SHAPE,
    SINE,
    V_DR,
    D,
    K,
    columns,
)
from fitting.model.problem import datum_calibration
from rig_sim.friction.law import LAWS

ROUNDING = 1e-14  # of a curvature: as little left of it after elimination is rounding; sums of 1e4 terms err by less
LITTLE = 0.01  # of a guess's variance: where more is left of it after the fit, the guess still says how much
SIGNED = ("v_dr", "x0", "x0 + Fs/k", "(G_slip - c)/m")
HIDDEN = {  # what is known only together with a datum or a damping that nothing shows
    DATUM: ("x0", "Fs/m", "Fs/k", "Fs", "Fs0/m", "wear"),
    DAMPING: ("c/m", "c", "G_slip/m", "G_slip"),
}
# Of each run; the other parameters are one for all.
OWN = ("v_dr", "x0", "Fs0/m", "wear", "droop", "ripple", "ripple_hz")


def covariance(fit: Fit, precision: Array) -> Array:
    """Return the covariance of the active shared unknowns, shape (p, p).

    Parameters
    ----------
    fit : Fit
    precision : (p,) f8
        1/sd^2 of the calibrations, 0 where there is none: a prior's own error is one more independent source.
    """
    blocks = fit.solution.blocks
    reduced = SchurComplement(blocks)
    H = reduced.H
    own = blocks.cycle_g - np.einsum("cpq,cq->cp", blocks.cross, reduced.local_step(blocks.gl))
    cycles = own.shape[0]
    # All in units of the curvatures: nothing overflows where a record shows next to nothing of an unknown.  A weak
    # direction must neither make the inverse fail nor pass for a known one: one that only rounding holds gets the
    # variance of a guess that is all there is to it.
    scale = 1 / np.sqrt(np.maximum(np.diag(H), np.maximum(ROUNDING * np.diag(blocks.H), 1e-100)))
    size, axes = eigen(np.clip(H * scale[:, None] * scale, -1.0, 1.0))  # rounding must not pass for knowledge
    half = axes / np.sqrt(np.maximum(size, 1e-15))
    bread = np.einsum("ik,jk->ij", half, half)
    own = own * scale
    meat = np.einsum("ci,cj->ij", own, own) * (cycles / max(cycles - 1, 1)) + np.diag(precision * scale**2)
    sandwich = np.einsum("ik,kl->il", np.einsum("ik,kl->il", bread, meat), bread)
    least, found = np.diag(bread), np.diag(sandwich)
    floor = np.sqrt(np.maximum(least / np.maximum(found, 1e-20 * least), 1.0))
    spread = sandwich * floor[:, None] * floor
    np.fill_diagonal(spread, np.maximum(np.diag(spread), least))
    return np.asarray(spread * scale[:, None] * scale)


def parameters(
    fit: Fit, motion: MeasuredMotion, alpha: float, run: int = 0, *, sustained: bool = True
) -> dict[str, Parameter]:
    """Return a law's parameters with their intervals, in the record's own signs.

    ``x0`` is where the spring's rest lies in the recorded positions.  Fs is its mean over the record; where the contact
    sticks again and again, ``Fs0/m`` is what it was when the recording began and ``wear`` the fraction of that lost per
    second, both by the line through the cycles' levels (`fitting.estimation.wear`).
    ``ripple`` and ``ripple_hz`` are amplitude and frequency of its swing where the sticks show one.
    ``droop`` is how much slower the belt runs under the load Fs.

    The error of the metres per count enters every parameter that has a length in its unit.

    Without a calibration of the datum or of the damping a guess stands in for it.  Where the record adds next to
    nothing to the guess, what depends on it is left out, and the combination that the record does know is given
    instead: ``x0 + Fs/k``, ``(G_slip - c)/m``.

    Parameters
    ----------
    fit : Fit
        Of all runs together.
    motion : MeasuredMotion
        Of the run; its mass or stiffness, when known, turns accelerations into newtons.
    alpha : float
        1 - confidence.
    run : int
        Whose own parameters are wanted, beside those that all runs share.
    sustained : bool
        Whether the contact sticks again and again: else its level is not made anew and shows no wear.
    """
    from scipy.stats import t as student

    slots = columns(fit.active, fit.runs)[run]
    known = slots >= 0
    active = [int(slot) for slot in slots[known]]
    spread = covariance(fit, fit.precision)[np.ix_(known, known)]
    if LAWS[fit.law].curve == "constant":
        # The datum is held in the fit; Fs/k moves against it, and of a ramp its width and the belt's speed with that.
        rate = -fit.u[K] / math.exp(fit.u[LOG_F])
        beside = {DATUM: 1.0, LOG_F: rate, D: rate * fit.u[D], V_DR: rate * fit.u[D]}
        if D not in active:
            del beside[V_DR]
        against = np.array([beside.get(slot, 0.0) for slot in active])
        spread = spread + datum_calibration(motion).sd ** 2 * np.outer(against, against)
    own = fit.u[PER_RUN * run : PER_RUN * (run + 1)]
    quantile = float(student.ppf(1 - alpha / 2, max(len(fit.rows) - 1, 1)))
    found: dict[str, Parameter] = {}

    def add(
        name: str, unit: str, formula: Callable[[Array], float], scale: Measured | None = None, *, lengths: int = 0
    ) -> None:
        """Add one parameter; ``lengths`` is the power of the metre in it, for the error of the metres per count."""
        value = formula(own)
        slope = np.array([_slope(formula, own, index) for index in active])
        variance = float(np.einsum("i,ij,j", slope, spread, slope)) + (lengths * value * motion.length_error) ** 2
        if scale is not None:
            variance = variance * scale.value**2 + (value * scale.sd) ** 2
            value *= scale.value
        error = float(np.sqrt(max(variance, 0.0)))
        lo, hi = value - quantile * error, value + quantile * error
        if name not in SIGNED:
            lo = max(lo, 0.0)
        found[name] = Parameter(value, error, lo, hi, unit)

    guessed = {DATUM: motion.datum_prior is None, DAMPING: motion.damping_prior is None or motion.per_mass}
    left = np.diag(spread) * fit.precision[known]
    unknown = {slot for slot, share in zip(active, left, strict=True) if guessed.get(slot) and share > LITTLE}
    if guessed[DATUM] and LAWS[fit.law].curve == "constant":
        unknown.add(DATUM)
    law = LAWS[fit.law]
    add("k/m", "s^-2", lambda u: float(u[K]))
    add("Fs/m", "m s^-2", lambda u: float(np.exp(u[LOG_F])), lengths=1)
    add("Fs/k", "m", lambda u: float(np.exp(u[LOG_F]) / u[K]), lengths=1)
    add("v_dr", "m/s", lambda u: motion.sign * float(u[V_DR]), lengths=1)
    if law.curve == "hyperbolic":
        add("gamma", "s/m", lambda u: float(u[SHAPE]), lengths=-1)
    elif law.curve == "linear":
        add("G_slip/m", "s^-1", lambda u: float(u[SHAPE] * np.exp(u[LOG_F])))
    if law.contact == "ramp":
        add("d", "m/s", lambda u: float(u[D]), lengths=1)
    add("x0", "m", lambda u: motion.sign * float(u[DATUM]), lengths=1)
    add("c/m", "s^-1", lambda u: float(u[DAMPING]))
    trend = fit.level_trend(run) if sustained else None
    if trend is not None:
        first, reach = trend.first, float(student.ppf(1 - alpha / 2, trend.degrees_of_freedom))
        level, rate = found["Fs/m"], trend.rate
        value, error = level.value * first.value, math.hypot(level.stderr * first.value, level.value * first.sd)
        found["Fs0/m"] = Parameter(value, error, max(value - reach * error, 0.0), value + reach * error, level.unit)
        found["wear"] = Parameter(
            rate.value, rate.sd, rate.value - reach * rate.sd, rate.value + reach * rate.sd, "s^-1"
        )
    if GIVE in active:
        add("droop", "m/s", lambda u: float(u[GIVE] * np.exp(u[LOG_F]) / u[K]), lengths=1)
    if COSINE in active:
        add("ripple", "m/s", lambda u: math.hypot(u[COSINE], u[SINE]), lengths=1)
        add("ripple_hz", "Hz", lambda u: float(u[OMEGA]) / (2 * math.pi))
    if motion.mass is not None:
        mass = motion.mass
        add("k", "N/m", lambda u: float(u[K]), mass)
        add("Fs", "N", lambda u: float(np.exp(u[LOG_F])), mass, lengths=1)
        if law.curve == "linear":
            add("G_slip", "N s/m", lambda u: float(u[SHAPE] * np.exp(u[LOG_F])), mass)
        add("c", "N s/m", lambda u: float(u[DAMPING]), mass)
    elif motion.stiffness is not None:
        stiffness = motion.stiffness
        add("m", "kg", lambda u: 1 / float(u[K]), stiffness)
        add("Fs", "N", lambda u: float(np.exp(u[LOG_F]) / u[K]), stiffness, lengths=1)
        if law.curve == "linear":
            add("G_slip", "N s/m", lambda u: float(u[SHAPE] * np.exp(u[LOG_F]) / u[K]), stiffness)
        add("c", "N s/m", lambda u: float(u[DAMPING] / u[K]), stiffness)
    if DATUM in unknown:
        add("x0 + Fs/k", "m", lambda u: motion.sign * float(u[DATUM] + np.exp(u[LOG_F]) / u[K]), lengths=1)
    if DAMPING in unknown and law.curve == "linear":
        add("(G_slip - c)/m", "s^-1", lambda u: float(u[SHAPE] * np.exp(u[LOG_F]) - u[DAMPING]))
    hidden = {name for slot in unknown for name in HIDDEN[slot]}
    return {name: item for name, item in found.items() if name not in hidden}


def _slope(formula: Callable[[Array], float], u: Array, index: int) -> float:
    step = 1e-6 * max(abs(float(u[index])), 1e-6)
    up, down = u.copy(), u.copy()
    up[index] += step
    down[index] -= step
    return (formula(up) - formula(down)) / (2 * step)
