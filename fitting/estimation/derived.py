"""Results of a fit in the units of the rig: one table of derived quantities, each with its interval.

Errors are propagated to first order from the covariance of the fit (`fitting.estimation.covariance`), with a Student's
t quantile over the cycles.  The error of the metres per count enters every quantity that has a length in its unit.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.distributions import student_quantile
from fitting.estimation.covariance import covariances, levels_differ, upper_bound
from fitting.estimation.fit import Fit
from fitting.estimation.result import Correlations, Parameter
from fitting.model.parameters import PER_RUN, Global, PerCycle, Values, columns, values
from fitting.model.problem import datum_calibration
from fitting.model.wear import Wear
from rig_sim.friction.law import LAWS
from stickslip.compute.arrays import Array
from stickslip.units import Measured

# Share of a default's variance left after the fit: with more the default still decides, and what depends on it is
# not given.  Chosen; half and twice give the same parameters on 26 records.
DEFAULT_LEFT = 0.01


class Derived(NamedTuple):
    """One derived quantity and its condition."""

    name: str
    unit: str
    formula: Callable[[Values], float]
    length: int = 0  # power of the metre in it, for the error of the metres per count
    curve: str = ""  # only for laws of this curve
    needs: Global | None = None  # only where the fit has this parameter
    scale: str = ""  # calibration that it is multiplied by, and without which it is not given
    instead_of: Global | None = None  # only where this one is undetermined


TABLE = (
    Derived("k/m", "s^-2", lambda p: p.K),
    Derived("Fs/m", "m s^-2", lambda p: p.F, 1),
    Derived("Fs/k", "m", lambda p: p.F / p.K, 1),
    Derived("v_dr", "m/s", lambda p: p.v_dr, 1),
    Derived("gamma", "s/m", lambda p: p.shape, -1, curve="hyperbolic"),
    Derived("G_slip/m", "s^-1", lambda p: p.shape * p.F, curve="linear"),
    Derived("d", "m/s", lambda p: p.d, 1, needs=Global.D),
    Derived("static", "", lambda p: p.static, needs=Global.STATIC),
    Derived("x0", "m", lambda p: p.datum, 1),
    Derived("c/m", "s^-1", lambda p: p.damping),
    Derived("droop", "m/s", lambda p: p.compliance * p.F / p.K, 1, needs=Global.COMPLIANCE),
    Derived("ripple", "m/s", lambda p: math.hypot(p.cosine, p.sine), 1, needs=Global.COSINE),
    Derived("ripple_hz", "Hz", lambda p: p.omega / (2 * math.pi), needs=Global.OMEGA),
    Derived("k", "N/m", lambda p: p.K, scale="mass"),
    Derived("Fs", "N", lambda p: p.F, 1, scale="mass"),
    Derived("G_slip", "N s/m", lambda p: p.shape * p.F, curve="linear", scale="mass"),
    Derived("c", "N s/m", lambda p: p.damping, scale="mass"),
    Derived("m", "kg", lambda p: 1 / p.K, scale="stiffness"),
    Derived("Fs", "N", lambda p: p.F / p.K, 1, scale="stiffness"),
    Derived("G_slip", "N s/m", lambda p: p.shape * p.F / p.K, curve="linear", scale="stiffness"),
    Derived("c", "N s/m", lambda p: p.damping / p.K, scale="stiffness"),
    Derived("x0 + Fs/k", "m", lambda p: p.datum + p.F / p.K, 1, instead_of=Global.DATUM),
    Derived("(G_slip - c)/m", "s^-1", lambda p: p.shape * p.F - p.damping, curve="linear", instead_of=Global.DAMPING),
)
MIRRORED = ("v_dr", "x0", "x0 + Fs/k")  # change sign with a record of a backward belt
SIGNED = (*MIRRORED, "(G_slip - c)/m")  # the others cannot be negative
UNDETERMINED_WITH = {  # what is known only together with something that the record does not show
    Global.DATUM: ("x0", "Fs/m", "Fs/k", "Fs", "Fs0/m", "wear"),
    Global.DAMPING: ("c/m", "c", "G_slip/m", "G_slip"),
    Global.V_DR: ("d",),
}
RUNS_OWN = ("v_dr", "x0", "Fs0/m", "wear", "droop", "ripple", "ripple_hz")  # the others are one for all runs


def derived_parameters(
    fit: Fit, motion: MeasuredMotion, alpha: float, run: int = 0, *, sustained: bool = True
) -> dict[str, Parameter]:
    """Return a law's parameters with their intervals, in the record's signs.

    ``x0`` is the spring's rest in the recorded positions.  Fs is its mean over the record; for a ``sustained`` contact,
    which sticks repeatedly, ``Fs0/m`` is its value at the start and ``wear`` the fraction lost per second, by the line
    through the cycles' levels (`fitting.model.wear`).  ``static`` is a ramp's break-away level over Fs, where they
    differ.  ``droop`` is the slowing of the belt under Fs, ``ripple`` and ``ripple_hz`` are amplitude and frequency of
    its speed.

    Where datum or damping is not calibrated and the data hardly constrain it, what depends on it is omitted, and the
    constrained combination is given: ``x0 + Fs/k``, ``(G_slip - c)/m``.
    """
    known = _known(fit, motion, run)
    quantile = student_quantile(1 - alpha / 2, max(len(fit.rows) - 1, 1))
    found: dict[str, Parameter] = {}
    for row, scale in given_rows(LAWS[fit.law].curve, motion, known):
        found[row.name] = scaled(row, scale, known, motion, quantile)
        if row.name == "c/m" and sustained:
            found |= wear_of(fit.level_trend(run), found["Fs/m"], alpha)
    return {name: item for name, item in found.items() if name not in hidden(known)}


def correlations(fit: Fit, motion: MeasuredMotion, run: int = 0) -> Correlations:
    """Return the correlations of a law's parameters per unit mass, without those that follow from others."""
    known = _known(fit, motion, run)
    rows = _rows_each_once(fit, motion, known)
    slopes = np.array([list(_slopes(row.formula, known.own, known.active)) for row in rows])
    slopes *= np.array([sign_of(row, motion) for row in rows])[:, None]
    lengths = np.array([row.length * row.formula(values(known.own)) * motion.length_error for row in rows])
    lengths *= [sign_of(row, motion) for row in rows]
    spread = np.einsum("ri,ij,sj->rs", slopes, upper_bound(*known.spreads), slopes) + np.outer(lengths, lengths)
    shown = np.diag(spread) > 0
    error = np.sqrt(np.diag(spread)[shown])
    matrix = np.clip(spread[np.ix_(shown, shown)] / np.outer(error, error), -1.0, 1.0)
    return Correlations(tuple(row.name for row, own in zip(rows, shown, strict=True) if own), matrix)


def _rows_each_once(fit: Fit, motion: MeasuredMotion, known: "Known") -> list[Derived]:
    rows = given_rows(LAWS[fit.law].curve, motion, known)
    left_out = {"Fs/k", *hidden(known)}
    return [row for row, scale in rows if scale is None and row.name not in left_out]


def independent_parameters(fit: Fit, motion: MeasuredMotion) -> "IndependentParameters":
    """Return the parameters of the first run that follow from no others, per unit mass, at given unknowns."""
    known = _known(fit, motion, 0)
    rows = _rows_each_once(fit, motion, known)

    def at(q: Array, unseen: float) -> Array:
        u = fit.at.task.split(q)[0][:PER_RUN].copy()
        u[known.active] += unseen * known.unseen
        return np.array([sign_of(row, motion) * row.formula(values(u)) for row in rows])

    return IndependentParameters(tuple(row.name for row in rows), np.array([row.length for row in rows]), at)


def break_away_level_error(fit: Fit, motion: MeasuredMotion, run: int = 0) -> float:
    """Return the error of a run's break-away level over Fs from rest position, Fs and k/m, which all cycles share.

    Without a datum, or on a camera track, it is far larger than the scatter between cycles suggests.
    """
    known = _known(fit, motion, run)
    p = values(known.own)
    place = p.datum + p.F / p.K
    slope = np.array(list(_slopes(lambda q: q.K * (place - q.datum) / q.F, known.own, known.active)))
    return math.sqrt(max(float(np.einsum("i,sij,j->s", slope, known.spreads, slope).max()), 0.0))


class IndependentParameters(NamedTuple):
    """Names of parameters, the power of the metre in each (k,), and a function to their values (k,).

    ``at(q, unseen)`` takes the unknowns q and the standard deviations of what the record does not constrain.
    """

    names: tuple[str, ...]
    lengths: Array
    at: Callable[[Array, float], Array]


class Known(NamedTuple):
    """A fit's knowledge of one run, with unknowns ``own`` (13,).

    ``spreads`` (2, p, p) are the covariances of the ``active`` ones by sandwich and curvature; ``undetermined`` are
    those dominated by a default; ``unseen`` (p,) is an unconstrained direction, a standard deviation long, contained in
    ``spreads``.
    """

    own: Array
    active: list[Global]
    spreads: Array
    undetermined: set[Global]
    unseen: Array | float = 0.0


def _known(fit: Fit, motion: MeasuredMotion, run: int) -> Known:
    slots = columns(fit.active, fit.runs)[run]
    known = slots >= 0
    active = [Global(slot) for slot in slots[known]]
    places = np.flatnonzero(known)  # unknowns of a force come after them
    spread = np.array(covariances(fit, fit.at.problem.precision))[:, places][:, :, places]
    law, unseen = LAWS[fit.law], np.zeros(len(active))
    if law.curve == "constant":
        # The datum is held in the fit; Fs/k moves against it, and of a ramp its width and the belt's speed with that.
        rate = -fit.values.K / fit.values.F
        beside = {Global.DATUM: 1.0, Global.LOG_F: rate}
        if Global.D in active:
            beside |= {Global.D: rate * fit.values.d, Global.V_DR: rate * fit.values.d}
        datum_sd = datum_calibration(motion).sd
        unseen = datum_sd * np.array([beside.get(slot, 0.0) for slot in active])
        spread, known_datum = spread + np.outer(unseen, unseen), spread
        if Global.D in active:
            # The record knows d/Fs, so an error of the datum also scales the error of the width, which the product of
            # both derivatives leaves out; without a datum it is the larger part of it.
            width = known_datum[:, active.index(Global.D), active.index(Global.D), None, None]
            both = np.array([float(slot in (Global.D, Global.V_DR)) for slot in active])
            spread = spread + width * (rate * datum_sd) ** 2 * np.outer(both, both)
    elif law.curve == "linear" and motion.datum_prior is None:
        unseen = _hidden_level(fit, run, active)
        spread = spread + np.outer(unseen, unseen)
    default = {
        Global.DATUM: motion.datum_prior is None,
        Global.DAMPING: motion.damping_prior is None or motion.per_mass,
    }
    left = np.einsum("sii->si", spread).max(axis=0) * fit.precision[known]
    held = fit.problem.held[PER_RUN * run : PER_RUN * (run + 1)]
    undetermined = {
        slot
        for slot, share in zip(active, left, strict=True)
        if default.get(slot) and not held[slot] and share > DEFAULT_LEFT
    }
    if default[Global.DATUM] and law.curve == "constant":
        undetermined.add(Global.DATUM)
    if law.curve == "constant" and not fit.problem.runs[run].cut.shows_belt:
        undetermined.add(Global.V_DR)
        at = active.index(Global.V_DR)  # no better than its start, however sharply the mass bounds it from below
        spread[:, at, at] = np.maximum(spread[:, at, at], 1 / fit.precision[known][at])
    return Known(fit.u[PER_RUN * run : PER_RUN * (run + 1)], active, spread, undetermined, unseen)


def _hidden_level(fit: Fit, run: int, active: list[Global]) -> Array:
    """Return the unconstrained direction (p,) of a linear curve, by the error of the datum.

    On a ramp, or a belt that slows under load, rest position and belt speed absorb another level of friction, unless
    levels that differ move the load by more than the position.
    """
    p = values(fit.u[PER_RUN * run : PER_RUN * (run + 1)])
    width = p.d if LAWS[fit.law].ramp else p.compliance * p.F / p.K
    if width <= 0 or not fit.inlier_cycles.any():
        return np.zeros(len(active))
    moved = math.sqrt(float(np.mean(fit.local[fit.inlier_cycles, PerCycle.LEVEL] ** 2))) * p.F / p.K
    if levels_differ(fit) and moved > fit.geometric_mean_rms:
        return np.zeros(len(active))
    moves = {
        Global.DATUM: -p.F / (width * p.K),
        Global.LOG_F: 1 / width,
        Global.SHAPE: -p.shape / width,
        Global.V_DR: 1.0,
        Global.D: 1.0,
    }
    place = PER_RUN * run + Global.DATUM
    datum_sd = 1 / math.sqrt(float(fit.problem.precision[place]))
    return np.array([moves.get(slot, 0.0) for slot in active]) * datum_sd * width * p.K / p.F


def given_rows(curve: str, motion: MeasuredMotion, known: Known) -> Iterator[tuple[Derived, Measured | None]]:
    """Yield the rows of a fit with this curve, each with the calibration that multiplies it."""
    for row in TABLE:
        scale = None if not row.scale or (row.scale == "stiffness" and motion.mass) else getattr(motion, row.scale)
        if (
            row.curve in ("", curve)
            and (row.needs is None or row.needs in known.active)
            and (not row.scale or scale is not None)
            and (row.instead_of is None or row.instead_of in known.undetermined)
        ):
            yield row, scale


def hidden(known: Known) -> set[str]:
    """Return the names that are constrained only together with an undetermined one."""
    return {name for slot in known.undetermined for name in UNDETERMINED_WITH[slot]}


def sign_of(row: Derived, motion: MeasuredMotion) -> float:
    """Return -1 for a row that changes sign with the belt, if the run's belt runs backward."""
    return motion.sign if row.name in MIRRORED else 1.0


def scaled(row: Derived, scale: Measured | None, known: Known, motion: MeasuredMotion, quantile: float) -> Parameter:
    """Return a derived quantity with its interval, times its row's calibration."""
    value = sign_of(row, motion) * float(row.formula(values(known.own)))
    slope = np.array(list(_slopes(row.formula, known.own, known.active)))
    variance = float(np.einsum("i,sij,j->s", slope, known.spreads, slope).max())
    variance += (row.length * value * motion.length_error) ** 2
    if scale is not None:
        variance = variance * scale.value**2 + (value * scale.sd) ** 2
        value *= scale.value
    error = math.sqrt(max(variance, 0.0))
    return as_parameter(value, error, quantile, row.unit, signed=row.name in SIGNED)


def _slopes(formula: Callable[[Values], float], u: Array, active: list[Global]) -> Iterator[float]:
    for slot in active:
        step = 1e-6 * max(abs(float(u[slot])), 1e-6)
        up, down = u.copy(), u.copy()
        up[slot] += step
        down[slot] -= step
        yield (formula(values(up)) - formula(values(down))) / (2 * step)


def wear_of(trend: Wear | None, level: Parameter, alpha: float) -> dict[str, Parameter]:
    """Return Fs/m at the start of the recording, and wear; empty where the levels have no trend."""
    if trend is None:
        return {}
    first, rate = trend.first, trend.rate
    quantile = student_quantile(1 - alpha / 2, trend.degrees_of_freedom)
    error = math.hypot(level.stderr * first.value, level.value * first.sd)
    return {
        "Fs0/m": as_parameter(level.value * first.value, error, quantile, level.unit, signed=False),
        "wear": as_parameter(rate.value, rate.sd, quantile, "s^-1", signed=True),
    }


def as_parameter(value: float, error: float, quantile: float, unit: str, *, signed: bool) -> Parameter:
    """Return a quantity with its interval, cut at 0 unless it may be negative."""
    lo, hi = value - quantile * error, value + quantile * error
    return Parameter(value, error, lo if signed else max(lo, 0.0), hi, unit)
