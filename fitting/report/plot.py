"""Pictures of a report as SVG: portrait, friction curves, residuals, evidence, levels, cost, break-aways.

Each shows all runs of a joint fit, each run in its own colour, dashes and marks.
"""

from collections.abc import Sequence

import numpy as np

from fitting.drawing import curves
from fitting.drawing.palette import (
    COLOURS,
    DASH,
    INK,
    MEASURED,
    NARROW,
    WIDE,
    law_dashes,
    run_colour,
    run_dash,
    run_mark,
)
from fitting.report import adequacy_plot, motion_plot
from fitting.report.adequacy_plot import by_law, colours_of
from fitting.report.chart import LEFT, SMALL, Axes, legend_rows, picture, text_width
from fitting.report.motion_plot import BROAD, PALE, PALE_RUN, begins, fitted_motion, measured_motion, time_label
from fitting.report.scale import AxisScale
from fitting.selection.result import LawResult, Ranking
from processing.statistics import StickSlipStatistics, pooled
from stickslip.compute.arrays import Array
from stickslip.output.lengths import shown_length

MOST_POINTS = 12_000
BAND = 2.0  # standard deviations of the noise: 95 % of the residuals of a law that describes the record
SPREAD = 99.5  # percentile of residuals and frictions, beyond which the axes may cut some off
ALIKE = 0.045  # of the axes: points that near are named by one label
RESIDUAL, NOISE = "model minus measurement", "noise, ±2 sd"
BINS = (4, 30)  # of the distribution: fewest and most; between them the square root of the number of break-aways


def portrait(ranking: Ranking) -> str:
    """Draw velocity against position of the whole record, and the best law's motion in every window."""
    runs = [measured_motion(side)[1:] for side in ranking.sides]
    x, v = (np.concatenate(parts_of) for parts_of in zip(*runs, strict=True))
    legend = _legend(ranking, MEASURED, "measured")
    fitted = [f"{ranking.best.label}, fitted"] if ranking.rows else []
    rows = legend_rows([label for _, label in legend] + (fitted and [*fitted, "belt speed"]), NARROW)
    axes = Axes(0, 0, NARROW, 350, AxisScale.around(x), AxisScale.around(v), rows=rows)
    axes.xlabel, axes.ylabel = "position (mm)", "velocity (m/s)"
    opacity = PALE_RUN if ranking.runs else PALE
    for number, (orbit, (colour, label)) in enumerate(zip(runs, legend, strict=True), start=1):
        axes.trace([orbit], colour, width=BROAD, opacity=opacity, dash=run_dash(number), label=label)
    if ranking.rows:
        parts = [part[1:] for side in ranking.sides for part in fitted_motion(side.best, side.motion.sign)]
        axes.trace(parts, INK, width=0.7, label=fitted[0])
        named = "belt speed"
        for side, (colour, _) in zip(ranking.sides, _legend(ranking, INK, ""), strict=True):
            axes.level(side.best.parameters["v_dr"].value, colour, dash=DASH, label=named)
            named = ""
    about = "Velocity against position: as measured, and the motion of the best law."
    return picture("portrait", NARROW, 350, [axes], about)


def _legend(ranking: Ranking, colour: str, label: str) -> list[tuple[str, str]]:
    """Return colour and label of each run: the arguments for a single run, else those of its number."""
    if not ranking.runs:
        return [(colour, label)]
    return [(run_colour(number), f"run {number}") for number in range(1, len(ranking.runs) + 1)]


def friction(ranking: Ranking) -> str:
    """Draw friction against relative velocity: the measured points and every law's curve, the best one heaviest."""
    motion = ranking.motion
    clouds = [curves.points(side.best.fit, side.motion)[:2] for side in ranking.sides]
    force = np.concatenate([forces for _, forces in clouds])
    most = MOST_POINTS // len(clouds)
    grid = curves.speeds_of_all([side.motion for side in ranking.sides])
    drawn = {row.law: curves.curve(row.fit, motion, grid) for row in ranking.rows}
    top = max(float(np.nanmax(np.abs(drawn[ranking.best.law]))), float(np.percentile(np.abs(force), SPREAD)))
    legend = _legend(ranking, MEASURED, "measured")
    label = f"friction ({curves.unit(motion)})"
    rows = legend_rows([row.label for row in ranking.rows] + [named for _, named in legend], NARROW)
    colours, dashes = colours_of(ranking), law_dashes(row.law for row in ranking.rows)
    axes = Axes(0, 0, NARROW, 350, AxisScale.around(grid), AxisScale(-1.3 * top, 1.3 * top), rows=rows)
    axes.xlabel, axes.ylabel = "relative velocity: mass minus belt (m/s)", label
    axes.level(0, INK)
    axes.level(0, INK, upright=True)
    for row in sorted(by_law(ranking), key=lambda row: row is ranking.best):
        values = np.where(grid == 0, np.nan, drawn[row.law])
        heavy = row is ranking.best
        width = 2.4 if heavy else 1.6 if row.in_set else 1.0
        axes.line(grid, values, colours[row.law], width=width, dash=dashes[row.law], label=row.label)
    for (w, forces), (colour, label) in zip(clouds, legend, strict=True):
        thin = slice(None, None, max(1, w.size // most))
        axes.cloud(w[thin], forces[thin], colour, opacity=0.35, label=label)
    about = "Friction against relative velocity: points of the force balance, and the curves of the laws."
    return picture("friction", NARROW, 350, [axes], about)


def residuals(ranking: Ranking) -> str:
    """Draw model minus measurement with the noise band: the best law over time and phase, a rival over phase."""
    best = ranking.best
    others = (row for row in ranking.rows if row is not best and not row.in_set)
    rival, colours = next((row for row in others if row.rms_m > 1.2 * best.rms_m), None), colours_of(ranking)
    panels = [(best, True), (best, False)] + ([(rival, False)] if rival is not None else [])
    parts = np.array([1.25, *[1.0] * (len(panels) - 1)])
    widths = WIDE * parts / parts.sum()
    named = [label for _, label in _legend(ranking, "", RESIDUAL)]
    rows = legend_rows([*named, NOISE], float(widths.min()))
    drawn = []
    for (row, whole), left, width in zip(panels, np.cumsum(widths) - widths, widths, strict=True):
        sides = [side.row(row.law) for side in ranking.sides]
        times = [
            one.motion.begin + one.fit.windows.time + begin if whole else _since_break_away(one)
            for one, begin in zip(sides, begins(ranking), strict=True)
        ]
        noise = 1e6 * BAND * ranking.adequacy.noise_m
        reach = 1.4 * max(1e6 * float(np.percentile(np.abs(row.fit.residual), SPREAD)), noise)
        across = AxisScale.around(np.concatenate(times))
        axes = Axes(float(left), 0, float(width), 265, across, AxisScale(-reach, reach), rows=rows)
        axes.title = f"{row.label}, {_whole(ranking) if whole else 'all cycles'}"
        axes.xlabel = time_label(ranking) if whole else "time since break-away (s)"
        axes.ylabel = "residual (µm)"
        for one, time, (colour, label) in zip(sides, times, _legend(ranking, colours[row.law], RESIDUAL), strict=True):
            axes.cloud(time, 1e6 * one.fit.residual, colour, label=label)
        ends, level = np.array([axes.x.low, axes.x.high]), np.full(2, noise)
        axes.band(ends, -level, level, INK, opacity=0.16, label=NOISE)
        drawn.append(axes)
    about = "Residuals against time and against the time since the break-away, with the band of the noise."
    return picture("residuals", WIDE, 265, drawn, about)


def _whole(ranking: Ranking) -> str:
    return "all runs" if ranking.runs else "whole record"


def evidence(ranking: Ranking) -> str:
    """Draw each cycle's error under each law, the basis of the ranking."""
    rows = list(reversed(ranking.rows))
    errors = [1e6 * row.fit.cycle_rms for row in rows]
    names = tuple(f"{row.label}{' *' if row.in_set else ''}" for row in rows)
    colours = colours_of(ranking)
    height = 60.0 + 30 * len(rows)
    places = AxisScale(-0.6, len(rows) - 0.4, names=names)
    axes = Axes(0, 0, NARROW, height, AxisScale.around(np.concatenate(errors), log=True), places, rows=0)
    if ranking.rivals:
        axes.margin = max(LEFT, 14.0 + max(text_width(name, SMALL) for name in names))
    axes.xlabel = "error of each cycle (µm rms); dot: their geometric mean"
    for place, (row, cycles) in enumerate(zip(rows, errors, strict=True)):
        axes.marks(cycles, np.full(cycles.size, place), colours[row.law], sign="|", size=8)
        axes.marks(np.exp([np.mean(np.log(cycles))]), np.array([place]), colours[row.law], size=4)
    about = "Error of each cycle under each law."
    return picture("evidence", NARROW, height, [axes], about)


def cost(ranking: Ranking) -> str:
    """Draw each law's error against the CPU time of its fit."""
    time, error = np.array([row.cpu_s for row in ranking.rows]), 1e6 * np.array([row.rms_m for row in ranking.rows])
    across = AxisScale(0.0, 1.12 * max(float(time.max()), 1e-3))
    axes = Axes(0, 0, NARROW, 230, across, AxisScale.around(error, log=True, edge=0.12), rows=0)
    axes.xlabel, axes.ylabel = "CPU time of the fit (s)", "error (µm rms)"
    places = np.stack([axes.x.place(time), axes.y.place(error)], axis=1)
    named: list[list[int]] = []
    colours, numbered = colours_of(ranking), [row.law for row in by_law(ranking)]
    for k, row in enumerate(ranking.rows):
        axes.marks(time[k : k + 1], error[k : k + 1], colours[row.law], size=4.0 if row.in_set else 3.0)
        near = next((group for group in named if np.max(np.abs(places[group[0]] - places[k])) < ALIKE), None)
        if near is None:
            named.append([k])
        else:
            near.append(k)
    for group in named:
        laws = ", ".join(str(law) for law in sorted((ranking.rows[k].law for k in group), key=numbered.index))
        axes.text(float(time[group].max()), float(error[group].max()), laws, (7.0, -4.0))
    about = "Error of each law against the CPU time of its fit."
    return picture("cost", NARROW, 230, [axes], about)


def levels(ranking: Ranking) -> str:
    """Draw the friction level of each cycle at break-away and in the slip, against time."""
    runs = []
    for side, begin in zip(ranking.sides, begins(ranking), strict=True):
        events = [event for event in side.events if np.isfinite(event.kinetic_scale)]
        columns = [(begin + event.t, event.break_away_level, event.kinetic_scale) for event in events]
        runs.append(np.array(columns).reshape(-1, 3))
    every = np.concatenate(runs)
    axes = Axes(0, 0, NARROW, 270, AxisScale.around(every[:, 0]), AxisScale.around(every[:, 1:].ravel()))
    axes.xlabel, axes.ylabel = time_label(ranking), "friction level / mean sliding level"
    for column, colour, sign, label in ((1, COLOURS[4], "c", "break-away"), (2, COLOURS[2], "o", "sliding")):
        for run in runs:
            axes.line(run[:, 0], run[:, column], colour, width=0.5)
        axes.marks(every[:, 0], every[:, column], colour, sign=sign, label=label)
    about = "Friction level of each cycle at break-away and in the slip, against time."
    return picture("levels", NARROW, 270, [axes], about)


def break_aways(statistics: Sequence[StickSlipStatistics], ranking: Ranking, unit: str) -> str:
    """Draw the break-away levels: their distribution, their trend, and level against stick time."""
    counted, shown_as = pooled(statistics), _legend(ranking, COLOURS[2], "")
    factor, shown = shown_length(unit)
    times = [begin + run.column("t") for begin, run in zip(begins(ranking), statistics, strict=True)]
    time, level, stick = np.concatenate(times), factor * counted.column("break_away_m"), counted.column("stick_s")
    label, width, height = f"break-away level ({shown})", WIDE / 3, 260.0
    number, edges = np.histogram(level, int(np.clip(np.sqrt(level.size), *BINS)))
    most, rows = AxisScale(0.0, max(1.1 * float(number.max()), 1.5)), legend_rows([name for _, name in shown_as], width)
    distribution = Axes(
        0, 0, width, height, AxisScale.around(edges), most, "distribution", label, "number of break-aways", rows
    )
    distribution.bars(edges[:-1], edges[1:], number.astype(float), COLOURS[2])
    mean = float(level.mean())
    distribution.level(mean, COLOURS[4], dash=DASH, upright=True, label=f"mean {mean:.4g} {shown}")
    tall = AxisScale.around(level)
    trend = Axes(width, 0, width, height, AxisScale.around(time), tall, "against time", ylabel=label, rows=rows)
    trend.xlabel = time_label(ranking)
    against = Axes(
        2 * width, 0, width, height, AxisScale.around(stick), tall, "against stick time", "stick time (s)", label, rows
    )
    for place, (run, when, (colour, named)) in enumerate(zip(statistics, times, shown_as, strict=True), start=1):
        levels_of_run, sign = factor * run.column("break_away_m"), run_mark(place)
        trend.marks(when, levels_of_run, colour, sign=sign, label=named)
        against.marks(run.column("stick_s"), levels_of_run, colour, sign=sign, label=named)
    summary = counted.summary("break_away_m")
    if summary is not None and summary["trend_per_s"] is not None:
        slope, reach = factor * summary["trend_per_s"], np.array([time.min(), time.max()])
        trend.line(reach, mean + slope * (reach - time.mean()), COLOURS[4], label=f"trend {slope:+.2g} {shown}/s")
    about = "Break-away levels: their distribution, and against time and stick time."
    return picture("break-aways", WIDE, height, [distribution, trend, against], about)


def _since_break_away(row: LawResult) -> Array:
    time, rows = row.fit.windows.time, row.fit.rows
    phase = np.empty(time.size)
    for part, cycle in zip(rows, row.fit.cycles, strict=True):
        phase[part] = time[part] - cycle.break_away
    return phase


PICTURES = (motion_plot.cycle, motion_plot.record, portrait, friction, residuals, evidence, levels, cost)
WITHOUT_LAW = (motion_plot.record, portrait)


def draw(ranking: Ranking, statistics: Sequence[StickSlipStatistics]) -> dict[str, str]:
    """Return the pictures of the report as ``<svg>`` elements by name; without a law only the measured ones."""
    shown = PICTURES if ranking.rows else WITHOUT_LAW
    drawn = {one.__name__: one(ranking) for one in shown}
    if ranking.rows:
        drawn["orbits"] = adequacy_plot.orbits(ranking)
    if ranking.adequacy.curve is not None:
        drawn["measured_curve"] = adequacy_plot.measured_curve(ranking)
    if ranking.adequacy.departures:
        drawn["departures"] = adequacy_plot.departures(ranking.adequacy)
    if pooled(statistics).rows("m"):
        drawn["break_aways"] = break_aways(statistics, ranking, "m")
    return drawn
