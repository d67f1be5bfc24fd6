"""A law given as a formula as the curve of a fit: followed through a spline, started from another friction.

The spline's knots are set closer until it errs by less than `TOLERANCE` of the friction; the derivatives by the
parameters are the formula's own.  A parameter that bends the curve and is never negative is fitted by its logarithm.
A trial whose formula is not finite or is negative at a speed of the motion is refused as one that cannot be followed.

Starting values need nothing from the user: on the friction of another curve the parameters in which the formula is
linear follow from least squares beside trials of the others, and the best of these are improved within their bounds.
"""

import math
from collections.abc import Sequence
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
from rig_sim.flow.modes import STICK

TOLERANCE = 1e-6  # of the largest friction: how far the spline may be from the formula
FIRST_PIECES, KNOT_POWER = 24, 1.8  # knots s_max u^1.8, before they are set closer where the curve bends most
MOST_PIECES = 300  # a power with an infinite slope at rest takes 150; more are a curve with a corner
PER_PIECE = 6  # speeds of each piece at which the spline is put through the formula, and compared with it
BEYOND = 1.1  # of the measured curve's last knot: slips of the fit may be a little faster
# At which starting values are compared with another friction, from the slowest on: below few samples show it.
SPEEDS, SLOWEST = 61, 0.06
DOUBLED = 2.0  # of a parameter: whether the derivative by it changes then shows whether it bends the curve
DRAWS = 3  # of values at which that is looked at
SAME = 1e-9  # of a derivative: less is rounding
# Trials of a parameter that bends the curve, over its natural size: half as many a decade still start Stribeck curves.
TRIALS = 10.0 ** np.arange(-2.5, 2.1, 0.5)
MOST_TRIALS, SEED = 300, 7  # of all such parameters together; more than that are drawn
IMPROVED = 4  # of the best trials
FAR = 1e9  # a residual of no number: the step is refused


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


class StartValues(NamedTuple):
    """The free parameters by name, and whether each bends the curve."""

    values: dict[str, float]
    bends: dict[str, bool]


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

    Raises
    ------
    InputError
        Where no trial of the parameters is a friction.
    """

    def __init__(self, law: Law, fastest: float, near: "Target") -> None:
        self.law, self.fastest, self.ramp, self.size = law, fastest, law.ramp, len(law.free)
        start = start_values(law, near)
        self.by_log = np.array([start.bends[name] and law.limits(name)[0] >= 0.0 for name in law.free], np.bool_)
        self.start = self.theta(start.values)
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
        """See `FrictionCurve`."""
        return self.at_speeds(theta, s)

    def near(self, friction: Friction, beside: Array) -> Array:
        """See `FrictionCurve`."""
        return self.theta(start_values(self.law, Target.of(friction, self.fastest)).values)

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
            away = np.abs(found(self._at) - target) > TOLERANCE * target.max()
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


def start_values(law: Law, near: Target) -> StartValues:
    """Return values of a law's free parameters near another friction.

    A start that the law gives is kept for the first trial.

    Raises
    ------
    InputError
        Where no trial is finite at all speeds.
    """
    s = near.speeds
    sizes = {name: _size(law, name, near.size, float(s[-1])) for name in law.free}
    begin = sizes | dict(law.start or {})
    begin = {name: _inside(law, name, begin[name]) for name in law.free}
    bends = {name: _bends(law, name, begin, s) for name in law.free}
    linear = [name for name in law.free if not bends[name] and name not in (law.start or {})]
    tried = [name for name in law.free if bends[name] and name not in (law.start or {})]
    found = []
    for trial in [begin, *_trials(law, tried, begin, sizes)]:
        values = _with_linear(law, linear, trial, near)
        left = None if values is None else _left(law, values, near)
        if values is not None and left is not None:
            found.append((float(np.sum(left**2)), values))
    if not found:
        law.curve.value(s, dict(law.fix or {}) | begin)
        raise InputError(f"law {law.name}: no starting value near the measured curve", "formula", "give start values")
    found.sort(key=lambda one: one[0])
    improved = [_improved(law, values, near) for _, values in found[:IMPROVED]]
    return StartValues(min(improved, key=lambda one: one[0])[1], bends)


def _size(law: Law, name: str, friction: float, speed: float) -> float:
    """Return the natural size of a parameter by its dimensions; 1 where these are not known."""
    force, power = law.dimensions.get(name, (0, 0))
    return float(friction**force * speed**power)


def _inside(law: Law, name: str, value: float) -> float:
    low, high = law.limits(name)
    if low < value < high:
        return value
    if math.isfinite(low) and math.isfinite(high):
        return 0.5 * (low + high)
    return float(np.clip(value, low, high))


def _bends(law: Law, name: str, values: dict[str, float], s: Array) -> bool:
    """Return whether the derivative by a parameter depends on it, at some values of the others.

    These differ from each other by chance: where two friction levels are equal, a Stribeck speed seems to act not.
    """
    rng = np.random.default_rng(SEED)
    for _ in range(DRAWS):
        drawn = {own: _inside(law, own, value * rng.uniform(0.5, 2.0)) for own, value in values.items()}
        whole = dict(law.fix or {}) | drawn
        value = whole[name] if whole[name] else 1.0
        try:
            first, other = (
                law.curve.gradient(s, whole | {name: factor * value}, (name,)) for factor in (1.0, 1.0 / DOUBLED)
            )
        except InputError:
            return True
        if np.any(np.abs(first - other) > SAME * np.max(np.abs(first))):
            return True
    return False


def _trials(law: Law, tried: Sequence[str], begin: dict[str, float], sizes: dict[str, float]) -> list[dict[str, float]]:
    """Return trials of the parameters that bend the curve: every combination, or some of very many."""
    each = []
    for name in tried:
        low, high = law.limits(name)
        values = [float(sizes[name] * factor) for factor in TRIALS]
        values += [] if low >= 0 else [-value for value in values]
        if math.isfinite(low) and math.isfinite(high):
            values += np.linspace(low, high, TRIALS.size)[1:-1].tolist()
        each.append([value for value in values if low <= value <= high])
    count = math.prod(len(values) for values in each)
    if count <= MOST_TRIALS:
        combined = list(product(*each))
    else:
        rng = np.random.default_rng(SEED)
        combined = [tuple(values[rng.integers(len(values))] for values in each) for _ in range(MOST_TRIALS)]
    return [begin | dict(zip(tried, values, strict=True)) for values in combined]


def _with_linear(law: Law, linear: Sequence[str], values: dict[str, float], near: Target) -> dict[str, float] | None:
    """Return the values with those in which the formula is linear by least squares, within their bounds."""
    left = _left(law, values, near)
    if left is None or not linear:
        return None if left is None else values
    try:
        columns = law.curve.gradient(near.speeds, dict(law.fix or {}) | values, tuple(linear))
    except InputError:
        return None
    change = np.linalg.lstsq(np.einsum("mk,kp->mp", near.root, columns), -left, rcond=None)[0]
    return values | {
        name: float(np.clip(values[name] + step, *law.limits(name))) for name, step in zip(linear, change, strict=True)
    }


def _left(law: Law, values: dict[str, float], near: Target) -> Array | None:
    """Return how far the formula is from the target (m,); None where it is not finite."""
    try:
        found = law.curve.value(near.speeds, dict(law.fix or {}) | values)
    except InputError:
        return None
    return np.asarray(np.einsum("mk,k->m", near.root, found) - near.aim)


def _improved(law: Law, values: dict[str, float], near: Target) -> tuple[float, dict[str, float]]:
    """Return the sum of squares and the values after nonlinear least squares within the bounds."""
    from scipy.optimize import least_squares

    names = law.free
    low, high = np.array([law.limits(name) for name in names]).T
    begin = np.array([values[name] for name in names])
    size = np.maximum(np.abs(begin), 1e-300)

    def residual(z: Array) -> Array:
        left = _left(law, dict(zip(names, (z * size).tolist(), strict=True)), near)
        return np.full(near.aim.size, FAR) if left is None else left

    bounds = (low / size, high / size)
    inside = np.clip(begin / size, *bounds)
    found = least_squares(residual, inside, bounds=bounds, method="trf", x_scale=1.0, max_nfev=200)
    better = dict(zip(names, (found.x * size).tolist(), strict=True))
    return float(2 * found.cost), better
