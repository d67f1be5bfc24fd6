"""The picture of a motion: position and velocity against time, and the phase portrait."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from processing.record.motion import Phase
from stickslip.compute.arrays import Array, pieces
from stickslip.output.lengths import shown_length, shown_speed
from stickslip.output.plot import STYLE, draw_markers, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

CYCLES = 12  # drawn against time; the portrait shows them all

SHADE, MOTION, STICK, BELT = "#f3e6c8", "#0072B2", "#E69F00", "#D55E00"


@dataclass(frozen=True, eq=False)
class DrawnMotion:
    """What the picture shows of a motion."""

    caption: str
    time: Array  # (n,) s; in ``unit``, and that per second; the number of each sample's segment
    position: Array
    velocity: Array
    segment: NDArray[np.uint16] | NDArray[np.uint32]
    unit: str  # "m" or "count"
    sticks: tuple[Phase, ...]
    cycles: int  # complete cycles
    belt_speed: float  # in ``unit``/s; NaN where it is not known
    markers: tuple[tuple[float, str], ...] = ()  # Time, s, and words


def figure_of(motion: DrawnMotion, axes: "Axes | None" = None) -> "Figure":
    """Return the motion as a figure of its own; where there are axes, theirs, with the phase portrait in them."""
    with mpl.rc_context(fname=STYLE):
        if axes is not None:
            _portrait(axes, motion)
            return axes.figure.figure
        drawn = figure(11.5, 5.6)
        draw_motion(drawn, drawn.add_gridspec(1, 1)[0], motion)
    return drawn


def draw_motion(drawn: "Figure", cell: "SubplotSpec", motion: DrawnMotion) -> None:
    """Draw a motion into a cell of a figure, with its caption above.

    Left: position (mm) and velocity (m/s) against time (s), sticks shaded, with the markers that a person set, from the
    beginning over at most `CYCLES` cycles.  Right: the phase portrait of the whole record.  In counts for a rig without
    a calibration.
    """
    grid = cell.subgridspec(2, 2, width_ratios=(1.35, 1.0), hspace=0.04, wspace=0.05)
    above = drawn.add_subplot(grid[0, 0])
    below = drawn.add_subplot(grid[1, 0], sharex=above)
    _against_time(above, below, motion)
    _portrait(drawn.add_subplot(grid[:, 1]), motion)
    drawn.suptitle(motion.caption, parse_math=False, x=0.01, ha="left", fontsize=11.5)


def _last_shown(motion: DrawnMotion) -> float:
    sticks = motion.sticks
    return sticks[CYCLES].start if len(sticks) > CYCLES else float(motion.time[-1])


def _pieces(motion: DrawnMotion, own: slice) -> tuple[slice, ...]:
    """Return the stretches without a gap: a line across one would draw a motion that nobody measured."""
    time = motion.time[own]
    interval = float(np.median(np.diff(time)))
    return pieces(time, motion.segment[own], interval)


def _against_time(above: "Axes", below: "Axes", motion: DrawnMotion) -> None:
    factor, unit = shown_length(motion.unit)
    until = _last_shown(motion)
    own = slice(0, int(np.searchsorted(motion.time, until, side="right")))
    time = motion.time[own]
    for axes, values in ((above, factor * motion.position), (below, motion.velocity)):
        shown = values[own]
        for k, stick in enumerate(phase for phase in motion.sticks if phase.start < until):
            label = "stick" if k == 0 else None
            axes.axvspan(stick.start, min(stick.end, until), color=SHADE, lw=0, zorder=0, label=label)
        for k, part in enumerate(_pieces(motion, own)):
            axes.plot(time[part], shown[part], color=MOTION, lw=1.0, label="mass" if k == 0 else None)
        axes.margins(x=0.01)
    draw_markers(above, [marker for marker in motion.markers if marker[0] <= until])
    if np.isfinite(motion.belt_speed):
        below.axhline(motion.belt_speed, color=BELT, lw=1.0, ls=(0, (5, 3)), label="belt")
    shown_part = "" if own.stop >= motion.time.size else f", first {time[-1] - time[0]:.3g} s of the run"
    above.set_title(f"position{shown_part}")
    below.set_title("velocity")
    above.set_ylabel(f"x ({unit})")
    below.set_ylabel(f"v ({shown_speed(motion.unit)})")
    below.set_xlabel("time (s)")
    above.tick_params(labelbottom=False)
    handles, labels = below.get_legend_handles_labels()
    if len(labels) > 1:
        # Beside the title: inside the axes it would cover the motion.
        below.legend(
            handles,
            labels,
            loc="lower right",
            bbox_to_anchor=(1.0, 0.99),
            borderaxespad=0.2,
            ncols=3,
            handlelength=1.6,
            columnspacing=1.2,
        )


def _portrait(axes: "Axes", motion: DrawnMotion) -> None:
    (factor, unit), per_second = shown_length(motion.unit), shown_speed(motion.unit)
    x, v = factor * motion.position, motion.velocity
    for piece in _pieces(motion, slice(0, x.size)):
        axes.plot(x[piece], v[piece], color=MOTION, lw=0.7, alpha=0.75)
    for k, phase in enumerate(motion.sticks):
        own = slice(phase.first, phase.last + 1)
        axes.plot(x[own], v[own], color=STICK, lw=1.8, label="stick" if k == 0 else None)
    axes.plot([], [], color=MOTION, lw=0.9, label="slip" if motion.sticks else "mass")
    if np.isfinite(motion.belt_speed):
        speed = motion.belt_speed
        axes.axhline(speed, color=BELT, lw=1.0, ls=(0, (5, 3)), zorder=1, label=f"belt {speed:.4g} {per_second}")
    cycles = motion.cycles
    counted = f", {cycles} complete cycle{'s' if cycles != 1 else ''}" if cycles else ""
    axes.locator_params(axis="x", nbins=7)  # counts of five digits touched each other
    axes.set_title(f"phase portrait{counted}")
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"v ({per_second})")
    axes.margins(0.05)
    axes.legend(loc="best")
