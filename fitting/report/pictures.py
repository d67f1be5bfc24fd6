"""The pictures of a page as SVG; of a joint fit with all runs, each in its colour, dashes and marks."""

import base64
import csv
import html
import io
import math
import re
import zipfile
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from fitting import drawing
from fitting.palette import COLOURS, DASHED, INK, MEASURED, law_styles, run_colour, run_dash, run_mark
from fitting.record.cycles import Cycle
from fitting.report.symbols import pretty
from fitting.result import LawResult, Ranking
from processing.statistics import pooled
from stickslip.compute.arrays import Array
from stickslip.output.lengths import format_length, shown_length

DPI = 110  # of what is drawn as an image
MOST_VECTOR = 4000  # points of a line; a longer one is drawn as an image, and thinned in the table of its figure
MOST_POINTS = 200_000  # points of a whole record that are drawn, or up to twice as many
MM = 1e3  # positions are drawn in mm, speeds in m/s
ABOVE = 1 + 1e-6  # of the belt's speed, which difference quotients reach to within rounding
GAP = 0.01  # between runs that are drawn one after another, of the time of all
BROAD, PALE, PALE_RUN = 3.0, 0.45, 0.65  # width and opacity of a measured line; opacity for several runs
BAND = 2.0  # standard deviations of the noise: 95 % of the residuals of a law that describes the record
SPREAD = 99.5  # percentile of residuals within the axes
BINS = (4, 30)  # fewest and most of the distribution, whose number is the square root of that of the break-aways
Part = Array  # (3, n) time (s), position (mm), velocity (m/s)


def embed(drawn: Figure, about: str, name: str) -> str:
    """Return a figure as an ``<svg>`` element with a unique ``name``, and a link that saves it with its data.

    ``about`` is the text alternative.
    """
    buffer = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with mpl.rc_context({"svg.hashsalt": name, "savefig.bbox": "standard"}):
        drawn.savefig(buffer, format="svg", dpi=DPI, transparent=True, metadata=nothing)
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|(<g) id=\"[^\"]*\"", r"\1", text, flags=re.DOTALL)
    text = re.sub(r"=\"[^\"]*\"", lambda value: re.sub(r"(\.\d\d)\d+", r"\1", value[0]), text)
    text = re.sub(r"\s*\n\s*", "\n", re.sub(r"font: ([\d.]+px) [^;\"]*", r"font: \1 sans-serif", text))
    shown = f'<svg role="img" aria-label="{html.escape(about)}" style="max-width: {130 * drawn.get_figwidth():.0f}px"'
    picture = text[text.index("<svg") :].replace("<svg", shown, 1)
    saved = _archive(name, picture, drawn)
    return f'{picture}<a class="save" download="{name}.zip" href="{saved}">SVG and data (CSV)</a>'


def _archive(name: str, picture: str, drawn: Figure) -> str:
    """Return the address of an archive of a figure and of what it shows."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, text in ((f"{name}.svg", picture), (f"{name}.csv", as_csv(drawn))):
            archive.writestr(zipfile.ZipInfo(file), text, zipfile.ZIP_DEFLATED)
    return f"data:application/zip;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def as_csv(drawn: Figure) -> str:
    """Return the curves, bands (as outlines) and bars of a figure as a table with a row for each point.

    A curve of more than `MOST_VECTOR` points is thinned to every n-th.
    """
    text = io.StringIO()
    table = csv.writer(text)
    table.writerow(("panel", "curve", "x axis", "y axis", "x", "y"))
    below, beside = drawn.get_supxlabel(), drawn.get_supylabel()
    for axes in drawn.axes:
        curves: list[tuple[Any, Any]] = [
            (line.get_label(), line.get_xydata()) for line in axes.lines if line.get_transform() == axes.transData
        ]
        curves += [(band.get_label(), path.vertices) for band in axes.collections for path in band.get_paths()]
        curves += [("", [(*bar.get_center()[:1], bar.get_height()) for bar in bars]) for bars in axes.containers]
        labels = (axes.get_xlabel() or below or drawn.axes[-1].get_xlabel(), axes.get_ylabel() or beside)
        for name, points in curves:
            head = [_plain(part) for part in (axes.get_title(loc="left"), "" if name[:1] == "_" else name, *labels)]
            thinned = points[:: math.ceil(len(points) / MOST_VECTOR) or 1]
            table.writerows((*head, f"{x:.7g}", f"{y:.7g}") for x, y in thinned if not math.isnan(x + y))
    return text.getvalue()


def _plain(label: str) -> str:
    """Return a label without the marks of typeset symbols."""
    return re.sub(r"\$|\\mathrm|[{}]", "", label).replace("\n", ", ")


def shown_rows(ranking: Ranking) -> list[LawResult]:
    """Return the laws that were requested or may be the contact's."""
    may_be = ranking.not_excluded
    return [row for row in ranking.rows if row.asked or row.in_set or row is ranking.best or row.law in may_be]


def _styles(ranking: Ranking) -> dict[int | str, dict[str, Any]]:
    return law_styles(row.law for row in ranking.rows)


def _runs(ranking: Ranking, colour: str, label: str) -> list[dict[str, Any]]:
    """Return the style of each run: ``colour`` and ``label`` for a single run, else those of its number."""
    if not ranking.runs:
        return [{"color": colour, "label": label, **run_mark(1)}]
    numbers = range(1, len(ranking.runs) + 1)
    return [{"color": run_colour(number), "label": f"run {number}", **run_mark(number)} for number in numbers]


def _measured_lines(ranking: Ranking) -> list[dict[str, Any]]:
    broad = {"lw": BROAD, "alpha": PALE_RUN if ranking.runs else PALE, "marker": ""}
    runs = enumerate(_runs(ranking, MEASURED, "measured"), start=1)
    return [run | broad | {"ls": run_dash(number)} for number, run in runs]


def typical_cycle(row: LawResult) -> Cycle:
    """Return the cycle with a law's median error."""
    order = np.argsort(row.fit.cycle_rms, kind="stable")
    return row.fit.cycles[int(order[order.size // 2])]


def extent(cycle: Cycle) -> slice:
    parts = [part for part in (cycle.stick, cycle.slip) if part[1] > part[0]]
    return slice(min(first for first, _ in parts), max(end for _, end in parts))


def measured_motion(side: Ranking, cycle: Cycle | None = None) -> Part:
    motion = side.motion
    every = slice(None, None, max(1, motion.time.size // MOST_POINTS))
    samples = every if cycle is None else extent(cycle)
    time = motion.begin + motion.time[samples]
    return np.stack((time, MM * motion.sign * motion.position[samples], motion.sign * motion.velocity[samples]))


def fitted_motion(row: LawResult, sign: float, measured: Part | None = None) -> Part:
    """Return the motion of a law in the windows of its fit, or while ``measured`` was, with NaN between windows.

    The ends of a window, where the velocity is a one-sided difference, are left out; so are slips above the belt's
    speed (and the ramp's width), unless the law has memory.
    """
    windows = row.fit.windows
    model = windows.position + row.fit.residual
    parts: list[Array] = [np.empty((3, 0))]
    for _, stick, first, count, *_ in windows.table:
        if count > 3:
            samples = slice(first, first + count)
            time, x = windows.time[samples], model[samples]
            v = np.gradient(x, time)
            if not row.fit.law.rate:
                v[(v > ABOVE * (row.fit.values.v_dr + row.fit.values.d)) & (stick == 0)] = np.nan
            part = np.stack((row.motion.begin + time, MM * sign * x, sign * v))[:, 1:-1]
            parts.append(np.hstack((part, np.full((3, 1), np.nan))))
    motion = np.hstack(parts)
    if measured is None:
        return motion
    return motion[:, ~((motion[0] < measured[0, 0]) | (motion[0] > measured[0, -1]))]


def begins(ranking: Ranking) -> list[float]:
    """Return the offsets of time, s, that put the runs one after another."""
    if not ranking.runs:
        return [0.0]
    spans = np.array([side.motion.span for side in ranking.sides])
    firsts = np.array([side.motion.begin + side.motion.time[0] for side in ranking.sides])
    gap = GAP * float(spans.sum())
    return list(np.cumsum(spans + gap) - spans - gap - firsts)


def time_label(ranking: Ranking) -> str:
    return "time, runs in sequence (s)" if ranking.runs else drawing.TIME


def record(ranking: Ranking) -> tuple[Figure, str]:
    """Draw position and velocity of the whole record, and the best law's motion in every window."""
    measured, fitted = [], []
    for side, begin in zip(ranking.sides, begins(ranking), strict=True):
        shift = np.array([[begin], [0.0], [0.0]])
        measured.append(measured_motion(side) + shift)
        if ranking.rows:
            fitted.append(fitted_motion(side.best, side.motion.sign) + shift)
    return _over_time(ranking, measured, fitted, time_label(ranking), "Position and velocity of the record")


def cycle(ranking: Ranking) -> tuple[Figure, str]:
    """Draw the measured position and the smoothed velocity of a typical cycle of each run."""
    measured, fitted = [], []
    for side in ranking.sides:
        typical = typical_cycle(side.best)
        shift = np.array([[side.motion.begin + typical.break_away], [0.0], [0.0]])
        part = measured_motion(side, typical)
        part[1] = MM * side.motion.sign * side.motion.measured[extent(typical)]
        measured.append(part - shift)
        fitted.append(fitted_motion(side.best, side.motion.sign, part) - shift)
    return _over_time(ranking, measured, fitted, drawing.SINCE_BREAK_AWAY, "Position and velocity of one cycle")


def _over_time(
    ranking: Ranking, measured: Sequence[Part], fitted: Sequence[Part], label: str, about: str
) -> tuple[Figure, str]:
    """Draw position above velocity against time: the measurement broad and pale, the fit thin and dark."""
    drawn, cells = drawing.panels(drawing.NARROW, 3.3, 2, sharex=True)
    styles, both = _measured_lines(ranking), cells[:, 0]
    whole = sum(part.shape[1] for part in measured) > MOST_VECTOR
    words = ["as measured", *([f"{ranking.best.name}, fitted"] if ranking.rows else [])]
    for place, (axes, unit) in enumerate(zip(both, (drawing.POSITION, drawing.VELOCITY), strict=True), start=1):
        for part, style in zip(measured, styles, strict=True):
            axes.plot(part[0], part[place], rasterized=whole, **style)
        if fitted:
            part = np.hstack(fitted)
            axes.plot(part[0], part[place], color=INK, lw=0.9, rasterized=whole, label=words[-1])
        axes.set_ylabel(unit)
        axes.margins(x=0.01)
    for side in ranking.sides if ranking.rows else ():
        both[1].axhline(side.best.parameters["v_dr"].value, color=INK, lw=0.8, ls=DASHED, label=drawing.BELT_SPEED)
    both[1].set_xlabel(label)
    drawing.add_legend(drawn, both)
    return drawn, f"{about}: {' and '.join(words)}."


def portraits(ranking: Ranking) -> tuple[Figure, str]:
    """Draw phase portraits of the laws over a typical cycle of each run; without a law, of the whole record."""
    if not ranking.rows:
        drawn, ((axes,),) = drawing.panels(drawing.NARROW, 3.3)
        _, x, v = measured_motion(ranking.sides[0])
        axes.plot(x, v, color=MEASURED, rasterized=True)
        axes.set(xlabel=drawing.POSITION, ylabel=drawing.VELOCITY)
        return drawn, "Velocity against position of the record."
    rows = [row for row in ranking.rows if row.asked or row.in_set or row is ranking.best]
    rows.sort(key=lambda row: row.law if isinstance(row.law, int) else len(COLOURS) + 1)
    lines, columns = math.ceil(len(rows) / 4), min(len(rows), 4)
    drawn, cells = drawing.panels(drawing.WIDE, 0.5 + 1.4 * lines, lines, columns, gap=0.1, sharex=True, sharey=True)
    drawn.subplots_adjust(top=1 - 2 * drawing.ROW / drawn.get_figheight(), hspace=0.45)
    styles = _styles(ranking)
    typical = [typical_cycle(side.best) for side in ranking.sides]
    for axes, row in zip(cells.flat, rows, strict=False):
        for side, one, style in zip(ranking.sides, typical, _measured_lines(ranking), strict=True):
            measured = measured_motion(side, one)
            axes.plot(*measured[1:], **style)
            _, x, v = fitted_motion(side.row(row.law), side.motion.sign, measured)
            axes.plot(x, v, lw=1.1, color=styles[row.law]["color"], label=row.name)
        axes.set_title(f"{row.name}{' *' if row.in_set else ''}\n{pretty(format_length(row.rms_m))}", fontsize=8)
    for axes in cells.flat[len(rows) :]:
        axes.remove()
    drawn.supxlabel(drawing.POSITION, fontsize=9)
    drawn.supylabel(drawing.VELOCITY, fontsize=9)
    return drawn, "Phase portraits of one cycle: the measurement and each fitted law."


def friction(ranking: Ranking) -> tuple[Figure, str]:
    """Draw the measured curve with its band, and the laws of the set."""
    drawn, ((axes,),) = drawing.panels(drawing.NARROW, 3.3)
    styles = _styles(ranking)
    rows = [row for row in ranking.rows if row.in_set] or [ranking.best]
    shown = [(row.fit, row.name, styles[row.law]) for row in rows]
    drawing.draw(axes, shown, ranking.motion, ranking.adequacy.curve)
    drawing.add_legend(drawn, [axes])
    named = ", ".join(row.name for row in rows)
    measured = "force balance" if rows[0].fit.law.rate else "model-free estimate with its band"
    return drawn, f"Friction against slip speed: {measured}, and {named}."


def laws(ranking: Ranking) -> tuple[Figure, str]:
    """Draw the measured curve with its band and all shown laws, at all speeds and at low ones."""
    styles = _styles(ranking)
    shown = [(row.fit, row.name, styles[row.law]) for row in shown_rows(ranking)]
    drawn = drawing.draw_both(shown, ranking.motion, ranking.adequacy.curve)
    return drawn, "Friction against slip speed: the curves of all laws, at all speeds and at low speeds."


def residuals(ranking: Ranking) -> tuple[Figure, str]:
    """Draw model minus measurement with the noise band: the best law over time and phase, a rival over phase."""
    best, styles = ranking.best, _styles(ranking)
    others = (row for row in ranking.rows if row is not best and not row.in_set)
    rival = next((row for row in others if row.rms_m > 1.2 * best.rms_m), None)
    shown = [(best, True), (best, False)] + ([(rival, False)] if rival is not None else [])
    drawn, cells = drawing.panels(drawing.WIDE, 2.7, 1, len(shown))
    noise = 1e6 * BAND * ranking.adequacy.noise_m
    for axes, (row, whole) in zip(cells[0], shown, strict=True):
        runs = _runs(ranking, styles[row.law]["color"], "model minus measurement")
        for side, begin, style in zip(ranking.sides, begins(ranking), runs, strict=True):
            one = side.row(row.law)
            time = one.motion.begin + one.fit.windows.time + begin if whole else since_break_away(one)
            dots = style | {"marker": ".", "mec": "none", "ms": 2}
            axes.plot(time, 1e6 * one.fit.residual, ls="", rasterized=True, **dots)
        axes.axhspan(-noise, noise, color=INK, alpha=0.16, lw=0, label="noise, ±2 sd")
        reach = 1.4 * max(1e6 * float(np.percentile(np.abs(row.fit.residual), SPREAD)), noise)
        kind = ("all runs" if ranking.runs else "whole record") if whole else "all cycles"
        axes.set(ylim=(-reach, reach), title=f"{row.name}, {kind}")
        axes.set_xlabel(time_label(ranking) if whole else drawing.SINCE_BREAK_AWAY)
    cells[0, 0].set_ylabel("residual (µm)")
    drawing.add_legend(drawn, cells[0], marks=4.0)
    return drawn, "Residuals against time, and against the time since break-away, with the noise band."


def since_break_away(row: LawResult) -> Array:
    time = row.fit.windows.time
    phase = np.empty(time.size)
    for part, cycle in zip(row.fit.rows, row.fit.cycles, strict=True):
        phase[part] = time[part] - cycle.break_away
    return phase


def evidence(ranking: Ranking) -> tuple[Figure, str]:
    """Draw each cycle's error under each law, the basis of the ranking."""
    rows, styles = ranking.rows[::-1], _styles(ranking)
    named = [f"{row.name}{' *' if row.in_set else ''}" for row in rows]
    left = 0.2 + drawing.LETTER * max(map(len, named))
    drawn, ((axes,),) = drawing.panels(drawing.WIDE, 0.6 + 0.27 * len(rows), left=left)
    for place, row in enumerate(rows):
        cycles, colour = 1e6 * row.fit.cycle_rms, styles[row.law]["color"]
        axes.plot(cycles, np.full(cycles.size, place), "|", color=colour, ms=9, label=row.name)
        axes.plot(np.exp(np.mean(np.log(cycles))), place, "o", color=colour, ms=5)
    axes.set_yticks(range(len(rows)), named)
    axes.set_xscale("log", subs=())
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="error of each cycle (µm rms)")
    return drawn, "Error of each cycle under each law."


def levels(ranking: Ranking) -> tuple[Figure, str]:
    """Draw the friction level of each cycle at break-away and in the slip, against time."""
    drawn, ((axes,),) = drawing.panels(drawing.NARROW, 2.8)
    for number, (side, begin) in enumerate(zip(ranking.sides, begins(ranking), strict=True)):
        events = [event for event in side.events if math.isfinite(event.kinetic_scale)]
        time = [begin + event.t for event in events]
        for name, label, style in (
            ("break_away_level", "break-away", {"color": COLOURS[4], "mfc": "none"}),
            ("kinetic_scale", "sliding", {"color": COLOURS[2]}),
        ):
            named = "" if number else label
            axes.plot(time, [getattr(event, name) for event in events], "o-", lw=0.5, ms=4, label=named, **style)
    axes.set(xlabel=time_label(ranking), ylabel="level / mean sliding level")
    drawing.add_legend(drawn, [axes])
    return drawn, "Friction level of each cycle at break-away and in the slip, against time."


def break_aways(ranking: Ranking) -> tuple[Figure, str]:
    """Draw the break-away levels: their distribution, their trend, and level against stick time."""
    statistics, (factor, unit) = ranking.statistics, shown_length("m")
    counted = pooled(statistics)
    time = np.concatenate([begin + run.column("t") for begin, run in zip(begins(ranking), statistics, strict=True)])
    level = factor * counted.column("break_away_m")
    mean = float(level.mean())
    drawn, ((distribution, trend, against),) = drawing.panels(drawing.WIDE, 2.7, 1, 3)
    bins = int(np.clip(np.sqrt(level.size), *BINS))
    distribution.hist(level, bins, color=COLOURS[2], alpha=0.55, edgecolor="white")
    distribution.axvline(mean, color=COLOURS[4], lw=0.8, ls=DASHED, label=f"mean {mean:.4g} {unit}")
    distribution.set(title="distribution", xlabel=f"break-away level ({unit})", ylabel="number of break-aways")
    distribution.legend()
    for run, begin, style in zip(statistics, begins(ranking), _runs(ranking, COLOURS[2], ""), strict=True):
        levels_of_run = factor * run.column("break_away_m")
        trend.plot(begin + run.column("t"), levels_of_run, ls="", ms=4, **style)
        against.plot(run.column("stick_s"), levels_of_run, ls="", ms=4, **style)
    summary = counted.summary("break_away_m")
    if summary is not None and summary["trend_per_s"] is not None:
        slope, reach = factor * summary["trend_per_s"], np.array([time.min(), time.max()])
        trend.plot(reach, mean + slope * (reach - time.mean()), color=COLOURS[4], label=f"trend {slope:+.2g} {unit}/s")
    trend.set(title="against time", xlabel=time_label(ranking), ylabel=f"break-away level ({unit})")
    against.set(title="against stick time", xlabel="stick time (s)")
    if trend.get_legend_handles_labels()[1]:
        trend.legend()
    return drawn, "Break-away levels: their distribution, and against time and stick time."


Picture = Callable[[Ranking], tuple[Figure, str]]  # with its text alternative
PICTURES: tuple[Picture, ...] = (friction, cycle, record, portraits, laws, residuals, evidence, levels)


def draw(ranking: Ranking) -> dict[str, str]:
    """Return the pictures of the report by name, as ``<svg>`` elements."""
    shown: list[Picture] = [*(PICTURES if ranking.rows else (record, portraits))]
    shown += [break_aways] if pooled(ranking.statistics).rows("m") else []
    with drawing.look():
        stem = ranking.records[0].recording.source.stem or "run"
        named = ((picture.__name__, picture(ranking)) for picture in shown)
        return {name: embed(*drawn, name=f"{re.sub('[^A-Za-z0-9._-]', '-', stem)}-{name}") for name, drawn in named}
