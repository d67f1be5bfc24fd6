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
from rig_sim.friction.spline import NO_TABLE, Table, table_of
from stickslip.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stickslip.compute.arrays import Array

# Of the largest value.  Event times of laws 3 and 5 written as formulas are then those of the laws to 5e-9 of the time;
# they err in proportion.  At half of it there are a fifth more pieces to step over.
TOLERANCE = 1e-8
MOST_PIECES = 2000  # published forms take 100 to 250: half refuses none of them, twice takes 0.1 s to build
WIDEST = 64.0  # times the speed that energy allows: a drive in resonance goes beyond; a doubling adds some ten pieces
FIRST_PIECES = 32  # up to that speed, with nine places each: what is narrower than a three-hundredth may be overlooked
SHORTEST = 1e-12  # share of the range: a shorter piece leaves four digits to the speeds within it
SLOWEST = 1e-60  # m/s: the third power of a piece's width and its inverse are then numbers
PLACES = (0.0625, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 0.9375)  # of a piece, where its error is seen


@dataclass(frozen=True)
class FormulaCurve:
    """What a flow takes of a formula: its friction at rest ``Fs`` (N), and its shape.

    ``curve`` is MEASURED, with ``pieces`` and ``table``; or LINEAR, with ``G_slip`` (N s/m); or CONSTANT.
    """

    Fs: float
    curve: int
    G_slip: float = 0.0
    pieces: int = 0
    table: Table = NO_TABLE


class _Asked(NamedTuple):
    """A formula with the values of its parameters."""

    formula: Formula
    parameters: "Mapping[str, float]"

    def values(self, s: "Array", needed: float) -> "Array":
        """Return the friction at slip speeds (m/s); where it is negative, say so with the speed that is ``needed``."""
        import numpy as np

        found = self.formula.value(s, self.parameters)
        wrong = np.flatnonzero(found < 0.0)
        if wrong.size:
            at = self.formula.place(float(s[wrong[0]]), self.parameters)
            what = f"friction is negative, {found[wrong[0]]:.6g}, {at}; the mass may reach s = {needed:.6g} m/s"
            raise InputError(what, "formula", "choose other values, or a form that stays above 0")
        return found


class _Pieces(NamedTuple):
    """Cubics: where they begin and end (m/s), and the powers 0 to 3 of the distance to the begin, (n, 4)."""

    begin: "Array"
    end: "Array"
    powers: "Array"


@lru_cache(maxsize=64)
def formula_curve(formula: Formula, values: tuple[float, ...], fastest: float) -> FormulaCurve:
    """Return the curve of a formula for slip speeds from 0 to at least ``fastest``.

    Parameters
    ----------
    formula : Formula
    values : tuple of float
        Of its parameters, in their order.
    fastest : float
        Slip speed that the motion may reach, m/s, above 0.

    Raises
    ------
    InputError
        Up to ``fastest`` the formula, or its slope, is not finite; it is negative; or it changes so abruptly that
        `MOST_PIECES` cubics do not follow it.  At rest it is not above 0.  Or ``fastest`` is out of range.
    """
    import numpy as np

    asked = _Asked(formula, dict(zip(formula.parameters, values, strict=True)))
    level = float(formula.value(0.0, asked.parameters))
    if not level > 0.0:
        at = formula.place(0.0, asked.parameters)
        what = f"friction at rest is {level:.6g}, {at}"
        raise InputError(what, "formula", "choose a form that is above 0 at s = 0: it is what holds the mass in stick")
    if not SLOWEST <= fastest <= 1.0 / SLOWEST:
        what = f"the mass may reach s = {fastest:.6g} m/s, beyond {SLOWEST:g} to {1.0 / SLOWEST:g}"
        raise InputError(what, "formula", "choose other units")
    # a power of 2: the pieces stay where they are while a parameter varies
    widest = 2.0 ** math.ceil(math.log2(fastest)) * WIDEST
    with np.errstate(all="ignore"):  # cubics of huge numbers may overflow: they then follow nothing, and are halved
        while widest > fastest:
            try:
                return _followed(asked, level, fastest, widest)
            except InputError:
                widest *= 0.5
        return _followed(asked, level, fastest, fastest)


def _followed(asked: _Asked, level: float, fastest: float, end: float) -> FormulaCurve:
    """Return the curve on slip speeds up to ``end`` (m/s), of which the motion needs those up to ``fastest``."""
    import numpy as np

    doublings = max(0, math.ceil(math.log2(end / fastest)))
    needed = end / 2.0**doublings
    ends = np.concatenate((np.linspace(0.0, needed, FIRST_PIECES + 1), needed * 2.0 ** np.arange(1, doublings + 1)))
    scale = float(np.max(asked.formula.value(ends[ends <= fastest], asked.parameters)))
    line = _line(asked, ends, scale)
    if line is not None:
        asked.values(np.array([0.0, fastest]), fastest)
        return FormulaCurve(level, CONSTANT if line == 0.0 else LINEAR, -line)
    found = _refined(asked, ends, scale, fastest)
    rows = [(begin, *powers) for begin, powers in zip(found.begin.tolist(), found.powers.tolist(), strict=True)]
    pieces, table = table_of([(s, *(power / level for power in powers)) for s, *powers in rows], end, ends=True)
    return FormulaCurve(level, MEASURED, 0.0, pieces, table)


def _line(asked: _Asked, ends: "Array", scale: float) -> float | None:
    """Return the slope (N s/m) of a formula that is a straight line over all pieces, to the tolerance; else None."""
    import numpy as np

    places = np.concatenate((ends[:-1, None] + np.diff(ends)[:, None] * np.array(PLACES), ends[1:, None]), axis=1)
    found = asked.formula.value(np.append(0.0, places.ravel()), asked.parameters)
    slope = float(asked.formula.slope(0.0, asked.parameters))
    away = np.abs(found[1:] - (found[0] + slope * places.ravel()))
    return slope if bool(np.all(away <= TOLERANCE * scale)) else None


def _refined(asked: _Asked, ends: "Array", scale: float, fastest: float) -> _Pieces:
    """Return cubics between the ends (m/s), each halved until it follows the formula; ``scale`` is its largest value.

    Beyond ``fastest`` the error may also be `TOLERANCE` of the value there.
    """
    import numpy as np

    left, right = ends[:-1], ends[1:]
    done: list[_Pieces] = []
    number = 0
    while left.size:
        piece = _hermite(asked, left, right, fastest)
        z = (right - left)[:, None] * np.array(PLACES)
        places = left[:, None] + z
        friction = asked.values(places.ravel(), fastest).reshape(places.shape)
        c0, c1, c2, c3 = piece.powers.T[:, :, None]
        away = np.max(np.abs(c0 + z * (c1 + z * (c2 + z * c3)) - friction), axis=1)
        beyond = np.where(left >= fastest, np.max(friction, axis=1), 0.0)
        good = away <= TOLERANCE * np.maximum(scale, beyond)
        done.append(_Pieces(left[good], right[good], piece.powers[good]))
        number += int(np.count_nonzero(good))
        left, right = left[~good], right[~good]
        middle = 0.5 * (left + right)
        if left.size and (np.min(right - left) < SHORTEST * ends[-1] or number + 2 * left.size > MOST_PIECES):
            hardest = middle[np.argmin(right - left)]
            at = asked.formula.place(float(hardest), asked.parameters)
            what = f"changes too abruptly to be followed to {TOLERANCE:g} by {MOST_PIECES} cubics, {at}"
            raise InputError(what, "formula", "choose values, or a form, that change over a wider range of speeds")
        left, right = np.concatenate((left, middle)), np.concatenate((middle, right))
    order = np.argsort(np.concatenate([piece.begin for piece in done]))
    return _Pieces(*(np.concatenate(parts)[order] for parts in zip(*done, strict=True)))


def _hermite(asked: _Asked, left: "Array", right: "Array", fastest: float) -> _Pieces:
    """Return the cubics that have the formula's value and slope at both ends, (n,) each."""
    import numpy as np

    places = np.concatenate((left, right))
    (F0, F1), (slope0, slope1) = (
        column.reshape(2, -1)
        for column in (asked.values(places, fastest), asked.formula.slope(places, asked.parameters))
    )
    width = right - left
    mean = (F1 - F0) / width
    square = (3.0 * mean - 2.0 * slope0 - slope1) / width
    cube = (slope0 + slope1 - 2.0 * mean) / (width * width)
    return _Pieces(left, right, np.stack((F0, slope0, square, cube), axis=1))
