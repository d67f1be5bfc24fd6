"""The sizes, labels and legends of every figure of a fit, and friction against slip speed."""

import math
import textwrap
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from fitting.judge.curve import MeasuredCurve
from fitting.judge.friction import friction_at, mass, points, speeds, unit
from fitting.judge.parameters import friction_band
from fitting.palette import INK, MEASURED, law_styles
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array
from stickslip.output.plot import STYLE, PngFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


NARROW, WIDE = 3.4, 7.0  # inches: half of the text of an A4 page, and all of it
LEFT, RIGHT, BOTTOM, TITLE = 0.62, 0.15, 0.42, 0.24  # inches of margin
ROW, KEY, LETTER = 0.17, 0.5, 0.062  # inches of a row of a legend, of its key, and of a letter
POSITION, VELOCITY, TIME = "position $x$ (mm)", "velocity $v$ (m/s)", "time $t$ (s)"
SINCE_BREAK_AWAY, SLIP_SPEED = "time since break-away (s)", "slip speed $s$ (m/s)"
BELT_SPEED = r"belt speed $v_\mathrm{dr}$"
ZOOM = 0.15  # of the largest slip speed: there laws and ramps differ most
COLUMNS = 95  # of a line of the title
MOST_POINTS = 12_000
BAND_ALPHA = 0.05  # significance of the band of a law with memory
USUAL = 99.5  # percentile of the force balance up to which it is drawn

Shown = Sequence[tuple[Fit, str, dict[str, Any]]]  # laws, best first, each with its name and line style


def look() -> AbstractContextManager[None]:
    return mpl.rc_context(fname=STYLE)


def friction(
    laws: Sequence[tuple[Fit, str]],
    motion: MeasuredMotion,
    measured: MeasuredCurve | None,
    title: str,
    axes: "Axes | None" = None,
) -> Figure:
    """Return friction against slip speed at all speeds (in ``axes``) and at low ones; laws best first."""
    styles = law_styles(fit.law.key for fit, _ in laws)
    shown = [(fit, name, styles[fit.law.key]) for fit, name in laws]
    with look():
        if axes is not None:
            draw(axes, shown, motion, measured)
            axes.legend()
            return axes.figure.figure
        return draw_both(shown, motion, measured, textwrap.fill(title, COLUMNS))


def draw_both(laws: Shown, motion: MeasuredMotion, measured: MeasuredCurve | None, title: str = "") -> Figure:
    """Return a figure of all speeds and of the low ones."""
    drawn, ((whole, low),) = panels(WIDE, 3.2 + ROW * title.count("\n"), 1, 2)
    draw(whole, laws, motion, measured)
    draw(low, laws, motion, measured, ZOOM)
    whole.set_title("all speeds")
    low.set(title="low speeds", ylabel="")
    add_legend(drawn, [whole], title=title)
    return drawn


def panels(
    width: float, height: float, rows: int = 1, columns: int = 1, *, left: float = LEFT, gap: float = LEFT, **more: Any
) -> tuple[PngFigure, Any]:
    """Return a figure (inches) and its axes, with fixed margins: a computed layout draws every picture twice."""
    drawn = PngFigure(figsize=(width, height))
    wide = (width - left - RIGHT - gap * (columns - 1)) / columns
    cells = drawn.subplots(rows, columns, squeeze=False, **more)
    drawn.subplots_adjust(left / width, BOTTOM / height, 1 - RIGHT / width, 1 - TITLE / height, gap / wide, 0.12)
    return drawn, cells


def add_legend(drawn: Figure, axes: "Sequence[Axes]", marks: float = 1.0, title: str = "") -> None:
    """Put one legend of some axes above the figure, below its title; ``marks`` is the scale of its marks."""
    lines = {name: line for one in axes for line, name in zip(*one.get_legend_handles_labels(), strict=True)}
    width, height = drawn.get_size_inches()
    columns = max(1, int((width - LEFT) / (KEY + LETTER * max(map(len, lines)))))
    above = 1 - ROW * (title.count("\n") + 1.5) / height if title else 1.0
    top = ROW * math.ceil(len(lines) / columns) + (TITLE if axes[0].get_title(loc="left") else 0.5 * ROW)
    drawn.subplots_adjust(top=above - top / height)
    drawn.legend(
        lines.values(),
        lines,
        loc="upper left",
        bbox_to_anchor=(LEFT / width, above),
        ncols=columns,
        borderaxespad=0,
        borderpad=0,
        labelspacing=0.3,
        markerscale=marks,
    )
    if title:
        drawn.suptitle(title, parse_math=False, x=0.01, y=0.99, ha="left")


def draw(axes: "Axes", laws: Shown, motion: MeasuredMotion, measured: MeasuredCurve | None, part: float = 1.0) -> None:
    """Draw the laws, the first one heaviest, and the measurement up to a ``part`` of the largest slip speed.

    Without ``measured``, or where the first law has memory, its force balance is drawn as points.  Where the level of
    the measurement is not determined, the band is that of the shape, and the laws are moved to its level.
    """
    measured = None if laws[0][0].law.rate else measured
    top = float(measured.speed[-1]) if measured is not None else float(np.abs(speeds(motion)).max())
    reach = 1.02 * part * top
    speed = reach * np.linspace(0, 1, 401)[1:] ** 2  # from just above 0, where a jump has no value
    if measured is None:
        ends = _draw_balance(axes, laws[0][0], motion)
    else:
        ends = _draw_band(axes, measured, reach)
    for place, (fit, name, style) in enumerate(laws):
        force = _force(fit, motion, speed)
        if measured is not None and not measured.level_known:
            force += float(np.mean(measured.friction - _force(fit, motion, measured.speed)))
        (line,) = axes.plot(speed, force, lw=1.4 if place else 2.8, zorder=3, label=name, **style)
        if fit.law.rate:  # beside which no curve without a law is drawn
            half = friction_band(fit, motion, speed, BAND_ALPHA)
            label = None if place else f"{100 * (1 - BAND_ALPHA):g} % band"
            axes.fill_between(
                speed, force - half, force + half, color=line.get_color(), alpha=0.18, lw=0, zorder=2, label=label
            )
        ends = ends if place else [*ends, force.min(), force.max()]
    slowest = _draw_loop(axes, *laws[0], motion, ends)
    low, high = min(ends), max(ends)
    room = 0.15 * (high - low)
    axes.set_ylim(low - room if low < 0 or (measured and not measured.level_known) else 0.0, high + room)
    axes.set(xlim=(max(1.05 * slowest, -reach), reach), xlabel=SLIP_SPEED, ylabel=f"friction $F$ ({unit(motion)})")


def _force(fit: Fit, motion: MeasuredMotion, speed: Array) -> Array:
    """Return a law's friction, positive where it opposes the slip."""
    return motion.sign * friction_at(fit, motion, -motion.sign * speed)


def _draw_loop(
    axes: "Axes", fit: Fit, name: str, style: dict[str, Any], motion: MeasuredMotion, ends: list[float]
) -> float:
    """Draw friction along a cycle of a law with memory, add its extremes to ``ends``, and return the least speed."""
    loop = fit.loop
    if loop is None:
        return 0.0
    speed, force = loop[0], mass(motion, fit) * loop[1]
    axes.plot(speed, force, label=f"{name}, one cycle", **style | {"lw": 0.9, "ls": "-", "zorder": 5})
    ends += [float(force.min()), float(force.max())]
    return min(float(speed.min()), 0.0)


def _draw_balance(axes: "Axes", fit: Fit, motion: MeasuredMotion) -> list[float]:
    """Draw the force balance at the samples; return the ends of the axis."""
    w, force, _ = points(fit, motion)
    thin = slice(None, None, max(1, w.size // MOST_POINTS))
    shown: dict[str, Any] = {"color": MEASURED, "ms": 2.5, "alpha": 0.4, "zorder": 1, "rasterized": True}
    axes.plot(-motion.sign * w[thin], motion.sign * force[thin], ".", label="measured", **shown)
    return [0.0, float(np.percentile(motion.sign * force, USUAL))]


def _draw_band(axes: "Axes", measured: MeasuredCurve, reach: float) -> list[float]:
    """Draw the measured curve with its band; return the ends of the axis for speeds up to ``reach``, m/s."""
    lo, hi, band, label = measured.lo, measured.hi, f"{100 * measured.confidence:g} % band", "model-free estimate"
    if not measured.level_known:  # the band of every level would hide the shape
        lo, hi = measured.friction - measured.shape_half, measured.friction + measured.shape_half
        band, label = f"{band} of the shape", "model-free estimate, level unknown"
    axes.fill_between(measured.speed, lo, hi, color=INK, alpha=0.18, lw=0, zorder=1, label=band)
    axes.plot(measured.speed, measured.friction, color=INK, lw=0.9, zorder=4, label=label)
    seen = measured.speed <= reach
    seen = seen if seen.sum() > 2 else np.ones_like(seen)
    return [float(lo[seen].min()), float(hi[seen].max())]
