"""Pictures of a mass under control: dither, a motion locked onto an unstable orbit, the plane of a shaker.

They are the thesis's figures 6.12 to 6.17, and 6.10 and 6.11 in one.
"""

import math
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from rig_sim.analyses.control.dither import (
    DECAY,
    MOST_SAMPLES,
    STEPS_IN_ALL,
    linear_ripple,
    measure_swing,
    sample_positions,
    threshold,
)
from rig_sim.analyses.control.ogy import Lock
from rig_sim.analyses.control.stability import ShakerPlane
from rig_sim.analyses.settling import settle
from rig_sim.flow.flow import Flow
from rig_sim.systems.driven import DrivenMap
from rig_sim.systems.landing import LandingMap
from rig_sim.systems.step_budget import StepBudget
from stickslip.compute.arrays import Array
from stickslip.output.plot import STYLE, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OSCILLATIONS = 12.0  # length of the drawn motion in periods of the undriven mass
SAMPLES = 40  # per drive period, or per oscillation of the mass if that is shorter
LOCK_SAMPLES = 200  # per drive period, of a motion under control
BEFORE = 12  # landings before the control in the phase portrait
TURNS = 3  # turns of the orbit drawn over time
RATIOS = (0.5, 1.5, 41)  # amplitudes over the threshold: from, to, how many
GROWTHS = (0.0, -0.1, -0.2)  # growth rates over sqrt(k/m) whose curves the thesis draws
FREQUENCIES = (0.5, 0.9, 1.0, 1.1, 2.0)  # frequencies over sqrt(k/m) whose curves the thesis draws
PHASES, LEVELS = 721, 501  # points of the shaded region in phase and amplification


def draw_dither(axes: "Axes", flow: Flow, x: float, v: float) -> None:
    oscillation, period = 2.0 * math.pi * math.sqrt(flow.m / flow.k), 2.0 * math.pi / abs(flow.omega)
    samples = min(math.ceil(OSCILLATIONS * oscillation / min(oscillation, period) * SAMPLES), MOST_SAMPLES)
    times = np.linspace(0.0, OSCILLATIONS * oscillation, samples)
    for u0, name, width in ((0.0, "without the drive", 0.8), (flow.u0, f"u0 = {flow.u0:.6g}", 1.6)):
        path = sample_positions(flow._replace(u0=u0), x, v, times)
        axes.plot(times[: len(path)], path, lw=width, label=name)
    axes.set(xlabel="t (the scene's unit)", ylabel="x (the scene's unit)", title=f"Dither of omega = {flow.omega:.6g}")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)


@mpl.rc_context(fname=STYLE)
def quench_figure(flow: Flow, x: float, v: float) -> Figure:
    """Return a figure of a motion with and without its drive, above, and of its swing over the amplitude, below."""
    drawn = figure(8.6, 7.2)
    above, below = drawn.subplots(2)
    draw_dither(above, flow, x, v)
    threshold_by_formula = threshold(flow)
    if threshold_by_formula > 0.0:
        amplitudes = threshold_by_formula * np.linspace(*RATIOS)
        flows = [flow._replace(u0=u0) for u0 in amplitudes.tolist()]
        steps = StepBudget(STEPS_IN_ALL)
        motions = [settle(DrivenMap(driven, budget=steps).motion(np.array([x, v])), DECAY) for driven in flows]
        below.plot(
            amplitudes,
            [measure_swing(driven, motion) for driven, motion in zip(flows, motions, strict=True)],
            ".-",
            ms=5,
        )
        ripples = [linear_ripple(driven) for driven in flows]
        below.plot(amplitudes, [math.nan if ripple is None else ripple for ripple in ripples], "--", color="0.5")
        below.axvline(threshold_by_formula, color="0.5", lw=0.8)
        style = {"xycoords": ("data", "axes fraction"), "rotation": 90, "va": "bottom", "ha": "right"}
        below.annotate("threshold by formula", (threshold_by_formula, 0.22), **style)
        below.set_yscale("log")
    below.set(
        xlabel="u0 (the scene's unit)",
        ylabel="peak to peak of x (the scene's unit)",
        title="Swing over the amplitude; dashed: spring and mass alone",
    )
    return drawn


def draw_landings(axes: "Axes", lock: Lock | None) -> None:
    if lock is not None:
        axes.plot(lock.states[:, -1], ".", ms=3, color="#0072B2")
        if lock.events_to_lock is not None:
            axes.axvline(lock.events_to_lock, color="black", lw=0.8, ls=":")
    axes.set(xlabel="landing", ylabel="x at landing (the scene's unit)", title="Landings")


@mpl.rc_context(fname=STYLE)
def lock_figure(f: LandingMap, lock: Lock, period: int, budget: float) -> Figure:
    """Return a figure of the landings, the change of the amplitude, the phase portrait and the velocity."""
    page = figure(10.0, 7.0)
    ((landings, changes), (portrait, velocity)) = page.subplots(2, 2)
    draw_landings(landings, lock)
    changes.plot(100.0 * lock.changes / f.strength, ".-", ms=3, lw=0.8, color="#D55E00")
    for side in (-1, 1):
        changes.axhline(side * 100.0 * budget, color="0.5", lw=0.8, ls="--")
    changes.set(xlabel="landing", ylabel="change of u0 (%)", title="Control; dashed: the budget")
    if lock.events_to_lock is not None:
        changes.axvline(lock.events_to_lock, color="black", lw=0.8, ls=":")
    first = max((lock.events_to_lock or 0) - BEFORE, 0)
    last = len(lock.changes)
    for part, colour, width in (
        (slice(first, first + BEFORE), "0.75", 0.7),
        (slice(last - period, last), "#0072B2", 1.6),
    ):
        _, x, v = f.sample_motion(lock.states[:last][part], lock.changes[part], LOCK_SAMPLES / f.period)
        portrait.plot(x, v, color=colour, lw=width)
    portrait.set(xlabel="x (the scene's unit)", ylabel="v (the scene's unit)")
    portrait.set_title(f"Last {period} landings; grey: before the control")
    drawn = slice(max(last - TURNS * period, 0), last)
    time, _, v = f.sample_motion(lock.states[drawn], lock.changes[drawn], LOCK_SAMPLES / f.period)
    velocity.plot(time, v, color="#0072B2", lw=1.0)
    velocity.set(xlabel="time (the scene's unit)", ylabel="v (the scene's unit)", title="Velocity on the orbit")
    return page


def draw_shaker(axes: "Axes", plane: ShakerPlane, a: float, phi: float) -> None:
    """Draw the stable region with curves of constant growth rate and frequency; (a, phi) is marked."""
    rate = math.sqrt(plane.k / plane.m)
    top = 1.1 * max(a, 5.0 * math.sqrt(plane.m * plane.k), 2.0 * abs(plane.S))
    phases, levels = np.linspace(0.0, 2.0 * math.pi, PHASES), np.linspace(0.0, top, LEVELS)
    stable = stable_region(plane, levels, phases)
    axes.contourf(phases, levels, stable, levels=[0.5, 1.5], colors=["#CFE8DF"])
    for share, width in zip(GROWTHS, (2.2, 1.4, 0.8), strict=True):
        name = f"delta = {share:g} omega0" if share else "delta = 0"
        curve = plane.growth_curve(share * rate, top)
        axes.plot(*break_at_wraps(curve.phi, curve.a), color="#0072B2", lw=width, label=name)
    for share, colour in zip(FREQUENCIES, ("#E69F00", "#CC79A7", "0.5", "#56B4E9", "#D55E00"), strict=True):
        curve = plane.frequency_curve(share * rate, top)
        axes.plot(*break_at_wraps(curve.phi, curve.a), "--", color=colour, lw=1.2, label=f"omega = {share:g} omega0")
    for omega in plane.band or ():
        curve = plane.frequency_curve(omega, top)
        axes.plot(*break_at_wraps(curve.phi, curve.a), color="black", lw=1.2, label=f"omega = {omega:g} rad/s (band)")
    axes.plot([phi % (2.0 * math.pi)], [a], "k+", ms=12, mew=2, label="a and phi given")
    axes.set(xlim=(0.0, 2.0 * math.pi), ylim=(0.0, top))
    axes.set_xlabel("phase phi (rad)")
    axes.set_ylabel("amplification a (N s/m, or the scene's unit)")
    within = "" if plane.band is None else " within the filter's band"
    axes.set_title(f"Shaded: the oscillation decays{within} (omega0 = {rate:.4g} rad/s)")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def stable_region(plane: ShakerPlane, a: Array, phi: Array) -> Array:
    """Return 1 where the plane is stable and 0 elsewhere, shape (len(a), len(phi))."""
    region = np.zeros((len(a), len(phi)))
    for row, level in zip(region, a, strict=True):
        for low, high in plane.stable_phases(float(level)):
            row[(low <= phi) & (phi <= high)] = 1.0
    return region


def break_at_wraps(phi: Array, a: Array) -> tuple[Array, Array]:
    """Return a curve with a gap where its phase passes 0, so that no line is drawn back."""
    jumps = np.flatnonzero(np.abs(np.diff(phi)) > math.pi) + 1
    return np.insert(phi, jumps, np.nan), np.insert(a, jumps, np.nan)
