"""A system given by a formula: one method, the step from a state to the next, makes it one of all analyses."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rig_sim.flow.modes import COMPLETED, OUTCOMES
from rig_sim.systems.interface import NO_ATTRACTOR, Passages, slope_at
from stickslip.compute.arrays import Array


class FormulaMap:
    """A custom system, given by the method `step`: a map, or a flow from one passage of a section to the next.

    Derive a class from this one and define `step`.  `rig_sim.lyapunov` and `rig_sim.lock` accept any such system,
    `rig_sim.map` and `rig_sim.basins` one with a single coordinate and an ``interval``.  `rig_sim.sweep` and
    `rig_sim.continue_` accept a function that returns a system for each value of a parameter.

    Parameters
    ----------
    scale : float or (d,) sequence
        A typical size of each coordinate of the state; distances are relative to it.
    start : float or (d,) sequence, optional
        Where motions begin; default 0.3 of the scale.
    turn : float or (d,) sequence, optional
        Period of a coordinate, such as a phase; default infinity.
    interval : (float, float), optional
        The interval that a map of one coordinate maps to itself.
    strength : float, optional
        Size of the control parameter; the budget of a control is relative to it.
    unit : int, optional
        Passages in one oscillation of the system, for the time to settle.

    Examples
    --------
    The logistic map at its last parameter has the Lyapunov exponent log 2:

    >>> import rig_sim
    >>> class Logistic(rig_sim.FormulaMap):
    ...     def __init__(self, r):
    ...         super().__init__(scale=1.0, interval=(0.0, 1.0), strength=r)
    ...         self.r = r
    ...
    ...     def step(self, x, change=0.0):
    ...         r = self.r + change
    ...         return r * x * (1 - x), r * (1 - 2 * x), 1.0
    >>> found = rig_sim.lyapunov(Logistic(4.0), events=20_000)
    >>> abs(found.exponent - 0.693147) < 4 * found.stderr
    True
    """

    def __init__(
        self,
        scale: "float | Sequence[float]",
        *,
        start: "float | Sequence[float] | None" = None,
        turn: "float | Sequence[float]" = math.inf,
        interval: tuple[float, float] | None = None,
        strength: float = 1.0,
        unit: int = 1,
    ) -> None:
        self.scale: Array = np.atleast_1d(np.asarray(scale, dtype=np.float64))
        self.turn: Array = np.array(np.broadcast_to(np.asarray(turn, dtype=np.float64), self.scale.shape))
        begin = 0.3 * self.scale if start is None else np.asarray(start, dtype=np.float64)
        self.start: Array = np.array(np.broadcast_to(begin, self.scale.shape))
        self.lo, self.hi = interval or (-math.inf, math.inf)
        self.strength, self.unit = float(strength), unit

    def step(self, state: Array, change: float = 0.0) -> tuple[Any, Any, float]:
        """Return the next state, the derivative by the state, and the time that passes.

        Parameters
        ----------
        state : (d,) float64
        change : float
            Change of the control parameter; ignored by a system without one.

        Returns
        -------
        state : (d,) array
            NaN where there is none.
        jacobian : (d, d) array or None
            Derivative of the next state by this one; None to use difference quotients.
        time : float
            1 for a map.
        """
        raise NotImplementedError("a FormulaMap must define step(self, state, change=0.0)")

    def after(self, state: Array, change: float = 0.0) -> Array:
        return self._step_within_interval(state, change)[0]

    def _step_within_interval(self, state: Array, change: float = 0.0) -> tuple[Array, Any, float]:
        """Return the result of `step` with the state as an array: NaN for a state outside the interval."""
        if len(state) == 1 and not self.lo <= state[0] <= self.hi:
            return np.full(1, math.nan), None, math.nan
        following, jacobian, duration = self.step(state, change)
        return self._state(following), jacobian, duration

    def _state(self, values: Any) -> Array:
        return np.asarray(values, dtype=np.float64).reshape(self.scale.shape)

    def motion(self, start: Array) -> "FormulaMotion":
        return FormulaMotion(self, self._state(start))

    def images(self, x: Array, times: int = 1) -> Array:
        images = np.array(x, dtype=np.float64)
        for _ in range(times):
            images = np.array([self.after(images[i : i + 1])[0] for i in range(len(images))])
        return images

    def slopes(self, x: Array) -> Array:
        states = np.asarray(x, dtype=np.float64).reshape(-1, 1)
        return np.array([self.slope_at(state, self.step(state)[1])[0, 0] for state in states])

    def slope_at(self, state: Array, jacobian: Any) -> Array:
        """Return the derivative at a state, (d, d), in units of the scales: from ``jacobian``, or numerically."""
        if jacobian is None:
            return slope_at(self, state, lambda place: self._state(self.step(place)[0]))[1]
        return np.reshape(jacobian, (len(state), len(state))) * self.scale / self.scale[:, None]

    def orbit(self, start: float, number: int) -> Array:
        orbit = np.empty(number)
        state = np.array([start], dtype=np.float64)
        for i in range(number):
            state = self.after(state)
            orbit[i] = state[0]
        return orbit


class FormulaMotion:
    """A motion of a `FormulaMap`; the followed deviation starts along the diagonal of the scales."""

    def __init__(self, f: FormulaMap, start: Array) -> None:
        self.system, self._state, self._time = f, start, 0.0
        self._direction = np.full(len(start), 1.0 / math.sqrt(len(start)))

    def follow(self, number: int, *, tangent: bool = False) -> Passages:
        f, scale = self.system, self.system.scale
        times, states, growth = np.empty(number), np.empty((number, len(scale))), np.full(number, math.nan)
        for i in range(number):
            following, jacobian, duration = f._step_within_interval(self._state)  # noqa: SLF001 - its own system
            if not np.all(np.isfinite(following)):
                return Passages(times[:i], states[:i], growth[:i], NO_ATTRACTOR)
            if tangent:
                turned = f.slope_at(self._state, jacobian) @ self._direction
                size = float(np.linalg.norm(turned))
                growth[i] = math.log(size) if size > 0.0 else -math.inf
                self._direction = turned / size if size > 0.0 else self._direction
            self._state, self._time = following, self._time + duration
            times[i], states[i] = self._time, following
        return Passages(times, states, growth, OUTCOMES[COMPLETED])

    def draw_points(self, number: int) -> Array:
        drawn: Array = self.follow(number).states[:, 0]
        return drawn
