"""What the functions return: a frozen dataclass with a table, a picture and the words that a command prints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

from stickslip.errors import in_python

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNIT = "(the scene's unit)"  # after the name of an axis
PALE, STABLE, UNSTABLE = "0.5", "#0072B2", "#D55E00"  # colours of pictures
COLOURS = (STABLE, UNSTABLE, "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito's
LINES = 6  # of a result in its short text
ROWS = 12  # of a result's table in a notebook


@dataclass(frozen=True, repr=False)
class Result:
    """A result; ``print(result)`` prints what the command prints.

    A subclass is a frozen dataclass with ``repr=False``.  Fields with ``repr=False`` are only for pictures.
    """

    name: str = field(default="", repr=False, compare=False, kw_only=True)  # of the scene or system

    UNITS: ClassVar[Mapping[str, str]] = {}  # of columns, in a scene in SI; else the scene's own
    SIZE: ClassVar[tuple[float, float]] = (8.6, 5.0)  # of a picture, inches

    def as_json(self) -> dict[str, Any]:
        """Return what the command prints with ``--json``."""
        return {item.name: getattr(self, item.name) for item in fields(self) if item.repr}

    def lines(self) -> list[str]:
        """Return the lines that the command prints."""
        return format_table(self.as_json())

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return the rows of the table."""
        return [self.as_json()]

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the result as a pandas table; ``attrs["units"]`` holds the units of its columns in a scene in SI."""
        import pandas as pd

        table = pd.DataFrame(list(self.rows()))
        table.attrs["units"] = {name: unit for name, unit in self.UNITS.items() if name in table}
        return table

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the result.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw; by default a new figure, which pyplot does not manage.

        Returns
        -------
        matplotlib Figure
            ``figure.savefig(path)`` writes it, a notebook shows it.
        """
        import matplotlib as mpl

        from stickslip.output.plot import STYLE, figure

        with mpl.rc_context(fname=STYLE):
            if ax is not None:
                self.draw(ax)
                return ax.figure.figure  # of axes in a part of a figure: the whole
            page = figure(*self.SIZE)
            self.draw_page(page)
        return page

    def undrawn(self) -> str:
        """Return why there is nothing to draw; "" where there is something."""
        return ""

    def draw_page(self, page: "Figure") -> None:
        """Draw the result into an empty figure."""
        self.draw(page.add_subplot())

    def draw(self, ax: "Axes") -> None:
        """Draw the result into axes."""
        raise NotImplementedError

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        words = in_python("\n".join(self.lines())).split("\n")
        more = [" ..."] if len(words) > LINES else []
        head = f"<{type(self).__name__} of {self.name}"
        return "\n".join([head, *(f" {line}" for line in words[:LINES]), *more]) + ">"

    def _repr_html_(self) -> str:
        from stickslip.output import notebook

        rows = list(self.rows())
        title = f"{type(self).__name__} of {self.name}"
        if len(rows) == 1:
            return notebook.table(
                title, [[name, format_value(value)] for name, value in rows[0].items() if has_value(value)]
            )
        header = list(rows[0]) if rows else []
        cells = [[format_value(value) for value in row.values()] for row in rows[:ROWS]]
        return notebook.table(title, cells + ([["..."] * len(header)] if len(rows) > ROWS else []), header)


def format_table(data: Mapping[str, Any]) -> list[str]:
    return [f"{key:11} {format_value(value, 15)}" for key, value in data.items() if has_value(value)]


def has_value(value: Any) -> bool:
    return not (value is None or (isinstance(value, str | tuple | list) and len(value) == 0))


def format_value(value: Any, digits: int = 6) -> str:
    """Return a value as text; numbers to ``digits`` digits."""
    if isinstance(value, tuple | list):
        return ", ".join(format_value(item, digits) for item in value)
    if isinstance(value, complex):
        sign = "-" if value.imag < 0 else "+"
        return f"{value.real:.{digits}g} {sign} {abs(value.imag):.{digits}g}i"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def format_outcome(outcome: str, advice: str) -> str:
    return f"{outcome} ({advice})" if advice else outcome
