"""What a system is to the analyses, which name none: a map from one passage of a section to the next.

==============  ======================================================  ==========================================
protocol        what it is asked                                        asked by
==============  ======================================================  ==========================================
`ReturnMap`     a motion from a start, passage after passage            attractors, exponents
`OnInterval`    where many places of an interval go                     basins, periodic points, branches
`Controlled`    where one state goes with the parameter changed         unstable orbits, locking
==============  ======================================================  ==========================================

A motion is a cursor: a driven mass that is restarted from its position and velocity loses the last bit of what it holds
within, and with it every digit of a chaotic motion.  `rig_sim.FormulaMap` makes a system of one method.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rig_sim.flow.modes import COMPLETED, OUTCOMES, Outcome
from stickslip.compute.arrays import Array

# Difference quotients of fourth order: places and weights, over 12 steps.
STENCIL, WEIGHTS = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0])
# Their step relative to the interval.  Slopes of the thesis's map come out to 1e-8 and better: its rounding, 1e-15 of f
# over the step, and its fourth-order remainder are both below that; not swept.
INTERVAL_STEP = 2e-5
# Their step relative to the scales.  Rounding of the driven mass's map, some 1e-15, over the step, and the remainder of
# fourth order are both below 1e-9 of a derivative; 1e-4 loses orbits next to grazing.
STATE_STEP = 1e-5
NO_ATTRACTOR = Outcome("no attractor", "the orbit leaves the places where the map is defined")


@dataclass(frozen=True)
class Passages:
    """Consecutive passages of a section.

    Attributes
    ----------
    times : (n,) float64
        When, in drive periods from the start of the motion; of a map how often it was applied.
    states : (n, d) float64
        The state there.
    growth : (n,) float64
        Logarithm of the factor by which a small deviation has grown since the passage before, along the direction
        that grows most; NaN where it was not asked for, or has none, as beside a jump of the motion.
    outcome : Outcome
        'completed', or why there are fewer passages than were asked for.
    """

    times: Array
    states: Array
    growth: Array
    outcome: Outcome


class Motion(Protocol):
    """A motion from one start, whose state moves on with every call."""

    @property
    def system(self) -> "ReturnMap":
        """What moves."""
        ...

    def follow(self, number: int, *, tangent: bool = False) -> Passages:
        """Return the next ``number`` passages; fewer where the motion ends.  ``tangent``: with their growth."""
        ...

    def drawn(self, number: int) -> Array:
        """Return the points (k,) that a bifurcation diagram draws of the next ``number`` passages."""
        ...


class ReturnMap(Protocol):
    """A system that passes a section again and again.

    Attributes
    ----------
    scale : (d,) float64
        A size of each coordinate of the state, in its unit: distances are judged relative to it.
    turn : (d,) float64
        Length after which a coordinate begins again, as a phase does; infinity where it does not.
    unit : int
        Passages in one oscillation of the system's own, at least 1: how long it takes to settle.
    """

    scale: Array
    turn: Array
    unit: int

    def motion(self, start: Array) -> Motion:
        """Return the motion from a state, (d,)."""
        ...


class OnInterval(ReturnMap, Protocol):
    """A map of the interval [lo, hi] to itself: d = 1.

    Where it has them, these are used: ``survey(x, times)``, faster images to see their sign and place; ``slopes(x)``,
    its derivative; ``growth_at(x)``, the logarithms of the slopes' sizes, in place of a motion's own tangent.
    """

    lo: float
    hi: float

    def images(self, x: Array, times: int = 1) -> Array:
        """Return the ``times``-th iterate of each x, shape (n,); NaN where the map is not defined."""
        ...

    def orbit(self, start: float, number: int) -> Array:
        """Return f(start), f(f(start)) ..., shape (number,)."""
        ...


class Controlled(ReturnMap, Protocol):
    """A map that a change of one parameter can correct at every application.

    Attributes
    ----------
    strength : float
        Size of the parameter, in its unit: a budget is relative to it.
    """

    strength: float

    def after(self, state: Array, change: float = 0.0) -> Array:
        """Return the state that follows, (d,), with the parameter changed by ``change``; NaN where there is none."""
        ...


class IntervalMotion:
    """A motion of a map of an interval: its orbit from a start, (1,)."""

    def __init__(self, f: OnInterval, start: Array) -> None:
        self.system, self._x, self._applied = f, float(np.asarray(start).reshape(-1)[0]), 0

    def follow(self, number: int, *, tangent: bool = False) -> Passages:
        """Return the next ``number`` points; fewer where the orbit leaves the map's domain."""
        orbit = self.system.orbit(self._x, number)
        ends = np.flatnonzero(~np.isfinite(orbit))
        count = number if ends.size == 0 else int(ends[0])
        self._x = float(orbit[-1]) if number else self._x
        times = self._applied + np.arange(1.0, count + 1.0)
        self._applied += number
        states = orbit[:count, None]
        growth = growth_at(self.system, orbit[:count]) if tangent else np.full(count, np.nan)
        return Passages(times, states, growth, OUTCOMES[COMPLETED] if count == number else NO_ATTRACTOR)

    def drawn(self, number: int) -> Array:
        """Return the next ``number`` points."""
        drawn: Array = self.follow(number).states[:, 0]
        return drawn


def slope(f: OnInterval, x: Array) -> Array:
    """Return f'(x), shape (n,): by the map's own ``slopes(x)`` where it has them, or a quotient of fourth order.

    NaN where the map is not defined about x.
    """
    known = getattr(f, "slopes", None)
    if known is not None:
        return np.asarray(known(x), dtype=np.float64)
    h = INTERVAL_STEP * (f.hi - f.lo)
    x = np.asarray(x, dtype=np.float64)
    values = f.images((x[:, None] + h * STENCIL).ravel()).reshape(-1, 4)
    return (values @ WEIGHTS) / (12.0 * h)  # type: ignore[no-any-return]


def growth_at(f: OnInterval, x: Array) -> Array:
    """Return the logarithm of abs(f'(x)), shape (n,); minus infinity where the slope is 0."""
    with np.errstate(divide="ignore"):
        return np.log(np.abs(slope(f, x)))


def survey(f: OnInterval, x: Array, times: int = 1) -> Array:
    """Return the ``times``-th iterate of each x to see its sign and place: by a faster way where the map has one."""
    values: Array = getattr(f, "survey", f.images)(x, times)
    return values


def difference(f: ReturnMap, a: Array, b: Array) -> Array:
    """Return a - b in units of the scales, the short way round where a coordinate is a phase; arrays (..., d)."""
    delta = a - b
    cyclic = np.isfinite(f.turn)
    turn = np.where(cyclic, f.turn, 1.0)
    short: Array = np.where(cyclic, delta - turn * np.round(delta / turn), delta)
    return short / f.scale


def orbit(f: Controlled, start: Array, number: int, change: float = 0.0) -> Array:
    """Return f(start), f(f(start)) ..., shape (n, d): ``number`` states, or fewer where the map ends."""
    states = []
    state = start
    for _ in range(number):
        state = f.after(state, change)
        if not np.all(np.isfinite(state)):
            break
        states.append(state)
    return np.array(states).reshape(len(states), len(start))


def slope_at(f: Controlled, state: Array, after: Callable[[Array], Array] | None = None) -> tuple[Array, Array]:
    """Return f at a state, (d,), and its derivative by the state, (d, d), in units of the scales.

    NaN where f is not defined about the state.  ``after`` stands in place of ``f.after``.
    """
    after = after or f.after
    middle = after(state)
    columns = []
    for j in range(len(state)):
        step = np.zeros(len(state))
        step[j] = STATE_STEP * f.scale[j]
        columns.append(_quotient(f, [after(state + place * step) for place in STENCIL], middle))
    return middle, np.array(columns).T


def derivatives(f: Controlled, state: Array) -> tuple[Array, Array]:
    """Return the derivatives of f at a state: by the state, (d, d), and by the parameter, (d,).

    In units of the scales and of the parameter's strength.  NaN where f is not defined about the state.
    """
    middle, by_state = slope_at(f, state)
    return by_state, _quotient(f, [f.after(state, place * STATE_STEP * f.strength) for place in STENCIL], middle)


def _quotient(f: Controlled, values: list[Array], middle: Array) -> Array:
    quotient: Array = (WEIGHTS / 12.0) @ np.array([difference(f, value, middle) for value in values]) / STATE_STEP
    return quotient
