"""Pictures of what a record shows beyond the ranking: the measured curve, the orbits of all laws, the departures."""

import itertools
import math

import numpy as np

from daq.base.compute.arrays import Array
from daq.base.output.lengths import format_length
from fitting.adequacy.result import Adequacy
from fitting.data.cycles import Cycle
from fitting.drawing import curves
from fitting.drawing.palette import COLOURS, DASH, INK, MEASURED, NARROW, WIDE, law_colours
from fitting.report.chart import SMALL, Axes, legend_rows, picture, text_width
from fitting.report.scale import AxisScale
from fitting.report.symbols import pretty
from fitting.selection.result import LawResult, Ranking

HALF, BESIDE = 560.0, 18.0  # px: of the picture of orbits, and for the name of its ordinate
MM = 1e3  # positions are drawn in mm, speeds in m/s
ZOOM = 0.15  # of the largest slip speed: there laws and ramps differ most


def by_law(ranking: Ranking) -> list[LawResult]:
    """Return the rows in the order of their laws: the six by number, then formulas, best first."""
    return sorted(ranking.rows, key=lambda row: row.law if isinstance(row.law, int) else len(COLOURS) + 1)


def colours_of(ranking: Ranking) -> dict[int | str, str]:
    """Return the colour of each law, the same in every picture."""
    return law_colours(row.law for row in ranking.rows)


def measured_curve(ranking: Ranking) -> str:
    """Draw friction against relative speed: the measured curve with its band, the laws behind it, and a zoom near 0.

    Where the record hardly determines the level of friction, the laws are drawn at the level of the measured curve.
    """
    found = ranking.adequacy.curve
    if found is None:
        raise ValueError("no curve was measured")
    height, drawn, colours = 320.0, [], colours_of(ranking)
    lo, hi, band = found.lo, found.hi, f"{100 * found.confidence:g} % band"
    label = "measured, without a law"
    if not found.level_known:  # the band of every level would hide the shape
        lo, hi, band = found.friction - found.shape_half, found.friction + found.shape_half, f"{band} of the shape"
        label += ", level not determined"
    rows = max(2, legend_rows([*(row.label for row in ranking.rows), band, label], WIDE / 2))
    for place, reach in enumerate((float(found.speed[-1]), ZOOM * float(found.speed[-1]))):
        seen = found.speed <= 1.02 * reach
        own = seen if seen.sum() > 2 else np.ones_like(seen)
        low, high = float(lo[own].min()), float(hi[own].max())
        tall = AxisScale(low - 0.25 * (high - low), high + 0.35 * (high - low))
        axes = Axes(place * WIDE / 2, 0, WIDE / 2, height, AxisScale(0.0, 1.02 * reach), tall, rows=rows)
        axes.title = "low speeds" if place else "all speeds"
        axes.xlabel, axes.ylabel = "relative speed (m/s)", f"friction ({ranking.adequacy.unit})"
        grid = np.linspace(0.0, 1.02 * reach, 400)
        for row in by_law(ranking):
            force = np.abs(curves.curve(row.fit, ranking.motion, -grid))
            if not found.level_known:
                at = np.abs(curves.curve(row.fit, ranking.motion, -found.speed))
                force = force + np.mean(found.friction - at)
            style = "" if row.in_set else DASH
            axes.line(grid, force, colours[row.law], width=1.0, dash=style, label=row.label)
        axes.band(found.speed, lo, hi, INK, opacity=0.22, label=band)
        axes.line(found.speed, found.friction, INK, width=1.8, label=label)
        drawn.append(axes)
    return picture("measured-curve", WIDE, height, drawn)


def orbits(ranking: Ranking) -> str:
    """Draw the phase portrait once a law: one cycle of each run as measured, and over it the law, with its error.

    It is the cycle in the middle of all by the best law's error.
    """
    rows, colours = by_law(ranking), colours_of(ranking)
    columns = min(len(rows), 3)
    lines = math.ceil(len(rows) / columns)
    typical = [_typical_cycle(side.best) for side in ranking.sides]
    measured = [measured_orbit(side, cycle) for side, cycle in zip(ranking.sides, typical, strict=True)]
    fitted = [
        [
            part
            for side, cycle in zip(ranking.sides, typical, strict=True)
            for part in fitted_orbits(side.row(row.law), side.motion.sign, cycle.number)
        ]
        for row in rows
    ]
    x, v = (np.concatenate(own) for own in zip(*measured, *itertools.chain(*fitted), strict=True))
    both, width, height = (AxisScale.around(x), AxisScale.around(v)), (HALF - BESIDE) / 3, 172.0
    drawn = []
    for place, row in enumerate(rows):
        line, column = divmod(place, columns)
        left, first = column * width + (BESIDE if column else 0.0), column == 0
        axes = Axes(left, line * height, width + (BESIDE if first else 0.0), height, *both, rows=0)
        axes.title = f"{row.label}{' *' if row.in_set else ''}: {pretty(format_length(row.rms_m))}"
        axes.margin += 0.0 if first else -BESIDE
        axes.xlabel = "position (mm)" if place + columns >= len(rows) else ""
        axes.ylabel = "velocity (m/s)" if first else ""
        axes.trace(measured, MEASURED, width=4.0, opacity=0.6)
        axes.trace(fitted[place], colours[row.law], width=1.2)
        drawn.append(axes)
    return picture("orbits", HALF, lines * height, drawn)


def _typical_cycle(row: LawResult) -> Cycle:
    order = np.argsort(row.fit.cycle_rms, kind="stable")
    return row.fit.cycles[int(order[order.size // 2])]


def measured_orbit(side: Ranking, cycle: Cycle | None = None) -> tuple[Array, Array]:
    """Return position (mm) and velocity (m/s) of a run as recorded, or of one cycle of it."""
    motion, own = side.motion, slice(None)
    if cycle is not None:
        parts = [part for part in (cycle.stick, cycle.slip) if part[1] > part[0]]
        own = slice(min(first for first, _ in parts), max(end for _, end in parts))
    return MM * motion.sign * motion.position[own], motion.sign * motion.velocity[own]


def fitted_orbits(row: LawResult, sign: float, number: int | None = None) -> list[tuple[Array, Array]]:
    """Return position (mm) and velocity (m/s) of a law in each window of its fit, or in those of one cycle."""
    windows = row.fit.windows
    model = windows.position + row.fit.residual
    parts = [
        slice(first, first + count)
        for cycle, _, first, count, *_ in windows.table
        if count > 2 and number in (None, row.fit.cycles[cycle].number)
    ]
    return [(MM * sign * model[own], sign * np.gradient(model[own], windows.time[own])) for own in parts]


def departures(adequacy: Adequacy) -> str:
    """Draw the departures as bars, in standard deviations."""
    found = adequacy.departures[::-1]
    names = tuple(one.name for one in found)
    sigmas = np.array([one.sigmas for one in found])
    height = 52.0 + 26 * len(found)
    axes = Axes(
        0, 0, NARROW, height, AxisScale(0.0, 1.2 * float(sigmas.max())), AxisScale(-0.6, len(found) - 0.4, names=names)
    )
    axes.rows, axes.margin = 0, 14.0 + max(text_width(name, SMALL) for name in names)
    axes.xlabel = "standard deviations (share of the misfit explained)"
    for place, one in enumerate(found):
        edge = np.array([place - 0.3, place + 0.3])
        axes.band(np.array([0.0, one.sigmas]), edge[[0, 0]], edge[[1, 1]], COLOURS[2], opacity=0.8)
        axes.text(one.sigmas, place, f"{100 * one.explained:.0f} %")
    return picture("departures", NARROW, height, [axes])
