"""Draw the pictures of the explanation pages from simulated records: python docs/draw_pictures.py [NAME ...]."""

import os
import runpy
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

import daq
import fitting
import processing
import rig_sim
from fitting import drawing
from fitting.palette import COLOURS, INK, MEASURED, law_styles
from fitting.report.pictures import since_break_away
from stickslip.output.plot import STYLE, PngFigure, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURES = Path(__file__).with_name("pictures")
GAMMA = 9.618  # s/m, of the scene rig
HARD = 16.85  # N/m^3, of a spring that is 5 % harder at the largest stretch
RUNS = 24  # repetitions of one record: one interval in twenty misses
STRIBECK = (
    "friction.formula=Fc + (Fs - Fc)*exp(-(s/v_s)**2) + b*s",
    "friction.Fc=0.7",
    "friction.v_s=0.15",
    "friction.b=0.1",
)


def record(*changes: str) -> "processing.Kinematics":
    """Return 20 s of the scene rig, changed, recorded by the simulated board and smoothed."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.h5"
        flags = [part for change in changes for part in ("--set", change)]
        command = [Path(sys.executable).with_name("daq"), "record", "-o", file, *flags]
        subprocess.run(command, check=True, capture_output=True)
        return processing.smooth(file)


def laws() -> PngFigure:
    """Draw the six laws: three curves, each with a jump and with a ramp."""
    drawn = figure(drawing.WIDE, 2.4)
    w = np.linspace(-1, 0.3, 1301)
    for axes, title, curve, pair in zip(
        drawn.subplots(1, 3, sharey=True),
        ("constant", "linear", "hyperbolic"),
        (np.ones_like, lambda s: 1 - 0.7 * s, lambda s: 1 / (1 + 5 * s)),
        ((1, 2), (3, 4), (5, 6)),
        strict=True,
    ):
        d = 0.1
        jump = np.where(w == 0, np.nan, -np.sign(w) * curve(np.abs(w)))
        s = np.maximum(np.abs(w) - d, 0)
        ramp = np.where(np.abs(w) <= d, -w / d, -np.sign(w) * curve(s))
        for law, force in zip(pair, (jump, ramp), strict=True):
            axes.plot(w, force, color=COLOURS[law], ls="-" if law % 2 else "--", label=f"law {law}")
        axes.set(title=title, xlabel="relative velocity $w$")
        axes.locator_params(axis="x", nbins=4)
        axes.axhline(0, color=INK, lw=0.5)
        axes.axvline(0, color=INK, lw=0.5)
        axes.legend()
    drawn.axes[0].set_ylabel("$F/F_s$")
    return drawn


def intervals() -> PngFigure:
    """Draw the intervals of gamma of repeated records, and the value that was simulated."""
    drawn = figure(drawing.WIDE, 2.8)
    axes = drawn.subplots()
    for seed in range(1, RUNS + 1):
        ranking = fitting.rank(record("friction.law=5", f"seed={seed}"))
        found = ranking.best.parameters["gamma"]
        axes.plot([seed, seed], [found.lo, found.hi], color=COLOURS[5], lw=3)
        axes.plot(seed, found.value, "o", color=INK, ms=4)
    axes.axhline(GAMMA, color=INK, lw=1, ls="--", label=rf"simulated: $\gamma$ = {GAMMA} s/m")
    axes.set(
        xlabel="record", ylabel=r"$\gamma$ (s/m)", title="95 % intervals of the same contact, recorded again and again"
    )
    axes.legend()
    return drawn


def none_of_six() -> PngFigure:
    """Draw the measured curve of a Stribeck contact with the six laws behind it, and the residuals of the best."""
    ranking = fitting.rank(record(*STRIBECK))
    rows = [row for row in ranking.rows if isinstance(row.law, int)]
    drawn, ((left, right),) = drawing.panels(drawing.WIDE, 3.2, 1, 2, gap=0.85)
    styles = law_styles(row.law for row in rows)
    drawing.draw(left, [(row.fit, row.name, styles[row.law]) for row in rows], ranking.motion, ranking.adequacy.curve)
    left.set_title("measured without a law; the six behind it")
    residuals(right, ranking)
    drawing.add_legend(drawn, [left])
    return drawn


def creep() -> PngFigure:
    """Draw a stick of a jump law and of a ramp law: velocity near that of the belt."""
    drawn = figure(drawing.WIDE, 2.6)
    axes = drawn.subplots()
    for law, style in ((5, "-"), (6, "--")):
        scene = rig_sim.scene("rig", **{"friction.law": law})
        motion = rig_sim.run(scene, until=6, rate=1000).to_dataframe()
        late = motion[motion.t > 2]
        axes.plot(late.t, late.v, color=COLOURS[law], ls=style, label=f"law {law}")
    axes.axhline(0.22, color=MEASURED, lw=1, label="belt")
    axes.set(
        xlabel=drawing.TIME,
        ylabel=drawing.VELOCITY,
        ylim=(0.15, 0.27),
        title="a ramp lets the mass creep relative to the belt",
    )
    axes.legend()
    return drawn


def continuous_slip() -> PngFigure:
    """Draw stable and unstable motions over the friction level: where stick-slip ends as a contact wears."""
    scene = rig_sim.scene("rig", **{"damper.c": 0.4})
    drawn = figure(drawing.WIDE, 3.0)
    axes = drawn.subplots()
    rig_sim.continue_(scene, over="friction.Fs=0.1:1.4").plot(ax=axes)
    # the scene is in SI
    axes.set(xlabel="$F_s$ (N)", ylabel="position $x$ (m)", title="solid: stable; dashed: unstable")
    return drawn


def departures() -> PngFigure:
    """Draw what a spring 5 % hard leaves beside the best law, and the departures that were tested."""
    contacts = runpy.run_path(str(Path(__file__).parents[1] / "tests" / "rig.py"))
    time, position = contacts["recorded"](contacts["Contact"](k3=HARD, scatter=0.03), count=50e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a table of counts and what it lacks
        ranking = fitting.rank(processing.smooth(daq.Recording.from_arrays(time, position, mass=0.3, x0=(0.0, 5e-4))))
    drawn = figure(drawing.WIDE, 2.8)
    left, right = drawn.subplots(1, 2)
    residuals(left, ranking)
    found = ranking.adequacy.departures[::-1]
    right.barh([one.name for one in found], [one.sigmas for one in found], color=COLOURS[2])
    right.set(xlabel="standard deviations", title="departures, the best explanation at the top")
    return drawn


def residuals(axes: "Axes", ranking: "fitting.Ranking") -> None:
    """Draw the residuals of the best law against the time since the break-away, with the band of the noise."""
    best = next(row for row in ranking.rows if isinstance(row.law, int))
    axes.plot(since_break_away(best), 1e6 * best.fit.residual, ".", color=COLOURS[best.law], ms=1.5)
    axes.axhspan(*(2e6 * ranking.adequacy.noise_m * np.array([-1, 1])), color=INK, alpha=0.25, lw=0)
    axes.set(xlabel=drawing.SINCE_BREAK_AWAY, ylabel="residual (µm)", title=f"{best.name}: the misfit repeats")


DRAWN = {
    one.__name__.replace("_", "-"): one for one in (laws, intervals, none_of_six, creep, departures, continuous_slip)
}

if __name__ == "__main__":
    os.environ.setdefault("SOURCE_DATE_EPOCH", "0")
    for name in sys.argv[1:] or DRAWN:
        with mpl.rc_context(fname=STYLE):
            DRAWN[name]().savefig(PICTURES / f"{name}.png", dpi=150)
