"""A law given as a formula: its starting values, and its curve as followed in a fit.

The parameters in which the formula is linear follow from least squares for trials of the others. The best trials, each
in a separate valley, are improved within the bounds. Several are starts, since motion says more than a curve.

The formula is followed through a spline whose knots are refined until its error is below `SPLINE_ERROR` of the
friction; the derivatives by the parameters are the formula's. A trial whose formula is not finite, negative at a speed
of the motion or not above 0 at rest is rejected. A non-negative parameter that bends the curve is fitted by its
logarithm.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from fitting.laws import Law, natural_size, undetermined
from fitting.model.curves import FrictionCurve
from fitting.model.path import Curve, FrictionSpline, Path, spline_curve
from fitting.model.tangents import friction_effect, shared_tangents, tangents
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

DOUBLED = 2.0  # factor on a parameter: whether the derivative by it changes then shows whether it bends the curve
BEND_DRAWS = 3  # sets of values at which that is looked at
DERIVATIVE_ROUNDING = 1e-9  # change over a derivative: less is rounding
SCANNED = 40  # values of one parameter that is tried alone: half as many find the same minima
# Values of each of several parameters, and their range over the natural sizes.
COMBINED, TRIED_SIZES = 10, (10**-2.5, 1e2)
MOST_TRIALS, SEED = 300, 7  # trials of all such parameters together; more than that are drawn
BEST_TRIALS = 4  # best trials that are improved, each in a valley of its own
SAME_VALLEY = 0.25  # difference over what a start leaves: curves that differ by less are in one valley
ROUNDING = 1e-12  # change over a misfit: less is rounding
SPEEDS_CHECKED = 400  # slip speeds at which a formula must be friction
REFUSED_RESIDUAL = 1e9  # a residual of no number: the step is refused


class Target(NamedTuple):
    """Target of a formula f: ``root`` f(``speeds``) near ``aim``."""

    speeds: Array  # (k,) m/s
    root: Array  # (m, k)
    aim: Array  # (m,)
    size: float  # of the friction, m/s^2

    @classmethod
    def of(cls, speeds: Array, friction: Array, sd: float) -> "Target":
        return cls(speeds, np.eye(speeds.size) / sd, friction / sd, float(np.median(friction)))

    def off_by_a_constant(self, sd: float) -> "Target":
        """Return the target with an unknown constant of standard deviation ``sd``, m/s^2."""
        along = sd * self.root.sum(axis=1)
        square = float(np.sum(along**2))
        if not square > 0:
            return self
        narrow = (1 - 1 / math.sqrt(1 + square)) / square  # (I + along along')^-1/2 = I - narrow along along'
        root = self.root - narrow * np.outer(along, np.einsum("m,mk->k", along, self.root))
        return self._replace(root=root, aim=self.aim - narrow * along * float(np.sum(along * self.aim)))

    def constant_beside(self, friction: Array, sd: float) -> float:
        """Return the constant, of standard deviation ``sd``, that brings friction nearest, m/s^2."""
        along = sd * self.root.sum(axis=1)
        return -sd * float(np.sum(along * self.away(friction))) / (1 + float(np.sum(along**2)))

    def away(self, friction: Array) -> Array:
        return np.asarray(np.einsum("mk,k->m", self.root, friction) - self.aim)


class Start(NamedTuple):
    values: dict[str, float]
    misfit: float


def find_starts(law: Law, near: Target, fastest: float = 0.0) -> list[Start]:
    """Return local minima near a target, nearest first, where the formula is friction up to ``fastest``, m/s."""
    return StartSearch(law, near, fastest).minima()


class StartSearch:
    def __init__(self, law: Law, near: Target, fastest: float = 0.0) -> None:
        self.law, self.near = law, near
        self.fixed, self.given = dict(law.fix or {}), dict(law.start or {})
        self.checked = np.linspace(0.0, max(fastest, float(near.speeds[-1])), SPEEDS_CHECKED)
        self.sizes = {name: natural_size(law, name, near.size, float(near.speeds[-1])) for name in law.free}
        first = self.sizes | self.given
        self.begin = {name: self._inside(name, first[name]) for name in law.free}
        self.refused: InputError | None = None

    def minima(self) -> list[Start]:
        improved = [end for start in self._tried() if (end := self._improved(start)) is not None]
        if not improved:
            why = self.refused or InputError("no values were tried", "formula", "give first values")
            what = f"law {self.law.name} is no friction curve with any of the values tried: {why.what}"
            raise InputError(what, why.where, why.do)
        return self._valleys(sorted(improved, key=_order))

    @cached_property
    def bends(self) -> dict[str, bool]:
        """Whether the derivative by each parameter depends on it."""
        return {name: self._moves((name,)) for name in self.law.free}

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """The parameters without a first value in which the formula is jointly linear."""
        chosen: list[str] = []
        for name in self.law.free:
            if name not in self.given and not self.bends[name] and not (chosen and self._moves((*chosen, name))):
                chosen.append(name)
        return tuple(chosen)

    def _moves(self, group: tuple[str, ...]) -> bool:
        """Return whether derivatives by a group depend on it; other values are random, as equal ones hide an effect."""
        rng = np.random.default_rng(SEED)
        for _ in range(BEND_DRAWS):
            whole = self.fixed | {
                name: self._inside(name, value * rng.uniform(0.5, 2.0)) for name, value in self.begin.items()
            }
            moved = whole | {name: (whole[name] or 1.0) / DOUBLED for name in group}
            try:
                first, other = (self.law.curve.gradient(self.near.speeds, at, group) for at in (whole, moved))
            except InputError:
                return True
            if np.any(np.abs(first - other) > DERIVATIVE_ROUNDING * np.max(np.abs(first))):
                return True
        return False

    def _inside(self, name: str, value: float) -> float:
        low, high = self.law.limits(name)
        if low < value < high:
            return value
        if math.isfinite(low) and math.isfinite(high):
            return 0.5 * (low + high)
        return float(np.clip(value, low, high))

    def _tried(self) -> list[Start]:
        """Return the best trials; of one parameter the minima of a scan, since the true valley may be narrow."""
        tried = [name for name in self.law.free if name not in self.linear and name not in self.given]
        first, found = self._with_linear(self.begin), [self._with_linear(values) for values in self._combined(tried)]
        if len(tried) != 1:
            return self._valleys(sorted((one for one in [first, *found] if one is not None), key=_order))
        left = np.array([math.inf, *(math.inf if one is None else one.misfit for one in found), math.inf])
        lowest = (left[1:-1] <= left[:-2]) & (left[1:-1] <= left[2:])
        minima = [start for start, low in zip(found, lowest, strict=True) if low]
        return [one for one in [first, *minima] if one is not None]

    def _combined(self, tried: Sequence[str]) -> list[dict[str, float]]:
        each = [self._values(name, SCANNED if len(tried) == 1 else COMBINED) for name in tried]
        if math.prod(map(len, each)) <= MOST_TRIALS:
            combined = list(product(*each))
        else:
            rng = np.random.default_rng(SEED)
            combined = [tuple(values[rng.integers(len(values))] for values in each) for _ in range(MOST_TRIALS)]
        return [self.begin | dict(zip(tried, values, strict=True)) for values in combined]

    def _values(self, name: str, count: int) -> list[float]:
        """Return values of each sign within the bounds, evenly spaced in their logarithm."""
        found: list[float] = []
        for sign in (1.0, -1.0):
            low, high = sorted(sign * limit for limit in self.law.limits(name))
            if not (low > 0 and math.isfinite(high)):
                low, high = max(low, self.sizes[name] * TRIED_SIZES[0]), min(high, self.sizes[name] * TRIED_SIZES[1])
            if low < high:
                found += (sign * np.geomspace(low, high, count)[:: -int(sign)]).tolist()
        return found

    def _with_linear(self, values: dict[str, float]) -> Start | None:
        """Add the linear parameters by bounded least squares; None where not finite."""
        left = self._left(values)
        if left is None:
            return None
        if self.linear:
            columns = self.sloped(values, self.linear)
            if columns is None:
                return None
            change = np.linalg.lstsq(columns, -left, rcond=None)[0]
            values = values | {
                name: float(np.clip(values[name] + step, *self.law.limits(name)))
                for name, step in zip(self.linear, change, strict=True)
            }
            left = self._left(values)
        return None if left is None else Start(values, float(np.sum(left**2)))

    def sloped(self, values: dict[str, float], by: tuple[str, ...]) -> Array | None:
        """Return the derivatives (m, p) of the residual; None where not finite."""
        try:
            slopes = self.law.curve.gradient(self.near.speeds, self.fixed | values, by)
        except InputError as error:
            self.refused = self.refused or error
            return None
        return np.asarray(np.einsum("mk,kp->mp", self.near.root, slopes))

    def _left(self, values: dict[str, float]) -> Array | None:
        """Return the residual (m,); None where not finite."""
        try:
            return self.near.away(self.law.curve.value(self.near.speeds, self.fixed | values))
        except InputError as error:
            self.refused = self.refused or error
            return None

    def _valleys(self, starts: Sequence[Start]) -> list[Start]:
        kept: list[tuple[Start, Array]] = []
        for start in starts:
            left = self._left(start.values)
            if left is not None and all(np.sum((left - other) ** 2) > SAME_VALLEY * start.misfit for _, other in kept):
                kept.append((start, left))
            if len(kept) == BEST_TRIALS:
                break
        return [start for start, _ in kept]

    def _improved(self, start: Start) -> Start | None:
        """Return the end of bounded least squares, or the start; None where neither is friction."""
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
            left = self._left(values(z))
            return np.full(self.near.aim.size, REFUSED_RESIDUAL) if left is None else left

        def slopes(z: Array) -> Array:
            own = self.sloped(values(z), names)
            return np.zeros((self.near.aim.size, len(names))) if own is None else own * size

        inside = np.clip(begin / size, *bounds)
        with np.errstate(all="ignore"):  # of steps along what hardly changes the curve
            found = least_squares(residual, inside, slopes, bounds=bounds, method="trf", x_scale=1.0, max_nfev=200)
        usable = self._is_friction(start.values)  # its reason is understood more easily than that of the end
        end = Start(values(found.x), float(2 * found.cost))
        return end if self._is_friction(end.values) else start if usable else None

    def _is_friction(self, values: dict[str, float]) -> bool:
        """Return whether friction is finite, not negative in slip, and above 0 at rest."""
        whole = self.fixed | values
        try:
            friction = self.law.curve.value(self.checked, whole)
            self.law.curve.gradient(self.checked, whole, self.law.free)
        except InputError as error:
            self.refused = self.refused or error
            return False
        lowest = int(np.argmin(friction))
        if friction[lowest] >= 0 and friction[0] > 0:
            return True
        bad, kind = (lowest, "negative") if friction[lowest] < 0 else (0, "not above 0")
        at = self.law.curve.place(float(self.checked[bad]), whole)
        what = f"friction is {kind}, {friction[bad]:.4g} m/s^2, {at}"
        self.refused = self.refused or InputError(what, "formula", "give bounds, or a form that stays above 0")
        return False


def _order(start: Start) -> tuple[float, int]:
    """Return the sort key: of equal curves, the one with fewer negative parameters is first."""
    return float(f"{max(start.misfit, ROUNDING):.5g}"), sum(value < 0 for value in start.values.values())


SPLINE_ERROR = 1e-6  # distance of the spline from the formula, over the largest friction
FIRST_PIECES, KNOT_POWER = 24, 1.8  # knots s_max u^1.8, before they are set closer where the curve bends most
MOST_PIECES = 300  # a power with an infinite slope at rest takes 150; more are a curve with a corner
PER_PIECE = 6  # speeds of each piece at which the spline is put through the formula, and compared with it
SPLINE_REACH = 1.1  # last knot over the measured curve's: slips of the fit may be a little faster


class FormulaCurve(FrictionCurve):
    """A formula as the friction of a path; theta are its free parameters, or their logarithms (``by_log``)."""

    law: Law

    def __init__(self, law: Law, fastest: float, near: Target) -> None:
        self.law, self.fastest, self.ramp = law, fastest, law.ramp
        self.together = undetermined(law, near.size, float(near.speeds[-1]))
        first = law.start or {}
        held = [name for group in self.together for name in group.names[len(group.names) - group.free :]]
        sizes = {name: natural_size(law, name, near.size, float(near.speeds[-1])) for name in held}
        fitted = law.given(fix={name: first.get(name, size) for name, size in sizes.items()})
        self.fixed, self.free, self.size = fitted.fix or {}, fitted.free, len(fitted.free)
        search = StartSearch(fitted, near, fastest)
        self.by_log = np.array([search.bends[name] and law.limits(name)[0] >= 0.0 for name in self.free], np.bool_)
        self.prior = self.precision = np.zeros(self.size)
        self.lower, self.upper = self.bounds
        self._first = FrictionSpline.over(fastest * np.linspace(0.0, 1.0, FIRST_PIECES + 1) ** KNOT_POWER)
        self._near = self._first
        # A logarithm of speed over next to nothing is near on the target, and too abrupt to be followed.
        self.starts = sorted(search.minima(), key=lambda start: self.spline(self.theta_at(start.values)) is None)
        self.start = self.theta_at(self.starts[0].values)

    def on_path(self, theta: Array, beside: Array) -> Curve | None:
        spline = self.spline(theta)
        return None if spline is None else spline_curve(spline, self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        in_slip, in_stick, edge = friction_effect(path)
        at_rest = self.slopes(theta, np.zeros(1))[0]
        forces = in_stick[:, None] * at_rest
        speed = np.clip(path.slip_speed[path.slips], 0.0, self.fastest)
        forces[path.slips] = in_slip[path.slips, None] * self.slopes(theta, speed)
        own = tangents(path, forces, edge=edge[:, None] * at_rest)
        return np.hstack([shared_tangents(path, places), own])

    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
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
        found = self.law.curve.value(s, self.values(theta))
        if found.min() < 0:
            at = self.law.curve.place(float(s[np.argmin(found)]), self.values(theta))
            what = f"law {self.law.name}: friction is negative, {found.min():.4g} m/s^2, {at}"
            raise InputError(what, "formula", "give bounds, or a form that stays above 0")
        return found

    def slopes(self, theta: Array, s: Array) -> Array:
        values = self.values(theta)
        found = self.law.curve.gradient(s, values, self.free)
        return np.asarray(found * np.where(self.by_log, [values[name] for name in self.free], 1.0))

    def spline(self, theta: Array) -> FrictionSpline | None:
        """Return a spline through the formula, from the last knots if they fit; None if not friction or too abrupt."""
        crowded = self._near.knots.size > MOST_PIECES // 2
        for begin in dict.fromkeys((self._first, self._near) if crowded else (self._near, self._first)):
            found = self._through(theta, begin)
            if found is not None:
                self._near = found
                return found
        return None

    def _through(self, theta: Array, spline: FrictionSpline) -> FrictionSpline | None:
        while True:
            knots = spline.knots
            at = np.append(np.linspace(knots[:-1], knots[1:], PER_PIECE, endpoint=False, axis=1), knots[-1])
            try:
                target = self.at_speeds(theta, at)
            except InputError:
                return None
            if not target[0] > 0:
                return None
            spline = spline.nearest(at, target)
            away = np.abs(spline(at) - target) > SPLINE_ERROR * target.max()
            if not away.any():
                return spline
            bad = np.unique(np.clip(np.searchsorted(knots, at[away], side="right") - 1, 0, knots.size - 2))
            if knots.size + bad.size > MOST_PIECES:
                return None
            spline = FrictionSpline.over(np.sort(np.concatenate((knots, 0.5 * (knots[bad] + knots[bad + 1])))))
