"""Parameters of a fit in the units of the rig, with their intervals, and each break-away.

Intervals: sandwich covariance over cycles, calibrations as priors, t quantile over the cycles. Residuals of a slightly
wrong model are correlated within a cycle and independent between cycles, so the spread of the cycles' gradients shows
how far the estimate would move with other cycles. With few cycles the sandwich can be too small, so the covariance from
the curvature at the noise level rms x sqrt(correlation time) is a lower limit. In it the information of a cycle is
limited by its residuals: under constant friction only the drag of a start-up constrains the belt's speed, and no other
cycle shows how far a ripple moves it.

The errors of the levels must not constrain the parameters (`remove_level_errors`). Without a datum the prior of the
levels is wider than their scatter (`EstimationProblem.level_prior`). The lower limit is then the covariance of the
estimate under the true scatter.

All derived quantities are in one table. Errors propagate to first order. The error of the metres per count enters every
quantity with a length in its unit.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from fitting.judge.friction import friction_at
from fitting.least_squares.levenberg_marquardt import linearise
from fitting.least_squares.normal_equations import (
    ROUNDING,
    SchurComplement,
    eigen,
    normal_equations,
    priors,
    scaled_inverse,
)
from fitting.model.curves import LawCurve
from fitting.model.problem import rest_calibration
from fitting.model.unknowns import PER_RUN, Global, PerCycle, Values, columns, values
from fitting.model.windows import Wear
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array, Integers, autocorrelation_time
from stickslip.units import Measured

STATED_ERROR = 0.5  # standard error over a value, above which a level is not constrained and only differences are given
NO_LIMITS = (-math.inf, math.inf)
DERIVATIVE_STEP = 1e-6  # step of a central difference, over the unknown: derivatives err by 1e-9
LARGEST_LOG = 300.0  # logarithm of the factor between a value and the end of its interval; larger ones overflow


@dataclass(frozen=True)
class Parameter:
    """A fitted value with its standard error and confidence interval.

    Attributes
    ----------
    value : float
        Value in ``unit``.
    stderr : float
        Standard error.
    lo, hi : float
        Ends of the confidence interval.
    unit : str
        Unit, such as ``s/m``; empty if the parameter is dimensionless.
    trusted : bool
        False if the law does not describe the record; the error is then too small and is not shown.
    fixed : bool
        True if the value was stated and not fitted.
    """

    value: float
    stderr: float
    lo: float
    hi: float
    unit: str
    trusted: bool = True  # False: the law does not describe the record, so its error is too small and is withheld
    fixed: bool = False  # not fitted

    @property
    def decimals(self) -> int:
        """Digits after the point: two of the error, at most 12."""
        return min(max(0, 1 - math.floor(math.log10(self.stderr))), 12) if self.stderr > 0 else 6

    def __str__(self) -> str:
        if self.fixed:
            return f"{self.value:.6g} {self.unit} (fixed)".replace("  ", " ")
        if not self.trusted:
            return f"{self.value:.4g} {self.unit} (interval withheld)".replace("  ", " ")
        digits = self.decimals
        return f"{self.value:.{digits}f} [{self.lo:.{digits}f}, {self.hi:.{digits}f}] {self.unit}".rstrip()

    @property
    def brief(self) -> str:
        """Value and standard error with two digits of the error."""
        if self.fixed or not self.trusted:
            return str(self).split(" (interval")[0]
        digits = self.decimals
        return f"{self.value:.{digits}f} +- {self.stderr:.{digits}f} {self.unit}".rstrip()

    def as_json(self) -> dict[str, Any]:
        error = {"stderr": self.stderr, "lo": self.lo, "hi": self.hi} if self.trusted else _WITHHELD
        return {"value": self.value, **error, "unit": self.unit} | ({"fixed": True} if self.fixed else {})

    @classmethod
    def around(
        cls,
        value: float,
        stderr: float,
        quantile: float,
        limits: tuple[float, float] = NO_LIMITS,
        *,
        by_log: bool = False,
        unit: str = "",
    ) -> "Parameter":
        """Return the interval of ``quantile`` standard errors within limits; ``by_log``: symmetric in the logarithm."""
        if by_log and value > 0:
            factor = math.exp(min(quantile * stderr / value, LARGEST_LOG))
            lo, hi = value / factor, value * factor
        else:
            lo, hi = value - quantile * stderr, value + quantile * stderr
        return cls(value, stderr, max(lo, limits[0]), min(hi, limits[1]), unit)


def in_columns(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return table cells: value, "NAME stderr", "NAME lo", "NAME hi"; None if withheld."""
    table: dict[str, Any] = {}
    for name, parameter in parameters.items():
        cells = parameter.as_json()
        table[name] = cells["value"]
        table |= {f"{name} {suffix}": cells[suffix] for suffix in ("stderr", "lo", "hi")}
    return table


_WITHHELD = dict.fromkeys(("stderr", "lo", "hi"))


@dataclass(frozen=True, eq=False)
class Correlations:
    """Correlations (p, p) of the errors of the parameters ``names``."""

    names: tuple[str, ...]
    matrix: Array

    def as_json(self) -> dict[str, Any]:
        return {"parameters": list(self.names), "matrix": self.matrix.tolist()}


@dataclass(frozen=True)
class BreakAway:
    number: int
    t: float  # s, when the mass leaves the belt
    break_away_level: float  # load at the break-away over Fs; NaN for a cycle that was not fitted
    kinetic_scale: float  # this cycle's kinetic level over Fs; NaN for a cycle that was not fitted
    # "" for a usual cycle, "rough" for one that fits far worse than the others, else why it is excluded
    flag: str

    def as_json(self) -> dict[str, Any]:
        return {"static_level" if name == "break_away_level" else name: value for name, value in vars(self).items()}


# Largest variance of a cycle's residuals over the assumed one: a correlation time from one window is uncertain.
LARGEST_VARIANCE = 2.0
# Scatter of the levels beyond their errors, in standard errors of a mean square, above which it is information: noise
# alone exceeds it once in 150 contacts.
SCATTER_ERRORS = 3.0


def remove_level_errors(fit: Fit) -> Fit:
    """Return a fit with the derivatives of its residuals at levels shrunk by their errors.

    Without a datum a ramp law constrains only Fs/d, v_dr - d and x0 + Fs/k, unless the level changes between cycles.
    If errors are taken for such changes, the interval of v_dr is a hundred times too narrow.
    """
    if fit.problem.level_prior <= 1 or not fit.inlier_cycles.any():
        return fit
    local = fit.local.copy()
    for column in (PerCycle.LEVEL, PerCycle.NEXT_LEVEL):
        true, error = _true_square(fit, column)
        local[:, column] *= true / (true + error)
    problem, solution = fit.least_squares, fit.solution
    point = linearise(problem, solution.u, local)
    if point is None:
        return fit
    prior = priors(problem, solution.u, fit.local)
    blocks = normal_equations(problem.first, problem.weights, solution.residual, point.derivatives, prior)
    return replace(fit, solution=replace(solution, blocks=blocks))


def _true_square(fit: Fit, column: PerCycle) -> tuple[float, Array]:
    """Return the mean square of an unknown beyond its expected errors, and the squares (cycles,)."""
    inliers = fit.inlier_cycles
    error = np.asarray(np.linalg.inv(fit.solution.blocks.Hl)[:, column, column])
    expected = float(np.mean(error[inliers])) * (1 + SCATTER_ERRORS * math.sqrt(2 / inliers.sum()))
    return max(float(np.mean(fit.local[inliers, column] ** 2)) - expected, 0.0), error


def covariance(fit: Fit) -> Array:
    """Return an upper bound of both covariances; for a single quantity use the larger variance instead."""
    return upper_bound(*covariances(fit))


def covariances(fit: Fit) -> tuple[Array, Array]:
    """Return the covariances (p, p) of the unknowns, the curve's last, from the sandwich and from the curvature."""
    blocks = fit.solution.blocks
    reduced = SchurComplement(blocks)
    H = reduced.H
    cycle_gradients = reduced.reduced_gradients(blocks.cycle_g, reduced.local_step(blocks.gl))
    cycles = cycle_gradients.shape[0]
    scale, bread = scaled_inverse(H, np.diag(blocks.H))
    cycle_gradients = cycle_gradients * scale
    prior_precision = np.diag(fit.least_squares.precision * scale**2)
    meat = np.einsum("ci,cj->ij", cycle_gradients, cycle_gradients) * (cycles / max(cycles - 1, 1)) + prior_precision
    sandwich = np.einsum("ik,kl->il", np.einsum("ik,kl->il", bread, meat), bread)
    share = _information_share(fit)
    information_lost = np.einsum("c,cpr->pr", share - 1, reduced.by_cycle(blocks.cycle_curvature))
    own_scale, by_curvature = scaled_inverse(H + information_lost, np.diag(blocks.H))
    if fit.problem.level_prior > 1:
        narrower = (
            np.einsum("c,cpr->pr", share, reduced.by_prior(_missing_precision(fit))) * own_scale[:, None] * own_scale
        )
        by_curvature = by_curvature - np.einsum("ij,jk,kl->il", by_curvature, narrower, by_curvature)
    return sandwich * scale[:, None] * scale, by_curvature * own_scale[:, None] * own_scale


def upper_bound(first: Array, second: Array) -> Array:
    """Return a covariance (p, p) that is in no direction smaller than either of two.

    In the basis in which the second is 1 and the first is diagonal, the larger eigenvalues are taken. Larger variances
    with the same correlations would give combinations of correlated unknowns an error that neither covariance allows.
    """
    unit = np.sqrt(np.diag(second))
    size, axes = eigen(second / unit[:, None] / unit)
    root = np.sqrt(np.maximum(size, ROUNDING))
    whitening, unwhitening = axes / root / unit[:, None], axes * root * unit[:, None]
    ratio, turn = eigen(np.einsum("ki,kl,lj->ij", whitening, first, whitening))
    half = np.einsum("ik,kj->ij", unwhitening, turn) * np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(np.einsum("ik,jk->ij", half, half))


def _information_share(fit: Fit) -> Array:
    """Return the share (cycles,) of each cycle's information that is consistent with its residuals."""
    assumed_variance = 1 / fit.least_squares.weights
    variance = np.full(assumed_variance.size, 1e-300)
    for cycle, _, first, size, *_ in fit.windows.table:  # a drag is a window of the first cycle
        residual = fit.residual[first : first + size]
        variance[cycle] = max(variance[cycle], float(np.mean(residual**2)) * autocorrelation_time([residual]))
    return np.asarray(np.minimum(LARGEST_VARIANCE * assumed_variance / variance, 1.0))


def _missing_precision(fit: Fit) -> Array:
    """Return the precision (cycles, q) of the levels missing in the prior, which is wider than their scatter."""
    sd = fit.noise.level_sd(fit.windows, fit.problem.level_prior)
    excess = (1 - (fit.noise.scatter / sd) ** 2) / sd**2
    precision = np.zeros_like(fit.solution.blocks.gl)
    precision[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = np.where(fit.inlier_cycles[:, None], excess, 0.0)
    return precision


DEFAULT_LEFT = 0.01  # variance over that of a default prior, above which what depends on it is not reported
POSITIVE = (0.0, math.inf)
LawValues = Mapping[str, float]  # the law's parameters by name, per unit mass
SIX = "six"  # of each of the six that its own kernel follows


class Derived(NamedTuple):
    name: str
    unit: str
    formula: Callable[[Values, LawValues], float]
    length: int = 0  # power of the metre in it, for the error of the metres per count
    curve: str = ""  # only for laws with this curve, or the `SIX`
    needs: Global | None = None  # only where the fit has this parameter
    scale: str = ""  # calibration that multiplies it; omitted without that
    instead_of: Global | None = None  # only where this unknown is undetermined
    limits: tuple[float, float] = POSITIVE
    mirrored: bool = False  # whether it changes sign if the belt runs backwards
    follows: bool = False  # whether it is a function of other rows
    power: int = 1  # of the calibration
    by_log: bool = False  # whether its interval is symmetric in the logarithm
    identifiable: bool = True  # whether it is identifiable in the formula
    fixed: bool = False


TABLE = (
    Derived("k/m", "s^-2", lambda p, _: p.K),
    Derived("Fs/m", "m s^-2", lambda p, _: p.F, 1, SIX),
    Derived("Fs/k", "m", lambda p, _: p.F / p.K, 1, SIX, follows=True),
    Derived("v_dr", "m/s", lambda p, _: p.v_dr, 1, limits=NO_LIMITS, mirrored=True),
    Derived("gamma", "s/m", lambda p, _: p.shape, -1, "hyperbolic"),
    Derived("G_slip/m", "s^-1", lambda p, _: p.shape * p.F, 0, "linear"),
    Derived("d", "m/s", lambda p, _: p.d, 1, needs=Global.D),
    Derived("static", "", lambda p, _: p.static, needs=Global.STATIC),
    Derived("x0", "m", lambda p, _: p.datum, 1, limits=NO_LIMITS, mirrored=True),
    Derived("c/m", "s^-1", lambda p, _: p.damping),
    Derived("droop", "m/s", lambda p, _: p.compliance * p.F / p.K, 1, needs=Global.COMPLIANCE),
    Derived("ripple", "m/s", lambda p, _: math.hypot(p.cosine, p.sine), 1, needs=Global.COSINE),
    Derived("ripple_hz", "Hz", lambda p, _: p.omega / (2 * math.pi), needs=Global.OMEGA),
    Derived("k", "N/m", lambda p, _: p.K, scale="mass"),
    Derived("Fs", "N", lambda p, _: p.F, 1, SIX, scale="mass"),
    Derived("G_slip", "N s/m", lambda p, _: p.shape * p.F, 0, "linear", scale="mass"),
    Derived("c", "N s/m", lambda p, _: p.damping, scale="mass"),
    Derived("m", "kg", lambda p, _: 1 / p.K, scale="stiffness"),
    Derived("Fs", "N", lambda p, _: p.F / p.K, 1, SIX, scale="stiffness"),
    Derived("G_slip", "N s/m", lambda p, _: p.shape * p.F / p.K, 0, "linear", scale="stiffness"),
    Derived("c", "N s/m", lambda p, _: p.damping / p.K, scale="stiffness"),
    Derived(
        "x0 + Fs/k", "m", lambda p, _: p.datum + p.F / p.K, 1, SIX, None, "", Global.DATUM, NO_LIMITS, mirrored=True
    ),
    Derived(
        "(G_slip - c)/m",
        "s^-1",
        lambda p, _: p.shape * p.F - p.damping,
        0,
        "linear",
        None,
        "",
        Global.DAMPING,
        NO_LIMITS,
    ),
)
UNDETERMINED_WITH = {  # parameters confounded with an undetermined unknown
    Global.DATUM: ("x0", "Fs/m", "Fs/k", "Fs", "Fs0/m", "wear"),
    Global.DAMPING: ("c/m", "c", "G_slip/m", "G_slip"),
    Global.V_DR: ("d",),
}
RUN_PARAMETERS = ("v_dr", "x0", "Fs0/m", "wear", "droop", "ripple", "ripple_hz")  # others are common to all runs


def derived_parameters(
    fit: Fit, motion: MeasuredMotion, alpha: float, run: int = 0, *, sustained: bool = True
) -> dict[str, Parameter]:
    """Return a law's parameters with their intervals, in the record's signs and recorded positions.

    A ``sustained`` contact sticks repeatedly and may wear: ``Fs0/m`` is the level at the start, ``wear`` the fraction
    lost per second. ``droop`` is the slowing of the belt under Fs. A formula's parameter ``NAME`` with friction in its
    unit is also given as ``NAME/m``; its name takes precedence. Where datum or damping is neither calibrated nor
    constrained by the data, only the constrained combination is given.
    """
    constraints = _constrain(fit, motion, run)
    quantile = float(special.stdtrit(max(len(fit.rows) - 1, 1), 1 - alpha / 2))
    parameters: dict[str, Parameter] = {}
    for row, scale in _table(fit, motion, constraints):
        parameters[row.name] = _derive(row, scale, constraints, motion, quantile)
        if row.name == "c/m" and sustained:
            parameters |= _wear_parameters(fit.level_trend(run), parameters.get("Fs/m"), alpha)
    parameters = {name: parameter for name, parameter in parameters.items() if name not in _hidden_names(constraints)}
    of_law = {row.name: _derive(row, scale, constraints, motion, quantile) for row, scale in _formula_rows(fit, motion)}
    of_law |= _differences(fit, constraints, of_law, quantile)
    return {name: parameter for name, parameter in parameters.items() if name not in of_law} | of_law


def _differences(
    fit: Fit, constraints: "Constraints", parameters: Mapping[str, Parameter], quantile: float
) -> dict[str, Parameter]:
    """Return constrained differences of a formula's unconstrained levels, per unit mass."""
    values_of, differences = fit.law_values, {}
    levels = [name for name in values_of if f"{name}/m" in parameters and fit.law.dimensions[name] == (1, 0)]
    for pair in combinations([name for name in levels if not parameters[f"{name}/m"].fixed], 2):
        if any(_is_constrained(parameters[f"{name}/m"]) for name in pair):
            continue
        high, low = sorted(pair, key=lambda name: -values_of[name])
        variance = constraints.variance(lambda _, law, high=high, low=low: law[high] - law[low])  # type: ignore[misc]
        difference = Parameter.around(values_of[high] - values_of[low], math.sqrt(variance), quantile, unit="m s^-2")
        if _is_constrained(difference):
            differences[f"({high} - {low})/m"] = difference
    return differences


def _is_constrained(parameter: Parameter) -> bool:
    return parameter.stderr < STATED_ERROR * abs(parameter.value)


def friction_band(fit: Fit, motion: MeasuredMotion, speed: Array, alpha: float) -> Array:
    """Return half the width of the confidence interval of friction (n,) at each slip speed, in `friction.unit`."""
    constraints = _constrain(fit, motion, 0)

    def friction_of(q: Array, stretched: float = 1.0) -> Array:
        moved = fit.q.copy()
        moved[constraints.places] = q
        return stretched * friction_at(replace(fit, q=moved), motion, speed / stretched)

    slopes = differences(friction_of, constraints.q, constraints.steps)
    variance = np.einsum("ni,sij,nj->sn", slopes, constraints.covariances, slopes).max(axis=0)
    by_length = (friction_of(constraints.q, 1 + 1e-6) - friction_of(constraints.q, 1 - 1e-6)) / 2e-6
    scale = motion.mass or motion.stiffness
    of_scale = 0.0 if scale is None else scale.sd / scale.value * friction_of(constraints.q)
    quantile = float(special.stdtrit(max(len(fit.rows) - 1, 1), 1 - alpha / 2))
    return np.asarray(quantile * np.sqrt(variance + (by_length * motion.length_error) ** 2 + of_scale**2))


def correlations(fit: Fit, motion: MeasuredMotion, run: int = 0) -> Correlations:
    """Return the correlations of parameters per unit mass that do not follow from others."""
    constraints = _constrain(fit, motion, run)
    rows = _independent_rows(fit, motion, constraints)
    slopes = np.array([constraints.slopes(row.formula) for row in rows])
    slopes *= np.array([_sign_of(row, motion) for row in rows])[:, None]
    point = constraints.at(constraints.q)
    lengths = np.array([row.length * row.formula(*point) * motion.length_error for row in rows])
    lengths *= [_sign_of(row, motion) for row in rows]
    spread = np.einsum("ri,ij,sj->rs", slopes, upper_bound(*constraints.covariances), slopes) + np.outer(
        lengths, lengths
    )
    shown = np.diag(spread) > 0
    error = np.sqrt(np.diag(spread)[shown])
    matrix = np.clip(spread[np.ix_(shown, shown)] / np.outer(error, error), -1.0, 1.0)
    return Correlations(tuple(row.name for row, is_shown in zip(rows, shown, strict=True) if is_shown), matrix)


def _independent_rows(fit: Fit, motion: MeasuredMotion, constraints: "Constraints") -> list[Derived]:
    law_rows = [
        row for row, scale in _formula_rows(fit, motion) if scale is None and row.identifiable and not row.fixed
    ]
    left_out = {*_hidden_names(constraints), *(row.name for row in law_rows)}
    table = [row for row, scale in _table(fit, motion, constraints) if scale is None and row.name not in left_out]
    return [row for row in (*table, *law_rows) if not row.follows]


class IndependentParameters(NamedTuple):
    """Parameters as a function of the unknowns and of a step along the unconstrained direction."""

    names: tuple[str, ...]
    lengths: Array  # (k,) power of the metre in each
    at: Callable[[Array, float], Array]  # (q, step in standard deviations) to their values (k,)


def independent_parameters(fit: Fit, motion: MeasuredMotion) -> IndependentParameters:
    """Return the parameters of the first run that follow from no others, per unit mass."""
    constraints = _constrain(fit, motion, 0)
    rows = _independent_rows(fit, motion, constraints)

    def at(q: Array, unconstrained: float) -> Array:
        point = constraints.at(q[constraints.places] + unconstrained * constraints.unconstrained)
        return np.array([_sign_of(row, motion) * row.formula(*point) for row in rows])

    return IndependentParameters(tuple(row.name for row in rows), np.array([row.length for row in rows]), at)


def unknown_of(fit: Fit, motion: MeasuredMotion, name: str) -> tuple[int, Callable[[float], float]] | None:
    """Return the one unknown that a parameter of the first run depends on, and the parameter as its function."""
    constraints = _constrain(fit, motion, 0)
    for row, scale in (*_formula_rows(fit, motion), *_table(fit, motion, constraints)):
        if row.name != name:
            continue
        deciding = np.flatnonzero(constraints.slopes(row.formula))
        if deciding.size != 1:
            return None
        factor = _sign_of(row, motion) * (1.0 if scale is None else scale.value**row.power)

        def value(unknown: float, row: Derived = row, factor: float = factor, k: int = int(deciding[0])) -> float:
            q = constraints.q.copy()
            q[k] = unknown
            return factor * row.formula(*constraints.at(q))

        return int(constraints.places[deciding[0]]), value
    return None


def break_away_level_error(fit: Fit, motion: MeasuredMotion, run: int = 0) -> float:
    """Return the error of the break-away level over Fs that is common to all cycles: from x0, Fs and k/m."""
    constraints = _constrain(fit, motion, run)
    p, _ = constraints.at(constraints.q)
    break_away = p.datum + p.F / p.K
    return math.sqrt(constraints.variance(lambda q, _: q.K * (break_away - q.datum) / q.F))


class Constraints(NamedTuple):
    """Constraints of a fit on the parameters of one run."""

    q: Array  # (m,) free unknowns: the ``active`` shared ones, then the curve's
    places: Integers  # (m,) among those of the fit
    at: Callable[[Array], tuple[Values, LawValues]]
    active: list[Global]
    covariances: Array  # (2, m, m) covariances by sandwich and curvature
    undetermined: set[Global]  # unknowns dominated by a default prior
    unconstrained: Array | float = 0.0  # (m,) such a direction, a standard deviation long, part of ``covariances``

    @property
    def steps(self) -> Array:
        return DERIVATIVE_STEP * np.maximum(np.abs(self.q), DERIVATIVE_STEP)

    def slopes(self, formula: Callable[[Values, LawValues], float]) -> Array:
        return differences(lambda q: formula(*self.at(q)), self.q, self.steps)

    def variance(self, formula: Callable[[Values, LawValues], float]) -> float:
        """Return the larger of both variances."""
        slope = self.slopes(formula)
        return max(float(np.einsum("i,sij,j->s", slope, self.covariances, slope).max()), 0.0)


def differences(function: Callable[[Array], Array | float], q: Array, steps: Array) -> Array:
    """Return the derivatives of a function by its arguments (n,), along the last axis, by central differences."""
    moves = zip(np.diag(steps), steps, strict=True)
    return np.stack(
        [(np.asarray(function(q + move)) - np.asarray(function(q - move))) / (2 * step) for move, step in moves],
        axis=-1,
    )


def _constrain(fit: Fit, motion: MeasuredMotion, run: int) -> Constraints:
    run, curve, problem = run if fit.run is None else fit.run, fit.task.curve, fit.least_squares
    slots = columns(fit.places, len(fit.problem.runs))[run]
    first = np.flatnonzero(slots >= 0)
    index = np.concatenate([first, len(slots) + np.arange(curve.size)])
    active, u = [Global(slot) for slot in slots[first]], fit.for_run(run).u

    def at(q: Array) -> tuple[Values, LawValues]:
        of_run, theta = u.copy(), q[len(active) :]
        of_run[active] = q[: len(active)]
        if theta.size:
            of_run[Global.LOG_F] = math.log(float(curve.friction(of_run, theta, q[:0], np.zeros(1))[0]))
        return values(of_run), curve.values(theta, of_run)

    precision = problem.precision[first]
    spread = np.array(covariances(fit))[:, index][:, :, index]
    unconstrained = np.zeros(index.size)
    if curve.kind == "constant":
        # The datum is fixed in the fit. Fs/k compensates it; on a ramp width and belt speed follow Fs/k.
        rate = -fit.values.K / fit.values.F
        moves = {Global.DATUM: 1.0, Global.LOG_F: rate}
        if Global.D in active:
            moves |= {Global.D: rate * fit.values.d, Global.V_DR: rate * fit.values.d}
        datum_sd = rest_calibration(fit.problem.runs[run]).sd
        unconstrained = datum_sd * np.array([moves.get(slot, 0.0) for slot in active])
        spread, known_datum = spread + np.outer(unconstrained, unconstrained), spread
        if Global.D in active:
            # The record determines d/Fs, so an error of the datum also scales that of the width, to second order.
            width = known_datum[:, active.index(Global.D), active.index(Global.D), None, None]
            width_and_speed = np.array([float(slot in (Global.D, Global.V_DR)) for slot in active])
            spread = spread + width * (rate * datum_sd) ** 2 * np.outer(width_and_speed, width_and_speed)
    elif curve.kind == "linear" and motion.datum_prior is None:
        unconstrained = _hidden_level(fit, values(u), run, active)
        spread = spread + np.outer(unconstrained, unconstrained)
    default = {
        Global.DATUM: motion.datum_prior is None,
        Global.DAMPING: motion.damping_prior is None or motion.per_mass,
    }
    prior_share = np.einsum("sii->si", spread).max(axis=0)[: len(active)] * precision
    fixed = problem.lower[first] == problem.upper[first]
    undetermined = {
        slot
        for slot, share, is_fixed in zip(active, prior_share, fixed, strict=True)
        if default.get(slot) and share > DEFAULT_LEFT and not (is_fixed and slot != Global.DATUM)
    }
    if default[Global.DATUM] and curve.kind == "constant":
        undetermined.add(Global.DATUM)
    if curve.kind == "constant" and not fit.problem.runs[run].cut.shows_belt:
        undetermined.add(Global.V_DR)
        belt_speed = active.index(
            Global.V_DR
        )  # no better than its start, however sharply the mass bounds it from below
        spread[:, belt_speed, belt_speed] = np.maximum(spread[:, belt_speed, belt_speed], 1 / precision[belt_speed])
    return Constraints(np.array([*u[active], *fit.theta]), index, at, active, spread, undetermined, unconstrained)


def _hidden_level(fit: Fit, p: Values, run: int, active: list[Global]) -> Array:
    """Return the unconstrained direction (p,) of a linear curve, scaled by the error of the datum.

    On a ramp, or a belt that slows under load, rest position and belt speed absorb a change of the friction level,
    unless the scatter of the levels moves the load by more than the residual.
    """
    width = p.d if fit.law.ramp else p.compliance * p.F / p.K
    if width <= 0 or not fit.inlier_cycles.any():
        return np.zeros(len(active))
    moved = math.sqrt(float(np.mean(fit.local[fit.inlier_cycles, PerCycle.LEVEL] ** 2))) * p.F / p.K
    if _true_square(fit, PerCycle.LEVEL)[0] > 0 and moved > fit.geometric_mean_rms:
        return np.zeros(len(active))
    moves = {
        Global.DATUM: -p.F / (width * p.K),
        Global.LOG_F: 1 / width,
        Global.SHAPE: -p.shape / width,
        Global.V_DR: 1.0,
        Global.D: 1.0,
    }
    datum = PER_RUN * run + Global.DATUM
    datum_sd = 1 / math.sqrt(float(fit.problem.precision[datum]))
    return np.array([moves.get(slot, 0.0) for slot in active]) * datum_sd * width * p.K / p.F


def _table(fit: Fit, motion: MeasuredMotion, constraints: Constraints) -> Iterator[tuple[Derived, Measured | None]]:
    """Yield the rows that apply to a fit, each with the calibration that multiplies it."""
    kind = fit.task.curve.kind
    for row in TABLE:
        scale = None if not row.scale or (row.scale == "stiffness" and motion.mass) else getattr(motion, row.scale)
        if (
            (row.curve in ("", kind) or (row.curve == SIX and kind))
            and (row.needs is None or row.needs in constraints.active)
            and (not row.scale or scale is not None)
            and (row.instead_of is None or row.instead_of in constraints.undetermined)
        ):
            yield row, scale


def _formula_rows(fit: Fit, motion: MeasuredMotion) -> Iterator[tuple[Derived, Measured | None]]:
    """Yield a formula's parameters; those with friction in their unit both per unit mass and as a force."""
    law, curve = fit.law, fit.task.curve
    if isinstance(curve, LawCurve):
        return
    scale = motion.mass or motion.stiffness
    unknown = {name for group in curve.together for name in group.names}
    for name in law.parameters:
        (force, speed), power = law.dimensions.get(name, (0, 0)), law.mass_power(name)
        by_log = name in curve.free and bool(curve.by_log[curve.free.index(name)])
        fixed = name in (law.fix or {})
        row = Derived(
            f"{name}/m" if power else name,
            law.unit(name),
            partial(_of_formula, name=name),
            0 if fixed else force + speed,
            limits=law.limits(name),
            by_log=by_log,
            identifiable=name not in unknown,
            fixed=fixed,
        )
        yield row, None
        if not power:
            continue
        in_newtons = partial(_of_formula, name=name, stretched=power if scale is motion.stiffness and scale else 0)
        unit = law.unit(name, newtons=scale is not None)
        yield row._replace(name=name, unit=unit, formula=in_newtons, follows=True, power=power), scale


def _of_formula(p: Values, law_values: LawValues, name: str, stretched: int = 0) -> float:
    return law_values[name] / p.K**stretched


def _hidden_names(constraints: Constraints) -> set[str]:
    return {name for slot in constraints.undetermined for name in UNDETERMINED_WITH[slot]}


def _sign_of(row: Derived, motion: MeasuredMotion) -> float:
    return motion.sign if row.mirrored else 1.0


def _derive(
    row: Derived, scale: Measured | None, constraints: Constraints, motion: MeasuredMotion, quantile: float
) -> Parameter:
    value = _sign_of(row, motion) * float(row.formula(*constraints.at(constraints.q)))
    variance = constraints.variance(row.formula) + (row.length * value * motion.length_error) ** 2
    low, high = row.limits
    if scale is not None:
        factor = scale.value**row.power
        variance = variance * factor**2 + (row.power * scale.value ** (row.power - 1) * value * scale.sd) ** 2
        value, low, high = value * factor, low * factor, high * factor
    parameter = Parameter.around(value, math.sqrt(variance), quantile, (low, high), by_log=row.by_log, unit=row.unit)
    return replace(parameter, trusted=row.identifiable, fixed=row.fixed)


def _wear_parameters(trend: Wear | None, level: Parameter | None, alpha: float) -> dict[str, Parameter]:
    """Return wear and, if a ``level`` is given, the level at the start; empty where the levels have no trend."""
    if trend is None:
        return {}
    first, rate = trend.first, trend.rate
    quantile = float(special.stdtrit(trend.degrees_of_freedom, 1 - alpha / 2))
    parameters = {}
    if level is not None:
        error = math.hypot(level.stderr * first.value, level.value * first.sd)
        parameters["Fs0/m"] = Parameter.around(level.value * first.value, error, quantile, POSITIVE, unit=level.unit)
    return parameters | {"wear": Parameter.around(rate.value, rate.sd, quantile, unit="s^-1")}
