"""A motion model as values by name, in SI units, nested as its parts are: how run file and `process inspect` have it.

A part that a record does not have is left out.  `restored` makes the model again, number by number, so that a smoothing
can be repeated without learning.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from processing.kalman.stick_slip import JUMP_DERIVATIVE
from processing.record.units import Units

Model = TypeVar("Model")

# Powers of length and time of the numbers in a model, by name; all others have none.
DIMENSIONS: dict[str, tuple[Any, Any]] = {
    **dict.fromkeys(("interval", "shortest", "slip"), (0, 1)),
    **dict.fromkeys(("step", "noise", "belt", "relative"), (1, 0)),
    **dict.fromkeys(("speed", "fastest", "belt_speed", "stated"), (1, -1)),
    **dict.fromkeys(("tolerance", "peak", "sharpest"), (1, -2)),
    **dict.fromkeys(("reading", "reading_variance"), (2, 0)),
    **{"jerk": (2, -5), "process_density": (2, -7), "mean_snap": (1, -4), "reset_variance": (2, -2 * JUMP_DERIVATIVE)},
}
SIGNED = ("speed", "belt_speed", "stated", "mean_snap")


def values(model: Any, units: Units) -> dict[str, Any]:
    """Return the values of a model in these units, in SI units: numbers, text, arrays, and such of its parts."""
    found = {name: getattr(model, name) for name in _names(type(model))}
    return {name: _value(name, own, units) for name, own in found.items() if own is not None}


def restored(kind: type[Model], stored: Mapping[str, Any], units: Units) -> Model:
    """Return the model of this type, in these units, that has the values ``stored``."""
    hints = get_type_hints(kind)
    return kind(**{name: _restored(name, hints[name], stored.get(name), units) for name in _names(kind)})


def unit_of(name: str, length: str) -> str:
    """Return the unit of a number by its name, where lengths have the unit ``length``; "" for none, or for several."""
    known = {"length_unit": (1, 0), "time_unit": (0, 1), "start": (0, 1)} | DIMENSIONS
    powers = known.get(name, (0, 0))
    if name not in known or np.ndim(powers[1]):
        return ""
    above = "" if not powers[0] else length if powers[0] == 1 else f"{length}^{powers[0]}"
    if powers[1] >= 0:
        return above or "s" * powers[1]
    return f"{above}/s" if powers[1] == -1 else f"{above}/s^{-powers[1]}"


def _unit(name: str, units: Units) -> Any:
    """Return the unit of a number in SI units."""
    length, time = DIMENSIONS.get(name, (0, 0))
    size = units.length_unit**length * units.time_unit ** np.asarray(time, float)
    return size if name in SIGNED else np.abs(size)


def _value(name: str, own: Any, units: Units) -> Any:
    if _names(type(own)):
        return values(own, units)
    if isinstance(own, float | np.ndarray) and name in DIMENSIONS:
        return own * _unit(name, units) if isinstance(own, np.ndarray) else float(own * _unit(name, units))
    return own


def _names(kind: type) -> tuple[str, ...]:
    """Return the names of the parts of a dataclass that are stored, or of a NamedTuple; none of any other type."""
    if not is_dataclass(kind):
        return getattr(kind, "_fields", ())
    return tuple(field.name for field in fields(kind) if field.metadata.get("stored", True))


def _restored(name: str, hint: Any, value: Any, units: Units) -> Any:
    if value is None:
        return None
    if get_origin(hint) in (Union, UnionType):
        hint = next(own for own in get_args(hint) if own is not type(None))
    if isinstance(hint, type) and _names(hint):
        return restored(hint, value, units)
    if get_origin(hint) is tuple:
        return tuple(int(own) for own in value)
    if hint in (int, bool, str):
        return hint(value)
    own = np.asarray(value, float) / _unit(name, units)
    return float(own) if hint is float else own
