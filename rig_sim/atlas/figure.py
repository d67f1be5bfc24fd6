"""A figure of the atlas as values: what is drawn, and the table beside it.  Nothing here draws."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from stickslip.compute.arrays import Array

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
class Computed:
    """What a chapter computes of a figure; `rig_sim.atlas.statements` joins it with the words.

    Attributes
    ----------
    panels : tuple of Panel
        Filled into rows of ``columns`` panels.
    numbers : mapping
        Numbers, words and verdicts, by the names that the words use.
    columns : int
    """

    panels: tuple[Panel, ...]
    numbers: Mapping[str, Any] = field(default_factory=dict)
    columns: int = 1


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
