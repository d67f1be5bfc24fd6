"""Picture of a driven mass that is locked onto an unstable orbit: the thesis's figures 6.12 to 6.17."""

import matplotlib as mpl
from matplotlib.figure import Figure

from daq.base.output.plot import STYLE, figure
from rig_sim.dynamics.control.ogy import Lock
from rig_sim.dynamics.rig.landing import LandingMap

SAMPLES = 200  # per drive period
BEFORE = 12  # landings of the motion without control that the phase portrait shows
TURNS = 3  # of the orbit, drawn over time


@mpl.rc_context(fname=STYLE)
def lock_figure(f: LandingMap, found: Lock, period: int, budget: float) -> Figure:
    """Return a figure of the landings, the change of the amplitude, the phase portrait and the velocity."""
    page = figure(10.0, 7.0)
    ((landings, changes), (portrait, velocity)) = page.subplots(2, 2)
    landings.plot(found.states[:, 1], ".", ms=3, color="#0072B2")
    landings.set(xlabel="landing", ylabel="x at landing (the scene's unit)", title="Landings")
    changes.plot(100.0 * found.changes / f.strength, ".-", ms=3, lw=0.8, color="#D55E00")
    for side in (-1, 1):
        changes.axhline(side * 100.0 * budget, color="0.5", lw=0.8, ls="--")
    changes.set(xlabel="landing", ylabel="change of u0 (%)", title="Control; dashed: the budget")
    if found.events_to_lock is not None:
        for axes in (landings, changes):
            axes.axvline(found.events_to_lock, color="black", lw=0.8, ls=":")
    first = max((found.events_to_lock or 0) - BEFORE, 0)
    last = len(found.changes)
    for part, colour, width in (
        (slice(first, first + BEFORE), "0.75", 0.7),
        (slice(last - period, last), "#0072B2", 1.6),
    ):
        _, x, v = f.sampled(found.states[:last][part], found.changes[part], SAMPLES / f.period)
        portrait.plot(x, v, color=colour, lw=width)
    portrait.set(xlabel="x (the scene's unit)", ylabel="v (the scene's unit)")
    portrait.set_title(f"Last {period} landings; grey: before the control")
    drawn = slice(max(last - TURNS * period, 0), last)
    time, _, v = f.sampled(found.states[drawn], found.changes[drawn], SAMPLES / f.period)
    velocity.plot(time, v, color="#0072B2", lw=1.0)
    velocity.set(xlabel="time (the scene's unit)", ylabel="v (the scene's unit)", title="Velocity on the orbit")
    return page
