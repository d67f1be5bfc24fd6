"""What the functions are given: a scene, numbers with or without a unit, and the values of a parameter."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig_sim.flow.flow import LARGEST, SMALLEST
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


def load_scene(source: SceneLike) -> Scene:
    """Return a scene by its name, its file, or itself."""
    return source if isinstance(source, Scene) else read(source)


def parse_number(value: float | str, dimension: str, flag: str) -> float:
    """Return a number, SI or a scene's own unit, or a text with a unit of this dimension: 20, '20 s', '1.5 min'."""
    if isinstance(value, str):
        from stickslip import units

        return units.quantity(value, dimension, flag)
    return parse_plain_number(value, flag, "use a number, or text with a unit")


def parse_plain_number(value: float, flag: str, do: str = "use a number") -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"is {value!r:.60}", flag, do) from None


def parse_whole(value: int, flag: str, least: float = -math.inf, most: float = math.inf, of: str = "") -> int:
    """Return a whole number from ``least`` to ``most``; ``of`` names what is counted in the message."""
    number = parse_plain_number(value, flag, "use a whole number")
    if not number.is_integer():
        raise InputError(f"is {value!r}, not a whole number", flag, "use a whole number")
    if not least <= number <= most:
        raise InputError(f"is {value}", flag, f"use {least} " + ("or more" if math.isinf(most) else f"to {most}{of}"))
    return int(number)


def check_size(name: str, value: float, *, positive: bool = False, negative: bool = False) -> None:
    if not math.isfinite(value) or abs(value) > LARGEST or 0.0 < abs(value) < SMALLEST:
        raise InputError(f"is {value:g}", f"--{name}", f"use 0 or a size from {SMALLEST:g} to {LARGEST:g}")
    if (positive and value <= 0.0) or (not negative and value < 0.0):
        raise InputError(f"is {value:g}", f"--{name}", "use a number above 0" if positive else "use 0 or more")


@dataclass(frozen=True)
class ParameterRange:
    """Values of the scene's key ``key``: ``number`` of them, evenly from ``start`` to ``stop``, or an uneven list."""

    key: str
    start: float  # first value
    stop: float  # last value
    number: int
    uneven: tuple[float, ...] = ()  # the values, where they are not even

    def values(self) -> "Array":
        import numpy as np

        return np.array(self.uneven) if self.uneven else np.linspace(self.start, self.stop, self.number)


def parse_range(over: "str | tuple[str, Sequence[float]]", *, of_scene: bool = True) -> ParameterRange:
    """Return the range of ``over``: 'damper.c=0.3:0.6:31', or a key and its values.

    The key is one of a scene, ``section.key``, or, not ``of_scene``, a parameter of a custom system.
    """
    if not isinstance(over, str):
        return parse_listed_range(over)
    key, equals, span = over.partition("=")
    parts = span.split(":")
    if not equals or (of_scene and "." not in key) or not key.strip() or len(parts) not in (2, 3):
        raise InputError(f"{over!r} is not a range of a parameter", "--over", FORM, python=IN_PYTHON)
    try:
        start, stop = float(parts[0]), float(parts[1])
        count = int(parts[2]) if len(parts) == 3 else NUMBER
    except ValueError:
        problem = f"{over!r} contains something that is not a number"
        raise InputError(problem, "--over", FORM, python=IN_PYTHON) from None
    if not (math.isfinite(start) and math.isfinite(stop)) or start == stop:
        raise InputError(f"{over!r} is not an interval", "--over", "use two different finite numbers")
    if not 2 <= count <= MOST_VALUES:
        raise InputError(f"{count} values", "--over", f"use 2 to {MOST_VALUES}")
    return ParameterRange(key.strip(), start, stop, count)


def parse_listed_range(over: Any) -> ParameterRange:
    try:
        key, numbers = over
        values = tuple(float(value) for value in numbers)
    except (TypeError, ValueError):
        raise InputError(f"{over!r:.60} is not a range of a parameter", "--over", FORM, python=IN_PYTHON) from None
    if not 2 <= len(values) <= MOST_VALUES or not all(math.isfinite(value) for value in values):
        raise InputError(f"{len(values)} values", "--over", f"use 2 to {MOST_VALUES} values, all of them finite")
    return ParameterRange(str(key), values[0], values[-1], len(values), values)
