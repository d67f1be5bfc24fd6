"""Figures of matplotlib in the style of every picture of a run, ``stickslip.mplstyle``, and their files."""

import io
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stickslip.errors import InputError
from stickslip.output import atomic
from stickslip.text import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STYLE = Path(__file__).with_name("stickslip.mplstyle")
FORMATS = (".png", ".svg", ".pdf")
MARK = "stickslip, sha256 of the raw record "  # before the run that a picture shows, among its metadata
NAMED_IN = {"png": "Source", "svg": "Source", "pdf": "Subject"}
MARKER = "#D55E00"
SCREEN_DPI = 90  # dots per inch of a figure in a notebook: 11.5 inches are then 1035 px wide


class PngFigure(Figure):
    """A figure that a notebook shows without pyplot and its list of open figures."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with mpl.rc_context(fname=STYLE):
            self.savefig(buffer, format="png", dpi=SCREEN_DPI)
        return buffer.getvalue()


def figure(width: float, height: float) -> PngFigure:
    """Return an empty figure, inches; draw into it inside ``matplotlib.rc_context(fname=STYLE)``."""
    return PngFigure(figsize=(width, height), layout="constrained")


def draw_over_time(
    parts: Iterable[tuple[NDArray[np.float64], NDArray[np.float64]]],
    ylabel: str,
    markers: Iterable[tuple[float, str]],
    title: str,
    axes: "Axes | None" = None,
) -> Figure:
    """Draw a quantity over time, s, in parts between gaps, with markers, into ``axes`` or a new figure."""
    with mpl.rc_context(fname=STYLE):
        if axes is None:
            axes = figure(9.5, 3.6).add_subplot()
        for time, values in parts:
            axes.plot(time, values, "." if len(time) == 1 else "-", color="C0", ms=3)
        draw_markers(axes, markers)
        axes.set(xlabel="time (s)", ylabel=ylabel)
        axes.set_title(printable(title), parse_math=False)
        axes.margins(x=0.01)
    return axes.figure.figure  # of axes in a part of a figure: the whole


def draw_markers(axes: "Axes", markers: Iterable[tuple[float, str]]) -> None:
    """Draw markers, (time in s, words), as lines across a picture over time."""
    for time, words in markers:
        axes.axvline(time, color=MARKER, lw=1.0, ls=(0, (5, 3)))
        box = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0}
        transform = axes.get_xaxis_transform()
        axes.text(
            time, 0.97, f" {printable(words)}", transform=transform, va="top", color=MARKER, bbox=box, parse_math=False
        )


def check_place(target: Path, *sources: Path, force: bool = False, digest: str = "") -> None:
    """Raise InputError where `save` would; an older picture of the run with this ``digest`` may be replaced."""
    mark = MARK + digest if digest else ""
    atomic.refuse_existing(target, force, *sources, mark=mark, kind="picture of this run", flag="--plot")
    if target.suffix.lower() not in FORMATS:
        kind = target.suffix or "file without a suffix"
        raise InputError(f"cannot draw a {kind}", str(target), "use .png, .svg or .pdf")


def save(figure: Figure, target: Path, *sources: Path, force: bool = False, digest: str = "") -> None:
    """Write a figure in the format of the file's suffix; arguments as of `check_place`."""
    check_place(target, *sources, force=force, digest=digest)
    form = target.suffix.lower()[1:]
    metadata = {NAMED_IN[form]: MARK + digest} if digest else {}
    with atomic.replacing(target, force=True) as temporary, mpl.rc_context(fname=STYLE):
        figure.savefig(temporary, format=form, metadata=metadata)
