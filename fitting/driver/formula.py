"""A law given as a formula as the curve of a fit: followed through a spline, started from another friction.

The spline's knots are set closer until it errs by less than `SPLINE_ERROR` of the friction; the derivatives by the
parameters are the formula's own.  A parameter that bends the curve and is never negative is fitted by its logarithm.
A trial whose formula is not finite or is negative at a speed of the motion is refused as one that cannot be followed.

Starting values need nothing from the user: on the friction of another curve the parameters in which the formula is
linear follow from least squares beside trials of the others, and the best of these are improved within their bounds.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from daq.base.compute.arrays import Array
from daq.base.errors import InputError
from fitting.driver.curves import Friction, FrictionCurve
from fitting.law import Law
from fitting.model.parameters import Global
from fitting.sensitivity.columns import shared_tangents
from fitting.sensitivity.path import Curve, Path, spline_curve
from fitting.sensitivity.spline import FrictionSpline
from fitting.sensitivity.tangents import tangents
from fitting.undetermined import natural_size
from rig_sim.flow.modes import STICK

SPLINE_ERROR = 1e-6  # distance of the spline from the formula, over the largest friction
FIRST_PIECES, KNOT_POWER = 24, 1.8  # knots s_max u^1.8, before they are set closer where the curve bends most
MOST_PIECES = 300  # a power with an infinite slope at rest takes 150; more are a curve with a corner
PER_PIECE = 6  # speeds of each piece at which the spline is put through the formula, and compared with it
SPLINE_REACH = 1.1  # last knot over the measured curve's: slips of the fit may be a little faster
# At which starting values are compared with another friction, from the slowest on: below few samples show it.
SPEEDS, SLOWEST = 61, 0.06
DOUBLED = 2.0  # factor on a parameter: whether the derivative by it changes then shows whether it bends the curve
BEND_DRAWS = 3  # sets of values at which that is looked at
DERIVATIVE_ROUNDING = 1e-9  # change over a derivative: less is rounding
# Trials of a parameter that bends the curve, over its natural size: half as many a decade still start Stribeck curves.
TRIALS = 10.0 ** np.arange(-2.5, 2.1, 0.5)
MOST_TRIALS, SEED = 300, 7  # trials of all such parameters together; more than that are drawn
BEST_TRIALS = 4  # best trials that are improved, each in a valley of its own
SAME_VALLEY = 0.25  # difference over what a start leaves: curves that differ by less are in one valley
ROUNDING = 1e-12  # change over a misfit: less is rounding
SPEEDS_CHECKED = 400  # slip speeds at which a formula must be friction
REFUSED_RESIDUAL = 1e9  # a residual of no number: the step is refused


class Target(NamedTuple):
    """What a formula f is to come near: ``root`` f(``speeds``) is to be ``aim``; shapes (k,) m/s, (m, k), (m,).

    ``size`` is that of the friction, m/s^2.
    """

    speeds: Array
    root: Array
    aim: Array
    size: float

    @classmethod
    def of(cls, friction: Friction, fastest: float) -> "Target":
        """Return another friction, all speeds beyond the slowest counting alike."""
        s = fastest * np.linspace(SLOWEST, 1.0, SPEEDS)
        target = friction(s)
        size = float(np.median(target))
        return cls(s, np.eye(SPEEDS) / size, target / size, size)

    def off_by_a_constant(self, sd: float) -> "Target":
        """Return the same where all of it may be off by one constant of standard deviation ``sd``, m/s^2."""
        along = sd * self.root.sum(axis=1)
        square = float(np.sum(along**2))
        if not square > 0:
            return self
        narrow = (1 - 1 / math.sqrt(1 + square)) / square  # (I + along along')^-1/2 = I - narrow along along'
        root = self.root - narrow * np.outer(along, np.einsum("m,mk->k", along, self.root))
        return self._replace(root=root, aim=self.aim - narrow * along * float(np.sum(along * self.aim)))

    def constant_beside(self, friction: Array, sd: float) -> float:
        """Return the constant, of standard deviation ``sd``, that brings friction (k,) nearest, m/s^2."""
        along = sd * self.root.sum(axis=1)
        return -sd * float(np.sum(along * self.away(friction))) / (1 + float(np.sum(along**2)))

    def away(self, friction: Array) -> Array:
        """Return how far friction (k,) at the speeds is from the target, (m,)."""
        return np.asarray(np.einsum("mk,k->m", self.root, friction) - self.aim)


class Start(NamedTuple):
    """Values of the free parameters by name, and the square of what they leave of the target."""

    values: dict[str, float]
    misfit: float


class FormulaCurve(FrictionCurve):
    """A law's formula as the friction that a path is followed with.

    Unknowns theta (k,) stand for the law's free parameters: the value, or its logarithm (``by_log``).

    Parameters
    ----------
    law : Law
    fastest : float
        Up to which slip speed the formula is followed, m/s.
    near : Target
        What the formula starts near.

    Attributes
    ----------
    starts : list of Start
        Minima on that target, nearest first.

    Raises
    ------
    InputError
        Where no trial of the parameters is a friction; the reason is that of the first of them.
    """

    def __init__(self, law: Law, fastest: float, near: Target) -> None:
        self.law, self.fastest, self.ramp, self.size = law, fastest, law.ramp, len(law.free)
        search = StartSearch(law, near, fastest)
        self.starts = search.minima()
        self.by_log = np.array([search.bends[name] and law.limits(name)[0] >= 0.0 for name in law.free], np.bool_)
        self.start = self.theta(self.starts[0].values)
        self.prior = self.precision = np.zeros(self.size)
        self.lower, self.upper = self.bounds
        self._through(fastest * np.linspace(0.0, 1.0, FIRST_PIECES + 1) ** KNOT_POWER)

    def on_path(self, theta: Array, beside: Array) -> Curve | None:
        """See `FrictionCurve`."""
        spline = self.spline(theta)
        return None if spline is None else spline_curve(spline, self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        """See `FrictionCurve`; the derivatives by the parameters are the formula's own."""
        return np.hstack([shared_tangents(path, places), self._tangents(path, theta)])

    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
        """See `FrictionCurve`; beyond `fastest`, where the formula may be none, friction is then that at `fastest`."""
        try:
            return self.at_speeds(theta, s)
        except InputError:
            return self.at_speeds(theta, np.minimum(s, self.fastest))

    def near(self, friction: Friction, beside: Array) -> Array:
        """See `FrictionCurve`."""
        return self.theta(find_starts(self.law, Target.of(friction, self.fastest))[0].values)

    def values(self, theta: Array) -> dict[str, float]:
        """Return the parameters by name."""
        free = np.where(self.by_log, np.exp(np.clip(theta, -700.0, 700.0)), theta)
        return dict(self.law.fix or {}) | dict(zip(self.law.free, free.tolist(), strict=True))

    def theta(self, values: dict[str, float]) -> Array:
        """Return the unknowns (k,) of parameters."""
        free = np.array([values[name] for name in self.law.free])
        return np.where(self.by_log, np.log(np.where(self.by_log, free, 1.0)), free)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (k,) of the unknowns."""
        lower, upper = np.array([self.law.limits(name) for name in self.law.free]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.by_log, np.log(lower), lower), np.where(self.by_log, np.log(upper), upper)

    def at_speeds(self, theta: Array, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,), m/s.

        Raises
        ------
        InputError
            Where it is not finite, or negative.
        """
        found = self.law.curve.value(s, self.values(theta))
        if found.min() < 0:
            at = self.law.curve.place(float(s[np.argmin(found)]), self.values(theta))
            what = f"law {self.law.name}: friction is negative, {found.min():.4g} m/s^2, {at}"
            raise InputError(what, "formula", "give bounds, or a form that stays above 0")
        return found

    def slopes(self, theta: Array, s: Array) -> Array:
        """Return the derivatives (k, unknowns) of friction at slip speeds s (k,) by the unknowns."""
        values = self.values(theta)
        found = self.law.curve.gradient(s, values, self.law.free)
        return np.asarray(found * np.where(self.by_log, [values[name] for name in self.law.free], 1.0))

    def spline(self, theta: Array) -> FrictionSpline | None:
        """Return a spline through the formula; None where it is no friction, or too abrupt to be followed."""
        while True:
            try:
                target = self.at_speeds(theta, self._at)
            except InputError:
                return None
            found = self._spline.with_coefficients(np.einsum("ij,j->i", self._project, target))
            away = np.abs(found(self._at) - target) > SPLINE_ERROR * target.max()
            if not away.any():
                return found
            knots = self._spline.knots
            bad = np.unique(np.clip(np.searchsorted(knots, self._at[away], side="right") - 1, 0, knots.size - 2))
            if knots.size + bad.size > MOST_PIECES:
                return None
            self._through(np.sort(np.concatenate((knots, 0.5 * (knots[bad] + knots[bad + 1])))))

    def _through(self, knots: Array) -> None:
        """Make splines through the formula with these knots."""
        parts = [np.linspace(a, b, PER_PIECE, endpoint=False) for a, b in pairwise(knots)]
        self._at = np.append(np.concatenate(parts), knots[-1])
        self._spline = FrictionSpline.over(knots)
        self._project = np.linalg.pinv(self._spline.basis(self._at))

    def _tangents(self, path: Path, theta: Array) -> Array:
        """Return the derivatives of the positions by the unknowns of the formula, shape (N, k)."""
        spline = path.curve.spline
        if spline is None:
            raise RuntimeError("the path of a formula follows a spline")
        at_rest = float(spline.coefficients[0])
        d = path.unknown(Global.D) if path.curve.ramp else 0.0
        q = path.unknown(Global.COMPLIANCE) * np.exp(path.unknown(Global.LOG_F)) / path.unknown(Global.K)
        giving = 1 - q * path.friction_slope / path.level if np.any(q) else 1.0
        slips = path.slips
        forces = np.zeros((path.time.size, theta.size))
        speed = np.clip(path.slip_speed[slips], 0.0, self.fastest)
        side = np.broadcast_to(path.level * path.side * giving, path.time.shape)[slips]
        forces[slips] = side[:, None] * self.slopes(theta, speed)
        rest = self.slopes(theta, np.zeros(1))[0]
        if path.curve.ramp or np.any(q):
            ramp = ~slips & (path.mode != STICK)
            share = path.friction / at_rest * (d / np.maximum(d + q * at_rest, 1e-300))
            forces[ramp] = share[ramp][:, None] * rest
        edge = np.broadcast_to(q, path.time.shape)[path.first_point[:-1]][:, None] * rest
        return tangents(path, forces, edge=edge)


def find_starts(law: Law, near: Target, fastest: float = 0.0) -> list[Start]:
    """Return values of a law's free parameters near another friction, nearest first: a local minimum each.

    Parameters
    ----------
    law : Law
        Its first values are where these parameters are tried; its bounds hold.
    near : Target
    fastest : float
        Slip speed up to which it must be friction, m/s; at least the target's fastest.

    Raises
    ------
    InputError
        With none of the values tried is the formula a friction curve; the reason is that of the first of them.
    """
    return StartSearch(law, near, fastest).minima()


class StartSearch:
    """The values of a law's free parameters that are tried near another friction; arguments as of `find_starts`."""

    def __init__(self, law: Law, near: Target, fastest: float = 0.0) -> None:
        self.law, self.near = law, near
        self.fixed, self.given = dict(law.fix or {}), dict(law.start or {})
        self.checked = np.linspace(0.0, max(fastest, float(near.speeds[-1])), SPEEDS_CHECKED)
        self.sizes = {name: natural_size(law, name, near.size, float(near.speeds[-1])) for name in law.free}
        first = self.sizes | self.given
        self.begin = {name: self._inside(name, first[name]) for name in law.free}
        self.refused: InputError | None = None

    def minima(self) -> list[Start]:
        """Return the best local minima."""
        linear = self.linear
        tried = [name for name in self.law.free if name not in linear and name not in self.given]
        found = [
            start
            for values in [self.begin, *self._trials(tried)]
            if (start := self._with_linear(values, linear)) is not None
        ]
        best = self._valleys(sorted(found, key=_order))
        improved = [end for start in best if (end := self._improved(start)) is not None]
        if not improved:
            why = self.refused or InputError("no values were tried", "formula", "give first values")
            what = f"law {self.law.name} is no friction curve with any of the values tried: {why.what}"
            raise InputError(what, why.where, why.do)
        return self._valleys(sorted(improved, key=_order))

    @cached_property
    def bends(self) -> dict[str, bool]:
        """Whether each parameter bends the curve: whether the derivative by it depends on it."""
        return {name: self._moves((name,)) for name in self.law.free}

    @property
    def linear(self) -> list[str]:
        """The parameters without a first value in which the formula is linear, in all of them together."""
        chosen: list[str] = []
        for name in self.law.free:
            if name not in self.given and not self.bends[name] and not self._moves((*chosen, name)):
                chosen.append(name)
        return chosen

    def _moves(self, group: tuple[str, ...]) -> bool:
        """Return whether the derivatives by a group of parameters depend on them, at some values of the others.

        These differ from each other by chance: where two friction levels are equal, a Stribeck speed seems to act not.
        """
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

    def _trials(self, tried: Sequence[str]) -> list[dict[str, float]]:
        """Return trials of the parameters that bend the curve: every combination, or some of very many."""
        each = []
        for name in tried:
            low, high = self.law.limits(name)
            values = [float(self.sizes[name] * factor) for factor in TRIALS]
            values += [] if low >= 0 else [-value for value in values]
            if math.isfinite(low) and math.isfinite(high):
                values += np.linspace(low, high, TRIALS.size)[1:-1].tolist()
            each.append([value for value in values if low <= value <= high])
        if math.prod(len(values) for values in each) <= MOST_TRIALS:
            combined = list(product(*each))
        else:
            rng = np.random.default_rng(SEED)
            combined = [tuple(values[rng.integers(len(values))] for values in each) for _ in range(MOST_TRIALS)]
        return [self.begin | dict(zip(tried, values, strict=True)) for values in combined]

    def _with_linear(self, values: dict[str, float], linear: Sequence[str]) -> Start | None:
        """Return values with the linear ones by least squares, within their bounds; None where they are not finite."""
        left = self._left(values)
        if left is None:
            return None
        if linear:
            try:
                columns = self.law.curve.gradient(self.near.speeds, self.fixed | values, tuple(linear))
            except InputError as error:
                self.refused = self.refused or error
                return None
            change = np.linalg.lstsq(np.einsum("mk,kp->mp", self.near.root, columns), -left, rcond=None)[0]
            values = values | {
                name: float(np.clip(values[name] + step, *self.law.limits(name)))
                for name, step in zip(linear, change, strict=True)
            }
            left = self._left(values)
        return None if left is None else Start(values, float(np.sum(left**2)))

    def _left(self, values: dict[str, float]) -> Array | None:
        """Return how far the formula is from the target (m,); None where it is not finite."""
        try:
            return self.near.away(self.law.curve.value(self.near.speeds, self.fixed | values))
        except InputError as error:
            self.refused = self.refused or error
            return None

    def _valleys(self, starts: Sequence[Start]) -> list[Start]:
        """Return the best of the starts in each of the best valleys."""
        kept: list[tuple[Start, Array]] = []
        for start in starts:
            left = self._left(start.values)
            if left is not None and all(np.sum((left - other) ** 2) > SAME_VALLEY * start.misfit for _, other in kept):
                kept.append((start, left))
            if len(kept) == BEST_TRIALS:
                break
        return [start for start, _ in kept]

    def _improved(self, start: Start) -> Start | None:
        """Return the end of least squares within the bounds, or the start; None where neither is friction."""
        from scipy.optimize import least_squares

        names = self.law.free
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
            try:
                own = self.law.curve.gradient(self.near.speeds, self.fixed | values(z), names)
            except InputError:
                own = np.zeros((self.near.speeds.size, len(names)))
            return np.asarray(np.einsum("mk,kp->mp", self.near.root, own * size))

        inside = np.clip(begin / size, *bounds)
        with np.errstate(all="ignore"):  # of steps along what hardly changes the curve
            found = least_squares(residual, inside, slopes, bounds=bounds, method="trf", x_scale=1.0, max_nfev=200)
        usable = self._is_friction(start.values)  # its reason is understood more easily than that of the end
        end = Start(values(found.x), float(2 * found.cost))
        return end if self._is_friction(end.values) else start if usable else None

    def _is_friction(self, values: dict[str, float]) -> bool:
        """Return whether friction is finite and not negative at every slip speed, and above 0 at rest."""
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
    """Return by what starts are sorted: of values that give the same curve those with fewer signs come first."""
    return float(f"{max(start.misfit, ROUNDING):.5g}"), sum(value < 0 for value in start.values.values())
