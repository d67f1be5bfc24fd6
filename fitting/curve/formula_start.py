"""Starting values of a formula's parameters, from a friction curve that was measured without a law.

Parameters in which the formula is linear follow from the others by least squares.  Of the others one is tried on a
grid, several at points that fill the space evenly, over the sizes that their units allow: friction is measured by that
of the curve, speed by its fastest.  The best few are improved by bounded least squares over all parameters together.

A formula that is negative or not finite somewhere on the range of slip speeds, or not above 0 at rest, is no friction.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from daq.base.compute.arrays import Array, Mask
from daq.base.errors import InputError
from fitting.law import Law

# Decades about its unit over which a parameter is tried: of one with a speed in its unit, of one without, and of one
# whose unit is not known.  Falls of published forms lie between 0.01 and 1 of the fastest speed, exponents between 0.3
# and 3: half would miss some of them; twice would leave the grid too coarse for a Gaussian fall.
SPEEDS, NUMBERS, UNKNOWN = (-3.0, 1.0), (-1.0, 1.0), (-3.0, 3.0)
GRID = 60  # values of one parameter; with half of them the narrowest valley, of a Gaussian fall, still has two
POINTS = 600  # of several parameters: 0.1 CPU s; twice finds no other minimum of sums of two falls
IMPROVED = 4  # of the best points, each in a valley of its own
SAME_VALLEY = 0.25  # of a start's misfit: curves that differ by less are in one valley
SCANNED = 48  # speeds at which points are compared
IRRATIONAL = 2.0**0.5 - 1.0  # the fractional parts of multiples of its powers fill a cube evenly
DRAWS = 3  # sets of the other parameters at which a derivative is compared
SAME = 1e-9  # of a derivative: less is rounding
CHECKED = 400  # speeds at which a formula must be friction
IMPOSSIBLE = 1e6  # standard deviations: what a residual counts where the formula is no friction


class Target(NamedTuple):
    """A measured friction curve.

    ``friction`` (k,), m/s^2, at slip speeds ``speed`` (k,), m/s, with standard deviations ``sd`` (k,); all of it may be
    off by one constant of standard deviation ``level_sd``, m/s^2.
    """

    speed: Array
    friction: Array
    sd: Array
    level_sd: float = 0.0

    @property
    def fastest(self) -> float:
        """The fastest slip speed, m/s."""
        return float(self.speed[-1])

    def away(self, friction: Array, offset: float) -> Array:
        """Return how far a friction (k,) with a constant added is off, in standard deviations."""
        found = (friction + offset - self.friction) / self.sd
        return np.append(found, offset / self.level_sd) if self.level_sd > 0 else found

    def offset(self, friction: Array) -> float:
        """Return the constant that brings a friction (k,) nearest."""
        if not self.level_sd > 0:
            return 0.0
        weight = self.sd**-2.0
        return float(np.sum(weight * (self.friction - friction)) / (np.sum(weight) + self.level_sd**-2.0))


@dataclass(frozen=True)
class FormulaStart:
    """Where a formula's parameters start.

    Attributes
    ----------
    values : dict of str to float
        Of the free parameters.
    offset : float
        What is added to the formula to be the measured curve, m/s^2.
    misfit : float
        Chi square, its speeds taken as independent.
    points : int
        How many speeds these are.
    """

    values: dict[str, float]
    offset: float
    misfit: float
    points: int


def find_starts(law: Law, target: Target, beyond: float = 1.0) -> list[FormulaStart]:
    """Return values with which a formula is near a measured curve, nearest first: a local minimum each.

    Parameters
    ----------
    law : Law
        Its own first values are where these parameters are tried; its bounds hold.
    target : Target
    beyond : float
        Times the fastest slip speed, up to which the formula must be friction.

    Raises
    ------
    InputError
        With none of the values tried is the formula a friction curve; the reason is that of the first of them.
    """
    return _Search(law, target, beyond).minima()


class _Search:
    """The values of one formula that are tried on a target."""

    def __init__(self, law: Law, target: Target, beyond: float) -> None:
        self.law, self.target = law, target
        self.names = law.free
        self.fixed, self.given = dict(law.fix or {}), dict(law.start or {})
        self.limits = np.array([law.limits(name) for name in self.names]).reshape(-1, 2)
        self.checked = np.linspace(0.0, beyond * target.fastest, CHECKED)
        few = np.unique(np.linspace(0, target.speed.size - 1, SCANNED).astype(int))
        self.few = Target(target.speed[few], target.friction[few], target.sd[few], target.level_sd)
        self.refused: InputError | None = None

    def minima(self) -> list[FormulaStart]:
        """Return the best local minima."""
        tried = [found for point in self._points() if (found := self._completed(point)) is not None]
        if not tried:
            raise self._reason()
        tried.sort(key=lambda start: start.misfit)
        improved = sorted((self._improved(start) for start in self._valleys(tried)), key=lambda start: start.misfit)
        return self._valleys(improved)

    def _named(self, values: Array) -> dict[str, float]:
        """Return values (k,) of the free parameters by name."""
        return dict(zip(self.names, values.tolist(), strict=True))

    @cached_property
    def linear(self) -> Mask:
        """In which free parameters (k,) the formula is linear, in all of them together."""
        rng = np.random.default_rng(len(self.law.formula))
        draws = [self._named(rng.uniform(0.5, 2.0, len(self.names))) for _ in range(DRAWS)]
        chosen: list[str] = []
        for name in self.names:
            if name not in self.given and all(self._unmoved(draw, [*chosen, name]) for draw in draws):
                chosen.append(name)
        return np.array([name in chosen for name in self.names], np.bool_)

    def _unmoved(self, draw: dict[str, float], group: list[str]) -> bool:
        """Return whether the derivatives by a group of parameters stay when all of the group change."""
        curve, others = self.law.curve, self.fixed | draw
        moved = others | {name: 3.0 * others[name] + 1.0 for name in group}
        s = self.few.fastest * np.linspace(0.05, 1.0, 7)
        try:
            here, there = (curve.gradient(s, values, tuple(group)) for values in (others, moved))
        except InputError:
            return False
        return bool(np.all(np.abs(here - there) <= SAME * np.max(np.abs(here))))

    def _points(self) -> Array:
        """Return values (n, k) of the parameters to be tried; those of linear ones are not used."""
        searched = [i for i, name in enumerate(self.names) if not self.linear[i] and name not in self.given]
        count = 1 if not searched else GRID if len(searched) == 1 else POINTS
        points = np.tile([self.given.get(name, 1.0) for name in self.names], (count, 1))
        for place, i in enumerate(searched, start=1):
            spread = np.linspace(0.0, 1.0, count) if len(searched) == 1 else IRRATIONAL**place * np.arange(count) % 1.0
            along = np.asarray(spread, np.float64)
            points[:, i] = self._sizes(self.names[i], along)
        signs = product(*((1.0, -1.0) if self.limits[i, 0] < 0 else (1.0,) for i in searched))
        found = np.concatenate([_with_signs(points, searched, sign) for sign in signs])
        return np.asarray(np.clip(found, self.limits[:, 0], self.limits[:, 1]))

    def _sizes(self, name: str, along: Array) -> Array:
        """Return sizes of a parameter, evenly spread over the decades that its unit allows; ``along`` is 0 to 1."""
        force, speed = self.law.dimensions.get(name, (0, 0))
        low, high = UNKNOWN if not self.law.dimensions else SPEEDS if speed else NUMBERS
        decades = (low + (high - low) * along) * (speed or force or 1)
        level = float(np.median(self.target.friction))
        return np.asarray(level**force * self.target.fastest**speed * 10.0**decades)

    def _completed(self, point: Array) -> FormulaStart | None:
        """Return a point with its linear parameters by least squares; None where that is no friction."""
        target = self.few
        linear = tuple(name for name, own in zip(self.names, self.linear, strict=True) if own)
        values = self._named(np.where(self.linear, 1.0, point))
        try:
            columns = self.law.curve.gradient(target.speed, self.fixed | values, linear)
            rest = self.law.curve.value(target.speed, self.fixed | values) - columns.sum(axis=1)
        except InputError as error:
            self.refused = self.refused or error
            return None
        found = _bounded(columns, target, rest, self.limits[self.linear])
        return self._judged(values | dict(zip(linear, found, strict=True)))

    def _judged(self, values: dict[str, float]) -> FormulaStart | None:
        """Return the values with their misfit; None where the formula is no friction."""
        whole = self.fixed | values
        try:
            friction = self.law.curve.value(self.checked, whole)
            own = self.law.curve.value(self.target.speed, whole)
            self.law.curve.gradient(self.checked, whole, self.names)
        except InputError as error:
            self.refused = self.refused or error
            return None
        lowest = int(np.argmin(friction))
        if friction[lowest] < 0 or not friction[0] > 0:
            bad, kind = (lowest, "negative") if friction[lowest] < 0 else (0, "not above 0")
            at = self.law.curve.place(float(self.checked[bad]), whole)
            what = f"friction is {kind}, {friction[bad]:.4g} m/s^2, {at}"
            self.refused = self.refused or InputError(what, "formula", "give bounds, or a form that stays above 0")
            return None
        offset = self.target.offset(own)
        away = self.target.away(own, offset)
        return FormulaStart(values, offset, float(np.sum(away**2)), self.target.speed.size)

    def _valleys(self, starts: list[FormulaStart]) -> list[FormulaStart]:
        """Return the best of the starts in each of the best valleys."""
        kept: list[tuple[FormulaStart, Array]] = []
        for start in starts:
            friction = self.law.curve.value(self.few.speed, self.fixed | start.values) + start.offset
            apart = (float(np.sum(((friction - other) / self.few.sd) ** 2)) for _, other in kept)
            if all(distance > SAME_VALLEY * start.misfit for distance in apart):
                kept.append((start, friction))
            if len(kept) == IMPROVED:
                break
        return [start for start, _ in kept]

    def _improved(self, start: FormulaStart) -> FormulaStart:
        """Return the end of bounded least squares over all values; those that are never negative by their logarithm."""
        from scipy.optimize import least_squares

        target, curve = self.target, self.law.curve
        begin = np.array([start.values[name] for name in self.names])
        by_log = ~self.linear & (self.limits[:, 0] >= 0) & (begin > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = (np.where(by_log, np.log(end), end) for end in self.limits.T)
        first = np.where(by_log, np.log(np.where(by_log, begin, 1.0)), begin)
        level = target.level_sd > 0

        def values(x: Array) -> dict[str, float]:
            own = x[: begin.size]
            return self._named(np.where(by_log, np.exp(np.clip(own, -700.0, 700.0)), own))

        def away(x: Array) -> Array:
            try:
                return target.away(curve.value(target.speed, self.fixed | values(x)), float(x[-1]) if level else 0.0)
            except InputError:
                return np.full(target.speed.size + level, IMPOSSIBLE)

        def slopes(x: Array) -> Array:
            named = values(x)
            try:
                own = curve.gradient(target.speed, self.fixed | named, self.names)
            except InputError:
                own = np.zeros((target.speed.size, begin.size))
            own = own * np.where(by_log, list(named.values()), 1.0) / target.sd[:, None]
            if not level:
                return np.asarray(own)
            below = np.append(np.zeros(begin.size), 1 / target.level_sd)
            return np.vstack([np.column_stack([own, 1 / target.sd]), below])

        x = np.append(first, start.offset) if level else first
        low, high = (np.append(low, -np.inf), np.append(high, np.inf)) if level else (low, high)
        scale = np.where(np.append(by_log, False)[: x.size], 1.0, np.where(x != 0, np.abs(x), 1.0))
        found = least_squares(away, np.clip(x, low, high), slopes, bounds=(low, high), x_scale=scale)
        better = self._judged(values(found.x))
        return better if better is not None and better.misfit < start.misfit else start

    def _reason(self) -> InputError:
        """Return why the formula is no friction with any of the values tried."""
        why = self.refused or InputError("no values were tried", "formula", "give some with --start")
        what = f"law {self.law.name} is no friction curve with any of the values tried: {why.what}"
        return InputError(what, why.where, why.do)


def _with_signs(points: Array, places: list[int], signs: tuple[float, ...]) -> Array:
    found = points.copy()
    found[:, places] *= signs
    return found


def _bounded(columns: Array, target: Target, rest: Array, limits: Array) -> list[float]:
    """Return the linear parameters (n,) within their bounds (n, 2), the level beside them."""
    from scipy.optimize import lsq_linear

    n = columns.shape[1]
    if not n:
        return []
    matrix, aim = columns / target.sd[:, None], (target.friction - rest) / target.sd
    if target.level_sd > 0:
        beside = np.append(np.zeros(n), 1 / target.level_sd)
        matrix = np.vstack([np.column_stack([matrix, 1 / target.sd]), beside])
        aim, limits = np.append(aim, 0.0), np.vstack([limits, [-np.inf, np.inf]])
    return [float(value) for value in lsq_linear(matrix, aim, (limits[:, 0], limits[:, 1])).x[:n]]
