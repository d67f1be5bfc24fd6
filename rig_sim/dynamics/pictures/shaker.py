"""Picture of the amplification-phase plane of a shaker: the thesis's figures 6.10 and 6.11 in one."""

import math
from typing import TYPE_CHECKING

import numpy as np

from daq.base.compute.arrays import Array
from rig_sim.dynamics.control.stability import ShakerPlane

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GROWTHS = (0.0, -0.1, -0.2)  # of sqrt(k/m), and
FREQUENCIES = (0.5, 0.9, 1.0, 1.1, 2.0)  # of sqrt(k/m): the curves of the thesis
PHASES, LEVELS = 721, 501  # of the shaded region


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
        axes.plot(*unwrapped(curve.phi, curve.a), color="#0072B2", lw=width, label=name)
    for share, colour in zip(FREQUENCIES, ("#E69F00", "#CC79A7", "0.5", "#56B4E9", "#D55E00"), strict=True):
        curve = plane.frequency_curve(share * rate, top)
        axes.plot(*unwrapped(curve.phi, curve.a), "--", color=colour, lw=1.2, label=f"omega = {share:g} omega0")
    for omega in plane.band or ():
        curve = plane.frequency_curve(omega, top)
        axes.plot(*unwrapped(curve.phi, curve.a), color="black", lw=1.2, label=f"omega = {omega:g} rad/s (band)")
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


def unwrapped(phi: Array, a: Array) -> tuple[Array, Array]:
    """Return a curve with a gap where its phase passes 0, so that no line is drawn back."""
    jumps = np.flatnonzero(np.abs(np.diff(phi)) > math.pi) + 1
    return np.insert(phi, jumps, np.nan), np.insert(a, jumps, np.nan)
