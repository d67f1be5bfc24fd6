"""The methods that estimate velocity from position, with one signature; a method's module is imported when it is used.

A method is a module with ``learn(method, series, setting, noise) -> MethodModel`` and ``apply(series, model) ->
Motion``.  The model learned from a record, or from stretches that represent it, is applied to all of it, in one block
or in many.  To add a method, add its line to `METHODS`.

Every method must satisfy one contract (tests/processing/methods/test_methods.py): shapes are kept, zero gives zero, a
straight line is reproduced exactly, nothing crosses a gap, and errors are positive; bad samples are rejected before it,
by index.
"""

from dataclasses import dataclass, field
from importlib import import_module
from typing import Protocol, cast

import numpy as np

from processing.kalman import white_jerk
from processing.record.motion import Motion
from processing.record.noise import position_noise
from processing.record.series import Series
from processing.record.setting import Setting
from processing.record.stretches import LEAST, MOST, survey
from processing.stick_slip.plateaus import PlateauRule
from processing.stick_slip.smoother import FirstPass, StickSlip
from stickslip.errors import InputError, nearest


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodModel:
    """The method that runs, and its learned parameters."""

    method: str  # never "auto"
    noise: float  # standard deviation of a position, m
    jerk: white_jerk.Noise  # of the record as a motion of white jerk, also used where readings are missing
    window: int = 0  # of Savitzky-Golay; 0 for the others
    order: int = 0
    rule: PlateauRule | None = None  # for finding sticks in the motion smoothed with ``jerk``; None without sticks
    sticks: StickSlip | None = None  # how the record sticks and slips; None if it does not, or for other methods
    stated: float | None = None  # belt speed that a person stated, m/s, signed
    # results of learning that are reused for the same series; not stored
    first_pass: FirstPass | None = field(default=None, metadata={"stored": False})


METHODS = {
    "auto": "processing.methods.smoothers",
    "segment": "processing.methods.smoothers",
    "rts": "processing.methods.smoothers",
    "sg": "processing.methods.savgol",
    "fd": "processing.methods.differences",
}
SMOOTHERS = ("segment", "rts")  # they handle missing readings


class Method(Protocol):
    """The signature of every method."""

    def learn(self, method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
        """Learn how to smooth ``series``, with position noise ``noise``, m; InputError for an impossible setting."""

    def apply(self, series: Series, model: MethodModel) -> Motion:
        """Estimate the motion of ``series``."""


def check_method(name: str) -> None:
    """Raise InputError for an unknown method."""
    if name not in METHODS:
        raise InputError(f"method is {name!r}", "--method", nearest(name, tuple(METHODS)))


def choose_method(name: str, setting: Setting) -> str:
    """Return the method that runs: a window or an order applies to Savitzky-Golay alone, so "auto" with one is "sg"."""
    return "sg" if name == "auto" and (setting.window is not None or setting.order is not None) else name


def learn(name: str, series: Series, setting: Setting, noise: float | None = None) -> MethodModel:
    """Learn the model of the method ``name`` from a record; its ``method`` is the one that "auto" chose.

    ``noise`` is the standard deviation of a position, m, by default that of the series.
    """
    check_method(name)
    method = choose_method(name, setting)
    if method not in ("auto", *SMOOTHERS):
        series = series.drop_missing()
    return _module(method).learn(method, series, setting, position_noise(series) if noise is None else noise)


def apply(series: Series, model: MethodModel) -> Motion:
    """Estimate the motion of the record that the model was learned from, or of a block of it.

    For methods other than the smoothers, the motion where readings are missing (NaN) is one of white jerk.
    """
    method, present = _module(model.method), ~np.isnan(series.position)
    if model.method in SMOOTHERS or present.all():
        return method.apply(series, model)
    motion = method.apply(series.select(present), model)
    rows = white_jerk.smooth(series, model.jerk).as_rows()
    rows[:, present] = motion.as_rows()
    return motion.with_rows(rows)


def estimate(name: str, series: Series, setting: Setting) -> Motion:
    """Estimate the motion of a record: learn from stretches that represent it, and apply the model to all of it."""
    record = survey(series.position.__getitem__, series.time.size)
    for least in sample_counts(name, setting):
        kept = np.zeros(series.time.size, bool)
        for stretch in record.stretches(least):
            kept[stretch] = True
        model = learn(name, series if kept.all() else series.select(kept), setting)
        if model.sticks is not None or kept.all():
            break
    return apply(series, model)


def sample_counts(name: str, setting: Setting) -> tuple[int, ...]:
    """Return how many samples a method learns from, at least: the first number, then more if those show no sticks."""
    return (LEAST, MOST) if choose_method(name, setting) in ("auto", "segment") else (MOST,)


def _module(method: str) -> Method:
    return cast(Method, import_module(METHODS[method]))
