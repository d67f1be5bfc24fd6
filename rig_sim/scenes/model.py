"""The model of a scene: its sections, and the equation of motion that they make.  Keys: `rig_sim.scenes.scene`."""

from typing import Annotated, Any

from pydantic import Field

from rig_sim.flow.flow import Flow
from rig_sim.flow.memory import MemoryFlow, make_memory_flow
from rig_sim.flow.reach import largest_slip_speed
from rig_sim.flow.two_mass import TwoMassFlow
from rig_sim.friction.curve import CONSTANT
from rig_sim.scenes import sections
from rig_sim.scenes.sections import Section
from stickslip.errors import InputError

TERMS = ("mass", "spring", "coupling", "belt", "friction", "start", "damper", "drive", "shaker")
EFFECTS = ("wear", "scatter", "joint", "droop", "slip_loss", "gaps", "encoder", "jitter", "output")
SECTIONS = TERMS + EFFECTS
STARTS = (("x", "v"), ("x1", "v1", "x2", "v2"), ("d",), ("attractor",))  # forms of a start; a change drops the others


class Scene(Section):
    """What exists on the rig; an absent section is None and its term does not exist."""

    name: str = ""
    title: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    mass: sections.Mass
    spring: sections.Spring
    belt: sections.Belt | None = None
    friction: sections.Friction | None = None
    start: sections.Start = sections.Start()
    coupling: sections.Coupling | None = None
    damper: sections.Damper | None = None
    drive: sections.Drive | None = None
    shaker: sections.Shaker | None = None
    wear: sections.WearSection | None = None
    scatter: sections.Scatter | None = None
    joint: sections.Joint | None = None
    droop: sections.Droop | None = None
    slip_loss: sections.SlipLoss | None = None
    gaps: sections.Gaps | None = None
    encoder: sections.Encoder | None = None
    jitter: sections.Jitter | None = None
    output: sections.Output | None = None
    fit: sections.FitSection | None = None

    def terms(self) -> list[str]:
        """Return the names of the sections that the scene has, in the order of `SECTIONS`."""
        return [name for name in SECTIONS if getattr(self, name) is not None]

    def flow(self, *, belt_running: bool = True, factor: float = 1.0) -> Flow:
        """Return the equation of motion for the integrator; raises InputError of a scene with two masses.

        A ripple of the belt becomes a drive, in coordinates that swing with it: see `rig_sim.effects.ripple`.  A shaker
        becomes another damper, spring and rest position: see `rig_sim.effects.shaker`.  ``belt_running`` is False
        before ``belt.start``: the belt is at rest.  ``factor`` (wear times scatter) multiplies the friction curve; the
        ramp's width stays.
        """
        if self.coupling:
            do = "remove the section coupling, or use events, run, fixed-point, map, sweep, basins or lyapunov"
            python = "use rig_sim.events, run, fixed_point, continue_, map, sweep, basins or lyapunov"
            raise InputError(
                "has two masses, but this analysis requires one mass", f"scene {self.name}", do, python=python
            )
        if self.has_memory():
            problem = "has a friction law with memory, which this analysis does not support"
            do = "use run, events, cycle or fixed-point, or use law 1 to 6"
            python = "use rig_sim.run, events, cycle or fixed_point"
            raise InputError(problem, f"scene {self.name}", do, python=python)
        return self._one_mass_flow(belt_running=belt_running, factor=factor)

    def has_memory(self) -> bool:
        return self.friction is not None and self.friction.memory_law() is not None

    def memory_flow(self, *, belt_running: bool = True, factor: float = 1.0) -> MemoryFlow:
        """Return the equation of motion of a scene whose friction law has a memory; parameters as of `flow`."""
        law = self.friction.memory_law() if self.friction else None
        if self.friction is None or law is None or self.belt is None:
            raise ValueError("requires a belt and a law with memory")
        flow = self._one_mass_flow(belt_running=belt_running, factor=factor)
        values = {name: value for name, value in self.friction.memory_parameters().items() if value is not None}
        return make_memory_flow(flow, law.code, float(self.belt.speed), values)

    def two_mass_flow(self) -> TwoMassFlow:
        """Return the equations of motion of two masses; raises InputError of a scene with one mass."""
        if self.coupling is None:
            do = "set coupling.a and coupling.b, or use the scene two-mass"
            python = f"write rig_sim.scene({self.name!r}, coupling={{'a': 1.2, 'b': 1.3}}), or use 'two-mass'"
            raise InputError(
                "has one mass, but this analysis requires two masses", f"scene {self.name}", do, python=python
            )
        return TwoMassFlow(self._one_mass_flow(), float(self.coupling.a), float(self.coupling.b))

    def _largest_slip_speed(self) -> float:
        """Return the largest slip speed (m/s) that energy allows, for a formula; 0 for a law: its curve has no end."""
        if self.friction is None or self.friction.formula is None:
            return 0.0
        speed = abs(float(self.belt.speed)) + float(self.belt.ripple or 0.0) if self.belt else 0.0
        return largest_slip_speed(
            float(self.mass.m),
            float(self.spring.k),
            float(self.damper.c) if self.damper else 0.0,
            speed,
            self.friction.largest_force(speed),
            float(self.start.x) - float(self.spring.x0),
            abs(float(self.start.v)) + (abs(float(self.joint.kick)) if self.joint else 0.0),
            abs(float(self.drive.u0)) if self.drive else 0.0,
        )

    def _one_mass_flow(self, *, belt_running: bool = True, factor: float = 1.0) -> Flow:
        friction: dict[str, Any] = {"curve": CONSTANT, "ramp": 0, "Fs": 0.0, "G_slip": 0.0, "gamma": 0.0, "d": 0.0}
        if self.friction and not self.has_memory():
            friction |= self.friction.flow_fields(self._largest_slip_speed())
        flow = Flow(
            m=float(self.mass.m),
            k=float(self.spring.k),
            x0=float(self.spring.x0),
            c=float(self.damper.c) if self.damper else 0.0,
            v_belt=float(self.belt.speed) if self.belt and belt_running else 0.0,
            factor=factor,
            **friction,
            u0=float(self.drive.u0) if self.drive else 0.0,
            omega=float(self.drive.omega) if self.drive else 0.0,
            phase=0.0,
            droop=self.droop.fraction * abs(self.belt.speed) if self.droop and self.belt and belt_running else 0.0,
        )
        if self.shaker and belt_running:
            from rig_sim.effects.shaker import add_shaker

            flow = add_shaker(flow, float(self.shaker.a), float(self.shaker.phi))
        if self.belt and self.belt.ripple and belt_running:
            return self.belt.swing().drive(flow)
        return flow
