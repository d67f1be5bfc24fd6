"""A law given as a formula: its starting values, and its curve in a fit.

The parameters in which the formula is linear are fitted by least squares, for trial values of the others. The best
trials, each in a separate valley, are refined within the bounds. Several of them are used as starts, since the motion
constrains parameters better than the curve.

In a fit the formula is replaced by a spline whose knots are refined until its error is below `SPLINE_ERROR` of the
friction; the derivatives by the parameters are the formula's. A trial is rejected if the formula is not finite,
negative at a speed of the motion, or not positive at rest. A non-negative parameter in which the formula is not linear
is fitted by its logarithm.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from fitting.laws import UNIT_DRAWS, Law, hold_confounded, natural_size
from fitting.model.curves import FrictionCurve
from fitting.model.path import Curve, FrictionSpline, Path, spline_curve
from fitting.model.tangents import friction_effect, shared_tangents, tangents
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

DOUBLED = 2.0  # factor on a parameter in the test of linearity: the derivative by a linear one does not change
DERIVATIVE_ROUNDING = 1e-9  # change over a derivative, below which it is rounding
SCANNED = 40  # values of a single nonlinear parameter: half as many find the same minima
# Values of each of several nonlinear parameters, and their range over the natural sizes.
COMBINED, TRIED_SIZES = 10, (10**-2.5, 1e2)
MOST_TRIALS, SEED = 300, 7  # most combinations of such values; from more, a random sample is drawn
BEST_TRIALS = 4  # best trials that are refined, each in a separate valley
SAME_VALLEY = 0.25  # squared difference of two curves over the misfit, below which they are in the same valley
ROUNDING = 1e-12  # misfit below which it is rounding
SPEEDS_CHECKED = 400  # slip speeds at which friction must not be negative
REFUSED_RESIDUAL = 1e9  # residual where the formula is not finite, so that the step is rejected


class Target(NamedTuple):
    """Target of a formula f: ``root`` f(``speeds``) near ``aim``."""

    speeds: Array  # (k,) m/s
    root: Array  # (m, k)
    aim: Array  # (m,)
    size: float  # of the friction, m/s^2

    @classmethod
    def of(cls, speeds: Array, friction: Array, sd: float) -> "Target":
        return cls(speeds, np.eye(speeds.size) / sd, friction / sd, float(np.median(friction)))

    def with_unknown_constant(self, sd: float) -> "Target":
        """Return the target with an unknown constant of standard deviation ``sd``, m/s^2."""
        along = sd * self.root.sum(axis=1)
        square = float(np.sum(along**2))
        if not square > 0:
            return self
        narrow = (1 - 1 / math.sqrt(1 + square)) / square  # (I + along along')^-1/2 = I - narrow along along'
        root = self.root - narrow * np.outer(along, np.einsum("m,mk->k", along, self.root))
        return self._replace(root=root, aim=self.aim - narrow * along * float(np.sum(along * self.aim)))

    def nearest_constant(self, friction: Array, sd: float) -> float:
        """Return the constant, with prior standard deviation ``sd``, that fits best with this friction, m/s^2."""
        along = sd * self.root.sum(axis=1)
        return -sd * float(np.sum(along * self.residual_of(friction))) / (1 + float(np.sum(along**2)))

    def residual_of(self, friction: Array) -> Array:
        return np.asarray(np.einsum("mk,k->m", self.root, friction) - self.aim)


class Start(NamedTuple):
    values: dict[str, float]
    misfit: float


def find_starts(law: Law, target: Target, fastest: float = 0.0) -> list[Start]:
    """Return local minima for a target, best first, at which the formula is friction up to ``fastest``, m/s."""
    return StartSearch(law, target, fastest).minima()


class StartSearch:
    def __init__(self, law: Law, target: Target, fastest: float = 0.0) -> None:
        self.law, self.target = law, target
        self.fixed, self.given = dict(law.fix or {}), dict(law.start or {})
        self.checked = np.linspace(0.0, max(fastest, float(target.speeds[-1])), SPEEDS_CHECKED)
        self.sizes = {name: natural_size(law, name, target.size, float(target.speeds[-1])) for name in law.free}
        first = self.sizes | self.given
        self.begin = {name: self._move_inside(name, first[name]) for name in law.free}
        self.refusal: InputError | None = None

    def minima(self) -> list[Start]:
        improved = [end for start in self._list_trials() if (end := self._improve(start)) is not None]
        if not improved:
            why = self.refusal or InputError("no values were tried", "formula", "set initial values")
            message = f"law {self.law.name} is not a valid friction curve for any of the tried values: {why.what}"
            raise InputError(message, why.where, why.do)
        return self._select_valleys(sorted(improved, key=_order))

    @cached_property
    def bends(self) -> dict[str, bool]:
        """Whether the derivative by each parameter depends on it."""
        return {name: self._varies_with((name,)) for name in self.law.free}

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """The parameters without a first value in which the formula is jointly linear."""
        chosen: list[str] = []
        for name in self.law.free:
            if name not in self.given and not self.bends[name] and not (chosen and self._varies_with((*chosen, name))):
                chosen.append(name)
        return tuple(chosen)

    def _varies_with(self, group: tuple[str, ...]) -> bool:
        """Return whether derivatives by a group depend on it at random values; equal values can hide an effect."""
        rng = np.random.default_rng(SEED)
        for _ in range(UNIT_DRAWS):
            base = self.fixed | {
                name: self._move_inside(name, value * rng.uniform(0.5, 2.0)) for name, value in self.begin.items()
            }
            changed = base | {name: (base[name] or 1.0) / DOUBLED for name in group}
            try:
                first, other = (self.law.curve.gradient(self.target.speeds, point, group) for point in (base, changed))
            except InputError:
                return True
            if np.any(np.abs(first - other) > DERIVATIVE_ROUNDING * np.max(np.abs(first))):
                return True
        return False

    def _move_inside(self, name: str, value: float) -> float:
        low, high = self.law.limits(name)
        if low < value < high:
            return value
        if math.isfinite(low) and math.isfinite(high):
            return 0.5 * (low + high)
        return float(np.clip(value, low, high))

    def _list_trials(self) -> list[Start]:
        """Return the best trials; for a single parameter the minima of a scan, since the true valley may be narrow."""
        tried = [name for name in self.law.free if name not in self.linear and name not in self.given]
        first, trials = (self._fit_linear(self.begin), [self._fit_linear(values) for values in self._combine(tried)])
        if len(tried) != 1:
            return self._select_valleys(sorted((trial for trial in [first, *trials] if trial is not None), key=_order))
        misfits = np.array([math.inf, *(math.inf if trial is None else trial.misfit for trial in trials), math.inf])
        lowest = (misfits[1:-1] <= misfits[:-2]) & (misfits[1:-1] <= misfits[2:])
        minima = [start for start, low in zip(trials, lowest, strict=True) if low]
        return [start for start in [first, *minima] if start is not None]

    def _combine(self, tried: Sequence[str]) -> list[dict[str, float]]:
        each = [self._values(name, SCANNED if len(tried) == 1 else COMBINED) for name in tried]
        if math.prod(map(len, each)) <= MOST_TRIALS:
            combined = list(product(*each))
        else:
            rng = np.random.default_rng(SEED)
            combined = [tuple(values[rng.integers(len(values))] for values in each) for _ in range(MOST_TRIALS)]
        return [self.begin | dict(zip(tried, values, strict=True)) for values in combined]

    def _values(self, name: str, count: int) -> list[float]:
        """Return values of each sign within the bounds, evenly spaced in their logarithm."""
        values: list[float] = []
        for sign in (1.0, -1.0):
            low, high = sorted(sign * limit for limit in self.law.limits(name))
            if not (low > 0 and math.isfinite(high)):
                low, high = max(low, self.sizes[name] * TRIED_SIZES[0]), min(high, self.sizes[name] * TRIED_SIZES[1])
            if low < high:
                values += (sign * np.geomspace(low, high, count)[:: -int(sign)]).tolist()
        return values

    def _fit_linear(self, values: dict[str, float]) -> Start | None:
        """Fit the linear parameters by least squares, within the bounds; None if not finite."""
        residual = self._residual(values)
        if residual is None:
            return None
        if self.linear:
            columns = self.residual_derivatives(values, self.linear)
            if columns is None:
                return None
            change = np.linalg.lstsq(columns, -residual, rcond=None)[0]
            values = values | {
                name: float(np.clip(values[name] + step, *self.law.limits(name)))
                for name, step in zip(self.linear, change, strict=True)
            }
            residual = self._residual(values)
        return None if residual is None else Start(values, float(np.sum(residual**2)))

    def residual_derivatives(self, values: dict[str, float], by: tuple[str, ...]) -> Array | None:
        """Return the derivatives (m, p) of the residual; None if not finite."""
        try:
            slopes = self.law.curve.gradient(self.target.speeds, self.fixed | values, by)
        except InputError as error:
            self.refusal = self.refusal or error
            return None
        return np.asarray(np.einsum("mk,kp->mp", self.target.root, slopes))

    def _residual(self, values: dict[str, float]) -> Array | None:
        """Return the residual (m,); None if not finite."""
        try:
            return self.target.residual_of(self.law.curve.value(self.target.speeds, self.fixed | values))
        except InputError as error:
            self.refusal = self.refusal or error
            return None

    def _select_valleys(self, starts: Sequence[Start]) -> list[Start]:
        minima: list[tuple[Start, Array]] = []
        for start in starts:
            residual = self._residual(start.values)
            if residual is not None and all(
                np.sum((residual - other) ** 2) > SAME_VALLEY * start.misfit for _, other in minima
            ):
                minima.append((start, residual))
            if len(minima) == BEST_TRIALS:
                break
        return [start for start, _ in minima]

    def _improve(self, start: Start) -> Start | None:
        """Return the minimum of bounded least squares, or the start; None if neither is a friction curve."""
        from scipy.optimize import least_squares

        names = self.law.free
        if not names:
            return start if self._is_friction(start.values) else None
        low, high = np.array([self.law.limits(name) for name in names]).T
        begin = np.array([start.values[name] for name in names])
        size = np.maximum(np.abs(begin), [DERIVATIVE_ROUNDING * self.sizes[name] for name in names])
        bounds = (low / size, high / size)

        def values(z: Array) -> dict[str, float]:
            return dict(zip(names, (z * size).tolist(), strict=True))

        def residual(z: Array) -> Array:
            remaining = self._residual(values(z))
            return np.full(self.target.aim.size, REFUSED_RESIDUAL) if remaining is None else remaining

        def slopes(z: Array) -> Array:
            derivatives = self.residual_derivatives(values(z), names)
            return np.zeros((self.target.aim.size, len(names))) if derivatives is None else derivatives * size

        inside = np.clip(begin / size, *bounds)
        with np.errstate(all="ignore"):  # long steps along unconstrained directions may overflow
            solution = least_squares(residual, inside, slopes, bounds=bounds, method="trf", x_scale=1.0, max_nfev=200)
        usable = self._is_friction(start.values)  # first, since its reason is easier to understand than the minimum's
        end = Start(values(solution.x), float(2 * solution.cost))
        return end if self._is_friction(end.values) else start if usable else None

    def _is_friction(self, values: dict[str, float]) -> bool:
        """Return whether friction is finite, not negative in slip, and positive at rest."""
        all_values = self.fixed | values
        try:
            friction = self.law.curve.value(self.checked, all_values)
            self.law.curve.gradient(self.checked, all_values, self.law.free)
        except InputError as error:
            self.refusal = self.refusal or error
            return False
        lowest = int(np.argmin(friction))
        if friction[lowest] >= 0 and friction[0] > 0:
            return True
        index, kind = (lowest, "negative") if friction[lowest] < 0 else (0, "not above 0")
        position = self.law.curve.place(float(self.checked[index]), all_values)
        message = f"friction is {kind}, {friction[index]:.4g} m/s^2, {position}"
        self.refusal = self.refusal or InputError(message, "formula", "set bounds, or use a form that stays above 0")
        return False


def _order(start: Start) -> tuple[float, int]:
    """Return the sort key: of equal curves, the one with fewer negative parameters is first."""
    return float(f"{max(start.misfit, ROUNDING):.5g}"), sum(value < 0 for value in start.values.values())


SPLINE_ERROR = 1e-6  # error of the spline over the largest friction
FIRST_PIECES, KNOT_POWER = 24, 1.8  # knots s_max u^1.8, before they are refined where the error is large
MOST_PIECES = 300  # a power with an infinite slope at rest needs 150; a curve that needs more has a corner
PER_PIECE = 6  # speeds in each piece at which the spline is fitted to the formula, and compared with it
SPLINE_REACH = 1.1  # last knot over the measured curve's: slips of a fit may be slightly faster


class FormulaCurve(FrictionCurve):
    """A formula as the friction of a path; theta are its free parameters, or their logarithms (``by_log``)."""

    law: Law

    def __init__(self, law: Law, fastest: float, target: Target) -> None:
        self.law, self.fastest, self.ramp = law, fastest, law.ramp
        self.together, fitted = hold_confounded(law, target.size, float(target.speeds[-1]))
        self.fixed, self.free, self.size = fitted.fix or {}, fitted.free, len(fitted.free)
        search = StartSearch(fitted, target, fastest)
        self.by_log = np.array([search.bends[name] and law.limits(name)[0] >= 0.0 for name in self.free], np.bool_)
        self.prior = self.precision = np.zeros(self.size)
        self.lower, self.upper = self.bounds
        self._first = FrictionSpline.over(fastest * np.linspace(0.0, 1.0, FIRST_PIECES + 1) ** KNOT_POWER)
        self._near = self._first
        self._last: tuple[Array, FrictionSpline | None] | None = None
        # A logarithm of speed over a tiny speed may fit the target, but is too steep near rest to be integrated.
        self.starts = sorted(search.minima(), key=lambda start: self.spline(self.theta_at(start.values)) is None)
        self.start = self.theta_at(self.starts[0].values)

    def on_path(self, theta: Array, shared: Array) -> Curve | None:
        spline = self.spline(theta)
        return None if spline is None else spline_curve(spline, self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        in_slip, in_stick, edge = friction_effect(path)
        at_rest = self.slopes(theta, np.zeros(1))[0]
        forces = in_stick[:, None] * at_rest
        speed = np.clip(path.slip_speed[path.slips], 0.0, self.fastest)
        forces[path.slips] = in_slip[path.slips, None] * self.slopes(theta, speed)
        by_theta = tangents(path, forces, edge=edge[:, None] * at_rest)
        return np.hstack([shared_tangents(path, places), by_theta])

    def friction(self, u: Array, theta: Array, shared: Array, s: Array) -> Array:
        """Constant beyond `fastest`, where the formula may not be friction."""
        try:
            return self.at_speeds(theta, s)
        except InputError:
            return self.at_speeds(theta, np.minimum(s, self.fastest))

    def values(self, theta: Array, u: Array | None = None) -> dict[str, float]:
        free = np.where(self.by_log, np.exp(np.clip(theta, -700.0, 700.0)), theta)
        return dict(self.fixed) | dict(zip(self.free, free.tolist(), strict=True))

    def theta_at(self, values: dict[str, float]) -> Array:
        free = np.array([values[name] for name in self.free])
        return np.where(self.by_log, np.log(np.where(self.by_log, free, 1.0)), free)

    @property
    def bounds(self) -> tuple[Array, Array]:
        lower, upper = np.array([self.law.limits(name) for name in self.free]).reshape(-1, 2).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.by_log, np.log(lower), lower), np.where(self.by_log, np.log(upper), upper)

    def at_speeds(self, theta: Array, s: Array) -> Array:
        """Return friction, m/s^2, at slip speeds, m/s; InputError if not finite or negative."""
        friction = self.law.curve.value(s, self.values(theta))
        if friction.min() < 0:
            position = self.law.curve.place(float(s[np.argmin(friction)]), self.values(theta))
            message = f"law {self.law.name}: friction is negative, {friction.min():.4g} m/s^2, {position}"
            raise InputError(message, "formula", "set bounds, or use a form that stays above 0")
        return friction

    def slopes(self, theta: Array, s: Array) -> Array:
        values = self.values(theta)
        slopes_by_parameter = self.law.curve.gradient(s, values, self.free)
        return np.asarray(slopes_by_parameter * np.where(self.by_log, [values[name] for name in self.free], 1.0))

    def spline(self, theta: Array) -> FrictionSpline | None:
        """Return a spline of the formula, from the last knots if possible; None if not friction or too steep."""
        if self._last is None or not np.array_equal(theta, self._last[0]):
            crowded = self._near.knots.size > MOST_PIECES // 2
            begins = dict.fromkeys((self._first, self._near) if crowded else (self._near, self._first))
            refined = (self._refine_spline(theta, begin) for begin in begins)
            spline = next((spline for spline in refined if spline is not None), None)
            self._near = spline or self._near
            self._last = theta.copy(), spline
        return self._last[1]

    def _refine_spline(self, theta: Array, spline: FrictionSpline) -> FrictionSpline | None:
        while True:
            knots = spline.knots
            speeds = np.append(np.linspace(knots[:-1], knots[1:], PER_PIECE, endpoint=False, axis=1), knots[-1])
            try:
                target = self.at_speeds(theta, speeds)
            except InputError:
                return None
            if not target[0] > 0:
                return None
            spline = spline.nearest(speeds, target)
            too_far = np.abs(spline(speeds) - target) > SPLINE_ERROR * target.max()
            if not too_far.any():
                return spline
            poor = np.unique(np.clip(np.searchsorted(knots, speeds[too_far], side="right") - 1, 0, knots.size - 2))
            if knots.size + poor.size > MOST_PIECES:
                return None
            spline = FrictionSpline.over(np.sort(np.concatenate((knots, 0.5 * (knots[poor] + knots[poor + 1])))))
