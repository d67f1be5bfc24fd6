"""Pictures of the motion over time: position and velocity as measured, with the fit over them."""

from collections.abc import Sequence

import numpy as np

from fitting.data.cycles import Cycle
from fitting.drawing.palette import DASH, INK, MEASURED, NARROW, run_colour, run_dash
from fitting.report.chart import BOTTOM, CLOSE, ROW, Axes, legend_rows, picture
from fitting.report.scale import AxisScale
from fitting.selection.result import LawResult, Ranking
from stickslip.compute.arrays import Array

MM = 1e3  # positions are drawn in mm, speeds in m/s
HEIGHT = 300.0  # px
GAP = 0.01  # between runs that are drawn one after another, of the time of all
BROAD, PALE = 4.0, 0.45  # width and opacity of a measured line, so that a fitted one over it leaves both to be seen
PALE_RUN = 0.65  # opacity of each of several runs, whose luminances are to stay apart
Part = tuple[Array, Array, Array]  # time (s), position (mm), velocity (m/s)


def typical_cycle(row: LawResult) -> Cycle:
    """Return the cycle with a law's median error."""
    order = np.argsort(row.fit.cycle_rms, kind="stable")
    return row.fit.cycles[int(order[order.size // 2])]


def extent(cycle: Cycle) -> slice:
    """Return the samples of a cycle, from the first of its stick to the last of its slip."""
    parts = [part for part in (cycle.stick, cycle.slip) if part[1] > part[0]]
    return slice(min(first for first, _ in parts), max(end for _, end in parts))


def measured_motion(side: Ranking, cycle: Cycle | None = None) -> Part:
    """Return the smoothed motion of a run or of one cycle."""
    motion, samples = side.motion, slice(None) if cycle is None else extent(cycle)
    time = motion.begin + motion.time[samples]
    return time, MM * motion.sign * motion.position[samples], motion.sign * motion.velocity[samples]


def fitted_motion(row: LawResult, sign: float, number: int | None = None) -> list[Part]:
    """Return the motion of a law in each window of its fit, or of one cycle."""
    windows = row.fit.windows
    model = windows.position + row.fit.residual
    parts = [
        slice(first, first + count)
        for cycle, _, first, count, *_ in windows.table
        if count > 2 and number in (None, row.fit.cycles[cycle].number)
    ]
    return [
        (
            row.motion.begin + windows.time[samples],
            MM * sign * model[samples],
            sign * np.gradient(model[samples], windows.time[samples]),
        )
        for samples in parts
    ]


def begins(ranking: Ranking) -> list[float]:
    """Return the offsets of each run's times, s, that put the runs one after another."""
    if not ranking.runs:
        return [0.0]
    spans = np.array([side.motion.span for side in ranking.sides])
    firsts = np.array([side.motion.begin + side.motion.time[0] for side in ranking.sides])
    gap = GAP * float(spans.sum())
    return list(np.cumsum(spans + gap) - spans - gap - firsts)


def time_label(ranking: Ranking) -> str:
    """Return the label of the times that `begins` shifts."""
    return "time, one run after another (s)" if ranking.runs else "time (s)"


def record(ranking: Ranking) -> str:
    """Draw position and velocity of the whole record, and the best law's motion in every window."""
    measured, fitted = [], []
    for side, begin in zip(ranking.sides, begins(ranking), strict=True):
        time, x, v = measured_motion(side)
        measured.append((time + begin, x, v))
        if ranking.rows:
            fitted += [(time + begin, x, v) for time, x, v in fitted_motion(side.best, side.motion.sign)]
    return _over_time("record", ranking, measured, fitted, time_label(ranking), "Position and velocity of the record")


def cycle(ranking: Ranking) -> str:
    """Draw position and velocity of a typical cycle of each run against the time since its break-away.

    Positions are the readings, velocities are smoothed.
    """
    measured, fitted = [], []
    for side in ranking.sides:
        typical = typical_cycle(side.best)
        time, _, v = measured_motion(side, typical)
        readings = MM * side.motion.sign * side.motion.measured[extent(typical)]
        broke = side.motion.begin + typical.break_away
        measured.append((time - broke, readings, v))
        parts = fitted_motion(side.best, side.motion.sign, typical.number)
        fitted += [(time - broke, x, v) for time, x, v in parts]
    label = "time since break-away (s)"
    return _over_time("cycle", ranking, measured, fitted, label, "Position and velocity of one cycle")


def _over_time(
    name: str, ranking: Ranking, measured: Sequence[Part], fitted: Sequence[Part], label: str, about: str
) -> str:
    """Draw position above velocity against time: the measurement broad and pale, the fit thin and dark."""
    runs, opacity = [("measured", MEASURED)], PALE_RUN if ranking.runs else PALE
    if ranking.runs:
        runs = [(f"run {number}", run_colour(number)) for number in range(1, len(measured) + 1)]
    words = [f"{ranking.best.label}, fitted"] if ranking.rows else []
    rows = legend_rows([*(named for named, _ in runs), *words, "belt speed"], NARROW)
    across = AxisScale.around(np.concatenate([time for time, _, _ in measured]), edge=0.01)
    beside = 3 * CLOSE + ROW * rows + BOTTOM
    upper = 2 * CLOSE + ROW * rows + 0.5 * (HEIGHT - beside)  # both fields have the same height
    drawn = []
    for place, (top, height, unit) in enumerate(((0.0, upper, "x (mm)"), (upper, HEIGHT - upper, "v (m/s)")), start=1):
        tall = AxisScale.around(np.concatenate([part[place] for part in (*measured, *fitted)]))
        axes = Axes(0, top, NARROW, height, across, tall, ylabel=unit, over=place == 1)
        axes.rows, axes.xlabel = (rows, "") if axes.over else (0, label)
        for number, (part, (named, colour)) in enumerate(zip(measured, runs, strict=True), start=1):
            line, dash, label_here = [(part[0], part[place])], run_dash(number), named if axes.over else None
            axes.trace(line, colour, width=BROAD, opacity=opacity, dash=dash, label=label_here)
        if ranking.rows:
            axes.trace([(part[0], part[place]) for part in fitted], INK, label=words[0] if axes.over else None)
            if axes.over:
                axes.key("belt speed", INK, DASH)
            else:
                for side in ranking.sides:
                    axes.level(side.best.parameters["v_dr"].value, INK, dash=DASH)
        drawn.append(axes)
    return picture(name, NARROW, HEIGHT, drawn, f"{about}: {' and '.join(['as measured', *words])}.")
