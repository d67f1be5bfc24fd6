"""The figure of `process inspect`: the motion and its phase portrait, and below them the break-aways."""

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from processing.record.kinematics import Kinematics
from processing.record.plot import BELT, MOTION, draw_motion
from processing.statistics import FEWEST_SLIPS, StickSlipStatistics, from_kinematics
from stickslip.output.lengths import shown_length
from stickslip.output.plot import STYLE, figure

if TYPE_CHECKING:
    from matplotlib.gridspec import GridSpecBase


MOST_DRAWN = 500  # break-aways drawn as shapes, of some 80 bytes each; more become an image of some 15 kB
BINS = (4, 30)  # of the distribution: fewest and most; between them the square root of the number of break-aways


def draw_inspection(kinematics: Kinematics) -> Figure:
    """Draw the motion, and below it the panels of `_draw_break_aways` if there are at least `FEWEST_SLIPS` slips."""
    statistics = from_kinematics(kinematics)
    enough_slips = statistics.slips >= FEWEST_SLIPS and len(statistics.events) >= FEWEST_SLIPS
    with mpl.rc_context(fname=STYLE):
        picture = figure(11.5, 8.8 if enough_slips else 5.6)
        parts = picture.add_gridspec(2 if enough_slips else 1, 1, height_ratios=(5.6, 3.2) if enough_slips else None)
        if enough_slips:
            _draw_break_aways(picture, parts[1].subgridspec(1, 3, wspace=0.06), statistics, kinematics.unit)
        draw_motion(picture, parts[0], kinematics)
    return picture


def _draw_break_aways(picture: Figure, cells: "GridSpecBase", statistics: StickSlipStatistics, unit: str) -> None:
    """Draw the break-away levels into one row of cells: their distribution, trend, and level against stick time."""
    distribution, trend, stick = (picture.add_subplot(cells[0, column]) for column in range(3))
    factor, unit_text = shown_length(unit)
    time, level = statistics.column("t"), factor * statistics.column("break_away_m")
    label = f"break-away level ({unit_text})"
    bins = int(np.clip(np.sqrt(level.size), *BINS))
    distribution.hist(level, bins, color=MOTION, alpha=0.55, edgecolor="white", lw=0.6)
    distribution.axvline(level.mean(), color=BELT, lw=1.2, ls=(0, (5, 3)), label=f"mean {level.mean():.4g} {unit_text}")
    distribution.yaxis.set_major_locator(MaxNLocator(integer=True))
    distribution.set(title="distribution", xlabel=label, ylabel="number of break-aways")
    cloud: dict[str, Any] = {"ms": 4, "mew": 0, "color": MOTION, "alpha": 0.75, "rasterized": level.size > MOST_DRAWN}
    trend.plot(time, level, "o", **cloud)
    summary = statistics.summary("break_away_m")
    if summary is not None and summary["trend_per_s"] is not None:
        slope, ends = factor * summary["trend_per_s"], np.array([time.min(), time.max()])
        line = level.mean() + slope * (ends - time.mean())
        trend.plot(ends, line, color=BELT, lw=1.4, label=f"trend {slope:+.2g} {unit_text}/s")
    trend.set(title="against time", xlabel="time (s)", ylabel=label)
    stick.plot(statistics.column("stick_s"), level, "o", **cloud)
    stick.set(title="against stick time", xlabel="stick time (s)", ylabel=label)
    for axes in (distribution, trend):
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), borderaxespad=0.2, handlelength=1.6)
