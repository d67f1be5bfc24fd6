"""The methods that make velocity from position, behind one signature; a method's module is imported when it is used.

A method is a module with ``estimate(series, setting) -> Motion``.  To admit a new one, add its line to `METHODS`;
the contract every method is held to (tests/processing/test_methods.py): shapes kept, zero gives zero, a straight
line comes back exactly, nothing crosses a gap, errors are positive, and bad samples were refused before it by index.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from daq.errors import InputError, nearest
from processing.series import Series

Array = NDArray[np.float64]

METHODS = {"sg": "processing.savgol", "fd": "processing.differences"}
AUTO = "sg"  # what "auto" stands for


@dataclass(frozen=True)
class Setting:
    """What was asked of a method: samples in the window and degree of the polynomial; None lets it choose."""

    window: int | None = None
    order: int | None = None


@dataclass(frozen=True, eq=False)
class Motion:
    """What a method gives: x, v, a (m, m/s, m/s^2) with one standard error each, all of shape (n,)."""

    position: Array
    velocity: Array
    acceleration: Array
    position_errors: Array
    velocity_errors: Array
    acceleration_errors: Array
    window: int
    order: int


class Method(Protocol):
    """The one signature."""

    def estimate(self, series: Series, setting: Setting) -> Motion:
        """Rebuild the motion of ``series``; InputError for a setting that the method cannot carry out."""


def resolve(name: str) -> str:
    """Return the method that ``name`` stands for, or raise InputError for an unknown one."""
    if name == "auto":
        return AUTO
    if name not in METHODS:
        raise InputError(f"method is {name!r}", "--method", nearest(name, ("auto", *METHODS)))
    return name


def estimate(name: str, series: Series, setting: Setting) -> Motion:
    """Run the method ``name`` ("auto" included)."""
    module = cast(Method, import_module(METHODS[resolve(name)]))
    return module.estimate(series, setting)
