"""What the commands of ``rig-sim`` answer for a driven mass: sweep, lyapunov, quench."""

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from daq.base.console import application
from daq.base.console.application import Answer, Json, SetChanges
from daq.base.console.flags import Force, Plot, check_plot
from daq.base.errors import InputError
from rig_sim.cli.numbers import with_error

if TYPE_CHECKING:
    from rig_sim.dynamics.analyses.sweep import AttractorAt
    from rig_sim.dynamics.rig.driven import DrivenMotion
    from rig_sim.flow.flow import Flow
    from rig_sim.scenes.model import Scene

ROTATIONS = 2000  # landings over which the mean time between two is taken


@dataclass(frozen=True)
class DrivenAttractors:
    """Finds the attractors of a driven mass at a value of one key of its scene, as a process is handed it.

    Attributes
    ----------
    scene : Scene
    key : str
        Its key that is left open.
    draws : str
        The section whose points are drawn, 'poincare' or 'slip'.
    """

    scene: "Scene"
    key: str
    draws: str

    def __call__(self, value: float) -> "list[AttractorAt]":
        """Return the attractors, the one that most starts lead to first."""
        from rig_sim.dynamics.analyses.settling import attractors
        from rig_sim.dynamics.analyses.sweep import AttractorAt
        from rig_sim.dynamics.rig.driven import with_starts
        from rig_sim.scenes.scene import scene

        flow, x, v = driven(scene(self.scene, **{self.key: value}), self.scene.name)
        if flow.omega == 0.0:
            return [AttractorAt(value, 0, (), None, 0.0, (float("nan"), float("nan")), None, "no drive period")]
        rows = attractors(*with_starts(flow, x, v, self.draws), value)
        if flow.u0 == 0.0:
            rows = [replace(row, outcome="no drive" if row.points else row.outcome) for row in rows]
        return rows


def driven(found: "Scene", name: str) -> "tuple[Flow, float, float]":
    """Return the flow and the start (x, v) of a scene of one driven mass; ``name`` is for messages.

    Raises
    ------
    InputError
        Two masses, no drive, or numbers that are not physical.
    """
    from rig_sim.flow.flow import validate

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
    from rig_sim.dynamics.analyses.exponent import exponent, rotation_number

    per = "landing"
    mass = driven_mass(name, changes, "landing")
    with application.progress("following the motion", events) as show:
        found = exponent(mass, events, show.stage)
        if found.outcome == "no stick":
            per = "drive period"
            mass = driven_mass(name, changes, "poincare")
            found = exponent(mass, events, show.stage)
    data = {**asdict(found), "per": per}
    if found.outcome != "completed":
        return Answer(data, f"{found.outcome}: no exponent; list the events instead")
    if per == "landing":
        data["drive_periods_per_landing"] = rotation_number(mass.follow(ROTATIONS))
    orbit = f"period {found.period}, exact" if found.period else f"over {found.events} {per}s"
    return Answer(data, f"{with_error(found.exponent, found.stderr)} per {per} ({orbit})")


def quench(
    scene: str,
    /,
    *,
    plot: Plot = None,
    force: Force = False,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find whether a fast drive (dither) quenches stick-slip, and from which amplitude on: by formula and simulation.

    threshold is the amplitude u0 with which the mass alone reaches the belt's speed: v_belt abs(k - m omega^2 + i c
    omega) / omega; threshold_with_slope counts the slope of friction there as damping. simulated_threshold is the
    least u0 with which the simulated motion, from the scene's start, loses its stick-slip; quenched says so for the
    scene's own u0.

    Example: rig-sim quench forced --set drive.omega=20 --set drive.u0=1.75

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file, with a drive.
    """
    from rig_sim.dynamics.control.dither import quench as find
    from rig_sim.scenes.scene import parse_changes

    check_plot(plot, force)
    flow, x, v = with_period(scene, parse_changes(set_))
    with application.progress("settling", 2) as show:
        found = find(flow, x, v, show.stage)
    data: dict[str, object] = asdict(found)
    lines = [f"{found.outcome}: u0 = {flow.u0:.6g}"]
    for name, value in (("by formula", found.threshold), ("with the slope of friction", found.threshold_with_slope)):
        lines.append(f"threshold {name} {value:.6g}")
        if found.simulated_threshold is not None and value > 0.0:
            lines[-1] += f" (simulation {found.simulated_threshold / value - 1.0:+.2%})"
    if found.simulated_threshold is not None:
        lines.append(f"threshold by simulation {found.simulated_threshold:.6g}")
    swings = [application.shown(swing, ".4g") for swing in (found.swing, found.free_swing)]
    lines.append(f"peak to peak of x {swings[0]}; without the drive {swings[1]}")
    if found.linear_ripple is not None:
        lines.append(f"of spring and mass alone under the drive {found.linear_ripple:.4g}")
    if plot is not None:
        from daq.base.output.plot import save
        from rig_sim.dynamics.pictures.driven import quench_figure

        save(quench_figure(flow, x, v), plot, force=force)
        data["file"] = plot
        lines.append(str(plot))
    return Answer(data, "\n".join(lines))


def driven_mass(name: str, changes: dict[str, object], section: str) -> "DrivenMotion":
    """Return the mass of a scene, from its own start.

    Raises
    ------
    InputError
        As `driven`, or a drive without a period.
    """
    import numpy as np

    from rig_sim.dynamics.rig.driven import DrivenMap

    flow, x, v = with_period(name, changes)
    return DrivenMap(flow, section).motion(np.array([x, v]))


def with_period(name: str, changes: dict[str, object]) -> "tuple[Flow, float, float]":
    """Return flow and start as `driven`, or refuse a drive without a period."""
    from rig_sim.scenes.scene import scene

    flow, x, v = driven(scene(name, **changes), name)
    if flow.omega == 0.0:
        raise InputError("drive.omega is 0: there is no drive period", f"scene {name}", "set drive.omega")
    return flow, x, v
