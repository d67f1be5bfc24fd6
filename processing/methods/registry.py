"""The methods that make velocity from position, behind one signature; a method's module is imported when it is used.

A method is a module with ``estimate(series, setting, estimates) -> Motion``.  To admit a new one, add its line to
`METHODS`.
Every method is held to one contract (tests/processing/methods/test_methods.py): shapes kept, zero gives zero, a
straight line comes back exactly, nothing crosses a gap, errors are positive, and bad samples were refused before it
by index.
"""

from importlib import import_module
from typing import Protocol, cast

from daq.errors import InputError, nearest
from processing.record.estimates import RecordEstimates
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting

METHODS = {
    "auto": "processing.methods.auto",
    "segment": "processing.methods.segment",
    "rts": "processing.methods.rts",
    "sg": "processing.methods.savgol",
    "fd": "processing.methods.differences",
}


class Method(Protocol):
    """The one signature."""

    def estimate(self, series: Series, setting: Setting, estimates: RecordEstimates) -> Motion:
        """Rebuild the motion of ``series``; InputError for a setting that the method cannot carry out."""


def check(name: str) -> None:
    """Raise InputError for an unknown method."""
    if name not in METHODS:
        raise InputError(f"method is {name!r}", "--method", nearest(name, tuple(METHODS)))


def resolve(name: str, setting: Setting) -> str:
    """Return the method that runs: a window or an order applies to Savitzky-Golay alone, so "auto" with one is "sg"."""
    return "sg" if name == "auto" and (setting.window is not None or setting.order is not None) else name


def estimate(name: str, series: Series, setting: Setting, estimates: RecordEstimates | None = None) -> Motion:
    """Run the method ``name`` on the record; the result's ``method`` is the one that was chosen by "auto".

    ``estimates`` are those of the record that ``series`` is a block of; by default it is one of its own.
    """
    check(name)
    module = cast(Method, import_module(METHODS[resolve(name, setting)]))
    return module.estimate(series, setting, estimates or RecordEstimates())
