"""The parameters of a law given as a formula, with their intervals: those of rig and contact, then the formula's."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np

from fitting.curve.formula_fit import FormulaFit
from fitting.data.frame import MeasuredMotion
from fitting.distributions import student_quantile
from fitting.estimation import derived
from fitting.estimation.covariance import upper_bound
from fitting.estimation.derived import IndependentParameters, Known
from fitting.estimation.result import STATED_ERROR, Correlations, Parameter
from fitting.model import parameters
from fitting.model.parameters import PER_RUN, Global
from stickslip.compute.arrays import Array

LEVELS = ("Fs/m", "Fs/k", "Fs", "Fs0/m", "x0 + Fs/k", "(G_slip - c)/m", "static")  # of the six alone
SLOTS = {"k/m": Global.K, "v_dr": Global.V_DR, "d": Global.D, "x0": Global.DATUM, "c/m": Global.DAMPING}


def formula_parameters(
    fit: FormulaFit, motion: MeasuredMotion, alpha: float, run: int = 0, *, sustained: bool = True
) -> dict[str, Parameter]:
    """Return the law's parameters with their intervals, those of rig and contact first.

    A parameter whose unit has friction is given as ``NAME/m`` and as ``NAME``, in newtons where mass or stiffness is
    known. A name of the formula's parameter takes precedence.
    """
    quantile = student_quantile(1 - alpha / 2, max(len(fit.rows) - 1, 1))
    found = _of_rig(fit, motion, quantile, run)
    if sustained:
        level = Parameter(1.0, 0.0, 1.0, 1.0, "")
        trend = derived.wear_of(fit.level_trend(run), level, alpha)
        found |= {name: item for name, item in trend.items() if name == "wear"}
    own: dict[str, Parameter] = {}
    for name in fit.asked_for.curve.parameters:
        own |= _own(fit, name, motion, quantile)
    own |= _differences(fit, own, quantile)
    return {name: item for name, item in found.items() if name not in own} | own


def formula_correlations(fit: FormulaFit, motion: MeasuredMotion) -> Correlations:
    """Return the correlations of the parameters of rig, contact and formula."""
    shown = _each_once(fit, motion)
    columns = [place for _, place, _ in shown]
    spread = upper_bound(*(own[np.ix_(columns, columns)] for own in fit.spreads))
    error, sign = np.sqrt(np.maximum(np.diag(spread), 0.0)), np.array([one for _, _, one in shown])
    seen = error > 0
    matrix = spread[np.ix_(seen, seen)] / np.outer(error[seen], error[seen]) * np.outer(sign[seen], sign[seen])
    names = tuple(name for (name, _, _), own in zip(shown, seen, strict=True) if own)
    return Correlations(names, np.clip(matrix, -1.0, 1.0))


def independent_formula_parameters(fit: FormulaFit, motion: MeasuredMotion) -> IndependentParameters:
    """Return the parameters that `formula_correlations` compares, at given unknowns of the fit."""
    shown, first, free = _each_once(fit, motion), len(fit.places), fit.curve.law.free
    of_rig = {row.name: row.length for row in derived.TABLE if row.name in SLOTS}
    lengths = [
        of_rig[name] if place < first else sum(fit.asked_for.dimensions.get(free[place - first], (0, 0)))
        for name, place, _ in shown
    ]

    def at(q: Array, unseen: float) -> Array:  # a formula's unknowns are all in the fit
        own = fit.curve.values(fit.at.task.split(q)[1])
        return np.array([sign * q[place] if place < first else own[free[place - first]] for _, place, sign in shown])

    return IndependentParameters(tuple(name for name, _, _ in shown), np.array(lengths), at)


def _each_once(fit: FormulaFit, motion: MeasuredMotion) -> list[tuple[str, int, float]]:
    """Return name, unknown and sign in the record's frame of each parameter of rig and contact."""
    known, index = _known(fit, motion, 0), _slots(fit, 0)
    hidden = derived.hidden(known)
    shown: list[tuple[str, int, float]] = []
    for row, _ in derived.given_rows("", motion, known):
        slot = SLOTS.get(row.name)
        if slot is not None and slot in known.active and row.name not in hidden:
            shown.append((row.name, index[known.active.index(slot)], derived.sign_of(row, motion)))
    unknown = {name for one in fit.together for name in one.names}
    for place, name in enumerate(fit.curve.law.free, start=len(fit.places)):
        if name not in unknown:
            force = fit.asked_for.dimensions.get(name, (0, 0))[0]
            shown.append((f"{name}/m" if force else name, place, 1.0))
    return shown


def formula_level_error(fit: FormulaFit, run: int = 0) -> float:
    """Return the standard error of a run's break-away level from what all cycles share: rest, curve and k/m."""
    p, slope = fit.values, np.zeros(fit.at.q.size)
    for place in _slots(fit, run):
        slot = fit.places[place] % PER_RUN
        slope[place] = {int(Global.K): 1 / p.K, int(Global.DATUM): -p.K / p.F}.get(slot, 0.0)
    slope[len(fit.places) :] = -fit.curve.slopes(fit.theta, np.zeros(1))[0] / p.F
    return _error(fit, slope)


def _error(fit: FormulaFit, slope: Array) -> float:
    """Return the standard error of a quantity with these derivatives by the unknowns (p + k,)."""
    return math.sqrt(max(float(np.einsum("i,sij,j->s", slope, fit.spreads, slope).max()), 0.0))


def _slots(fit: FormulaFit, run: int) -> list[int]:
    """Return the unknowns of one run among those of the fit."""
    slots = parameters.columns(fit.places, len(fit.at.task.problem.runs))[run]
    return [place for place, slot in enumerate(slots) if slot >= 0]


def _known(fit: FormulaFit, motion: MeasuredMotion, run: int) -> Known:
    """Return the fit's knowledge of one run without the formula's parameters."""
    places, task = _slots(fit, run), fit.at.problem
    active = [Global(fit.places[place] % PER_RUN) for place in places]
    spread = fit.spreads[:, places][:, :, places]
    default = {
        Global.DATUM: motion.datum_prior is None,
        Global.DAMPING: motion.damping_prior is None or motion.per_mass,
    }
    share = np.einsum("sii->si", spread).max(axis=0) * task.precision[places]
    held = task.lower[places] == task.upper[places]
    undetermined = {
        slot
        for slot, own, fixed in zip(active, share, held, strict=True)
        if default.get(slot) and own > derived.DEFAULT_LEFT and not (fixed and slot != Global.DATUM)
    }
    first = PER_RUN * run if fit.runs > 1 else 0
    return Known(fit.u[first : first + PER_RUN], active, spread, undetermined)


def _of_rig(fit: FormulaFit, motion: MeasuredMotion, quantile: float, run: int) -> dict[str, Parameter]:
    known = _known(fit, motion, run)
    rows = [(row, scale) for row, scale in derived.given_rows("", motion, known) if row.name not in LEVELS]
    hidden = derived.hidden(known)
    return {
        row.name: derived.scaled(row, scale, known, motion, quantile) for row, scale in rows if row.name not in hidden
    }


def _own(fit: FormulaFit, name: str, motion: MeasuredMotion, quantile: float) -> dict[str, Parameter]:
    """Return a parameter of the formula, per unit mass and, where its unit has friction, also as a force."""
    law, free = fit.asked_for, fit.curve.law.free
    value, error, by_log = fit.own_values[name], 0.0, False
    if name in free:
        k = free.index(name)
        by_log = bool(fit.curve.by_log[k])
        place = len(fit.places) + k
        error = math.sqrt(max(float(fit.spreads[:, place, place].max()), 0.0)) * (value if by_log else 1.0)
    force, speed = law.dimensions.get(name, (0, 0))
    error = math.hypot(error, (force + speed) * value * motion.length_error)  # that of the metres per count
    trusted = not any(name in one.names for one in fit.together)
    fixed = name in (law.fix or {})
    item = Parameter.around(value, 0.0 if fixed else error, quantile, law.limits(name), by_log=by_log)
    item = replace(item, unit=law.unit(name), trusted=trusted, fixed=fixed)
    if not force:
        return {name: item}
    known = motion.mass or motion.stiffness
    if known is None:
        return {f"{name}/m": item, name: item}
    factor = (known.value if motion.mass else known.value / fit.values.K) ** force
    spread = math.hypot(item.stderr * factor, force * value * factor * known.sd / known.value)
    low, high = (factor * end for end in law.limits(name))
    newtons = Parameter.around(value * factor, spread, quantile, (low, high), by_log=by_log)
    return {f"{name}/m": item, name: replace(newtons, unit=law.unit(name, newtons=True), trusted=trusted)}


def _differences(fit: FormulaFit, own: dict[str, Parameter], quantile: float) -> dict[str, Parameter]:
    """Return, per unit mass, the differences of levels that are known where the levels are not."""
    free, values = fit.curve.law.free, fit.own_values
    levels = [name for name in free if fit.asked_for.dimensions.get(name) == (1, 0)]
    found = {}
    for pair in combinations(levels, 2):
        if any(_level_known(own[f"{name}/m"]) for name in pair):
            continue
        high, low = sorted(pair, key=lambda name: -values[name])
        slope = np.zeros(fit.at.q.size)
        for name, sign in ((high, 1.0), (low, -1.0)):
            k = free.index(name)
            slope[len(fit.places) + k] = sign * (values[name] if fit.curve.by_log[k] else 1.0)
        error, value = _error(fit, slope), values[high] - values[low]
        item = Parameter(value, error, value - quantile * error, value + quantile * error, "m s^-2")
        if _level_known(item):
            found[f"({high} - {low})/m"] = item
    return found


def _level_known(item: Parameter) -> bool:
    return item.stderr < STATED_ERROR * abs(item.value)
