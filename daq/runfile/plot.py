"""The picture of a recording: position against time, without lines across gaps."""

from typing import TYPE_CHECKING

import matplotlib as mpl

from daq.compute.arrays import pieces
from daq.output.plot import STYLE, PngFigure, figure, length_factor

if TYPE_CHECKING:
    from daq.runfile.recording import Recording

MARKER = "#D55E00"


def position(recording: "Recording") -> PngFigure:
    """Return position (cm, or counts) against time (s), with the markers that a person set."""
    factor, unit = length_factor(recording.unit)
    time, shown = recording.time, factor * recording.position
    with mpl.rc_context(fname=STYLE):
        drawn = figure(9.5, 3.6)
        axes = drawn.add_subplot()
        for part in pieces(time, recording.segment, 1 / recording.rate_hz) if time.size > 1 else (slice(None),):
            axes.plot(time[part], shown[part], "." if time[part].size == 1 else "-", color="C0", ms=3)
        for sample, kind, note in zip(recording.event_sample, recording.event_kind, recording.event_note, strict=True):
            if kind == "marker" and sample < time.size:
                axes.axvline(time[sample], color=MARKER, lw=1.0, ls=(0, (5, 3)))
                at = axes.get_xaxis_transform()
                box = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0}
                axes.text(
                    time[sample], 0.97, f" {note}", transform=at, va="top", color=MARKER, bbox=box, parse_math=False
                )
        axes.set(xlabel="time (s)", ylabel=f"position ({unit})")
        axes.set_title(f"{recording.name}: {recording.title}", parse_math=False)
        axes.margins(x=0.01)
    return drawn
