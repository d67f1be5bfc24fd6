"""Pictures of driven masses: dither."""

import math

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from daq.base.output.plot import STYLE, figure
from rig_sim.dynamics.analyses.settling import settled
from rig_sim.dynamics.control.dither import (
    DECAY,
    MOST_SAMPLES,
    STEPS_IN_ALL,
    linear_ripple,
    positions,
    swing,
    threshold,
)
from rig_sim.dynamics.rig.driven import DrivenMap
from rig_sim.dynamics.system.step_budget import StepBudget
from rig_sim.flow.flow import Flow

OSCILLATIONS = 12.0  # of the mass alone that are drawn
SAMPLES = 40  # drawn of a drive period, or of an oscillation of the mass if that is shorter
RATIOS = (0.5, 1.5, 41)  # amplitudes over the threshold: from, to, how many


@mpl.rc_context(fname=STYLE)
def quench_figure(flow: Flow, x: float, v: float) -> Figure:
    """Return a figure of a motion with and without its drive, above, and of its swing over the amplitude, below."""
    drawn = figure(8.6, 7.2)
    above, below = drawn.subplots(2)
    own, period = 2.0 * math.pi * math.sqrt(flow.m / flow.k), 2.0 * math.pi / abs(flow.omega)
    samples = min(math.ceil(OSCILLATIONS * own / min(own, period) * SAMPLES), MOST_SAMPLES)
    times = np.linspace(0.0, OSCILLATIONS * own, samples)
    for u0, name, width in ((0.0, "without the drive", 0.8), (flow.u0, f"u0 = {flow.u0:.6g}", 1.6)):
        path = positions(flow._replace(u0=u0), x, v, times)
        above.plot(times[: len(path)], path, lw=width, label=name)
    above.set(xlabel="t (the scene's unit)", ylabel="x (the scene's unit)", title=f"Dither of omega = {flow.omega:.6g}")
    above.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)
    least = threshold(flow)
    if least > 0.0:
        amplitudes = least * np.linspace(*RATIOS)
        flows = [flow._replace(u0=u0) for u0 in amplitudes.tolist()]
        steps = StepBudget(STEPS_IN_ALL)
        motions = [settled(DrivenMap(driven, budget=steps).motion(np.array([x, v])), DECAY) for driven in flows]
        below.plot(
            amplitudes, [swing(driven, motion) for driven, motion in zip(flows, motions, strict=True)], ".-", ms=5
        )
        ripples = [linear_ripple(driven) for driven in flows]
        below.plot(amplitudes, [math.nan if ripple is None else ripple for ripple in ripples], "--", color="0.5")
        below.axvline(least, color="0.5", lw=0.8)
        place = {"xycoords": ("data", "axes fraction"), "rotation": 90, "va": "bottom", "ha": "right"}
        below.annotate("threshold by formula", (least, 0.22), **place)
        below.set_yscale("log")
    below.set(
        xlabel="u0 (the scene's unit)",
        ylabel="peak to peak of x (the scene's unit)",
        title="Swing over the amplitude; dashed: spring and mass alone",
    )
    return drawn
