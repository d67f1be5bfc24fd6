"""A motion model as values by name, nested as its parts are: how the run file and `process inspect` have it.

A part that a record does not have is left out.  `restored` makes the model again, number by number, so that a smoothing
can be repeated without learning.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

Model = TypeVar("Model")


def values(model: Any) -> dict[str, Any]:
    """Return the values of a model: numbers, text, arrays, and such of its parts."""
    found = {name: getattr(model, name) for name in _names(type(model))}
    return {name: values(own) if _names(type(own)) else own for name, own in found.items() if own is not None}


def restored(kind: type[Model], stored: Mapping[str, Any]) -> Model:
    """Return the model of this type that has the values ``stored``."""
    hints = get_type_hints(kind)
    return kind(**{name: _restored(hints[name], stored.get(name)) for name in _names(kind)})


def _names(kind: type) -> tuple[str, ...]:
    """Return the names of the parts of a dataclass or a NamedTuple; none of any other type."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else getattr(kind, "_fields", ())


def _restored(hint: Any, value: Any) -> Any:
    if value is None:
        return None
    if get_origin(hint) in (Union, UnionType):
        hint = next(own for own in get_args(hint) if own is not type(None))
    if isinstance(hint, type) and _names(hint):
        return restored(hint, value)
    if get_origin(hint) is tuple:
        return tuple(int(own) for own in value)
    return hint(value) if hint in (int, float, bool, str) else np.asarray(value, float)
