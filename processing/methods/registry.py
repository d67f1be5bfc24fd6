"""The methods that make velocity from position, behind one signature; a method's module is imported when it is used.

A method is a module with ``estimate(series, setting) -> Motion``.  To admit a new one, add its line to `METHODS`.
Every method is held to one contract (tests/processing/methods/test_methods.py): shapes kept, zero gives zero, a
straight line comes back exactly, nothing crosses a gap, errors are positive, and bad samples were refused before it
by index.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Protocol, cast

from daq.compute.arrays import Array
from daq.errors import InputError, nearest
from processing.record.series import Series

METHODS = {
    "auto": "processing.methods.auto",
    "segment": "processing.segmentation.smoother",
    "rts": "processing.kalman.white_jerk",
    "sg": "processing.polynomial.savgol",
    "fd": "processing.methods.differences",
}


@dataclass(frozen=True)
class Setting:
    """What was asked of a method: samples in the window, degree of the polynomial, belt speed (m/s, signed).

    None lets the method choose.
    """

    window: int | None = None
    order: int | None = None
    belt_speed: float | None = None


@dataclass(frozen=True)
class Corner:
    """Where stick and slip meet: time and its standard deviation, s, and what happens there.

    ``what`` is "land" (on the belt), "leave" (it), "start" (from rest), "stop" or "kick".
    """

    time: float
    sd: float
    what: str


@dataclass(frozen=True, eq=False)
class Motion:
    """What a method gives: x, v, a (m, m/s, m/s^2) with one standard error each, all of shape (n,).

    ``corners`` are those the method has fitted; None or none when it knows nothing of corners.
    """

    position: Array
    velocity: Array
    acceleration: Array
    position_errors: Array
    velocity_errors: Array
    acceleration_errors: Array
    window: int
    order: int
    method: str
    corners: tuple[Corner, ...] = ()


class Method(Protocol):
    """The one signature."""

    def estimate(self, series: Series, setting: Setting) -> Motion:
        """Rebuild the motion of ``series``; InputError for a setting that the method cannot carry out."""


def check(name: str) -> None:
    """Raise InputError for an unknown method."""
    if name not in METHODS:
        raise InputError(f"method is {name!r}", "--method", nearest(name, tuple(METHODS)))


def estimate(name: str, series: Series, setting: Setting) -> Motion:
    """Run the method ``name``; which one that was in the end is in the result's ``method``."""
    check(name)
    module = cast(Method, import_module(METHODS[name]))
    return module.estimate(series, setting)
