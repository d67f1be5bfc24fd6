"""Pictures of a report, each a matplotlib Figure: portrait, friction curves, residuals, evidence, levels, cost.

The picture of the break-aways is that of `process inspect`.

matplotlib is imported here and nowhere else in `fitting`; the look is that of processing's style file.
"""

import base64
import io
import math
import re
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from daq.compute.arrays import Array
from fitting.data.cycles import Cycle
from fitting.report import adequacy_plot, curves
from fitting.report.palette import COLOURS, INK, MEASURED
from fitting.selection.result import Ranking
from processing.plot import STYLE, break_aways
from processing.statistics import StickSlipStatistics

RESOLUTION = 220  # dots per inch of the clouds, which are pictures inside the vector drawing
SMALL_RESOLUTION = 120  # of small multiples: at the full one they are a quarter of the page's size
PNG = re.compile(r"(?<=data:image/png;base64,)[A-Za-z0-9+/=\s]+")
MOST_POINTS = 12_000


def svg(figure: Figure, resolution: int = RESOLUTION) -> str:
    """Return the figure as an ``<svg>`` element to stand inside a page: no prologue, no outside reference.

    Its clouds have 256 colours: a page of noisy points has 0.3 MB with them, 0.7 MB in full colour.
    """
    text = io.StringIO()
    figure.savefig(text, format="svg", dpi=resolution, metadata={"Date": None, "Creator": None})
    drawn = text.getvalue()
    return PNG.sub(_in_few_colours, drawn[drawn.index("<svg") :])


def _in_few_colours(found: re.Match[str]) -> str:
    from PIL import Image

    packed = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(found[0]))) as image:
        few = image.convert("RGBA").quantize(256, method=Image.Quantize.FASTOCTREE)
    few.save(packed, "png", optimize=True)
    return base64.b64encode(packed.getvalue()).decode()


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    """Return an empty figure, sizes in inches, and its axes."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def portrait(ranking: Ranking) -> Figure:
    """Draw velocity against position: the whole record, and the best law's motion in every window."""
    motion = ranking.motion
    figure, axes = _figure(5.4, 4.4)
    x, v = motion.sign * motion.position, motion.sign * motion.velocity
    axes.plot(100 * x, 100 * v, color=MEASURED, lw=1.6, alpha=0.55, label="measured", rasterized=True)
    axes.set(xlabel="position (cm)", ylabel="velocity (cm/s)")
    if not ranking.rows:
        return figure
    best = ranking.best
    fit = best.fit
    model = fit.windows.position + fit.residual
    for number, (_, _, first, count, *_) in enumerate(fit.windows.table):
        part = slice(first, first + count)
        if count < 3:
            continue
        speed = np.gradient(model[part], fit.windows.time[part])
        label = f"law {best.law}, fitted" if number == 0 else None
        orbit = 100 * motion.sign * np.stack([model[part], speed])
        axes.plot(*orbit, color=COLOURS[best.law], lw=0.7, label=label, rasterized=True)
    axes.axhline(100 * best.parameters["v_dr"].value, color=INK, lw=0.7, ls=(0, (4, 3)), label="belt speed")
    axes.legend(loc="best")
    return figure


def friction(ranking: Ranking) -> Figure:
    """Draw friction against relative velocity: the measured points and every law's curve, the best one heaviest."""
    motion = ranking.motion
    figure, axes = _figure(5.4, 4.4)
    w, force, _ = curves.points(ranking)
    thin = slice(None, None, max(1, w.size // MOST_POINTS))
    cloud: dict[str, Any] = {"ms": 2.2, "mew": 0, "alpha": 0.35, "rasterized": True, "zorder": 4}
    axes.plot(100 * w[thin], force[thin], ".", color=MEASURED, label="measured", **cloud)
    grid = curves.speeds(motion)
    top = 0.0
    for row in sorted(ranking.rows, key=lambda row: (row is ranking.best, row.law)):
        f = curves.curve(row, motion, grid)
        f[grid == 0] = np.nan
        heavy = row is ranking.best
        style: dict[str, Any] = {
            "lw": 2.2 if heavy else 1.0,
            "ls": "-" if heavy or row.in_set else (0, (5, 2)),
            "zorder": 2 + heavy,
        }
        axes.plot(100 * grid, f, color=COLOURS[row.law], label=f"law {row.law}", **style)
        if heavy:
            top = float(np.nanmax(np.abs(f)))
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda i: labels[i])
    axes.legend([handles[i] for i in order], [labels[i] for i in order], ncols=2, loc="best", markerscale=5)
    axes.set_ylim(-1.3 * top, 1.45 * top)
    axes.axvline(0, color=INK, lw=0.6)
    axes.axhline(0, color=INK, lw=0.6)
    axes.set(xlabel="relative velocity: mass minus belt (cm/s)", ylabel=f"friction ({curves.unit(motion)})")
    return figure


def residuals(ranking: Ranking) -> Figure:
    """Draw model minus measurement: the best law against time, and beside a rival against the time since break-away."""
    motion, best = ranking.motion, ranking.best
    rival = next((row for row in ranking.rows[1:] if not row.in_set and row.rms_m > 1.2 * best.rms_m), None)
    shown = [row for row in (rival, best) if row is not None]
    figure = Figure(figsize=(11.0, 3.3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    fit = best.fit
    left.plot(fit.windows.time, 1e6 * fit.residual, ".", ms=1.5, mew=0, color=COLOURS[best.law], rasterized=True)
    spread = 1e6 * float(np.percentile(np.abs(fit.residual), 99.5))
    left.set_ylim(-1.6 * spread, 1.6 * spread)
    left.set(xlabel="time (s)", ylabel="residual (um)", title=f"law {best.law} over the whole record")
    for row in shown:
        phase = _since_break_away(row.fit.windows.time, row.fit.rows, row.fit.cycles)
        cloud: dict[str, Any] = {"ms": 1.6, "mew": 0, "alpha": 0.6, "rasterized": True}
        right.plot(phase, 1e6 * row.fit.residual, ".", color=COLOURS[row.law], label=f"law {row.law}", **cloud)
    if rival is not None:
        narrow = max(2 * spread, 1e6 * motion.resolution)
        right.set_yscale("symlog", linthresh=narrow)
        low = math.ceil(math.log10(narrow))
        decades = 10.0 ** np.arange(low, max(low, math.ceil(math.log10(1e6 * rival.rms_m))) + 2)
        right.set_yticks([*-decades[::-1], 0.0, *decades])
        right.set_yticks([], minor=True)
        right.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        right.legend(markerscale=6)
    title = f"all cycles, beside the next best law {rival.law}" if rival is not None else "all cycles"
    right.set(xlabel="time since break-away (s)", ylabel="residual (um)", title=title)
    return figure


def evidence(ranking: Ranking) -> Figure:
    """Draw each cycle's error under each law: what the ranking is made of."""
    rows = list(reversed(ranking.rows))
    figure, axes = _figure(5.4, 0.9 + 0.42 * len(rows))
    for height, row in enumerate(rows):
        errors = 1e6 * row.fit.cycle_rms
        axes.plot(errors, np.full(errors.size, height), "|", ms=11, mew=1.1, color=COLOURS[row.law])
        axes.plot(np.exp(np.mean(np.log(errors))), height, "o", ms=5, color=COLOURS[row.law], mec="white", mew=0.8)
    axes.set_xscale("log")
    axes.set_yticks(range(len(rows)), [f"law {row.law}{' *' if row.in_set else ''}" for row in rows])
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.grid(visible=False, axis="y")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="error of each cycle (um rms); dot: their geometric mean")
    return figure


def cost(ranking: Ranking) -> Figure:
    """Draw each law's error against the CPU time of its fit."""
    figure, axes = _figure(5.4, 2.6)
    for row in ranking.rows:
        axes.plot(row.cpu_s, 1e6 * row.rms_m, "o", ms=7 if row.in_set else 5, color=COLOURS[row.law])
        axes.annotate(str(row.law), (row.cpu_s, 1e6 * row.rms_m), (6, 3), textcoords="offset points")
    axes.set_yscale("log")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.margins(0.12, 0.2)
    axes.set_xlim(left=0)
    axes.set(xlabel="CPU time of the fit (s)", ylabel="error (um rms)")
    return figure


def levels(ranking: Ranking) -> Figure:
    """Draw the friction level of each cycle at break-away and in the slip, against time."""
    events = [event for event in ranking.events if np.isfinite(event.kinetic_scale)]
    time = np.array([event.t for event in events])
    figure, axes = _figure(5.4, 3.4)
    thin: dict[str, Any] = {"lw": 0.5, "ls": "-"}
    above = [event.break_away_level for event in events]
    axes.plot(time, above, "o", ms=5.5, mfc="none", color=COLOURS[4], label="break-away", **thin)
    axes.plot(time, [event.kinetic_scale for event in events], "s", ms=3, color=COLOURS[2], label="sliding", **thin)
    axes.set(xlabel="time (s)", ylabel="friction level / mean sliding level")
    axes.legend(loc="best")
    return figure


def _since_break_away(time: Array, rows: tuple[slice, ...], cycles: tuple[Cycle, ...]) -> Array:
    phase = np.empty(time.size)
    for part, cycle in zip(rows, cycles, strict=True):
        phase[part] = time[part] - cycle.break_away
    return phase


PICTURES = (portrait, friction, residuals, evidence, levels, cost)


def draw(ranking: Ranking, counted: StickSlipStatistics) -> dict[str, str]:
    """Return every picture of the report as an ``<svg>`` element, by name.

    `break_aways` where there are statistics; of a record that no law comes near the portrait alone besides.
    """
    with mpl.rc_context(fname=str(STYLE)):
        shown = PICTURES if ranking.rows else (portrait,)
        drawn = {picture.__name__: svg(picture(ranking)) for picture in shown}
        if ranking.rows:
            drawn["orbits"] = svg(adequacy_plot.orbits(ranking), SMALL_RESOLUTION)
        if ranking.adequacy.curve is not None:
            drawn["measured_curve"] = svg(adequacy_plot.measured_curve(ranking))
        if ranking.adequacy.departures:
            drawn["departures"] = svg(adequacy_plot.departures(ranking.adequacy))
        if counted.rows("m"):
            drawn["break_aways"] = svg(break_aways(counted, "m"))
    return drawn
