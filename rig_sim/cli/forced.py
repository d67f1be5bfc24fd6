"""What the commands of ``rig-sim`` answer for a driven mass: sweep, lyapunov, quench."""

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from daq.console.application import Answer
from daq.errors import InputError

if TYPE_CHECKING:
    from rig_sim.dynamics.forced.driven_mass import DrivenMass
    from rig_sim.dynamics.maps.sweep import AttractorAt
    from rig_sim.flow.flow import Flow

ROTATIONS = 2000  # landings over which the mean time between two is taken


@dataclass(frozen=True)
class DrivenAttractors:
    """Finds the attractors of a driven mass at a value of one key of its scene, as a process is handed it.

    Attributes
    ----------
    name, changes, key
        The scene, its changes, and the key left open.
    draws : str
        The section whose points are drawn, 'poincare' or 'slip'.
    """

    name: str
    changes: dict[str, object]
    key: str
    draws: str

    def __call__(self, value: float) -> "list[AttractorAt]":
        """Return the attractors, the one that most starts lead to first."""
        from rig_sim.dynamics.forced.attractors import attractors
        from rig_sim.dynamics.forced.driven_mass import driven_masses
        from rig_sim.dynamics.maps.sweep import AttractorAt

        flow, x, v = driven(self.name, {**self.changes, self.key: value})
        if flow.omega == 0.0:
            return [AttractorAt(value, 0, (), None, 0.0, (float("nan"), float("nan")), None, "no drive period")]
        rows = attractors(driven_masses(flow, x, v, self.draws), value)
        if flow.u0 == 0.0:
            rows = [replace(row, outcome="no drive" if row.points else row.outcome) for row in rows]
        return rows


def driven(name: str, changes: dict[str, object]) -> "tuple[Flow, float, float]":
    """Return the flow and the start (x, v) of a scene of one driven mass.

    Raises
    ------
    InputError
        Two masses, no drive, or numbers that are not physical.
    """
    from rig_sim.flow.flow import validate
    from rig_sim.scenes.scene import scene

    found = scene(name, **changes)
    if found.drive is None:
        do = "set drive.u0 and drive.omega, or take the scene forced"
        raise InputError("has no drive, and this is for a driven mass", f"scene {name}", do)
    flow = found.flow()
    try:
        validate(flow)
    except ValueError as error:
        raise InputError(str(error), f"scene {name}", "change that value with --set") from None
    return flow, float(found.start.x), float(found.start.v)


def driven_lyapunov(name: str, changes: dict[str, object], events: int) -> Answer:
    """Return the answer of ``rig-sim lyapunov`` for a driven mass, per landing or per drive period."""
    from rig_sim.dynamics.forced.exponent import exponent, rotation_number

    per = "landing"
    mass = driven_mass(name, changes, "landing")
    found = exponent(mass, events)
    if found.outcome == "no stick":
        per = "drive period"
        mass = driven_mass(name, changes, "poincare")
        found = exponent(mass, events)
    data = {**asdict(found), "per": per}
    if found.outcome != "completed":
        return Answer(data, f"{found.outcome}: no exponent; list the events instead")
    if per == "landing":
        data["drive_periods_per_landing"] = rotation_number(mass.follow(ROTATIONS))
    orbit = f"period {found.period}, exact" if found.period else f"over {found.events} {per}s"
    return Answer(data, f"{found.exponent:.8g} +- {found.stderr:.2g} per {per} ({orbit})")


def driven_mass(name: str, changes: dict[str, object], section: str) -> "DrivenMass":
    """Return the mass of a scene, from its own start.

    Raises
    ------
    InputError
        As `driven`, or a drive without a period.
    """
    from rig_sim.dynamics.forced.driven_mass import DrivenMass

    flow, x, v = driven(name, changes)
    if flow.omega == 0.0:
        raise InputError("drive.omega is 0: there is no drive period", f"scene {name}", "set drive.omega")
    return DrivenMass(flow, x, v, section)
