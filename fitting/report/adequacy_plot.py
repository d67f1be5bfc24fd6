"""Pictures of what a record shows beyond the ranking: the measured curve, the orbits of all laws, the departures."""

import math

import numpy as np
from matplotlib.figure import Figure

from fitting.adequacy.result import Adequacy
from fitting.report import curves
from fitting.report.palette import COLOURS, INK, MEASURED
from fitting.selection.result import Ranking
from fitting.selection.verdict import format_length

ZOOM = 0.15  # of the largest slip speed: there laws and ramps differ most


def measured_curve(ranking: Ranking) -> Figure:
    """Draw friction against relative speed: the measured curve with its band, the laws behind it, and a zoom near 0."""
    figure = Figure(figsize=(11.0, 4.0), layout="constrained")
    axes = figure.subplots(1, 2)
    found = ranking.adequacy.curve
    if found is None:
        return figure
    top = float(found.speed[-1])
    low, high = float(found.lo.min()), float(found.hi.max())
    for place, (side, reach) in enumerate(zip(axes, (top, ZOOM * top), strict=True)):
        grid = np.linspace(0.0, 1.02 * reach, 400)
        for row in sorted(ranking.rows, key=lambda row: row.law):
            force = np.abs(curves.curve(row, ranking.motion, -grid))
            style = "-" if row.in_set else (0, (5, 2))
            side.plot(100 * grid, force, color=COLOURS[row.law], lw=1.0, ls=style, label=f"law {row.law}")
        band = 100 * found.speed, found.lo, found.hi
        side.fill_between(*band, color=INK, alpha=0.22, lw=0, zorder=5, label=f"{100 * found.confidence:g} % band")
        side.plot(100 * found.speed, found.friction, color=INK, lw=1.8, zorder=6, label="measured, without a law")
        side.set_xlim(0, 102 * reach)
        side.set(xlabel="relative speed (cm/s)", title="all speeds" if place == 0 else "low speeds")
        seen = found.speed <= 1.02 * reach
        if place and seen.sum() > 2:
            low, high = float(found.lo[seen].min()), float(found.hi[seen].max())
        side.set_ylim(low - 0.25 * (high - low), high + 0.35 * (high - low))
    axes[0].set_ylabel(f"friction ({ranking.adequacy.unit})")
    axes[0].legend(ncols=2, loc="best")
    return figure


def orbits(ranking: Ranking) -> Figure:
    """Draw the orbit of every law over the measured one, on the same axes, with the law's error."""
    motion = ranking.motion
    rows = sorted(ranking.rows, key=lambda row: row.law)
    columns = min(len(rows), 3)
    lines = math.ceil(len(rows) / columns)
    figure = Figure(figsize=(11.0, 0.4 + 2.7 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel()
    x, v = 100 * motion.sign * motion.position, 100 * motion.sign * motion.velocity
    for side, row in zip(axes, rows, strict=False):
        side.plot(x, v, color=MEASURED, lw=2.2, alpha=0.5, rasterized=True)
        windows = row.fit.windows
        model = windows.position + row.fit.residual
        for _, _, first, count, *_ in windows.table:
            part = slice(first, first + count)
            if count > 2:
                speed = 100 * motion.sign * np.gradient(model[part], windows.time[part])
                side.plot(100 * motion.sign * model[part], speed, color=COLOURS[row.law], lw=0.7, rasterized=True)
        side.set_title(f"law {row.law}{' *' if row.in_set else ''}: {format_length(row.rms_m)}")
    for side in axes[len(rows) :]:
        side.set_visible(False)
    figure.supxlabel("position (cm)", fontsize="medium")
    figure.supylabel("velocity (cm/s)", fontsize="medium")
    return figure


def departures(adequacy: Adequacy) -> Figure:
    """Draw the departures as bars, in standard deviations."""
    found = adequacy.departures[::-1]
    figure = Figure(figsize=(5.4, 0.9 + 0.34 * len(found)), layout="constrained")
    axes = figure.subplots()
    heights = range(len(found))
    axes.barh(heights, [one.sigmas for one in found], color=COLOURS[2], height=0.6)
    axes.set_yticks(heights, [one.name for one in found])
    for height, one in zip(heights, found, strict=True):
        axes.annotate(f" {100 * one.explained:.0f} %", (one.sigmas, height), va="center", fontsize="small")
    axes.margins(x=0.15)
    axes.grid(visible=False, axis="y")
    axes.set(xlabel="standard deviations; beside the bar: share of the misfit explained")
    return figure
