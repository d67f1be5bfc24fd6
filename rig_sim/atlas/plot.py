"""Pictures of the atlas; matplotlib is imported here and nowhere else in `rig_sim.atlas`.

A picture is reduced to few colours: lines on white need no more, and 75 of them then take about 1 MB.
"""

import io
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from PIL import Image

from rig_sim.atlas.figure import Drawing, Panel, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STYLE = Path(__file__).with_name("atlas.mplstyle")
COLOURS = 64  # colours of a picture: with fewer the edges of thin lines show steps
# Width of the picture, and height of a row by the number of panels in it, inches.
WIDTH, HEIGHT = 7.2, {1: 2.15, 2: 3.0, 3: 2.35}
ALONE = 4.1  # height of a panel that is the only one
LETTERS = 112  # letters in a line of the sentence
BEHIND: dict[str, Any] = {"frameon": True, "framealpha": 0.7, "edgecolor": "none"}  # curves show through a legend
LOOKS: dict[str, dict[str, Any]] = {
    "line": {"lw": 1.2},
    "thick": {"lw": 2.2},
    "thin": {"lw": 0.7},
    "dashed": {"lw": 1.2, "ls": "--"},
    "points": {"ls": "", "marker": ".", "ms": 3.0, "mew": 0},
    "dots": {"ls": "", "marker": ",", "mew": 0},
    "filled": {"ls": "", "marker": "o", "ms": 5.0, "mew": 0.9},
    "open": {"ls": "", "marker": "o", "ms": 5.0, "mfc": "white", "mew": 0.9},
    "cross": {"ls": "", "marker": "x", "ms": 5.5, "mew": 1.2},
}


def render_picture(drawing: Drawing) -> bytes:
    """Return a figure as PNG: its number and subject above, its panels, and its sentence below."""
    with mpl.rc_context(fname=STYLE):
        rows = -(-len(drawing.panels) // drawing.columns)
        words = textwrap.wrap(drawing.sentence, LETTERS)
        above, below = 0.34, 0.17 * len(words) + 0.12
        height = (ALONE if len(drawing.panels) == 1 else rows * HEIGHT[drawing.columns]) + above + below
        inside = (0.0, below / height, 0.985, 1.0 - (above + below) / height)
        figure = Figure(figsize=(WIDTH, height), layout=ConstrainedLayoutEngine(rect=inside))
        figure.text(
            0.012, 1.0 - 0.1 / height, f"Thesis figure {drawing.number}: {drawing.title}", va="top", weight="bold"
        )
        figure.text(0.012, 0.07 / height, "\n".join(words), va="bottom", color="#333333", fontsize=8.5)
        legend_names: set[str] = set()  # names in the legends so far
        for index, panel in enumerate(drawing.panels, 1):
            draw_panel(
                figure.add_subplot(rows, drawing.columns, index, projection="3d" if panel.z else None),
                panel,
                legend_names,
            )
        full = io.BytesIO()
        figure.savefig(full, format="png")
    small = io.BytesIO()
    with Image.open(full) as drawn:
        reduced = drawn.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        reduced.save(small, "PNG", optimize=True)
    return small.getvalue()


def draw_panel(axes: "Axes", panel: Panel, explained: set[str]) -> None:
    """Draw a panel; its legend has the names that are not yet explained."""
    for curve in panel.curves:
        look = LOOKS[curve.style] | {"color": choose_colour(curve)}
        coordinates = (curve.x, curve.y) if curve.z is None else (curve.x, curve.y, curve.z)
        axes.plot(*coordinates, label=curve.label or None, **look)
    for text in panel.texts:
        axes.annotate(text.words, (text.x, text.y), xytext=(5, 3), textcoords="offset points", fontsize=8)
    axes.set(xlabel=panel.x, ylabel=panel.y, title=panel.title, **({"zlabel": panel.z} if panel.z else {}))
    if panel.x_range is not None:
        axes.set_xlim(panel.x_range)
    if panel.y_range is not None:
        axes.set_ylim(panel.y_range)
    if panel.equal:
        axes.set_aspect("equal")
    handles, labels = axes.get_legend_handles_labels()
    new = {label: handle for label, handle in zip(labels, handles, strict=True) if label not in explained}
    explained.update(new)
    if new:
        legend = axes.legend(new.values(), new.keys(), loc="best", **BEHIND)
        for handle in legend.legend_handles:
            if isinstance(handle, Line2D) and handle.get_marker() in (".", ","):
                handle.set(marker=".", markersize=7.0)  # of the size of a drawn point its colour could not be seen


def choose_colour(curve: Trace) -> str:
    if curve.colour is None:
        return "0.6"
    return "black" if curve.colour < 0 else f"C{curve.colour}"
