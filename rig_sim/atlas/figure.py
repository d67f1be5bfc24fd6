"""A figure of the atlas as values: what is drawn, and the table beside it.  Nothing here draws.

A statement of the thesis agrees when the number computed lies within ``within`` of it: by default one unit of the last
digit printed, since most of its numbers were read off a plot.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from daq.base.compute.arrays import Array

Style = Literal["line", "thick", "thin", "dashed", "points", "dots", "filled", "open", "cross"]


@dataclass(frozen=True)
class Trace:
    """Points (x, y), each (n,), and how to draw them.

    ``style``: 'line', 'thick', 'thin', 'dashed'; 'points' and 'dots' (of a diagram with many points: the smallest);
    'filled' and 'open' circles, 'cross' for single places.  ``colour``: place in the cycle of colours, None for grey,
    -1 for black.  ``label``: for the legend; empty for none.  ``z``: the third coordinate, in a panel that has one.
    """

    x: Array
    y: Array
    label: str = ""
    style: Style = "line"
    colour: int | None = 0
    z: Array | None = None


@dataclass(frozen=True)
class Label:
    """Words at a place (x, y) of a panel."""

    x: float
    y: float
    words: str


@dataclass(frozen=True)
class Panel:
    """Axes with their curves.

    ``x``, ``y`` and, in space, ``z`` name what the axes show, with the unit; ranges None: as the data demand.
    """

    x: str
    y: str
    curves: tuple[Trace, ...]
    title: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    equal: bool = False
    texts: tuple[Label, ...] = ()
    z: str = ""


@dataclass(frozen=True)
class StatementCheck:
    """One row of a table: what the thesis says of a quantity, what is computed, and, where they differ, why.

    ``value`` is the number computed, None where the statement is no number.
    """

    quantity: str
    thesis: str
    computed: str
    agrees: bool
    why: str
    value: float | None = None


@dataclass(frozen=True)
class Drawing:
    """What `rig-sim atlas` makes of a figure.

    Attributes
    ----------
    sentence : str
        What it shows.
    panels : tuple of Panel
        Filled into rows of ``columns`` panels.
    table : tuple of StatementCheck
        Empty where the thesis states nothing about the figure that can be computed.
    choices : str
        What the thesis does not state and was chosen here; empty for nothing.
    """

    sentence: str
    panels: tuple[Panel, ...]
    table: tuple[StatementCheck, ...] = ()
    columns: int = 1
    choices: str = ""


@dataclass(frozen=True)
class Entry:
    """A figure of the thesis: its number, its subject, and the function that computes it anew."""

    number: str
    title: str
    draw: Callable[[], Drawing]


def compare(
    quantity: str, printed: str, value: float, why: str = "", *, within: float | None = None, of: float | None = None
) -> StatementCheck:
    """Return the comparison of a printed number with a computed one.

    Parameters
    ----------
    quantity : str
        What the number is.
    printed : str
        As the thesis prints it; ``of`` gives its value where it is no plain number ('2 pi').
    value : float
        Computed.
    why : str
        Why they differ; shown only where they do.
    within : float, optional
        How far apart they may lie; default one unit of the last digit printed.
    """
    number = float(printed) if of is None else of
    unit = 10.0 ** -len(printed.partition(".")[2]) if of is None else 0.0
    allowed = (unit if within is None else within) * (1.0 + 1e-9)
    agrees = math.isfinite(value) and abs(value - number) <= allowed
    return StatementCheck(quantity, printed, f"{value:.8g}", agrees, "" if agrees else why, value)


def state(quantity: str, thesis: str, computed: str, agrees: bool, why: str = "") -> StatementCheck:
    """Return the comparison of a statement in words; ``agrees`` is decided by what was computed."""
    return StatementCheck(quantity, thesis, computed, agrees, "" if agrees else why)
