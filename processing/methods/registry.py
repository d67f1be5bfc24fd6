"""The methods that make velocity from position, behind one signature; a method's module is imported when it is used.

A method is a module with ``learn(method, series, setting, noise) -> MethodModel`` and ``apply(series, model) ->
Motion``.  What is learned from a record, or from stretches that represent it, is applied to all of it, in one block or
in many.  To admit a new one, add its line to `METHODS`.
Every method is held to one contract (tests/processing/methods/test_methods.py): shapes kept, zero gives zero, a
straight line comes back exactly, nothing crosses a gap, errors are positive, and bad samples were refused before it
by index.
"""

from importlib import import_module
from typing import Protocol, cast

import numpy as np

from processing.kalman import white_jerk
from processing.methods.method_model import MethodModel
from processing.record.motion import Motion
from processing.record.noise import position_noise
from processing.record.series import Series
from processing.record.setting import Setting
from processing.record.stretches import LEAST, MOST, survey
from stickslip.errors import InputError, nearest

METHODS = {
    "auto": "processing.methods.smoothers",
    "segment": "processing.methods.smoothers",
    "rts": "processing.methods.smoothers",
    "sg": "processing.methods.savgol",
    "fd": "processing.methods.differences",
}
SMOOTHERS = ("segment", "rts")  # they take missing readings as they are


class Method(Protocol):
    """The one signature."""

    def learn(self, method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
        """Learn how ``series`` is to be smoothed; InputError for a setting that the method cannot carry out.

        ``noise`` is the standard deviation of a position, m.
        """

    def apply(self, series: Series, model: MethodModel) -> Motion:
        """Rebuild the motion of ``series``."""


def check(name: str) -> None:
    """Raise InputError for an unknown method."""
    if name not in METHODS:
        raise InputError(f"method is {name!r}", "--method", nearest(name, tuple(METHODS)))


def resolve(name: str, setting: Setting) -> str:
    """Return the method that runs: a window or an order applies to Savitzky-Golay alone, so "auto" with one is "sg"."""
    return "sg" if name == "auto" and (setting.window is not None or setting.order is not None) else name


def learn(name: str, series: Series, setting: Setting, noise: float | None = None) -> MethodModel:
    """Learn from a record how the method ``name`` smooths it; the model's ``method`` is the one that "auto" chose.

    ``noise`` is the standard deviation of a position, m, by default that of the series.
    """
    check(name)
    method = resolve(name, setting)
    if method not in ("auto", *SMOOTHERS):
        series = series.readings()
    return _module(method).learn(method, series, setting, position_noise(series) if noise is None else noise)


def apply(series: Series, model: MethodModel) -> Motion:
    """Rebuild the motion of the record that the model was learned from, or of a block of it.

    Where readings are missing (NaN) the smoothers know what to do; for the others the motion there is one of white
    jerk.
    """
    method, known = _module(model.method), ~np.isnan(series.position)
    if model.method in SMOOTHERS or known.all():
        return method.apply(series, model)
    found = method.apply(series.taken(known), model)
    rows = white_jerk.smooth(series, model.jerk).rows()
    rows[:, known] = found.rows()
    return found.with_rows(rows)


def estimate(name: str, series: Series, setting: Setting) -> Motion:
    """Rebuild the motion of a record: learn from stretches that represent it, and apply that to all of it."""
    seen = survey(series.position.__getitem__, series.time.size)
    for least in samples_learned(name, setting):
        kept = np.zeros(series.time.size, bool)
        for own in seen.stretches(least):
            kept[own] = True
        model = learn(name, series if kept.all() else series.taken(kept), setting)
        if model.sticks is not None or kept.all():
            break
    return apply(series, model)


def samples_learned(name: str, setting: Setting) -> tuple[int, ...]:
    """Return how many samples a method learns from at least: more where few show no sticks that it accepts."""
    return (LEAST, MOST) if resolve(name, setting) in ("auto", "segment") else (MOST,)


def _module(method: str) -> Method:
    return cast(Method, import_module(METHODS[method]))
