"""A motion model as nested values by name, in SI units, for the run file and `process inspect`.

Parts that a record does not have are left out.  `restore` returns the same model, number by number, so that a smoothing
can be repeated without learning.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from processing.kalman.stick_slip import JUMP_DERIVATIVE
from processing.record.series import Units

Model = TypeVar("Model")

# Powers of length and time of the numbers in a model, by name; all others are dimensionless.
DIMENSIONS: dict[str, tuple[Any, Any]] = {
    **dict.fromkeys(("interval", "shortest", "slip"), (0, 1)),
    **dict.fromkeys(("step", "noise", "belt", "relative"), (1, 0)),
    **dict.fromkeys(("speed", "fastest", "belt_speed", "stated"), (1, -1)),
    **dict.fromkeys(("tolerance", "peak", "sharpest"), (1, -2)),
    **dict.fromkeys(("reading", "reading_variance"), (2, 0)),
    **{"jerk": (2, -5), "process_density": (2, -7), "mean_snap": (1, -4), "reset_variance": (2, -2 * JUMP_DERIVATIVE)},
}
SIGNED = ("speed", "belt_speed", "stated", "mean_snap")


def values_in_si(model: Any, units: Units) -> dict[str, Any]:
    """Return the values of a model, whose numbers are in ``units``, in SI units, with nested dicts for its parts."""
    parts = {name: getattr(model, name) for name in _stored_names(type(model))}
    return {name: _convert_value(name, value, units) for name, value in parts.items() if value is not None}


def restore(kind: type[Model], stored: Mapping[str, Any], units: Units) -> Model:
    """Return the model of this type, with numbers in ``units``, from the values ``stored`` in SI units."""
    hints = get_type_hints(kind)
    return kind(**{name: _restore_value(name, hints[name], stored.get(name), units) for name in _stored_names(kind)})


def unit_of(name: str, length: str) -> str:
    """Return the unit of a number by its name, for lengths in the unit ``length``; "" for none or several."""
    dimensions = {"length_unit": (1, 0), "time_unit": (0, 1), "start": (0, 1)} | DIMENSIONS
    powers = dimensions.get(name, (0, 0))
    if name not in dimensions or np.ndim(powers[1]):
        return ""
    length_text = "" if not powers[0] else length if powers[0] == 1 else f"{length}^{powers[0]}"
    if powers[1] >= 0:
        return length_text or "s" * powers[1]
    return f"{length_text}/s" if powers[1] == -1 else f"{length_text}/s^{-powers[1]}"


def _si_unit(name: str, units: Units) -> Any:
    length, time = DIMENSIONS.get(name, (0, 0))
    size = units.length_unit**length * units.time_unit ** np.asarray(time, float)
    return size if name in SIGNED else np.abs(size)


def _convert_value(name: str, value: Any, units: Units) -> Any:
    if _stored_names(type(value)):
        return values_in_si(value, units)
    if isinstance(value, float | np.ndarray) and name in DIMENSIONS:
        return value * _si_unit(name, units) if isinstance(value, np.ndarray) else float(value * _si_unit(name, units))
    return value


def _stored_names(kind: type) -> tuple[str, ...]:
    """Return the names of the stored fields of a dataclass, or of a NamedTuple; empty for any other type."""
    if not is_dataclass(kind):
        return getattr(kind, "_fields", ())
    return tuple(field.name for field in fields(kind) if field.metadata.get("stored", True))


def _restore_value(name: str, hint: Any, value: Any, units: Units) -> Any:
    if value is None:
        return None
    if get_origin(hint) in (Union, UnionType):
        hint = next(part for part in get_args(hint) if part is not type(None))
    if isinstance(hint, type) and _stored_names(hint):
        return restore(hint, value, units)
    if get_origin(hint) is tuple:
        return tuple(int(part) for part in value)
    if hint in (int, bool, str):
        return hint(value)
    part = np.asarray(value, float) / _si_unit(name, units)
    return float(part) if hint is float else part
