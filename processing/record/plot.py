"""The picture of a motion: position and velocity against time, and the phase portrait."""

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from daq.compute.arrays import pieces
from daq.output.plot import STYLE, PngFigure, figure, length_factor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

    from processing.record.kinematics import Kinematics

CYCLES = 12  # drawn against time; the portrait shows them all

SHADE, MOTION, STICK, BELT = "#f3e6c8", "#0072B2", "#E69F00", "#D55E00"


def motion(kinematics: "Kinematics") -> PngFigure:
    """Return the motion as a figure of its own."""
    with mpl.rc_context(fname=STYLE):
        drawn = figure(11.5, 5.6)
        draw_motion(drawn, drawn.add_gridspec(1, 1)[0], kinematics)
    return drawn


def draw_motion(drawn: "Figure", cell: "SubplotSpec", kinematics: "Kinematics") -> None:
    """Draw a motion into a cell of a figure, with its caption above.

    Left: position (cm) and velocity (cm/s) against time (s), sticks shaded, from the beginning over at most `CYCLES`
    cycles.  Right: the phase portrait of the whole record.  In counts for a rig without a calibration.
    """
    factor, unit = length_factor(kinematics.unit)
    grid = cell.subgridspec(2, 2, width_ratios=(1.35, 1.0), hspace=0.04, wspace=0.05)
    above = drawn.add_subplot(grid[0, 0])
    below = drawn.add_subplot(grid[1, 0], sharex=above)
    _against_time(above, below, kinematics, factor, unit)
    _portrait(drawn.add_subplot(grid[:, 1]), kinematics, factor, unit)
    drawn.suptitle(_caption(kinematics), parse_math=False, x=0.01, ha="left", fontsize=11.5)


def _caption(kinematics: "Kinematics") -> str:
    recording = kinematics.recording
    smoothing = (
        "finite differences"
        if kinematics.method == "fd"
        else f"{kinematics.method}, window {kinematics.window}, order {kinematics.order}"
    )
    return f"{recording.name}: {recording.title}   ({smoothing}, {kinematics.times} times)"


def _last_shown(kinematics: "Kinematics") -> float:
    sticks = kinematics.sticks
    return sticks[CYCLES].start if len(sticks) > CYCLES else float(kinematics.time[-1])


def _pieces(kinematics: "Kinematics", own: slice) -> tuple[slice, ...]:
    """Return the stretches without a gap: a line across one would draw a motion that nobody measured."""
    time = kinematics.time[own]
    interval = float(np.median(np.diff(time)))
    return pieces(time, kinematics.recording.segment[own], interval)


def _against_time(above: "Axes", below: "Axes", kinematics: "Kinematics", factor: float, unit: str) -> None:
    until = _last_shown(kinematics)
    own = slice(0, int(np.searchsorted(kinematics.time, until, side="right")))
    time = kinematics.time[own]
    for axes, values in ((above, kinematics.position), (below, kinematics.velocity)):
        shown = factor * values[own]
        for k, stick in enumerate(phase for phase in kinematics.sticks if phase.start < until):
            label = "stick" if k == 0 else None
            axes.axvspan(stick.start, min(stick.end, until), color=SHADE, lw=0, zorder=0, label=label)
        for k, part in enumerate(_pieces(kinematics, own)):
            axes.plot(time[part], shown[part], color=MOTION, lw=1.0, label="mass" if k == 0 else None)
        axes.margins(x=0.01)
    if np.isfinite(kinematics.belt_speed):
        below.axhline(factor * kinematics.belt_speed, color=BELT, lw=1.0, ls=(0, (5, 3)), label="belt")
    shown_part = "" if own.stop >= kinematics.time.size else f", first {time[-1] - time[0]:.3g} s of the run"
    above.set_title(f"position{shown_part}")
    below.set_title("velocity")
    above.set_ylabel(f"x ({unit})")
    below.set_ylabel(f"v ({unit}/s)")
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


def _portrait(axes: "Axes", kinematics: "Kinematics", factor: float, unit: str) -> None:
    x, v = factor * kinematics.position, factor * kinematics.velocity
    for piece in _pieces(kinematics, slice(0, x.size)):
        axes.plot(x[piece], v[piece], color=MOTION, lw=0.7, alpha=0.75)
    for k, phase in enumerate(kinematics.sticks):
        own = slice(phase.first, phase.last + 1)
        axes.plot(x[own], v[own], color=STICK, lw=1.8, label="stick" if k == 0 else None)
    axes.plot([], [], color=MOTION, lw=0.9, label="slip" if kinematics.sticks else "mass")
    if np.isfinite(kinematics.belt_speed):
        speed = factor * kinematics.belt_speed
        axes.axhline(speed, color=BELT, lw=1.0, ls=(0, (5, 3)), zorder=1, label=f"belt {speed:.4g} {unit}/s")
    cycles = len(kinematics.cycles)
    counted = f", {cycles} complete cycle{'s' if cycles != 1 else ''}" if cycles else ""
    axes.locator_params(axis="x", nbins=7)  # counts of five digits touched each other
    axes.set_title(f"phase portrait{counted}")
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"v ({unit}/s)")
    axes.margins(0.05)
    axes.legend(loc="best")
