"""Parameters of a fit in the units of the rig, with their intervals, and each break-away.

Intervals: a sandwich over cycles, calibrations as priors, t quantile over the cycles. Residuals of a slightly wrong
model are correlated within a cycle and independent between cycles, so the spread of the cycles' gradients shows how far
the estimate would move with other cycles. With few cycles the sandwich can be too small; the curvature at the noise
level rms x sqrt(correlation time) is the floor. In it a cycle informs by no more than its residuals allow: under
constant friction only the drag of a start-up constrains the belt's speed, and no other cycle shows how far a ripple
moves it.

The errors of the levels must not inform the parameters (`without_level_errors`). Without a datum the prior of the
levels is wider than their scatter (`EstimationProblem.level_prior`); the floor is then the covariance of the estimate
under the true scatter.

Derived quantities are one table. Errors propagate to first order; that of the metres per count enters every quantity
with a length in its unit.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from fitting.distributions import student_quantile
from fitting.least_squares.levenberg_marquardt import linearise
from fitting.least_squares.normal_equations import ROUNDING, SchurComplement, eigen, scaled_inverse
from fitting.model.curves import LawCurve
from fitting.model.problem import rest_calibration
from fitting.model.unknowns import PER_RUN, Global, PerCycle, Values, columns, values
from fitting.model.windows import Wear
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array, Integers, autocorrelation_time
from stickslip.units import Measured

STATED_ERROR = 0.5  # standard error over a value, from which it is not stated; of levels only the difference is
NO_LIMITS = (-math.inf, math.inf)
LARGEST_LOG = 300.0  # logarithm of a value's factor: at more the end of an interval is no number


@dataclass(frozen=True)
class Parameter:
    """A value with its standard error and confidence interval."""

    value: float
    stderr: float
    lo: float
    hi: float
    unit: str
    trusted: bool = True  # False: the law does not describe the record, and the error, too small, is withheld
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
        """Return the interval of ``quantile`` standard errors within limits, by a factor if fitted by its logarithm."""
        if by_log and value > 0:
            factor = math.exp(min(quantile * stderr / value, LARGEST_LOG))
            lo, hi = value / factor, value * factor
        else:
            lo, hi = value - quantile * stderr, value + quantile * stderr
        return cls(value, stderr, max(lo, limits[0]), min(hi, limits[1]), unit)


def in_columns(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return table cells: value, "NAME stderr", "NAME lo", "NAME hi"; None for what is withheld."""
    found: dict[str, Any] = {}
    for name, item in parameters.items():
        cells = item.as_json()
        found[name] = cells["value"]
        found |= {f"{name} {part}": cells[part] for part in ("stderr", "lo", "hi")}
    return found


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
    # "" for a cycle that counted, "rough" for one that fits far worse than the others, else why it was left out
    flag: str

    def as_json(self) -> dict[str, Any]:
        return {"static_level" if name == "break_away_level" else name: item for name, item in vars(self).items()}


# Largest variance of a cycle's residuals over the assumed one: a correlation time from one window is uncertain.
LARGEST_VARIANCE = 2.0
# Scatter of the levels beyond their errors, in standard errors of a mean square, from which they inform: noise alone
# shows as much once in 150 contacts.
SCATTER_ERRORS = 3.0


def remove_level_errors(fit: Fit) -> Fit:
    """Return a fit with the curvatures at levels without their errors.

    Without a datum a ramp law constrains only Fs/d, v_dr - d and x0 + Fs/k, unless the level changes between cycles.
    Errors counted as such changes would give v_dr an interval a hundred times too narrow.
    """
    if fit.problem.level_prior <= 1 or not fit.inlier_cycles.any():
        return fit
    local = fit.local.copy()
    for column in (PerCycle.LEVEL, PerCycle.NEXT_LEVEL):
        true, error = _true_square(fit, column)
        local[:, column] *= true / (true + error)
    there, here = linearise(fit.least_squares, fit.solution.u, local), fit.solution.blocks
    if there is None:
        return fit
    blocks = replace(there.blocks, g=here.g, gl=here.gl, cycle_g=here.cycle_g)
    return replace(fit, solution=replace(fit.solution, blocks=blocks))


def _true_square(fit: Fit, column: PerCycle) -> tuple[float, Array]:
    """Return the mean square of an unknown beyond its expected errors, and the squares (cycles,)."""
    own = fit.inlier_cycles
    error = np.asarray(np.linalg.inv(fit.solution.blocks.Hl)[:, column, column])
    likely = float(np.mean(error[own])) * (1 + SCATTER_ERRORS * math.sqrt(2 / own.sum()))
    return max(float(np.mean(fit.local[own, column] ** 2)) - likely, 0.0), error


def covariance(fit: Fit) -> Array:
    """Return one covariance not smaller than either; for one quantity take the larger of both variances."""
    return upper_bound(*covariances(fit))


def covariances(fit: Fit) -> tuple[Array, Array]:
    """Return the covariances (p, p) of the unknowns, the curve's last, by the sandwich and by the curvature."""
    blocks = fit.solution.blocks
    reduced = SchurComplement(blocks)
    H = reduced.H
    own = reduced.reduced_gradients(blocks.cycle_g, reduced.local_step(blocks.gl))
    cycles = own.shape[0]
    scale, bread = scaled_inverse(H, np.diag(blocks.H))
    own = own * scale
    priors = np.diag(fit.least_squares.precision * scale**2)
    meat = np.einsum("ci,cj->ij", own, own) * (cycles / max(cycles - 1, 1)) + priors
    sandwich = np.einsum("ik,kl->il", np.einsum("ik,kl->il", bread, meat), bread)
    share = _founded(fit)
    informed = np.einsum("c,cpr->pr", share - 1, reduced.by_cycle(blocks.cycle_curvature))
    own_scale, limited = scaled_inverse(H + informed, np.diag(blocks.H))
    if fit.problem.level_prior > 1:
        narrower = np.einsum("c,cpr->pr", share, reduced.by_prior(_excess(fit))) * own_scale[:, None] * own_scale
        limited = limited - np.einsum("ij,jk,kl->il", limited, narrower, limited)
    return sandwich * scale[:, None] * scale, limited * own_scale[:, None] * own_scale


def upper_bound(first: Array, second: Array) -> Array:
    """Return a covariance (p, p) that is in no direction smaller than either of two.

    In the basis in which the second is 1 and the first diagonal it is the larger of both. Larger variances with the
    same correlations would give combinations of correlated unknowns an error that neither covariance allows.
    """
    unit = np.sqrt(np.diag(second))
    size, axes = eigen(second / unit[:, None] / unit)
    root = np.sqrt(np.maximum(size, ROUNDING))
    back, there = axes / root / unit[:, None], axes * root * unit[:, None]
    ratio, turn = eigen(np.einsum("ki,kl,lj->ij", back, first, back))
    half = np.einsum("ik,kj->ij", there, turn) * np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(np.einsum("ik,jk->ij", half, half))


def _founded(fit: Fit) -> Array:
    """Return the share (cycles,) of a cycle's information that its residuals allow."""
    assumed = 1 / fit.least_squares.weights
    own = np.full(assumed.size, 1e-300)
    for cycle, _, first, size, *_ in fit.windows.table:  # a drag is a window of the first cycle
        part = fit.residual[first : first + size]
        own[cycle] = max(own[cycle], float(np.mean(part**2)) * autocorrelation_time([part]))
    return np.asarray(np.minimum(LARGEST_VARIANCE * assumed / own, 1.0))


def _excess(fit: Fit) -> Array:
    """Return the precision (cycles, q) of the levels missing in the prior, which is wider than their scatter."""
    sd = fit.noise.level_sd(fit.windows, fit.problem.level_prior)
    excess = (1 - (fit.noise.scatter / sd) ** 2) / sd**2
    found = np.zeros_like(fit.solution.blocks.gl)
    found[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = np.where(fit.inlier_cycles[:, None], excess, 0.0)
    return found


DEFAULT_LEFT = 0.01  # share of a default's variance left after the fit; with more, what depends on it is not given
POSITIVE = (0.0, math.inf)
Own = Mapping[str, float]  # the law's parameters by name, per unit mass
SIX = "six"  # of each of the six that its own kernel follows


class Derived(NamedTuple):
    name: str
    unit: str
    formula: Callable[[Values, Own], float]
    length: int = 0  # power of the metre in it, for the error of the metres per count
    curve: str = ""  # only for laws of this curve, or the `SIX`
    needs: Global | None = None  # only where the fit has this parameter
    scale: str = ""  # calibration that it is multiplied by, and without which it is not given
    instead_of: Global | None = None  # only where this one is undetermined
    limits: tuple[float, float] = POSITIVE
    mirrored: bool = False  # whether it changes sign with a record of a backward belt
    follows: bool = False  # whether it follows from other rows
    power: int = 1  # of the calibration
    by_log: bool = False  # whether its interval is one by a factor
    apart: bool = True  # whether the formula determines it apart from other parameters
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
UNDETERMINED_WITH = {  # what is known only together with something that the record does not show
    Global.DATUM: ("x0", "Fs/m", "Fs/k", "Fs", "Fs0/m", "wear"),
    Global.DAMPING: ("c/m", "c", "G_slip/m", "G_slip"),
    Global.V_DR: ("d",),
}
RUNS_OWN = ("v_dr", "x0", "Fs0/m", "wear", "droop", "ripple", "ripple_hz")  # the others are one for all runs


def derived_parameters(
    fit: Fit, motion: MeasuredMotion, alpha: float, run: int = 0, *, sustained: bool = True
) -> dict[str, Parameter]:
    """Return a law's parameters with their intervals, in the record's signs and recorded positions.

    A ``sustained`` contact sticks repeatedly and may wear: ``Fs0/m`` is the level at the start, ``wear`` the fraction
    lost per second. ``droop`` is the slowing of the belt under Fs. A formula's parameter ``NAME`` with friction in its
    unit is also given as ``NAME/m``; its name takes precedence. Where datum or damping is neither calibrated nor
    constrained by the data, only the constrained combination is given.
    """
    known = _known(fit, motion, run)
    quantile = student_quantile(1 - alpha / 2, max(len(fit.rows) - 1, 1))
    found: dict[str, Parameter] = {}
    for row, scale in _table(fit, motion, known):
        found[row.name] = _scaled(row, scale, known, motion, quantile)
        if row.name == "c/m" and sustained:
            found |= _wear_of(fit.level_trend(run), found.get("Fs/m"), alpha)
    found = {name: item for name, item in found.items() if name not in _hidden(known)}
    own = {row.name: _scaled(row, scale, known, motion, quantile) for row, scale in _own_rows(fit, motion)}
    own |= _differences(fit, known, own, quantile)
    return {name: item for name, item in found.items() if name not in own} | own


def _differences(fit: Fit, known: "Known", own: Mapping[str, Parameter], quantile: float) -> dict[str, Parameter]:
    """Return the differences of a formula's levels that are known where the levels are not, per unit mass."""
    values_of, found = fit.law_values, {}
    levels = [name for name in values_of if f"{name}/m" in own and fit.law.dimensions[name] == (1, 0)]
    for pair in combinations([name for name in levels if not own[f"{name}/m"].fixed], 2):
        if any(_level_known(own[f"{name}/m"]) for name in pair):
            continue
        high, low = sorted(pair, key=lambda name: -values_of[name])
        variance = known.variance(lambda _, own, high=high, low=low: own[high] - own[low])  # type: ignore[misc]
        item = Parameter.around(values_of[high] - values_of[low], math.sqrt(variance), quantile, unit="m s^-2")
        if _level_known(item):
            found[f"({high} - {low})/m"] = item
    return found


def _level_known(item: Parameter) -> bool:
    return item.stderr < STATED_ERROR * abs(item.value)


def correlations(fit: Fit, motion: MeasuredMotion, run: int = 0) -> Correlations:
    """Return the correlations of parameters per unit mass that do not follow from others."""
    known = _known(fit, motion, run)
    rows = _rows_each_once(fit, motion, known)
    slopes = np.array([list(known.slopes(row.formula)) for row in rows])
    slopes *= np.array([_sign_of(row, motion) for row in rows])[:, None]
    lengths = np.array([row.length * row.formula(*known.at(known.q)) * motion.length_error for row in rows])
    lengths *= [_sign_of(row, motion) for row in rows]
    spread = np.einsum("ri,ij,sj->rs", slopes, upper_bound(*known.spreads), slopes) + np.outer(lengths, lengths)
    shown = np.diag(spread) > 0
    error = np.sqrt(np.diag(spread)[shown])
    matrix = np.clip(spread[np.ix_(shown, shown)] / np.outer(error, error), -1.0, 1.0)
    return Correlations(tuple(row.name for row, own in zip(rows, shown, strict=True) if own), matrix)


def _rows_each_once(fit: Fit, motion: MeasuredMotion, known: "Known") -> list[Derived]:
    own = [row for row, scale in _own_rows(fit, motion) if scale is None and row.apart and not row.fixed]
    left_out = {*_hidden(known), *(row.name for row in own)}
    table = [row for row, scale in _table(fit, motion, known) if scale is None and row.name not in left_out]
    return [row for row in (*table, *own) if not row.follows]


class IndependentParameters(NamedTuple):
    """Parameters at given unknowns ``q`` and, in standard deviations, a direction ``unseen`` by the record."""

    names: tuple[str, ...]
    lengths: Array  # (k,) power of the metre in each
    at: Callable[[Array, float], Array]  # (q, unseen) to their values (k,)


def independent_parameters(fit: Fit, motion: MeasuredMotion) -> IndependentParameters:
    """Return the parameters of the first run that follow from no others, per unit mass."""
    known = _known(fit, motion, 0)
    rows = _rows_each_once(fit, motion, known)

    def at(q: Array, unseen: float) -> Array:
        point = known.at(q[known.places] + unseen * known.unseen)
        return np.array([_sign_of(row, motion) * row.formula(*point) for row in rows])

    return IndependentParameters(tuple(row.name for row in rows), np.array([row.length for row in rows]), at)


def unknown_of(fit: Fit, motion: MeasuredMotion, name: str) -> tuple[int, Callable[[float], float]] | None:
    """Return the unknown that alone decides a parameter of the first run, and the parameter by its value; else None."""
    known = _known(fit, motion, 0)
    for row, scale in (*_own_rows(fit, motion), *_table(fit, motion, known)):
        if row.name != name:
            continue
        deciding = np.flatnonzero(list(known.slopes(row.formula)))
        if deciding.size != 1:
            return None
        factor = _sign_of(row, motion) * (1.0 if scale is None else scale.value**row.power)

        def value(at: float, row: Derived = row, factor: float = factor, k: int = int(deciding[0])) -> float:
            q = known.q.copy()
            q[k] = at
            return factor * row.formula(*known.at(q))

        return int(known.places[deciding[0]]), value
    return None


def break_away_level_error(fit: Fit, motion: MeasuredMotion, run: int = 0) -> float:
    """Return the error of the break-away level over Fs that all cycles share: from x0, Fs and k/m."""
    known = _known(fit, motion, run)
    p, _ = known.at(known.q)
    place = p.datum + p.F / p.K
    return math.sqrt(known.variance(lambda q, _: q.K * (place - q.datum) / q.F))


class Known(NamedTuple):
    """Constraints of a fit on one run."""

    q: Array  # (m,) free unknowns: the ``active`` shared ones, then the curve's
    places: Integers  # (m,) among those of the fit
    at: Callable[[Array], tuple[Values, Own]]
    active: list[Global]
    spreads: Array  # (2, m, m) covariances by sandwich and curvature
    undetermined: set[Global]  # dominated by a default
    unseen: Array | float = 0.0  # (m,) an unconstrained direction, a standard deviation long, contained in ``spreads``

    def slopes(self, formula: Callable[[Values, Own], float]) -> Iterator[float]:
        for k, value in enumerate(self.q.tolist()):
            step = 1e-6 * max(abs(value), 1e-6)
            up, down = self.q.copy(), self.q.copy()
            up[k] += step
            down[k] -= step
            yield (formula(*self.at(up)) - formula(*self.at(down))) / (2 * step)

    def variance(self, formula: Callable[[Values, Own], float]) -> float:
        """Return the larger variance of both."""
        slope = np.array(list(self.slopes(formula)))
        return max(float(np.einsum("i,sij,j->s", slope, self.spreads, slope).max()), 0.0)


def _known(fit: Fit, motion: MeasuredMotion, run: int) -> Known:
    run, curve, problem = run if fit.run is None else fit.run, fit.task.curve, fit.least_squares
    slots = columns(fit.places, len(fit.problem.runs))[run]
    first = np.flatnonzero(slots >= 0)
    index = np.concatenate([first, len(slots) + np.arange(curve.size)])
    active, u = [Global(slot) for slot in slots[first]], fit.for_run(run).u

    def at(q: Array) -> tuple[Values, Own]:
        own, theta = u.copy(), q[len(active) :]
        own[active] = q[: len(active)]
        if theta.size:
            own[Global.LOG_F] = math.log(float(curve.friction(own, theta, q[:0], np.zeros(1))[0]))
        return values(own), curve.values(theta, own)

    precision = problem.precision[first]
    spread = np.array(covariances(fit))[:, index][:, :, index]
    unseen = np.zeros(index.size)
    if curve.kind == "constant":
        # The datum is held in the fit; Fs/k moves against it, and of a ramp its width and the belt's speed with that.
        rate = -fit.values.K / fit.values.F
        beside = {Global.DATUM: 1.0, Global.LOG_F: rate}
        if Global.D in active:
            beside |= {Global.D: rate * fit.values.d, Global.V_DR: rate * fit.values.d}
        datum_sd = rest_calibration(fit.problem.runs[run]).sd
        unseen = datum_sd * np.array([beside.get(slot, 0.0) for slot in active])
        spread, known_datum = spread + np.outer(unseen, unseen), spread
        if Global.D in active:
            # The record determines d/Fs, so an error of the datum also scales that of the width, to second order.
            width = known_datum[:, active.index(Global.D), active.index(Global.D), None, None]
            both = np.array([float(slot in (Global.D, Global.V_DR)) for slot in active])
            spread = spread + width * (rate * datum_sd) ** 2 * np.outer(both, both)
    elif curve.kind == "linear" and motion.datum_prior is None:
        unseen = _hidden_level(fit, values(u), run, active)
        spread = spread + np.outer(unseen, unseen)
    default = {
        Global.DATUM: motion.datum_prior is None,
        Global.DAMPING: motion.damping_prior is None or motion.per_mass,
    }
    left = np.einsum("sii->si", spread).max(axis=0)[: len(active)] * precision
    held = problem.lower[first] == problem.upper[first]
    undetermined = {
        slot
        for slot, share, fixed in zip(active, left, held, strict=True)
        if default.get(slot) and share > DEFAULT_LEFT and not (fixed and slot != Global.DATUM)
    }
    if default[Global.DATUM] and curve.kind == "constant":
        undetermined.add(Global.DATUM)
    if curve.kind == "constant" and not fit.problem.runs[run].cut.shows_belt:
        undetermined.add(Global.V_DR)
        place = active.index(Global.V_DR)  # no better than its start, however sharply the mass bounds it from below
        spread[:, place, place] = np.maximum(spread[:, place, place], 1 / precision[place])
    return Known(np.array([*u[active], *fit.theta]), index, at, active, spread, undetermined, unseen)


def _hidden_level(fit: Fit, p: Values, run: int, active: list[Global]) -> Array:
    """Return the unconstrained direction (p,) of a linear curve, by the error of the datum.

    On a ramp, or a belt that slows under load, rest position and belt speed absorb another level of friction, unless
    levels that differ move the load by more than the position.
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
    place = PER_RUN * run + Global.DATUM
    datum_sd = 1 / math.sqrt(float(fit.problem.precision[place]))
    return np.array([moves.get(slot, 0.0) for slot in active]) * datum_sd * width * p.K / p.F


def _table(fit: Fit, motion: MeasuredMotion, known: Known) -> Iterator[tuple[Derived, Measured | None]]:
    """Yield the rows that apply to a fit, each with the calibration that multiplies it."""
    kind = fit.task.curve.kind
    for row in TABLE:
        scale = None if not row.scale or (row.scale == "stiffness" and motion.mass) else getattr(motion, row.scale)
        if (
            (row.curve in ("", kind) or (row.curve == SIX and kind))
            and (row.needs is None or row.needs in known.active)
            and (not row.scale or scale is not None)
            and (row.instead_of is None or row.instead_of in known.undetermined)
        ):
            yield row, scale


def _own_rows(fit: Fit, motion: MeasuredMotion) -> Iterator[tuple[Derived, Measured | None]]:
    """Yield a formula's parameters, those with friction in their unit per unit mass and as a force."""
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
            apart=name not in unknown,
            fixed=fixed,
        )
        yield row, None
        if not power:
            continue
        in_newtons = partial(_of_formula, name=name, stretched=power if scale is motion.stiffness and scale else 0)
        unit = law.unit(name, newtons=scale is not None)
        yield row._replace(name=name, unit=unit, formula=in_newtons, follows=True, power=power), scale


def _of_formula(p: Values, own: Own, name: str, stretched: int = 0) -> float:
    return own[name] / p.K**stretched


def _hidden(known: Known) -> set[str]:
    return {name for slot in known.undetermined for name in UNDETERMINED_WITH[slot]}


def _sign_of(row: Derived, motion: MeasuredMotion) -> float:
    return motion.sign if row.mirrored else 1.0


def _scaled(row: Derived, scale: Measured | None, known: Known, motion: MeasuredMotion, quantile: float) -> Parameter:
    value = _sign_of(row, motion) * float(row.formula(*known.at(known.q)))
    variance = known.variance(row.formula) + (row.length * value * motion.length_error) ** 2
    low, high = row.limits
    if scale is not None:
        factor = scale.value**row.power
        variance = variance * factor**2 + (row.power * scale.value ** (row.power - 1) * value * scale.sd) ** 2
        value, low, high = value * factor, low * factor, high * factor
    item = Parameter.around(value, math.sqrt(variance), quantile, (low, high), by_log=row.by_log, unit=row.unit)
    return replace(item, trusted=row.apart, fixed=row.fixed)


def _wear_of(trend: Wear | None, level: Parameter | None, alpha: float) -> dict[str, Parameter]:
    """Return wear, and with a level that at the start; empty where the levels have no trend."""
    if trend is None:
        return {}
    first, rate = trend.first, trend.rate
    quantile = student_quantile(1 - alpha / 2, trend.degrees_of_freedom)
    found = {}
    if level is not None:
        error = math.hypot(level.stderr * first.value, level.value * first.sd)
        found["Fs0/m"] = Parameter.around(level.value * first.value, error, quantile, POSITIVE, unit=level.unit)
    return found | {"wear": Parameter.around(rate.value, rate.sd, quantile, unit="s^-1")}
