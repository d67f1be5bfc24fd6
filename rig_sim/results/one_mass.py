"""One mass on a belt, undriven: its periodic orbit, its fixed point, and Floquet multipliers."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Literal

from rig_sim.analyses.limit_cycles import fixed_point as fixed
from rig_sim.analyses.limit_cycles import floquet as multipliers
from rig_sim.analyses.limit_cycles import limit_cycle
from rig_sim.flow.modes import NEGATIVE, POSITIVE
from rig_sim.integrate.phases import State
from rig_sim.results.arguments import SceneLike, load_scene
from rig_sim.results.result import PALE, STABLE, UNIT, Result
from rig_sim.scenes.model import Scene
from stickslip.errors import check_known

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes

ORBITS = ("stable", "unstable")
POINTS = 2000  # of a drawn orbit


@dataclass(frozen=True, repr=False)
class Cycle(Result, limit_cycle.Orbit):
    """The periodic orbit that a scene reaches from the slip point: what `rig_sim.cycle` returns."""

    scene: Scene | None = field(default=None, repr=False, compare=False)

    UNITS: ClassVar["Mapping[str, str]"] = {
        **dict.fromkeys(("period", "t_stick", "t_slip"), "s"),
        **dict.fromkeys(("x_slip", "x_stick", "x_min", "x_max"), "m"),
        **dict.fromkeys(("v_min", "v_max"), "m/s"),
    }
    SIZE = (6.4, 4.6)

    def draw(self, ax: "Axes") -> None:
        import numpy as np

        from rig_sim.integrate.sampled import sample_motion

        ax.set(xlabel=f"x {UNIT}", ylabel=f"v {UNIT}", title=f"{self.name}: {self.outcome}")
        if self.period is None or self.x_slip is None or self.scene is None:
            return
        if self.scene.has_memory():
            from rig_sim.analyses.limit_cycles.memory_cycle import memory_cycle

            memory_flow = self.scene.memory_flow()
            _, motion = memory_cycle(memory_flow)
            ax.plot(motion.x, motion.v, color=STABLE)
            ax.axhline(memory_flow.v_belt, color=PALE, lw=0.8, ls="--")
            return
        flow = self.scene.flow()
        edge = -math.copysign(flow.d, flow.v_belt) if flow.ramp else 0.0
        mode = NEGATIVE if flow.v_belt > 0.0 else POSITIVE
        times = np.linspace(0.0, self.period, POINTS)
        x, v = sample_motion(flow, State(mode, self.x_slip, edge, 0.0), times)
        ax.plot(x, v, color=STABLE)
        ax.axhline(flow.v_belt, color=PALE, lw=0.8, ls="--")


@dataclass(frozen=True, repr=False)
class FixedPoint(Result, fixed.FixedPoint):
    """The fixed point of one mass and its stability: what `rig_sim.fixed_point` returns."""

    UNITS: ClassVar["Mapping[str, str]"] = {"x": "m", "eigenvalues": "1/s"}
    SIZE = (5.4, 4.6)

    def draw(self, ax: "Axes") -> None:
        ax.axvline(0.0, color=PALE, lw=0.8)
        ax.plot([root.real for root in self.eigenvalues], [root.imag for root in self.eigenvalues], "o", color=STABLE)
        ax.set(xlabel=f"real part, growth rate {UNIT}", ylabel=f"imaginary part {UNIT}")
        ax.set_title(f"{self.name}: eigenvalues of the fixed point")


@dataclass(frozen=True, repr=False)
class TwoMassFixedPoint(Result, fixed.TwoMassFixedPoint):
    """The fixed point of two masses and its stability: what `rig_sim.fixed_point` returns for them."""

    UNITS: ClassVar["Mapping[str, str]"] = FixedPoint.UNITS
    SIZE = FixedPoint.SIZE
    draw = FixedPoint.draw


@dataclass(frozen=True, repr=False)
class FloquetOrbit(Result, multipliers.FloquetOrbit):
    """A periodic orbit with its Floquet multipliers: what `rig_sim.floquet` returns."""

    UNITS: ClassVar["Mapping[str, str]"] = {"period": "s", "x_min": "m", "x_max": "m"}
    SIZE = (5.4, 4.6)

    def draw(self, ax: "Axes") -> None:
        circle = [2.0 * math.pi * share / 360.0 for share in range(361)]
        ax.plot([math.cos(angle) for angle in circle], [math.sin(angle) for angle in circle], color=PALE, lw=0.8)
        ax.plot(self.multipliers, [0.0] * len(self.multipliers), "o", color=STABLE)
        ax.set(xlabel="real part", ylabel="imaginary part", title=f"{self.name}: Floquet multipliers")
        ax.set_aspect("equal", adjustable="datalim")


def cycle(scene: SceneLike) -> Cycle:
    """Find the periodic orbit that is reached from break-away: ``rig-sim cycle``.

    The start of the mass and of the belt, and all random effects, are ignored.  For a law with memory, the search
    starts at the rest position with the mass moving with the belt.

    Parameters
    ----------
    scene : str, Path or Scene
        Scene: a built-in name (see ``rig-sim scenes``) or a TOML file.
        In Python also the result of `rig_sim.scene`.

    Returns
    -------
    Cycle
        Period, times and extremes.  The ``outcome`` is 'grazing' for laws 1 and 2, and 'cycle', 'fixed point' ... for
        others.

    Raises
    ------
    InputError
        No such scene, two masses, or numbers that are not physical.

    Examples
    --------
    >>> import rig_sim
    >>> orbit = rig_sim.cycle(rig_sim.scene("base", **{"friction.law": 3}))
    >>> orbit.outcome, orbit.sequence, round(orbit.period, 3)
    ('cycle', 'NS', 6.338)
    """
    loaded = load_scene(scene)
    if loaded.has_memory():
        from rig_sim.analyses.limit_cycles.memory_cycle import memory_cycle

        return Cycle(**vars(memory_cycle(loaded.memory_flow())[0]), name=loaded.name, scene=loaded)
    return Cycle(**vars(limit_cycle.cycle(loaded)), name=loaded.name, scene=loaded)


def fixed_point(scene: SceneLike) -> FixedPoint | TwoMassFixedPoint:
    """Find the fixed point, at which the mass is at rest and friction balances the spring: ``rig-sim fixed-point``.

    Parameters
    ----------
    scene : str, Path or Scene
        Scene of one or two masses: a built-in name (see ``rig-sim scenes``) or a TOML file.  Its start is ignored.
        In Python also the result of `rig_sim.scene`.

    Returns
    -------
    FixedPoint or TwoMassFixedPoint
        Position (m), eigenvalues (1/s), and whether it is stable.

    Raises
    ------
    InputError
        No such scene, or numbers that are not physical.

    Examples
    --------
    >>> import rig_sim
    >>> rest = rig_sim.fixed_point("damped")
    >>> rest.stable, round(rest.eigenvalues[0].real, 4)
    (True, -0.0337)
    """
    loaded = load_scene(scene)
    if loaded.has_memory():
        from rig_sim.analyses.limit_cycles.memory_cycle import memory_fixed_point

        return FixedPoint(**vars(memory_fixed_point(loaded.memory_flow())), name=loaded.name)
    if loaded.coupling is None:
        return FixedPoint(**vars(fixed.fixed_point(loaded.flow())), name=loaded.name)
    return TwoMassFixedPoint(**vars(fixed.two_mass_fixed_point(loaded.two_mass_flow())), name=loaded.name)


def floquet(scene: SceneLike, orbit: Literal["stable", "unstable"] = "stable") -> FloquetOrbit:
    """Find a periodic orbit and its Floquet multipliers: ``rig-sim floquet``.

    The first multiplier belongs to the direction along the orbit and is 1.  The second one is 0 for an orbit that
    sticks, and above 1 for an unstable orbit.

    Parameters
    ----------
    scene : str, Path or Scene
        Scene: a built-in name (see ``rig-sim scenes``) or a TOML file.  Its start is ignored.  In Python also
        the result of `rig_sim.scene`.
    orbit : str
        The orbit that is reached from break-away ('stable'), or the one that separates it from the fixed point
        ('unstable').

    Returns
    -------
    FloquetOrbit
        Multipliers, period (s) and extremes (m).

    Raises
    ------
    InputError
        No such scene or orbit, two masses, or numbers that are not physical.

    Examples
    --------
    >>> import rig_sim
    >>> round(rig_sim.floquet("damped", orbit="unstable").multipliers[1], 6)
    1.692648
    """
    check_known(orbit, ORBITS, "orbit", "--orbit")
    loaded = load_scene(scene)
    return FloquetOrbit(**vars(multipliers.floquet(loaded.flow(), orbit)), name=loaded.name)
