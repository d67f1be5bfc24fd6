"""The picture of a recording: position against time, without lines across gaps."""

from collections.abc import Iterable

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array, pieces
from daq.output.lengths import shown_length
from daq.output.plot import STYLE, PngFigure, figure

MARKER = "#D55E00"


def position_over_time(
    time: Array,
    position: Array,
    unit: str,
    *,
    segment: NDArray[np.uint16],
    interval: float,
    markers: Iterable[tuple[float, str]],
    title: str,
) -> PngFigure:
    """Return position (mm, or counts) against time (s), with the markers that a person set.

    Parameters
    ----------
    time, position, segment : (n,) arrays
        Of each sample: s, in ``unit``, and the number of its segment.
    unit : str
        "m" or "count".
    interval : float
        Between two samples, s.
    markers : iterable of (float, str)
        Time, s, and words.
    title : str
    """
    factor, shown_unit = shown_length(unit)
    shown = factor * position
    with mpl.rc_context(fname=STYLE):
        drawn = figure(9.5, 3.6)
        axes = drawn.add_subplot()
        for part in pieces(time, segment, interval) if time.size > 1 else (slice(None),):
            axes.plot(time[part], shown[part], "." if time[part].size == 1 else "-", color="C0", ms=3)
        for at, words in markers:
            axes.axvline(at, color=MARKER, lw=1.0, ls=(0, (5, 3)))
            box = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0}
            place = axes.get_xaxis_transform()
            axes.text(at, 0.97, f" {words}", transform=place, va="top", color=MARKER, bbox=box, parse_math=False)
        axes.set(xlabel="time (s)", ylabel=f"position ({shown_unit})")
        axes.set_title(title, parse_math=False)
        axes.margins(x=0.01)
    return drawn
