"""Pictures of what a record shows beyond the ranking: the measured curve, the orbits of all laws, the departures."""

import itertools
import math

import numpy as np

from fitting.adequacy.result import Adequacy
from fitting.drawing import curves
from fitting.drawing.palette import COLOURS, INK, MEASURED, NARROW, WIDE, law_colours, law_dashes
from fitting.report.chart import SMALL, Axes, legend_rows, picture, text_width
from fitting.report.motion_plot import BROAD, PALE, fitted_motion, measured_motion, typical_cycle
from fitting.report.scale import AxisScale
from fitting.report.symbols import pretty
from fitting.selection.result import LawResult, Ranking
from stickslip.compute.arrays import Array
from stickslip.output.lengths import format_length

HALF, BESIDE = 560.0, 18.0  # px: of the picture of orbits, and for the name of its ordinate
ZOOM = 0.15  # of the largest slip speed: there laws and ramps differ most


def by_law(ranking: Ranking) -> list[LawResult]:
    """Return the rows in the order of their laws: the six by number, then formulas, best first."""
    return sorted(ranking.rows, key=lambda row: row.law if isinstance(row.law, int) else len(COLOURS) + 1)


def colours_of(ranking: Ranking) -> dict[int | str, str]:
    return law_colours(row.law for row in ranking.rows)


def measured_curve(ranking: Ranking) -> str:
    """Draw friction against relative speed: the measured curve with its band, over the laws, and a zoom near 0.

    Compatible laws are heavier; an undetermined level of friction is that of the measured curve.
    """
    curve = ranking.adequacy.curve
    if curve is None:
        raise ValueError("no curve was measured")
    height, drawn, colours, dashes = 320.0, [], colours_of(ranking), law_dashes(row.law for row in ranking.rows)
    lo, hi, band = curve.lo, curve.hi, f"{100 * curve.confidence:g} % band"
    label = "measured, without a law"
    if not curve.level_known:  # the band of every level would hide the shape
        lo, hi, band = curve.friction - curve.shape_half, curve.friction + curve.shape_half, f"{band} of the shape"
        label += ", level not determined"
    rows = max(2, legend_rows([*(row.label for row in ranking.rows), band, label], WIDE / 2))
    for place, reach in enumerate((float(curve.speed[-1]), ZOOM * float(curve.speed[-1]))):
        seen = curve.speed <= 1.02 * reach
        shown = seen if seen.sum() > 2 else np.ones_like(seen)
        grid = np.linspace(0.0, 1.02 * reach, 400)
        forces = {row.law: _force(ranking, row, grid) for row in by_law(ranking)}
        members = [forces[row.law] for row in ranking.rows if row.in_set]
        low = float(min([lo[shown].min(), *(force.min() for force in members)]))
        high = float(max([hi[shown].max(), *(force.max() for force in members)]))
        tall = AxisScale(low - 0.25 * (high - low), high + 0.35 * (high - low))
        axes = Axes(place * WIDE / 2, 0, WIDE / 2, height, AxisScale(0.0, 1.02 * reach), tall, rows=rows)
        axes.title = "low speeds" if place else "all speeds"
        axes.xlabel, axes.ylabel = "relative speed (m/s)", f"friction ({ranking.adequacy.unit})"
        for row in by_law(ranking):
            width = 1.8 if row.in_set else 1.0
            axes.line(grid, forces[row.law], colours[row.law], width=width, dash=dashes[row.law], label=row.label)
        axes.band(curve.speed, lo, hi, INK, opacity=0.22, label=band)
        axes.line(curve.speed, curve.friction, INK, width=1.8, label=label)
        drawn.append(axes)
    about = "Friction against relative speed: measured without a law, with its band, and the curves of the fitted laws."
    return picture("measured-curve", WIDE, height, drawn, about)


def _force(ranking: Ranking, row: LawResult, speed: Array) -> Array:
    """Return a law's friction at relative speeds, at the level of the measured curve if undetermined."""
    force = np.abs(curves.curve(row.fit, ranking.motion, -speed))
    curve = ranking.adequacy.curve
    if curve is None or curve.level_known:
        return force
    at = np.abs(curves.curve(row.fit, ranking.motion, -curve.speed))
    return force + float(np.mean(curve.friction - at))


def orbits(ranking: Ranking) -> str:
    """Draw phase portraits of the laws over a measured cycle of each run, with the error.

    It is the cycle with the median error of the best law.
    """
    rows = [row for row in by_law(ranking) if row.asked or row.in_set or row.law == ranking.best.law]
    colours, columns = colours_of(ranking), min(len(rows), 3)
    lines = math.ceil(len(rows) / columns)
    typical = [typical_cycle(side.best) for side in ranking.sides]
    measured = [measured_motion(side, cycle)[1:] for side, cycle in zip(ranking.sides, typical, strict=True)]
    fitted = [
        [
            part[1:]
            for side, cycle in zip(ranking.sides, typical, strict=True)
            for part in fitted_motion(side.row(row.law), side.motion.sign, cycle.number)
        ]
        for row in rows
    ]
    x, v = (np.concatenate(parts) for parts in zip(*measured, *itertools.chain(*fitted), strict=True))
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
        axes.trace(measured, MEASURED, width=BROAD, opacity=PALE)
        axes.trace(fitted[place], colours[row.law], width=1.2)
        drawn.append(axes)
    about = "Phase portraits of one cycle: as measured, and over it each law as fitted."
    return picture("orbits", HALF, lines * height, drawn, about)


def departures(adequacy: Adequacy) -> str:
    """Draw the departures as bars, in standard deviations."""
    shown = adequacy.departures[::-1]
    names = tuple(one.name for one in shown)
    sigmas = np.array([one.sigmas for one in shown])
    height = 52.0 + 26 * len(shown)
    axes = Axes(
        0, 0, NARROW, height, AxisScale(0.0, 1.2 * float(sigmas.max())), AxisScale(-0.6, len(shown) - 0.4, names=names)
    )
    axes.rows, axes.margin = 0, 14.0 + max(text_width(name, SMALL) for name in names)
    axes.xlabel = "standard deviations (share of the misfit explained)"
    for place, one in enumerate(shown):
        edge = np.array([place - 0.3, place + 0.3])
        axes.band(np.array([0.0, one.sigmas]), edge[[0, 0]], edge[[1, 1]], COLOURS[2], opacity=0.8)
        axes.text(one.sigmas, place, f"{100 * one.explained:.0f} %")
    about = f"Bars of departures, in standard deviations, the largest {adequacy.departures[0].name}."
    return picture("departures", NARROW, height, [axes], about)
