"""Colours, dashes and marks of the pictures, and the picture of friction against relative speed."""

import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from fitting.judge.curve import MeasuredCurve
from fitting.judge.friction import friction_at, points, speeds, unit
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array
from stickslip.output.plot import STYLE, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Dashes = str | tuple[float, tuple[float, ...]]  # a line style of matplotlib; lengths in line widths
COLOURS = {1: "#56B4E9", 2: "#0072B2", 3: "#E69F00", 4: "#D55E00", 5: "#009E73", 6: "#CC79A7"}
FORMULAS = ("#A03070", "#6B4226", "#5B6BBF", "#808000", "#1F7A7A")  # of formulas in the order of the ranking, repeated
DASHES: dict[int, Dashes] = {
    1: (0, (1.2, 2)),
    2: (0, (2.5, 1.5)),
    3: (0, (6, 2)),
    4: (0, (6, 2, 1.5, 2)),
    5: "-",
    6: (0, (10, 2, 2, 2)),
}
FORMULA_DASHES: tuple[Dashes, ...] = (
    (0, (4, 1.5, 1, 1.5, 1, 1.5)),
    (0, (8, 1.5, 1.5, 1.5, 1.5, 1.5)),
    (0, (3, 3)),
    (0, (0.8, 1.5)),
    (0, (12, 3)),
)
MEASURED = "#9a9a9a"
INK = "#222222"
DASHED: Dashes = (0, (5, 3))
# Of runs, none the colour of a law.  In greyscale three runs differ in luminance, the groups of three in dashes and
# marks.  From the tenth run on they repeat.
RUNS = ("#3B1A78", "#C03A58", "#A9B83A", "#4A2409", "#1F7F7F", "#D598BC", "#1E1E1E", "#8F6510", "#7FB0EA")
RUN_DASHES: tuple[Dashes, ...] = ("-", (0, (6, 3)), (0, (2, 2)))
RUN_MARKS: tuple[dict[str, Any], ...] = ({"marker": "o"}, {"marker": "o", "mfc": "none"}, {"marker": "|"})


def run_colour(number: int) -> str:
    return RUNS[(number - 1) % len(RUNS)]


def run_dash(number: int) -> Dashes:
    return RUN_DASHES[(number - 1) % len(RUNS) // 3]


def run_mark(number: int) -> dict[str, Any]:
    return RUN_MARKS[(number - 1) % len(RUNS) // 3]


def law_styles(laws: Iterable[int | str]) -> dict[int | str, dict[str, Any]]:
    styles: dict[int | str, dict[str, Any]] = {}
    names = 0
    for law in laws:
        if isinstance(law, int) and law in COLOURS:
            styles[law] = {"color": COLOURS[law], "ls": DASHES[law]}
        else:
            number = names % len(FORMULAS)
            styles[law] = {"color": FORMULAS[number], "ls": FORMULA_DASHES[number]}
            names += 1
    return styles


ZOOM = 0.15  # of the largest slip speed: there laws and ramps differ most
COLUMNS = 140  # of a line of the title
MOST_POINTS = 12_000
USUAL = 99.5  # percentile of the force balance up to which it is drawn

Shown = Sequence[tuple[Fit, str, dict[str, Any]]]  # laws, best first, each with its name and line style


def friction(
    laws: Sequence[tuple[Fit, str]],
    motion: MeasuredMotion,
    measured: MeasuredCurve | None,
    title: str,
    axes: "Axes | None" = None,
) -> Figure:
    """Return friction against relative speed at all speeds (in ``axes``) and at low ones; laws best first."""
    styles = law_styles(fit.law.key for fit, _ in laws)
    shown = [(fit, name, styles[fit.law.key]) for fit, name in laws]
    with mpl.rc_context(fname=STYLE):
        if axes is not None:
            draw(axes, shown, motion, measured)
            axes.legend()
            return axes.figure.figure
        drawn = figure(11.5, 4.6)
        draw_both(drawn.subplots(1, 2), shown, motion, measured)
        drawn.axes[0].legend()
        drawn.suptitle(textwrap.fill(title, COLUMNS), parse_math=False, x=0.01, ha="left", fontsize=10.5)
    return drawn


def draw_both(axes: "Sequence[Axes]", laws: Shown, motion: MeasuredMotion, measured: MeasuredCurve | None) -> None:
    whole, low = axes
    draw(whole, laws, motion, measured)
    draw(low, laws, motion, measured, ZOOM)
    whole.set_title("all speeds")
    low.set(title="low speeds", ylabel="")


def draw(axes: "Axes", laws: Shown, motion: MeasuredMotion, measured: MeasuredCurve | None, part: float = 1.0) -> None:
    """Draw the laws, the first one heaviest, and the measurement up to a ``part`` of the largest relative speed.

    Without ``measured`` the force balance of the first law is drawn as points.  Where its level is not determined, the
    band is that of the shape, and the laws are moved to its level.
    """
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
        axes.plot(speed, force, lw=1.4 if place else 2.8, zorder=3, label=name, **style)
        ends = ends if place else [*ends, force.min(), force.max()]
    low, high = min(ends), max(ends)
    room = 0.15 * (high - low)
    axes.set_ylim(low - room if low < 0 or (measured and not measured.level_known) else 0.0, high + room)
    axes.set(xlim=(0, reach), xlabel="relative speed (m/s)", ylabel=f"friction ({unit(motion)})")


def _force(fit: Fit, motion: MeasuredMotion, speed: Array) -> Array:
    """Return a law's friction, positive where it opposes the slip."""
    return motion.sign * friction_at(fit, motion, -motion.sign * speed)


def _draw_balance(axes: "Axes", fit: Fit, motion: MeasuredMotion) -> list[float]:
    """Draw the force balance at the samples; return the ends of the axis."""
    w, force, _ = points(fit, motion)
    thin = slice(None, None, max(1, w.size // MOST_POINTS))
    shown: dict[str, Any] = {"color": MEASURED, "ms": 2.5, "alpha": 0.4, "zorder": 1, "rasterized": True}
    axes.plot(-motion.sign * w[thin], motion.sign * force[thin], ".", label="measured", **shown)
    return [0.0, float(np.percentile(motion.sign * force, USUAL))]


def _draw_band(axes: "Axes", measured: MeasuredCurve, reach: float) -> list[float]:
    """Draw the measured curve with its band; return the ends of the axis for speeds up to ``reach``, m/s."""
    lo, hi, band, label = measured.lo, measured.hi, f"{100 * measured.confidence:g} % band", "measured, without a law"
    if not measured.level_known:  # the band of every level would hide the shape
        lo, hi = measured.friction - measured.shape_half, measured.friction + measured.shape_half
        band, label = f"{band} of the shape", "measured, level not determined"
    axes.fill_between(measured.speed, lo, hi, color=INK, alpha=0.18, lw=0, zorder=1, label=band)
    axes.plot(measured.speed, measured.friction, color=INK, lw=0.9, zorder=4, label=label)
    seen = measured.speed <= reach
    seen = seen if seen.sum() > 2 else np.ones_like(seen)
    return [float(lo[seen].min()), float(hi[seen].max())]
