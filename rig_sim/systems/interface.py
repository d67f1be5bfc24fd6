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
from stickslip.errors import InputError

# Difference quotients of fourth order: offsets and weights, over 12 steps.
STENCIL, WEIGHTS = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0])
# Their step relative to the interval.  Slopes of the thesis's map come out to 1e-8 and better: its rounding, 1e-15 of f
# over the step, and its fourth-order remainder are both below that.
INTERVAL_STEP = 2e-5
# Their step relative to the scales.  For the driven mass's map rounding, about 1e-15, over the step, and the remainder
# of fourth order are both below 1e-9 of a derivative; 1e-4 loses orbits next to grazing.
STATE_STEP = 1e-5
NO_ATTRACTOR = Outcome("no attractor", "the orbit leaves the region in which the map is defined")


class StepLimitError(InputError):
    """An analysis has taken more integrator steps than allowed."""


@dataclass
class StepBudget:
    """Integrator steps ``allowed`` in a whole analysis, however many motions it follows, and those ``left``."""

    allowed: float

    def __post_init__(self) -> None:
        self.left = self.allowed

    def limit_error(self, where: str, do: str) -> StepLimitError:
        """Return the error of a spent budget, with the analysis (``where``) and the remedy (``do``)."""
        return StepLimitError(f"step limit: more than {self.allowed:.0e} integrator steps", where, do)


@dataclass(frozen=True)
class Passages:
    """Consecutive passages of a section."""

    times: Array  # (n,) drive periods from the start of the motion; of a map the number of its application
    states: Array  # (n, d) the state there
    # (n,) logarithm of the factor by which a small deviation has grown since the passage before, along the direction
    # that grows most; NaN where it was not requested, or does not exist, as next to a jump of the motion
    growth: Array
    outcome: Outcome  # 'completed', or why there are fewer passages than requested


class Motion(Protocol):
    """A motion from one start, advanced by every call."""

    @property
    def system(self) -> "ReturnMap": ...

    def follow(self, number: int, *, tangent: bool = False) -> Passages:
        """Return the next ``number`` passages; fewer where the motion ends.  ``tangent``: with their growth."""
        ...

    def draw_points(self, number: int) -> Array:
        """Return the points (k,) that a bifurcation diagram draws of the next ``number`` passages."""
        ...


class ReturnMap(Protocol):
    """A system that passes a section again and again."""

    scale: Array  # (d,) typical size of each coordinate of the state, in its unit
    turn: Array  # (d,) period of each coordinate that is a phase; infinity for the others
    unit: int  # passages in one natural oscillation of the system, at least 1: sets how long it takes to settle

    def motion(self, start: Array) -> Motion:
        """Return the motion from a state, (d,)."""
        ...


class OnInterval(ReturnMap, Protocol):
    """A map of the interval [lo, hi] to itself: d = 1.

    Its optional methods are used where they exist: ``survey(x, times)``, faster images for sign and position;
    ``slopes(x)``, its derivative; ``growth_at(x)``, the logarithms of the slopes' sizes, in place of a motion's own
    tangent.
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
    """A map that a change of one parameter can correct at every application."""

    strength: float  # size of the parameter, in its unit; a budget is relative to it

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

    def draw_points(self, number: int) -> Array:
        drawn: Array = self.follow(number).states[:, 0]
        return drawn


def slope(f: OnInterval, x: Array) -> Array:
    """Return f'(x), shape (n,): by the map's own ``slopes(x)`` where it has them, or a quotient of fourth order.

    NaN where the map is not defined about x.
    """
    slopes = getattr(f, "slopes", None)
    if slopes is not None:
        return np.asarray(slopes(x), dtype=np.float64)
    h = INTERVAL_STEP * (f.hi - f.lo)
    x = np.asarray(x, dtype=np.float64)
    values = f.images((x[:, None] + h * STENCIL).ravel()).reshape(-1, 4)
    return (values @ WEIGHTS) / (12.0 * h)  # type: ignore[no-any-return]


def growth_at(f: OnInterval, x: Array) -> Array:
    """Return the logarithm of abs(f'(x)), shape (n,); minus infinity where the slope is 0."""
    with np.errstate(divide="ignore"):
        return np.log(np.abs(slope(f, x)))


def survey(f: OnInterval, x: Array, times: int = 1) -> Array:
    """Return the ``times``-th iterate of each x for its sign and position: by a faster way where the map has one."""
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

    NaN where f is not defined about the state.  ``after`` replaces ``f.after``.
    """
    after = after or f.after
    middle = after(state)
    columns = []
    for j in range(len(state)):
        step = np.zeros(len(state))
        step[j] = STATE_STEP * f.scale[j]
        columns.append(difference_quotient(f, [after(state + offset * step) for offset in STENCIL], middle))
    return middle, np.array(columns).T


def derivatives(f: Controlled, state: Array) -> tuple[Array, Array]:
    """Return the derivatives of f at a state: by the state, (d, d), and by the parameter, (d,).

    In units of the scales and of the parameter's strength.  NaN where f is not defined about the state.
    """
    middle, by_state = slope_at(f, state)
    return by_state, difference_quotient(
        f, [f.after(state, offset * STATE_STEP * f.strength) for offset in STENCIL], middle
    )


def difference_quotient(f: Controlled, values: list[Array], middle: Array) -> Array:
    quotient: Array = (WEIGHTS / 12.0) @ np.array([difference(f, value, middle) for value in values]) / STATE_STEP
    return quotient
