"""The picture of a ranking: friction against relative speed as measured without a law, and the curves of the laws."""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.drawing import curves
from fitting.drawing.palette import INK, MEASURED, law_colours
from fitting.driver.fit import Fit
from stickslip.output.plot import STYLE, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ZOOM = 0.15  # of the largest slip speed: there laws and ramps differ most
COLUMNS = 140  # of a line of the title
MOST_POINTS = 12_000


Shown = Sequence[tuple[Fit, str]]  # laws, best first, each with what it is called


def friction(
    laws: Shown, motion: MeasuredMotion, measured: MeasuredCurve | None, title: str, axes: "Axes | None" = None
) -> Figure:
    """Return friction against relative speed (m/s), all speeds (in ``axes``) and the low ones; laws best first.

    Where ``measured`` (with its band, in `curves.unit`) is None, the force balance of the first law is drawn as points.
    """
    top = float(measured.speed[-1]) if measured is not None else float(np.abs(curves.speeds(motion)).max())
    with mpl.rc_context(fname=STYLE):
        if axes is not None:
            _draw(axes, laws, motion, measured, top)
            axes.set_ylabel(f"friction ({curves.unit(motion)})")
            axes.legend()
            return axes.figure.figure
        drawn = figure(11.5, 4.6)
        whole, low = drawn.subplots(1, 2)
        _draw(whole, laws, motion, measured, top)
        _draw(low, laws, motion, measured, ZOOM * top)
        whole.set(title="all speeds", ylabel=f"friction ({curves.unit(motion)})")
        low.set(title="low speeds")
        whole.legend()
        drawn.suptitle(textwrap.fill(title, COLUMNS), parse_math=False, x=0.01, ha="left", fontsize=10.5)
    return drawn


def _draw(axes: "Axes", laws: Shown, motion: MeasuredMotion, measured: MeasuredCurve | None, reach: float) -> None:
    """Draw the laws and the measurement up to a relative speed, m/s."""
    _curves(axes, laws, motion, 1.02 * reach)
    if measured is None:
        w, force, _ = curves.points(laws[0][0], motion)
        thin = slice(None, None, max(1, w.size // MOST_POINTS))
        shown: dict[str, Any] = {"color": MEASURED, "ms": 2.5, "alpha": 0.4, "zorder": 1, "rasterized": True}
        axes.plot(-motion.sign * w[thin], motion.sign * force[thin], ".", label="measured", **shown)
    else:
        band = f"{100 * measured.confidence:g} % band"
        speed = measured.speed
        axes.fill_between(speed, measured.lo, measured.hi, color=INK, alpha=0.2, lw=0, zorder=1, label=band)
        axes.plot(speed, measured.friction, color=INK, lw=2.2, zorder=1, label="measured, without a law")
    axes.set(xlim=(0, 1.02 * reach), xlabel="relative speed (m/s)")
    axes.set_ylim(0, 1.06 * axes.dataLim.y1)


def _curves(axes: "Axes", laws: Shown, motion: MeasuredMotion, reach: float) -> None:
    """Draw each law from just above 0, where a jump has no value, to a relative speed, m/s."""
    speed = reach * np.linspace(0, 1, 401)[1:] ** 2  # densest near 0, where a ramp bends
    colours = law_colours(fit.law.key for fit, _ in laws)
    for place, (fit, name) in enumerate(laws):
        force = motion.sign * curves.curve(fit, motion, -motion.sign * speed)
        style = (0, (5, 3)) if place else "-"
        axes.plot(speed, force, color=colours[fit.law.key], lw=1.6, ls=style, zorder=3, label=name)
