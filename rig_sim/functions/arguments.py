"""What the functions are given: a scene, numbers with or without a unit, and the values of a parameter."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene as read
from stickslip.errors import InputError

if TYPE_CHECKING:
    from stickslip.compute.arrays import Array

SceneLike = str | Path | Scene

FORM = "write section.key=START:STOP, or section.key=START:STOP:N, as in damper.c=0.3:0.6:31"
IN_PYTHON = "write over='damper.c=0.3:0.6:31', or over=('damper.c', values)"
NUMBER = 41  # number of values where none is given
MOST_VALUES = 1_000_000


def scene_of(given: SceneLike) -> Scene:
    """Return a scene by its name, its file, or itself."""
    return given if isinstance(given, Scene) else read(given)


def number(given: float | str, dimension: str, flag: str) -> float:
    """Return a number, SI or a scene's own unit, or a text with a unit of this dimension: 20, '20 s', '1.5 min'."""
    if isinstance(given, str):
        from stickslip import units

        return units.quantity(given, dimension, flag)
    return plain_number(given, flag, "give a number, or a text with a unit")


def plain_number(given: float, flag: str, do: str = "give a number") -> float:
    """Return a number without a unit.

    Raises
    ------
    InputError
        It is none.
    """
    try:
        return float(given)
    except (TypeError, ValueError):
        raise InputError(f"is {given!r:.60}", flag, do) from None


def whole(given: int, flag: str) -> int:
    """Return a whole number.

    Raises
    ------
    InputError
        It is none.
    """
    found = plain_number(given, flag, "give a whole number")
    if not found.is_integer():
        raise InputError(f"is {given!r}, not a whole number", flag, "give a whole number")
    return int(found)


@dataclass(frozen=True)
class ParameterRange:
    """Values of the scene's key ``key``: ``number`` of them, evenly from ``start`` to ``stop``, or those given.

    Attributes
    ----------
    key : str
    start, stop : float
        The first and the last value.
    number : int
    given : tuple of float
        The values, where they are not even; else empty.
    """

    key: str
    start: float
    stop: float
    number: int
    given: tuple[float, ...] = ()

    def values(self) -> "Array":
        """Return the values, shape (number,)."""
        import numpy as np

        return np.array(self.given) if self.given else np.linspace(self.start, self.stop, self.number)


def parameter_range(over: "str | tuple[str, Sequence[float]]", *, of_scene: bool = True) -> ParameterRange:
    """Return the range that ``over`` describes: 'damper.c=0.3:0.6:31', or a key and its values.

    Parameters
    ----------
    over : str or (str, sequence of float)
    of_scene : bool
        Whether the key is one of a scene, ``section.key``, or a parameter of a system of one's own.

    Raises
    ------
    InputError
        Another form, numbers that are not finite, equal ends, or fewer than 2 values.
    """
    if not isinstance(over, str):
        return _given(over)
    key, equals, span = over.partition("=")
    parts = span.split(":")
    if not equals or (of_scene and "." not in key) or not key.strip() or len(parts) not in (2, 3):
        raise InputError(f"{over!r} is no range of a parameter", "--over", FORM, python=IN_PYTHON)
    try:
        start, stop = float(parts[0]), float(parts[1])
        count = int(parts[2]) if len(parts) == 3 else NUMBER
    except ValueError:
        what = f"{over!r} holds something that is no number"
        raise InputError(what, "--over", FORM, python=IN_PYTHON) from None
    if not (math.isfinite(start) and math.isfinite(stop)) or start == stop:
        raise InputError(f"{over!r} is no interval", "--over", "give two different finite numbers")
    if not 2 <= count <= MOST_VALUES:
        raise InputError(f"{count} values", "--over", f"give 2 to {MOST_VALUES}")
    return ParameterRange(key.strip(), start, stop, count)


def _given(over: Any) -> ParameterRange:
    try:
        key, listed = over
        values = tuple(float(value) for value in listed)
    except (TypeError, ValueError):
        raise InputError(f"{over!r:.60} is no range of a parameter", "--over", FORM, python=IN_PYTHON) from None
    if not 2 <= len(values) <= MOST_VALUES or not all(math.isfinite(value) for value in values):
        raise InputError(f"{len(values)} values", "--over", f"give 2 to {MOST_VALUES}, all of them finite numbers")
    return ParameterRange(str(key), values[0], values[-1], len(values), values)
