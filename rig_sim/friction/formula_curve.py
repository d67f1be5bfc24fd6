"""A formula as the curve that the kernels play: cubics through it, as close together as its shape needs.

Each cubic has the formula's value and slope at both of its ends, so that curve and slope are continuous.  It is halved
until it errs by less than `TOLERANCE` of the formula's largest value, seen at nine places of each.  A formula that is
a straight line to that tolerance becomes the linear or the constant curve, which are played in closed form.

The table is that of `rig_sim.friction.spline`, with an end: beyond it the formula is not extrapolated, and a motion
that gets there ends with the outcome `end of the curve`.  The end lies beyond what the motion needs, up to `WIDEST`
times as far, as long as the formula is finite and not negative there.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from rig_sim.friction.curve import CONSTANT, LINEAR, MEASURED
from rig_sim.friction.formula import Formula
from rig_sim.friction.spline import NO_TABLE, Table, make_table
from stickslip.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stickslip.compute.arrays import Array

# Of the largest value.  Event times of laws 3 and 5 written as formulas then agree with those of the laws to 5e-9.
TOLERANCE = 1e-8
MOST_PIECES = 2000  # published forms take 100 to 250
WIDEST = 64.0  # times the speed that energy allows: a drive in resonance exceeds it
FIRST_PIECES = 32  # up to that speed, with nine places each: features narrower than 1/300 may be missed
SHORTEST = 1e-12  # share of the range: speeds within a shorter piece have four digits
SLOWEST = 1e-60  # m/s: the third power of a piece's width and its inverse are then numbers
PLACES = (0.0625, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 0.9375)  # of a piece, at which its error is evaluated


@dataclass(frozen=True)
class FormulaCurve:
    """The curve of a formula for a flow: its friction at rest ``Fs`` (N), and its shape.

    ``curve`` is MEASURED, with ``pieces`` and ``table``; or LINEAR, with ``G_slip`` (N s/m); or CONSTANT.
    """

    Fs: float
    curve: int
    G_slip: float = 0.0
    pieces: int = 0
    table: Table = NO_TABLE


class _ParametrisedFormula(NamedTuple):
    formula: Formula
    parameters: "Mapping[str, float]"

    def values(self, s: "Array", needed: float) -> "Array":
        """Return the friction at slip speeds (m/s); raises InputError, naming the speed ``needed``, where negative."""
        import numpy as np

        friction = self.formula.value(s, self.parameters)
        wrong = np.flatnonzero(friction < 0.0)
        if wrong.size:
            position = self.formula.place(float(s[wrong[0]]), self.parameters)
            problem = (
                f"friction is negative, {friction[wrong[0]]:.6g}, {position}; the mass may reach s = {needed:.6g} m/s"
            )
            raise InputError(problem, "formula", "choose other values, or a formula that stays above 0")
        return friction


class _Pieces(NamedTuple):
    """Cubics: their start and end (m/s), and the powers 0 to 3 of the distance from the start, (n, 4)."""

    begin: "Array"
    end: "Array"
    powers: "Array"


@lru_cache(maxsize=64)
def formula_curve(formula: Formula, values: tuple[float, ...], fastest: float) -> FormulaCurve:
    """Return the curve of a formula, with the parameters' values in their order, up to at least ``fastest`` (m/s).

    Raises InputError where, up to ``fastest``, the formula or its slope is not finite; it is negative; or it changes so
    abruptly that `MOST_PIECES` cubics do not follow it.  Or at rest it is not above 0, or ``fastest`` is out of range.
    """
    import numpy as np

    curve = _ParametrisedFormula(formula, dict(zip(formula.parameters, values, strict=True)))
    level = float(formula.value(0.0, curve.parameters))
    if not level > 0.0:
        position = formula.place(0.0, curve.parameters)
        problem = f"friction at rest is {level:.6g}, {position}"
        raise InputError(
            problem,
            "formula",
            "choose a formula that is above 0 at s = 0, because this friction holds the mass in a stick",
        )
    if not SLOWEST <= fastest <= 1.0 / SLOWEST:
        problem = f"the mass may reach s = {fastest:.6g} m/s, which is outside {SLOWEST:g} to {1.0 / SLOWEST:g}"
        raise InputError(problem, "formula", "choose other units")
    # a power of 2: the pieces stay where they are while a parameter varies
    widest = 2.0 ** math.ceil(math.log2(fastest)) * WIDEST
    with np.errstate(all="ignore"):  # cubics of huge numbers may overflow: they then follow nothing, and are halved
        while widest > fastest:
            try:
                return fit_curve(curve, level, fastest, widest)
            except InputError:
                widest *= 0.5
        return fit_curve(curve, level, fastest, fastest)


def fit_curve(curve: _ParametrisedFormula, level: float, fastest: float, end: float) -> FormulaCurve:
    """Return the curve on slip speeds up to ``end`` (m/s); the motion needs those up to ``fastest``."""
    import numpy as np

    doublings = max(0, math.ceil(math.log2(end / fastest)))
    needed = end / 2.0**doublings
    ends = np.concatenate((np.linspace(0.0, needed, FIRST_PIECES + 1), needed * 2.0 ** np.arange(1, doublings + 1)))
    scale = float(np.max(curve.formula.value(ends[ends <= fastest], curve.parameters)))
    line = find_line(curve, ends, scale)
    if line is not None:
        curve.values(np.array([0.0, fastest]), fastest)
        return FormulaCurve(level, CONSTANT if line == 0.0 else LINEAR, -line)
    cubics = refine_cubics(curve, ends, scale, fastest)
    rows = [(begin, *powers) for begin, powers in zip(cubics.begin.tolist(), cubics.powers.tolist(), strict=True)]
    pieces, table = make_table([(s, *(power / level for power in powers)) for s, *powers in rows], end, ends=True)
    return FormulaCurve(level, MEASURED, 0.0, pieces, table)


def find_line(curve: _ParametrisedFormula, ends: "Array", scale: float) -> float | None:
    """Return the slope (N s/m) of a formula that is a straight line over all pieces, to the tolerance; else None."""
    import numpy as np

    speeds = np.concatenate((ends[:-1, None] + np.diff(ends)[:, None] * np.array(PLACES), ends[1:, None]), axis=1)
    friction = curve.formula.value(np.append(0.0, speeds.ravel()), curve.parameters)
    slope = float(curve.formula.slope(0.0, curve.parameters))
    errors = np.abs(friction[1:] - (friction[0] + slope * speeds.ravel()))
    return slope if bool(np.all(errors <= TOLERANCE * scale)) else None


def refine_cubics(curve: _ParametrisedFormula, ends: "Array", scale: float, fastest: float) -> _Pieces:
    """Return cubics between the ends (m/s), each halved until it follows the formula; ``scale`` is its largest value.

    Beyond ``fastest`` the error may also be `TOLERANCE` of the value there.
    """
    import numpy as np

    lower, upper = ends[:-1], ends[1:]
    accepted: list[_Pieces] = []
    number = 0
    while lower.size:
        piece = interpolate_hermite(curve, lower, upper, fastest)
        z = (upper - lower)[:, None] * np.array(PLACES)
        speeds = lower[:, None] + z
        friction = curve.values(speeds.ravel(), fastest).reshape(speeds.shape)
        c0, c1, c2, c3 = piece.powers.T[:, :, None]
        errors = np.max(np.abs(c0 + z * (c1 + z * (c2 + z * c3)) - friction), axis=1)
        beyond = np.where(lower >= fastest, np.max(friction, axis=1), 0.0)
        is_accurate = errors <= TOLERANCE * np.maximum(scale, beyond)
        accepted.append(_Pieces(lower[is_accurate], upper[is_accurate], piece.powers[is_accurate]))
        number += int(np.count_nonzero(is_accurate))
        lower, upper = lower[~is_accurate], upper[~is_accurate]
        middle = 0.5 * (lower + upper)
        if lower.size and (np.min(upper - lower) < SHORTEST * ends[-1] or number + 2 * lower.size > MOST_PIECES):
            hardest = middle[np.argmin(upper - lower)]
            position = curve.formula.place(float(hardest), curve.parameters)
            problem = f"changes too abruptly to be approximated to {TOLERANCE:g} by {MOST_PIECES} cubics, {position}"
            raise InputError(problem, "formula", "choose values or a formula with slower changes")
        lower, upper = np.concatenate((lower, middle)), np.concatenate((middle, upper))
    order = np.argsort(np.concatenate([piece.begin for piece in accepted]))
    return _Pieces(*(np.concatenate(parts)[order] for parts in zip(*accepted, strict=True)))


def interpolate_hermite(curve: _ParametrisedFormula, lower: "Array", upper: "Array", fastest: float) -> _Pieces:
    """Return the cubics that have the formula's value and slope at both ends, (n,) each."""
    import numpy as np

    speeds = np.concatenate((lower, upper))
    (F0, F1), (slope0, slope1) = (
        column.reshape(2, -1)
        for column in (curve.values(speeds, fastest), curve.formula.slope(speeds, curve.parameters))
    )
    width = upper - lower
    mean = (F1 - F0) / width
    square = (3.0 * mean - 2.0 * slope0 - slope1) / width
    cube = (slope0 + slope1 - 2.0 * mean) / (width * width)
    return _Pieces(lower, upper, np.stack((F0, slope0, square, cube), axis=1))
