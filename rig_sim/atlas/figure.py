"""A figure of the atlas as values: what is drawn, and the table beside it.  Nothing here draws."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from stickslip.compute.arrays import Array

Style = Literal["line", "thick", "thin", "dashed", "points", "dots", "filled", "open", "cross"]


@dataclass(frozen=True)
class Trace:
    """Points (x, y), each (n,), and their style.

    ``style``: 'line', 'thick', 'thin', 'dashed'; 'points' and 'dots' (of a diagram with many points: the smallest);
    'filled' and 'open' circles, 'cross' for single places.  ``colour``: index in the cycle of colours, None for grey,
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
    """Words at a position (x, y) of a panel."""

    x: float
    y: float
    words: str


@dataclass(frozen=True)
class Panel:
    """Axes with their curves.

    ``x``, ``y`` and, in space, ``z`` are the quantities on the axes, with the unit; a range of None is that of the
    data.
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
    """One row of a table: a statement of the thesis, its computed counterpart, and, where they differ, the reason.

    ``value`` is the computed number, None where the statement is not a number.
    """

    quantity: str
    thesis: str
    computed: str
    agrees: bool
    why: str
    value: float | None = None


@dataclass(frozen=True)
class Computed:
    """The computed part of a figure; `rig_sim.atlas.statements` joins it with the words."""

    panels: tuple[Panel, ...]  # filled into rows of ``columns`` panels
    # Numbers, words and verdicts, by the names in the words
    numbers: Mapping[str, Any] = field(default_factory=dict)
    columns: int = 1


@dataclass(frozen=True)
class Drawing:
    """A figure for `rig-sim atlas`."""

    number: str  # in the thesis
    title: str  # its subject
    sentence: str  # its description
    panels: tuple[Panel, ...]  # filled into rows of ``columns`` panels
    table: tuple[StatementCheck, ...]  # empty where the thesis has no computable statement about the figure
    columns: int
    choices: str  # parameters that the thesis does not state
    file: Path = Path()  # its picture, where it has been drawn
