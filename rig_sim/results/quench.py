"""Whether a fast drive quenches stick-slip: thesis figures 6.7 and 6.8."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rig_sim.analyses.control import dither
from rig_sim.analyses.control.dither import (
    DECAY,
    MOST_SAMPLES,
    STEPS_IN_ALL,
    linear_ripple,
    measure_swing,
    sample_positions,
)
from rig_sim.analyses.settling import settle
from rig_sim.flow.flow import Flow
from rig_sim.results.arguments import SceneLike, load_scene
from rig_sim.results.result import PALE, UNIT, Result
from rig_sim.results.scene_systems import require_period
from rig_sim.systems.driven import DrivenMap
from rig_sim.systems.interface import StepBudget
from stickslip.compute.stages import Stages, silent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OSCILLATIONS = 12.0  # length of the drawn motion in periods of the undriven mass
SAMPLES = 40  # per drive period, or per oscillation of the mass if that is shorter
RATIOS = (0.5, 1.5, 41)  # amplitudes over the threshold: from, to, how many


@dataclass(frozen=True, repr=False)
class Quench(Result, dither.Quench):
    """Whether a fast drive quenches stick-slip, and from which amplitude on: what `rig_sim.quench` returns."""

    flow: Flow = field(repr=False, compare=False, kw_only=True)
    start: tuple[float, float] = field(repr=False, compare=False, kw_only=True)

    UNITS: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("threshold", "threshold_with_slope", "simulated_threshold"), "N"),
        **dict.fromkeys(("swing", "linear_ripple", "free_swing"), "m"),
    }
    SIZE = (8.6, 7.2)

    def lines(self) -> list[str]:
        lines = [f"{self.outcome}: u0 = {self.flow.u0:.6g}"]
        simulated = self.simulated_threshold
        by_formula = ("by formula", self.threshold), ("with the slope of friction", self.threshold_with_slope)
        for name, value in by_formula:
            lines.append(f"threshold {name} {value:.6g}")
            if simulated is not None and value > 0.0:
                lines[-1] += f" (simulation {simulated / value - 1.0:+.2%})"
        if simulated is not None:
            lines.append(f"threshold by simulation {simulated:.6g}")
        swings = [format(swing, ".4g") if math.isfinite(swing) else "-" for swing in (self.swing, self.free_swing)]
        lines.append(f"peak to peak of x {swings[0]}; without the drive {swings[1]}")
        if self.linear_ripple is not None:
            lines.append(f"of spring and mass alone under the drive {self.linear_ripple:.4g}")
        return lines

    def draw_page(self, page: "Figure") -> None:
        """Draw the motion with and without its drive, above, and its swing over the amplitude, below."""
        above, below = page.subplots(2)
        self.draw(above)
        self.draw_swing(below)

    def draw(self, ax: "Axes") -> None:
        flow = self.flow
        oscillation, period = 2.0 * math.pi * math.sqrt(flow.m / flow.k), 2.0 * math.pi / abs(flow.omega)
        samples = min(math.ceil(OSCILLATIONS * oscillation / min(oscillation, period) * SAMPLES), MOST_SAMPLES)
        times = np.linspace(0.0, OSCILLATIONS * oscillation, samples)
        for u0, name, width in ((0.0, "without the drive", 0.8), (flow.u0, f"u0 = {flow.u0:.6g}", 1.6)):
            path = sample_positions(flow._replace(u0=u0), *self.start, times)
            ax.plot(times[: len(path)], path, lw=width, label=name)
        ax.set(xlabel=f"t {UNIT}", ylabel=f"x {UNIT}", title=f"Dither of omega = {flow.omega:.6g}")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)

    def draw_swing(self, ax: "Axes") -> None:
        if self.threshold > 0.0:
            amplitudes = self.threshold * np.linspace(*RATIOS)
            flows = [self.flow._replace(u0=u0) for u0 in amplitudes.tolist()]
            steps, start = StepBudget(STEPS_IN_ALL), np.array(self.start)
            motions = [settle(DrivenMap(driven, budget=steps).motion(start), DECAY) for driven in flows]
            swings = [measure_swing(driven, motion) for driven, motion in zip(flows, motions, strict=True)]
            ax.plot(amplitudes, swings, ".-", ms=5)
            ripples = [linear_ripple(driven) for driven in flows]
            ax.plot(amplitudes, [math.nan if ripple is None else ripple for ripple in ripples], "--", color=PALE)
            ax.axvline(self.threshold, color=PALE, lw=0.8)
            style = {"xycoords": ("data", "axes fraction"), "rotation": 90, "va": "bottom", "ha": "right"}
            ax.annotate("threshold by formula", (self.threshold, 0.22), **style)  # type: ignore[arg-type]
            ax.set_yscale("log")
        ax.set(xlabel=f"u0 {UNIT}", ylabel=f"peak to peak of x {UNIT}")
        ax.set_title("Swing over the amplitude; dashed: spring and mass alone")


def quench(scene: SceneLike, *, progress: Stages = silent) -> Quench:
    """Find whether a fast drive (dither) quenches stick-slip, and the amplitude that is required: ``rig-sim quench``.

    ``threshold`` is the amplitude u0 at which the mass without friction reaches the speed of the belt: v_belt abs(k - m
    omega^2 + i c omega) / omega.  ``threshold_with_slope`` includes the slope of friction as damping.
    ``simulated_threshold`` is the smallest u0 at which the simulated motion, from the start of the scene, loses its
    stick-slip.  ``quenched`` tells whether this is so at the u0 of the scene.

    Parameters
    ----------
    scene : str, Path or Scene
        Scene of one mass with a drive: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also the
        result of `rig_sim.scene`.
    progress : callable, optional
        Called with the stage, the work done and the total work.

    Returns
    -------
    Quench

    Raises
    ------
    InputError
        If the scene does not exist, or has two masses, no drive, or a drive without a period.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.quench(rig_sim.scene("forced", **{"drive.omega": 20, "drive.u0": 1.75}))
    >>> found.quenched, round(found.threshold, 4)
    (True, 1.6957)
    """
    loaded = load_scene(scene)
    flow, x, v = require_period(loaded)
    return Quench(**vars(dither.quench(flow, x, v, progress)), name=loaded.name, flow=flow, start=(x, v))
