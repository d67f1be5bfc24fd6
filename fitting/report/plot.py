"""Pictures of a report as SVG: portrait, friction curves, residuals, evidence, levels, cost, break-aways."""

import numpy as np

from daq.compute.arrays import Array
from fitting.drawing import curves
from fitting.drawing.palette import COLOURS, DASH, INK, MEASURED, NARROW, WIDE
from fitting.report import adequacy_plot
from fitting.report.chart import Axes, picture
from fitting.report.scale import AxisScale
from fitting.selection.result import LawResult, Ranking
from processing.statistics import StickSlipStatistics, shown_length

MOST_POINTS = 12_000
BAND = 2.0  # standard deviations of the noise: 95 % of the residuals of a law that describes the record
SPREAD = 99.5  # percentile of residuals and frictions, beyond which the axes may cut some off
ALIKE = 0.045  # of the axes: points that near are named by one label
BINS = (4, 30)  # of the distribution: fewest and most; between them the square root of the number of break-aways


def portrait(ranking: Ranking) -> str:
    """Draw velocity against position: the whole record, and the best law's motion in every window."""
    motion = ranking.motion
    x, v = 100 * motion.sign * motion.position, 100 * motion.sign * motion.velocity
    axes = Axes(
        0, 0, NARROW, 350, AxisScale.around(x), AxisScale.around(v), xlabel="position (cm)", ylabel="velocity (cm/s)"
    )
    axes.trace([(x, v)], MEASURED, width=1.6, opacity=0.6, label="measured")
    if ranking.rows:
        best = ranking.best
        axes.trace(adequacy_plot.fitted_orbits(best, motion.sign), COLOURS[best.law], label=f"law {best.law}, fitted")
        axes.level(100 * best.parameters["v_dr"].value, INK, dash=DASH, label="belt speed")
    return picture("portrait", NARROW, 350, [axes])


def friction(ranking: Ranking) -> str:
    """Draw friction against relative velocity: the measured points and every law's curve, the best one heaviest."""
    motion = ranking.motion
    w, force, _ = curves.points(ranking.best.fit, motion)
    thin = slice(None, None, max(1, w.size // MOST_POINTS))
    grid = curves.speeds(motion)
    drawn = {row.law: curves.curve(row.fit, motion, grid) for row in ranking.rows}
    top = max(float(np.nanmax(np.abs(drawn[ranking.best.law]))), float(np.percentile(np.abs(force), SPREAD)))
    label = f"friction ({curves.unit(motion)})"
    axes = Axes(0, 0, NARROW, 350, AxisScale.around(100 * grid), AxisScale(-1.3 * top, 1.3 * top), ylabel=label, rows=2)
    axes.xlabel = "relative velocity: mass minus belt (cm/s)"
    axes.level(0, INK)
    axes.level(0, INK, upright=True)
    for row in sorted(ranking.rows, key=lambda row: (row is ranking.best, row.law)):
        values = np.where(grid == 0, np.nan, drawn[row.law])
        heavy = row is ranking.best
        width, dash = (2.2, "") if heavy else (1.0, "" if row.in_set else DASH)
        axes.line(100 * grid, values, COLOURS[row.law], width=width, dash=dash, label=f"law {row.law}")
    axes.cloud(100 * w[thin], force[thin], MEASURED, opacity=0.35, label="measured")
    return picture("friction", NARROW, 350, [axes])


def residuals(ranking: Ranking) -> str:
    """Draw model minus measurement with the band of the noise: the best law over time and phase, a rival over phase."""
    best = ranking.best
    rival = next((row for row in ranking.rows[1:] if not row.in_set and row.rms_m > 1.2 * best.rms_m), None)
    panels = [(best, True), (best, False)] + ([(rival, False)] if rival is not None else [])
    parts = np.array([1.25, *[1.0] * (len(panels) - 1)])
    widths = WIDE * parts / parts.sum()
    drawn = []
    for (row, whole), left, width in zip(panels, np.cumsum(widths) - widths, widths, strict=True):
        fit = row.fit
        time = fit.windows.time if whole else _since_break_away(row)
        noise = 1e6 * BAND * ranking.adequacy.noise_m
        reach = 1.4 * max(1e6 * float(np.percentile(np.abs(fit.residual), SPREAD)), noise)
        axes = Axes(float(left), 0, float(width), 265, AxisScale.around(time), AxisScale(-reach, reach))
        axes.title = f"law {row.law}, {'whole record' if whole else 'all cycles'}"
        axes.xlabel = "time (s)" if whole else "time since break-away (s)"
        axes.ylabel = "residual (um)"
        axes.cloud(time, 1e6 * fit.residual, COLOURS[row.law], label="model minus measurement")
        ends, level = np.array([axes.x.low, axes.x.high]), np.full(2, noise)
        axes.band(ends, -level, level, INK, opacity=0.16, label="noise, ±2 sd")
        drawn.append(axes)
    return picture("residuals", WIDE, 265, drawn)


def evidence(ranking: Ranking) -> str:
    """Draw each cycle's error under each law: what the ranking is made of."""
    rows = list(reversed(ranking.rows))
    errors = [1e6 * row.fit.cycle_rms for row in rows]
    names = tuple(f"law {row.law}{' *' if row.in_set else ''}" for row in rows)
    height = 60.0 + 30 * len(rows)
    places = AxisScale(-0.6, len(rows) - 0.4, names=names)
    axes = Axes(0, 0, NARROW, height, AxisScale.around(np.concatenate(errors), log=True), places, rows=0)
    axes.xlabel = "error of each cycle (um rms); dot: their geometric mean"
    for place, (row, own) in enumerate(zip(rows, errors, strict=True)):
        axes.marks(own, np.full(own.size, place), COLOURS[row.law], sign="|", size=8)
        axes.marks(np.exp([np.mean(np.log(own))]), np.array([place]), COLOURS[row.law], size=4)
    return picture("evidence", NARROW, height, [axes])


def cost(ranking: Ranking) -> str:
    """Draw each law's error against the CPU time of its fit."""
    time, error = np.array([row.cpu_s for row in ranking.rows]), 1e6 * np.array([row.rms_m for row in ranking.rows])
    across = AxisScale(0.0, 1.12 * max(float(time.max()), 1e-3))
    axes = Axes(0, 0, NARROW, 230, across, AxisScale.around(error, log=True, edge=0.12), rows=0)
    axes.xlabel, axes.ylabel = "CPU time of the fit (s)", "error (um rms)"
    places = np.stack([axes.x.place(time), axes.y.place(error)], axis=1)
    named: list[list[int]] = []
    for k, row in enumerate(ranking.rows):
        axes.marks(time[k : k + 1], error[k : k + 1], COLOURS[row.law], size=4.0 if row.in_set else 3.0)
        near = next((own for own in named if np.max(np.abs(places[own[0]] - places[k])) < ALIKE), None)
        if near is None:
            named.append([k])
        else:
            near.append(k)
    for own in named:
        laws = ", ".join(str(ranking.rows[k].law) for k in sorted(own, key=lambda k: ranking.rows[k].law))
        axes.text(float(time[own].max()), float(error[own].max()), laws, (7.0, -4.0))
    return picture("cost", NARROW, 230, [axes])


def levels(ranking: Ranking) -> str:
    """Draw the friction level of each cycle at break-away and in the slip, against time."""
    events = [event for event in ranking.events if np.isfinite(event.kinetic_scale)]
    time = np.array([event.t for event in events])
    above = np.array([event.break_away_level for event in events])
    sliding = np.array([event.kinetic_scale for event in events])
    axes = Axes(0, 0, NARROW, 270, AxisScale.around(time), AxisScale.around(np.concatenate([above, sliding])))
    axes.xlabel, axes.ylabel = "time (s)", "friction level / mean sliding level"
    for values, colour, sign, label in ((above, COLOURS[4], "c", "break-away"), (sliding, COLOURS[2], "o", "sliding")):
        axes.line(time, values, colour, width=0.5)
        axes.marks(time, values, colour, sign=sign, label=label)
    return picture("levels", NARROW, 270, [axes])


def break_aways(counted: StickSlipStatistics, unit: str) -> str:
    """Draw the break-away levels: their distribution, their trend, and level against stick time."""
    factor, shown = shown_length(unit)
    time, level, stick = counted.column("t"), factor * counted.column("break_away_m"), counted.column("stick_s")
    label, width, height = f"break-away level ({shown})", WIDE / 3, 260.0
    number, edges = np.histogram(level, int(np.clip(np.sqrt(level.size), *BINS)))
    most = AxisScale(0.0, max(1.1 * float(number.max()), 1.5))
    distribution = Axes(
        0, 0, width, height, AxisScale.around(edges), most, "distribution", label, "number of break-aways"
    )
    distribution.bars(edges[:-1], edges[1:], number.astype(float), COLOURS[2])
    mean = float(level.mean())
    distribution.level(mean, COLOURS[4], dash=DASH, upright=True, label=f"mean {mean:.4g} {shown}")
    tall = AxisScale.around(level)
    trend = Axes(width, 0, width, height, AxisScale.around(time), tall, "against time", "time (s)", label)
    trend.marks(time, level, COLOURS[2])
    summary = counted.summary("break_away_m")
    if summary is not None and summary["trend_per_s"] is not None:
        slope, ends = factor * summary["trend_per_s"], np.array([time.min(), time.max()])
        line = mean + slope * (ends - time.mean())
        trend.line(ends, line, COLOURS[4], label=f"trend {slope:+.2g} {shown}/s")
    against = Axes(
        2 * width, 0, width, height, AxisScale.around(stick), tall, "against stick time", "stick time (s)", label
    )
    against.marks(stick, level, COLOURS[2])
    return picture("break-aways", WIDE, height, [distribution, trend, against])


def _since_break_away(row: LawResult) -> Array:
    time, rows = row.fit.windows.time, row.fit.rows
    phase = np.empty(time.size)
    for part, cycle in zip(rows, row.fit.cycles, strict=True):
        phase[part] = time[part] - cycle.break_away
    return phase


PICTURES = (portrait, friction, residuals, evidence, levels, cost)


def draw(ranking: Ranking, counted: StickSlipStatistics) -> dict[str, str]:
    """Return every picture of the report as an ``<svg>`` element, by name.

    `break_aways` where there are statistics; of a record that no law comes near the portrait alone besides.
    """
    shown = PICTURES if ranking.rows else (portrait,)
    drawn = {one.__name__: one(ranking) for one in shown}
    if ranking.rows:
        drawn["orbits"] = adequacy_plot.orbits(ranking)
    if ranking.adequacy.curve is not None:
        drawn["measured_curve"] = adequacy_plot.measured_curve(ranking)
    if ranking.adequacy.departures:
        drawn["departures"] = adequacy_plot.departures(ranking.adequacy)
    if counted.rows("m"):
        drawn["break_aways"] = break_aways(counted, "m")
    return drawn
