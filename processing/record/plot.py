"""The picture of a motion: position and velocity against time, and the phase portrait."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import matplotlib as mpl
import numpy as np

from daq.runfile.recording import Recording
from processing.record.motion import Phase
from stickslip.compute.arrays import Array, pieces
from stickslip.output.lengths import shown_length, shown_speed
from stickslip.output.plot import STYLE, draw_markers, figure
from stickslip.text import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec


CYCLES = 12  # drawn against time; the portrait shows them all

SHADE, MOTION, STICK, BELT = "#f3e6c8", "#0072B2", "#E69F00", "#D55E00"


class Motion(Protocol):
    """What is drawn of `processing.record.kinematics.Kinematics`."""

    @property
    def recording(self) -> Recording: ...
    @property
    def time(self) -> Array: ...
    @property
    def position(self) -> Array: ...
    @property
    def velocity(self) -> Array: ...
    @property
    def unit(self) -> str: ...
    @property
    def sticks(self) -> Sequence[Phase]: ...
    @property
    def cycles(self) -> Sequence[object]: ...
    @property
    def belt_speed(self) -> float: ...
    def facts(self) -> dict[str, str]: ...


def draw_figure(motion: "Motion", axes: "Axes | None" = None) -> "Figure":
    """Draw the motion in a new figure, or only its phase portrait into ``axes``, and return the figure."""
    with mpl.rc_context(fname=STYLE):
        if axes is not None:
            _draw_portrait(axes, motion)
            return axes.figure.figure
        picture = figure(11.5, 5.6)
        draw_motion(picture, picture.add_gridspec(1, 1)[0], motion)
    return picture


def draw_motion(picture: "Figure", cell: "SubplotSpec", motion: "Motion") -> None:
    """Draw position and velocity over the first `CYCLES` cycles, and the phase portrait of the whole record."""
    grid = cell.subgridspec(2, 2, width_ratios=(1.35, 1.0), hspace=0.04, wspace=0.05)
    position_axes = picture.add_subplot(grid[0, 0])
    velocity_axes = picture.add_subplot(grid[1, 0], sharex=position_axes)
    _draw_against_time(position_axes, velocity_axes, motion)
    _draw_portrait(picture.add_subplot(grid[:, 1]), motion)
    caption = printable(f"{motion.recording.name}: {motion.recording.title}   ({motion.facts()['method']})")
    picture.suptitle(caption, parse_math=False, x=0.01, ha="left", fontsize=11.5)


def _end_of_cycles(motion: "Motion") -> float:
    sticks = motion.sticks
    return sticks[CYCLES].start if len(sticks) > CYCLES else float(motion.time[-1])


def _split_at_gaps(motion: "Motion", samples: slice) -> tuple[slice, ...]:
    """Return the stretches without a gap, since a line across one would show motion that was not measured."""
    time = motion.time[samples]
    interval = float(np.median(np.diff(time)))
    return pieces(time, motion.recording.segment[samples], interval)


def _draw_against_time(position_axes: "Axes", velocity_axes: "Axes", motion: "Motion") -> None:
    factor, unit = shown_length(motion.unit)
    until = _end_of_cycles(motion)
    samples = slice(0, int(np.searchsorted(motion.time, until, side="right")))
    time = motion.time[samples]
    for axes, values in ((position_axes, factor * motion.position), (velocity_axes, motion.velocity)):
        drawn = values[samples]
        for k, stick in enumerate(phase for phase in motion.sticks if phase.start < until):
            label = "stick" if k == 0 else None
            axes.axvspan(stick.start, min(stick.end, until), color=SHADE, lw=0, zorder=0, label=label)
        for k, part in enumerate(_split_at_gaps(motion, samples)):
            axes.plot(time[part], drawn[part], color=MOTION, lw=1.0, label="mass" if k == 0 else None)
        axes.margins(x=0.01)
    draw_markers(position_axes, [marker for marker in motion.recording.markers if marker[0] <= until])
    if np.isfinite(motion.belt_speed):
        velocity_axes.axhline(motion.belt_speed, color=BELT, lw=1.0, ls=(0, (5, 3)), label="belt")
    shown_part = "" if samples.stop >= motion.time.size else f", first {time[-1] - time[0]:.3g} s of the run"
    position_axes.set_title(f"position{shown_part}")
    velocity_axes.set_title("velocity")
    position_axes.set_ylabel(f"x ({unit})")
    velocity_axes.set_ylabel(f"v ({shown_speed(motion.unit)})")
    velocity_axes.set_xlabel("time (s)")
    position_axes.tick_params(labelbottom=False)
    handles, labels = velocity_axes.get_legend_handles_labels()
    if len(labels) > 1:
        # Next to the title: inside the axes it would cover the motion.
        velocity_axes.legend(
            handles,
            labels,
            loc="lower right",
            bbox_to_anchor=(1.0, 0.99),
            borderaxespad=0.2,
            ncols=3,
            handlelength=1.6,
            columnspacing=1.2,
        )


def _draw_portrait(axes: "Axes", motion: "Motion") -> None:
    (factor, unit), per_second = shown_length(motion.unit), shown_speed(motion.unit)
    x, v = factor * motion.position, motion.velocity
    for piece in _split_at_gaps(motion, slice(0, x.size)):
        axes.plot(x[piece], v[piece], color=MOTION, lw=0.7, alpha=0.75)
    for k, phase in enumerate(motion.sticks):
        samples = slice(phase.first, phase.last + 1)
        axes.plot(x[samples], v[samples], color=STICK, lw=1.8, label="stick" if k == 0 else None)
    axes.plot([], [], color=MOTION, lw=0.9, label="slip" if motion.sticks else "mass")
    if np.isfinite(motion.belt_speed):
        speed = motion.belt_speed
        axes.axhline(speed, color=BELT, lw=1.0, ls=(0, (5, 3)), zorder=1, label=f"belt {speed:.4g} {per_second}")
    cycles = len(motion.cycles)
    counted = f", {cycles} complete cycle{'s' if cycles != 1 else ''}" if cycles else ""
    axes.locator_params(axis="x", nbins=7)  # counts of five digits touched each other
    axes.set_title(f"phase portrait{counted}")
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"v ({per_second})")
    axes.margins(0.05)
    axes.legend(loc="best")
