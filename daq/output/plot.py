"""Figures of matplotlib in the style of every picture of a run, ``stickslip.mplstyle``, and their files."""

import io
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from daq.errors import InputError
from daq.output import atomic

STYLE = Path(__file__).with_name("stickslip.mplstyle")
FORMATS = (".png", ".svg", ".pdf")
SCREEN_DPI = 90  # of a figure in a notebook: 11.5 inches are then 1035 px wide


class PngFigure(Figure):
    """A figure that a notebook shows by itself, without pyplot and its list of open figures."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with mpl.rc_context(fname=STYLE):
            self.savefig(buffer, format="png", dpi=SCREEN_DPI)
        return buffer.getvalue()


def figure(width: float, height: float) -> PngFigure:
    """Return an empty figure, inches; draw into it inside ``matplotlib.rc_context(fname=STYLE)``."""
    return PngFigure(figsize=(width, height), layout="constrained")


def save(figure: Figure, target: Path) -> None:
    """Write a figure; its format is the file's ending.

    Raises
    ------
    InputError
        For an ending that is none of .png, .svg, .pdf.
    RefusedError
        The disk refuses; what stood there before still does.
    """
    if target.suffix.lower() not in FORMATS:
        raise InputError(
            f"cannot draw a {target.suffix or 'file without an ending'}", str(target), "use .png, .svg or .pdf"
        )
    with atomic.replacing(target, force=True) as temporary, mpl.rc_context(fname=STYLE):
        figure.savefig(temporary, format=target.suffix.lower()[1:])
