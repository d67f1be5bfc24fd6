"""The small oscillation of a mass under a shaker that feeds its velocity back: thesis figures 6.10 and 6.11 in one."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rig_sim.analyses.control.shaker import ShakerPlane, phasor_roots
from rig_sim.results.arguments import check_size, parse_number
from rig_sim.results.result import PALE, STABLE, UNSTABLE, Result
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GROWTHS = (0.0, -0.1, -0.2)  # growth rates over sqrt(k/m) whose curves the thesis draws
FREQUENCIES = (0.5, 0.9, 1.0, 1.1, 2.0)  # frequencies over sqrt(k/m) whose curves the thesis draws
PHASES, LEVELS = 721, 501  # points of the shaded region in phase and amplification


@dataclass(frozen=True, repr=False)
class Shaker(Result):
    """The small oscillation under a shaker that feeds the velocity back: what `rig_sim.shaker` returns.

    Attributes
    ----------
    omega, delta : float
        Frequency (rad/s) and growth rate (1/s).
    stable : bool
        Whether it decays and its frequency lies within the band.
    roots : tuple of complex
        Both roots omega + i delta.
    band : (float, float) or None
        The frequencies that the filter passes, rad/s.
    in_band : bool
    stable_phases, stable_amplifications : list of (float, float)
        Intervals of phi (rad) at this a, and of a (N s/m) at this phi.
    """

    omega: float
    delta: float
    stable: bool
    roots: tuple[complex, complex]
    band: tuple[float, float] | None
    in_band: bool
    stable_phases: list[tuple[float, float]]
    stable_amplifications: list[tuple[float, float]]
    a: float = field(repr=False, compare=False)
    phi: float = field(repr=False, compare=False)
    plane: ShakerPlane = field(repr=False, compare=False)

    UNITS: ClassVar[Mapping[str, str]] = {"omega": "rad/s", "delta": "1/s", "band": "rad/s", "stable_phases": "rad"}
    SIZE = (8.6, 6.2)

    def lines(self) -> list[str]:
        kind = "decays" if self.delta < 0.0 else "grows" if self.delta > 0.0 else "neither grows nor decays"
        outside = "" if self.in_band else ", but its frequency lies outside the filter's band"
        return [
            f"omega  {self.omega:.15g} rad/s",
            f"delta  {self.delta:.15g} 1/s: the oscillation {kind}{outside}",
            f"stable {self.stable}",
            f"stable phases at a = {self.a:g}: {format_intervals(self.stable_phases)}",
            f"stable amplifications at phi = {self.phi:g}: {format_intervals(self.stable_amplifications)}",
        ]

    def draw(self, ax: "Axes") -> None:
        """Draw the stable region with curves of constant growth rate and frequency; (a, phi) is marked."""
        plane = self.plane
        rate = math.sqrt(plane.k / plane.m)
        top = 1.1 * max(self.a, 5.0 * math.sqrt(plane.m * plane.k), 2.0 * abs(plane.S))
        phases, levels = np.linspace(0.0, 2.0 * math.pi, PHASES), np.linspace(0.0, top, LEVELS)
        stable = mark_stable(plane, levels, phases)
        ax.contourf(phases, levels, stable, levels=[0.5, 1.5], colors=["#CFE8DF"])
        for share, width in zip(GROWTHS, (2.2, 1.4, 0.8), strict=True):
            name = f"delta = {share:g} omega0" if share else "delta = 0"
            ax.plot(*plane.growth_curve(share * rate, top).with_gaps(), color=STABLE, lw=width, label=name)
        for share, colour in zip(FREQUENCIES, ("#E69F00", "#CC79A7", PALE, "#56B4E9", UNSTABLE), strict=True):
            curve = plane.frequency_curve(share * rate, top).with_gaps()
            ax.plot(*curve, "--", color=colour, lw=1.2, label=f"omega = {share:g} omega0")
        for omega in plane.band or ():
            curve = plane.frequency_curve(omega, top).with_gaps()
            ax.plot(*curve, color="black", lw=1.2, label=f"omega = {omega:g} rad/s (band)")
        ax.plot([self.phi % (2.0 * math.pi)], [self.a], "k+", ms=12, mew=2, label="the stated a and phi")
        ax.set(xlim=(0.0, 2.0 * math.pi), ylim=(0.0, top))
        ax.set_xlabel("phase phi (rad)")
        ax.set_ylabel("amplification a (N s/m, or the scene's unit)")
        within = "" if plane.band is None else " within the filter's band"
        ax.set_title(f"Shaded: the oscillation decays{within} (omega0 = {rate:.4g} rad/s)")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def shaker(
    m: float | str,
    k: float | str,
    c: float | str,
    gamma: float | str,
    a: float | str,
    phi: float | str,
    *,
    band: "str | tuple[float, float] | None" = None,
) -> Shaker:
    """Find the frequency and growth rate of a small oscillation with velocity feedback by a shaker.

    The force of the shaker is the velocity times ``a``, with a phase lead of ``phi``; ``phi`` = pi is a damper.  The
    picture shows curves of constant growth rate and of constant frequency over phase and amplification; the oscillation
    decays in the shaded region.

    Parameters
    ----------
    m : float or str
        Mass in kg, or with a unit such as '300 g'.
    k : float or str
        Stiffness of the spring in N/m, or with a unit.
    c : float or str
        Damping in N s/m, or with a unit.
    gamma : float or str
        Slope of friction at the belt speed, N s/m; positive if friction decreases with slip speed.
    a : float or str
        Amplification, N s/m.
    phi : float or str
        Phase by which the force leads the velocity, in rad, or with a unit such as '170 deg'.
    band : str or (float, float), optional
        Pass band of the filter, 'LOW:HIGH' in rad/s; ``stable`` then requires a frequency within it.  In Python also
        (low, high).

    Returns
    -------
    Shaker

    Raises
    ------
    InputError
        If a number is not finite or has the wrong sign, or ``band`` is invalid.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.shaker(m=1, k=1, c=0, gamma=0.3, a=0.5, phi=3, band=(0.9, 1.1))
    >>> found.stable, round(found.delta, 4)
    (True, -0.101)
    """
    kinds = {"m": "mass", "k": "stiffness", "c": "damping", "gamma": "damping", "a": "damping", "phi": "angle"}
    arguments = {"m": m, "k": k, "c": c, "gamma": gamma, "a": a, "phi": phi}
    values = {name: parse_number(arguments[name], kinds[name], f"--{name}") for name in kinds}
    for name, size in values.items():
        check_size(name, size, positive=name in ("m", "k"), negative=name in ("c", "gamma", "phi"))
    passband = None if band is None else parse_band(band)
    plane = ShakerPlane(values["m"], values["k"], values["gamma"] - values["c"], passband)
    level, phase = values["a"], values["phi"]
    roots = phasor_roots(plane.m, plane.k, plane.S, level, phase)
    return Shaker(
        roots[0].real,
        roots[0].imag,
        plane.is_stable(level, phase),
        roots,
        plane.band,
        plane.passes(roots[0].real),
        plane.stable_phases(level),
        plane.stable_amplifications(phase),
        level,
        phase,
        plane,
        name="a mass",
    )


def parse_band(band: "str | tuple[float, float]") -> tuple[float, float]:
    do, python = "write LOW:HIGH in rad/s, as in 0.9:1.1", "use (low, high) in rad/s, as in (0.9, 1.1)"
    ends: Sequence[Any] = band.split(":") if isinstance(band, str) else band
    try:
        first, last = ends
    except (TypeError, ValueError):
        raise InputError(f"{band!r} is not a frequency band", "--band", do, python=python) from None
    low, high = (parse_number(end, "angular frequency", "--band") for end in (first, last))
    if not 0.0 <= low < high < math.inf:
        raise InputError(f"{band!r} is not a frequency band", "--band", "use 0 <= LOW < HIGH, in rad/s")
    return low, high


def format_intervals(intervals: list[tuple[float, float]]) -> str:
    return ", ".join(f"{low:.6g} to {high:.6g}" for low, high in intervals) or "none"


def mark_stable(plane: ShakerPlane, a: Array, phi: Array) -> Array:
    """Return 1 where the plane is stable and 0 elsewhere, shape (len(a), len(phi))."""
    region = np.zeros((len(a), len(phi)))
    for row, level in zip(region, a, strict=True):
        for low, high in plane.stable_phases(float(level)):
            row[(low <= phi) & (phi <= high)] = 1.0
    return region
