"""Pictures of a smoothed run: position and velocity against time, the phase portrait, and the break-aways.

matplotlib is imported here and nowhere else in `processing`; the look is that of ``stickslip.mplstyle``.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from daq.errors import InputError
from daq.output import atomic
from processing import portrait
from processing.record import series
from processing.record.kinematics import Kinematics
from processing.statistics import FEWEST_SLIPS, StickSlipStatistics, from_kinematics, shown_length

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.gridspec import GridSpecBase

STYLE = Path(__file__).with_name("stickslip.mplstyle")
FORMATS = (".png", ".svg", ".pdf")
CYCLES = 12  # drawn against time; the portrait shows them all
MOST_DRAWN = 500  # break-aways drawn as shapes, of some 80 bytes each; more become an image of some 15 kB
BINS = (4, 30)  # of the distribution: fewest and most; between them the square root of the number of break-aways

SHADE, MOTION, STICK, BELT = "#f3e6c8", "#0072B2", "#E69F00", "#D55E00"


def inspection(kinematics: Kinematics) -> Figure:
    """Return the figure of `process inspect`.

    Parameters
    ----------
    kinematics : Kinematics
        The run.

    Returns
    -------
    Figure
        Left: position (cm) and velocity (cm/s) against time (s), sticks shaded, from the beginning over at most
        `CYCLES` cycles.  Right: the phase portrait of the whole record.  In counts for a rig without a calibration.
        Below, where there are at least `FEWEST_SLIPS` slips: the panels of `_break_aways`.
    """
    counted = from_kinematics(kinematics)
    several = counted.slips >= FEWEST_SLIPS and len(counted.events) >= FEWEST_SLIPS
    factor, unit = (100.0, "cm") if kinematics.recording.unit == "m" else (1.0, kinematics.recording.unit)
    with mpl.rc_context(fname=STYLE):
        figure = Figure(figsize=(11.5, 8.8 if several else 5.6), layout="constrained")
        parts = figure.add_gridspec(2 if several else 1, 1, height_ratios=(5.6, 3.2) if several else None)
        grid = parts[0].subgridspec(2, 2, width_ratios=(1.35, 1.0), hspace=0.04, wspace=0.05)
        above = figure.add_subplot(grid[0, 0])
        below = figure.add_subplot(grid[1, 0], sharex=above)
        right = figure.add_subplot(grid[:, 1])
        if several:
            _break_aways(figure, parts[1].subgridspec(1, 3, wspace=0.06), counted, kinematics.unit)
        _against_time(above, below, kinematics, factor, unit)
        _portrait(right, kinematics, factor, unit)
        figure.suptitle(_caption(kinematics), parse_math=False, x=0.01, ha="left", fontsize=11.5)
    return figure


def _break_aways(figure: Figure, cells: "GridSpecBase", counted: StickSlipStatistics, unit: str) -> None:
    """Draw the break-away levels into one row of cells: their distribution, trend, and level against stick time."""
    distribution, trend, stick = (figure.add_subplot(cells[0, column]) for column in range(3))
    factor, shown = shown_length(unit)
    time, level = counted.column("t"), factor * counted.column("break_away_m")
    label = f"break-away level ({shown})"
    bins = int(np.clip(np.sqrt(level.size), *BINS))
    distribution.hist(level, bins, color=MOTION, alpha=0.55, edgecolor="white", lw=0.6)
    distribution.axvline(level.mean(), color=BELT, lw=1.2, ls=(0, (5, 3)), label=f"mean {level.mean():.4g} {shown}")
    distribution.yaxis.set_major_locator(MaxNLocator(integer=True))
    distribution.set(title="distribution", xlabel=label, ylabel="number of break-aways")
    cloud: dict[str, Any] = {"ms": 4, "mew": 0, "color": MOTION, "alpha": 0.75, "rasterized": level.size > MOST_DRAWN}
    trend.plot(time, level, "o", **cloud)
    summary = counted.summary("break_away_m")
    if summary is not None and summary["trend_per_s"] is not None:
        slope, ends = factor * summary["trend_per_s"], np.array([time.min(), time.max()])
        line = level.mean() + slope * (ends - time.mean())
        trend.plot(ends, line, color=BELT, lw=1.4, label=f"trend {slope:+.2g} {shown}/s")
    trend.set(title="against time", xlabel="time (s)", ylabel=label)
    stick.plot(counted.column("stick_s"), level, "o", **cloud)
    stick.set(title="against stick time", xlabel="stick time (s)", ylabel=label)
    for axes in (distribution, trend):
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), borderaxespad=0.2, handlelength=1.6)


def _caption(kinematics: Kinematics) -> str:
    recording = kinematics.recording
    smoothing = (
        "finite differences"
        if kinematics.method == "fd"
        else f"{kinematics.method}, window {kinematics.window}, order {kinematics.order}"
    )
    return f"{recording.source.name}: {recording.title}   ({smoothing}, {kinematics.times} times)"


def _last_shown(kinematics: Kinematics) -> float:
    sticks = kinematics.sticks
    return sticks[CYCLES].start if len(sticks) > CYCLES else float(kinematics.time[-1])


def _pieces(kinematics: Kinematics, own: slice) -> tuple[slice, ...]:
    """Return the stretches without a gap: a line across one would draw a motion that nobody measured."""
    time = kinematics.time[own]
    interval = float(np.median(np.diff(time)))
    return series.pieces(time, kinematics.recording.segment[own], interval)


def _against_time(above: "Axes", below: "Axes", kinematics: Kinematics, factor: float, unit: str) -> None:
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


def _portrait(axes: "Axes", kinematics: Kinematics, factor: float, unit: str) -> None:
    drawn = portrait.from_kinematics(kinematics)
    x, v = factor * drawn.position, factor * drawn.velocity
    for piece in _pieces(kinematics, slice(0, x.size)):
        axes.plot(x[piece], v[piece], color=MOTION, lw=0.7, alpha=0.75)
    for k, phase in enumerate(kinematics.sticks):
        own = slice(phase.first, phase.last + 1)
        axes.plot(x[own], v[own], color=STICK, lw=1.8, label="stick" if k == 0 else None)
    axes.plot([], [], color=MOTION, lw=0.9, label="slip" if kinematics.sticks else "mass")
    if np.isfinite(kinematics.belt_speed):
        speed = factor * kinematics.belt_speed
        axes.axhline(speed, color=BELT, lw=1.0, ls=(0, (5, 3)), zorder=1, label=f"belt {speed:.4g} {unit}/s")
    cycles = len(drawn.cycles)
    counted = f", {cycles} complete cycle{'s' if cycles != 1 else ''}" if cycles else ""
    axes.set_title(f"phase portrait{counted}")
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"v ({unit}/s)")
    axes.margins(0.05)
    axes.legend(loc="best")


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
