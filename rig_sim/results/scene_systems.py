"""The systems that a scene makes, checked: one mass, two, or a driven one, and a scene with one key left open."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rig_sim.analyses import section
from rig_sim.analyses.settling import find_attractors
from rig_sim.analyses.sweep import AttractorAt
from rig_sim.flow.flow import Flow, validate
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import change_in_python, scene
from rig_sim.systems.driven import DrivenMap, driven_map_with_starts
from rig_sim.systems.formula import FormulaMap
from rig_sim.systems.interface import StepBudget
from rig_sim.systems.landing import LandingMap
from rig_sim.systems.stick import StickMap
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

CHANGE_IT = "change that value with --set"
STARTS = 8  # starts on a user's map of an interval; fewer miss attractors with small basins
# Of a start in its part of the interval: not a simple fraction, where unstable orbits may lie
OFFSET = 0.6180339887498949


def reject_scene(scene: Scene, error: ValueError) -> InputError:
    """Return the error for a scene whose numbers are not physical, or not modelled."""
    python = f"change that value: {change_in_python(scene.name, 'section.key', 'VALUE')}"
    return InputError(str(error), f"scene {scene.name}", CHANGE_IT, python=python)


def make_stick_map(scene: Scene, budget: StepBudget | None = None) -> StickMap:
    """Return the map of a scene of two masses, with its own integrator steps or from a ``budget`` that maps share."""
    flow = scene.two_mass_flow()
    try:
        return StickMap(flow, budget=budget)
    except ValueError as error:
        raise reject_scene(scene, error) from None


def load_driven_start(scene: Scene) -> tuple[Flow, float, float]:
    """Return the flow and the start (x, v) of a scene of one driven mass."""
    if scene.drive is None:
        do = "set drive.u0 and drive.omega, or use the scene forced"
        python = f"write rig_sim.scene({scene.name!r}, **{{'drive.u0': 0.2, 'drive.omega': 1.6}}), or use 'forced'"
        raise InputError(
            "has no drive, but this analysis requires a driven mass", f"scene {scene.name}", do, python=python
        )
    flow = scene.flow()
    try:
        validate(flow)
    except ValueError as error:
        raise reject_scene(scene, error) from None
    return flow, float(scene.start.x), float(scene.start.v)


def require_period(scene: Scene) -> tuple[Flow, float, float]:
    """Return flow and start as `load_driven_start`, or refuse a drive without a period."""
    flow, x, v = load_driven_start(scene)
    if flow.omega == 0.0:
        python = change_in_python(scene.name, "drive.omega", "1.6")
        problem = "drive.omega is 0, so there is no drive period"
        raise InputError(problem, f"scene {scene.name}", "set drive.omega", python=f"write {python}")
    return flow, x, v


def make_driven_map(scene: Scene, section: str) -> tuple[DrivenMap, Array]:
    """Return a driven mass as a system, and the scene's own start; errors as `require_period`."""
    flow, x, v = require_period(scene)
    return DrivenMap(flow, section), np.array([x, v])


def make_landing_map(scene: Scene, budget: StepBudget) -> LandingMap:
    """Return the map from landing to landing of a scene of one driven mass."""
    flow = scene.flow()
    if scene.drive is None:
        python = change_in_python(scene.name, "drive.u0", "0.2")
        do = "set drive.u0 and drive.omega"
        raise InputError("has no drive that could be controlled", f"scene {scene.name}", do, python=f"write {python}")
    try:
        return LandingMap(flow, budget=budget)
    except ValueError as error:
        raise reject_scene(scene, error) from None


@dataclass(frozen=True)
class SweptScene:
    """A scene with one free key, complete, for processes elsewhere that may not have its file."""

    scene: Scene
    key: str  # the free key, ``section.key``

    def with_value(self, value: float, **changes: object) -> Scene:
        return scene(self.scene, **{**changes, self.key: value})

    def flow(self, value: float) -> Flow:
        return self.with_value(value).flow()


def find_two_mass_attractors(swept: SweptScene, drawn: str, value: float) -> list[AttractorAt]:
    """Return the attractors of two masses at a value of one key; ``drawn`` is the section whose points are drawn."""
    return section.attractors_at(lambda key_value: swept.with_value(key_value).two_mass_flow(), drawn, value)


def find_driven_attractors(swept: SweptScene, drawn: str, value: float) -> list[AttractorAt]:
    """Return the attractors of a driven mass at a value of one key; ``drawn`` is the section whose points are drawn."""
    flow, x, v = load_driven_start(swept.with_value(value))
    if flow.omega == 0.0:
        return [AttractorAt(value, 0, (), None, 0.0, (math.nan, math.nan), None, "no drive period")]
    rows = find_attractors(*driven_map_with_starts(flow, x, v, drawn), value)
    if flow.u0 == 0.0:
        rows = [replace(row, outcome="no drive" if row.points else row.outcome) for row in rows]
    return rows


def find_custom_attractors(system_at: Callable[[float], FormulaMap], value: float) -> list[AttractorAt]:
    """Return the attractors of a custom system, which ``system_at`` returns for a value of its parameter."""
    f = system_at(value)
    starts = [f.start]
    if math.isfinite(f.hi - f.lo):
        positions = f.lo + (f.hi - f.lo) * (np.arange(STARTS) + OFFSET) / STARTS
        starts += [np.array([position]) for position in positions]
    return find_attractors(f, starts, value)


def require_interval(f: FormulaMap) -> FormulaMap:
    """Return a custom system that is a map of an interval; refuse one of more coordinates, or without an interval."""
    if len(f.scale) != 1 or not math.isfinite(f.hi - f.lo):
        do = "state its interval"
        python = f"write super().__init__(..., interval=(lo, hi)) in {type(f).__name__}, a map of one coordinate"
        raise InputError("is not a map of an interval", type(f).__name__, do, python=python)
    return f
