"""Pictures of what a record shows beyond the ranking: the measured curve, the orbits of all laws, the departures."""

import math

import numpy as np

from daq.compute.arrays import Array
from fitting.adequacy.result import Adequacy
from fitting.drawing import curves
from fitting.drawing.palette import COLOURS, DASH, INK, MEASURED, NARROW, WIDE
from fitting.report.chart import CHARACTER, SMALL, Axes, picture
from fitting.report.scale import AxisScale
from fitting.selection.result import LawResult, Ranking
from fitting.selection.verdict import format_length

ZOOM = 0.15  # of the largest slip speed: there laws and ramps differ most


def measured_curve(ranking: Ranking) -> str:
    """Draw friction against relative speed: the measured curve with its band, the laws behind it, and a zoom near 0."""
    found = ranking.adequacy.curve
    if found is None:
        raise ValueError("no curve was measured")
    height, drawn = 320.0, []
    for place, reach in enumerate((float(found.speed[-1]), ZOOM * float(found.speed[-1]))):
        seen = found.speed <= 1.02 * reach
        own = seen if seen.sum() > 2 else np.ones_like(seen)
        low, high = float(found.lo[own].min()), float(found.hi[own].max())
        tall = AxisScale(low - 0.25 * (high - low), high + 0.35 * (high - low))
        axes = Axes(place * WIDE / 2, 0, WIDE / 2, height, AxisScale(0.0, 102 * reach), tall, rows=2)
        axes.title = "low speeds" if place else "all speeds"
        axes.xlabel, axes.ylabel = "relative speed (cm/s)", f"friction ({ranking.adequacy.unit})"
        grid = np.linspace(0.0, 1.02 * reach, 400)
        for row in sorted(ranking.rows, key=lambda row: row.law):
            force = np.abs(curves.curve(row.fit, ranking.motion, -grid))
            style = "" if row.in_set else DASH
            axes.line(100 * grid, force, COLOURS[row.law], width=1.0, dash=style, label=f"law {row.law}")
        band = f"{100 * found.confidence:g} % band"
        axes.band(100 * found.speed, found.lo, found.hi, INK, opacity=0.22, label=band)
        axes.line(100 * found.speed, found.friction, INK, width=1.8, label="measured, without a law")
        drawn.append(axes)
    return picture("measured-curve", WIDE, height, drawn)


def orbits(ranking: Ranking) -> str:
    """Draw the orbit of every law over the measured one, on the same axes, with the law's error."""
    rows = sorted(ranking.rows, key=lambda row: row.law)
    columns = min(len(rows), 3)
    lines = math.ceil(len(rows) / columns)
    measured = [measured_orbit(side) for side in ranking.sides]
    x, v = (np.concatenate(own) for own in zip(*measured, strict=True))
    both, width, height = (AxisScale.around(x), AxisScale.around(v, edge=0.1)), WIDE / 3, 225.0
    drawn = []
    for place, row in enumerate(rows):
        line, column = divmod(place, columns)
        axes = Axes(column * width, line * height, width, height, *both, rows=0)
        axes.title = f"law {row.law}{' *' if row.in_set else ''}: {format_length(row.rms_m)}"
        axes.xlabel = "position (cm)" if place + columns >= len(rows) else ""
        axes.ylabel = "velocity (cm/s)" if column == 0 else ""
        axes.trace(measured, MEASURED, width=2.2, opacity=0.5)
        fitted = [part for side in ranking.sides for part in fitted_orbits(side.row(row.law), side.motion.sign)]
        axes.trace(fitted, COLOURS[row.law], width=0.7)
        drawn.append(axes)
    return picture("orbits", WIDE, lines * height, drawn)


def measured_orbit(side: Ranking) -> tuple[Array, Array]:
    """Return position (cm) and velocity (cm/s) of a run as recorded."""
    motion = side.motion
    return 100 * motion.sign * motion.position, 100 * motion.sign * motion.velocity


def fitted_orbits(row: LawResult, sign: float) -> list[tuple[Array, Array]]:
    """Return position (cm) and velocity (cm/s) of a law in each window of its fit."""
    windows = row.fit.windows
    model = windows.position + row.fit.residual
    parts = [slice(first, first + count) for _, _, first, count, *_ in windows.table if count > 2]
    return [(100 * sign * model[own], 100 * sign * np.gradient(model[own], windows.time[own])) for own in parts]


def departures(adequacy: Adequacy) -> str:
    """Draw the departures as bars, in standard deviations."""
    found = adequacy.departures[::-1]
    names = tuple(one.name for one in found)
    sigmas = np.array([one.sigmas for one in found])
    height = 52.0 + 26 * len(found)
    axes = Axes(
        0, 0, NARROW, height, AxisScale(0.0, 1.2 * float(sigmas.max())), AxisScale(-0.6, len(found) - 0.4, names=names)
    )
    axes.rows, axes.margin = 0, 14.0 + CHARACTER * SMALL * max(map(len, names))
    axes.xlabel = "standard deviations (share of the misfit explained)"
    for place, one in enumerate(found):
        edge = np.array([place - 0.3, place + 0.3])
        axes.band(np.array([0.0, one.sigmas]), edge[[0, 0]], edge[[1, 1]], COLOURS[2], opacity=0.8)
        axes.text(one.sigmas, place, f"{100 * one.explained:.0f} %")
    return picture("departures", NARROW, height, [axes])
