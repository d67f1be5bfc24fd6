"""What a map with a control parameter is to the analyses of this folder, which name no system; its derivatives."""

from typing import Protocol

import numpy as np

from daq.base.compute.arrays import Array

# Step of the difference quotients, relative to the scales.  Rounding of the driven mass's map, some 1e-15, over the
# step, and the remainder of fourth order are both below 1e-9 of a derivative; 1e-4 loses orbits next to grazing.
STEP = 1e-5
STENCIL, WEIGHTS = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12.0


class ControlledMap(Protocol):
    """A map of states of d numbers, which a change of one parameter can correct at every application.

    Attributes
    ----------
    scale : (d,) float64
        A size of every coordinate: distances are judged relative to it.
    turn : (d,) float64
        Length after which a coordinate begins again, as a phase does; infinity where it does not.
    strength : float
        Size of the parameter: a budget is relative to it.
    """

    scale: Array
    turn: Array
    strength: float

    def __call__(self, state: Array, change: float = 0.0) -> Array:
        """Return the state that follows, (d,), with the parameter changed by ``change``; NaN where there is none."""
        ...


def difference(f: ControlledMap, a: Array, b: Array) -> Array:
    """Return a - b in units of the scales, the short way round where a coordinate is a phase; arrays (..., d)."""
    delta = a - b
    cyclic = np.isfinite(f.turn)
    turn = np.where(cyclic, f.turn, 1.0)
    short: Array = np.where(cyclic, delta - turn * np.round(delta / turn), delta)
    return short / f.scale


def orbit(f: ControlledMap, start: Array, number: int, change: float = 0.0) -> Array:
    """Return f(start), f(f(start)) ..., shape (n, d): ``number`` states, or fewer where the map ends."""
    states = []
    state = start
    for _ in range(number):
        state = f(state, change)
        if not np.all(np.isfinite(state)):
            break
        states.append(state)
    return np.array(states).reshape(len(states), len(start))


def slope_at(f: ControlledMap, state: Array) -> tuple[Array, Array]:
    """Return f at a state, (d,), and its derivative by the state, (d, d), in units of the scales.

    NaN where f is not defined about the state.
    """
    middle = f(state)
    columns = []
    for j in range(len(state)):
        step = np.zeros(len(state))
        step[j] = STEP * f.scale[j]
        columns.append(_quotient(f, [f(state + place * step) for place in STENCIL], middle))
    return middle, np.array(columns).T


def derivatives(f: ControlledMap, state: Array) -> tuple[Array, Array]:
    """Return the derivatives of f at a state: by the state, (d, d), and by the parameter, (d,).

    In units of the scales and of the parameter's strength.  NaN where f is not defined about the state.
    """
    middle, slope = slope_at(f, state)
    return slope, _quotient(f, [f(state, place * STEP * f.strength) for place in STENCIL], middle)


def _quotient(f: ControlledMap, values: list[Array], middle: Array) -> Array:
    quotient: Array = WEIGHTS @ np.array([difference(f, value, middle) for value in values]) / STEP
    return quotient
