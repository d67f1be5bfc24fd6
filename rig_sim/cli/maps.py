"""The commands of ``rig-sim`` that ask the map of two masses: map."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from daq.console.application import Answer, Json, SetChanges
from daq.errors import InputError

if TYPE_CHECKING:
    from rig_sim.dynamics.maps.stick_map import StickEvent, StickMap

Plot = Annotated[Path | None, Parameter(help="Draw the result into this file (.png, .svg, .pdf).")]
Force = Annotated[bool, Parameter(negative=(), help="Replace the file if it exists.")]


def map_(
    scene: str,
    /,
    *,
    d: Annotated[
        list[str] | None,
        Parameter(
            allow_leading_hyphen=True,
            help="Stretch x2 - x1 while both masses stick; several as 0.05,0.1 or with several --d.",
        ),
    ] = None,
    iterate: Annotated[int, Parameter(help="How many events to follow.")] = 1,
    periodic: Annotated[
        bool, Parameter(negative=(), help="Find the periodic orbits of the map with --iterate as their period.")
    ] = False,
    plot: Plot = None,
    force: Force = False,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Map the stretch d = x2 - x1 of two masses from one global stick to the next; list which mass slipped.

    The word lists the masses in the order in which they broke away; of several events the words are separated by
    spaces. Start and the belt's start are ignored.

    Example: rig-sim map two-mass --d 0.05,0.1,0.15 --iterate 2

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    if iterate < 1:
        raise InputError(f"is {iterate}", "--iterate", "give 1 or more")
    if d is None and not periodic and plot is None:
        raise InputError("nothing to do", "--d", "give --d, --periodic or --plot")
    found = stick_map(scene, set_)
    data: dict[str, Any] = {}
    lines = []
    if d is not None:
        stretches, several = _numbers(d)
        chains = [_chain(found, stretch, iterate) for stretch in stretches]
        data = {
            "d": stretches,
            "f": [chain[-1].d for chain in chains],
            "word": [" ".join(event.word for event in chain) for chain in chains],
            "duration": [sum(event.duration for event in chain) for chain in chains],
            "outcome": [chain[-1].outcome for chain in chains],
            "advice": [chain[-1].advice for chain in chains],
        }
        lines = [f"{'d':>22} {'f(d)':>22}  word"]
        for row in zip(*(data[key] for key in ("d", "f", "word", "outcome", "advice")), strict=True):
            ended = "" if row[3] == "completed" else f"  {row[3]} ({row[4]})"
            lines.append(f"{row[0]:22.15g} {row[1]:22.15g}  {row[2]}{ended}")
        if not several:
            data = {key: values[0] for key, values in data.items()}
    if periodic:
        from rig_sim.dynamics.maps.periodic_points import periodic_points

        orbits = periodic_points(found, iterate)
        data["periodic"] = [{**asdict(orbit), "period": orbit.period, "stable": orbit.stable} for orbit in orbits]
        lines += [
            f"period {orbit.period}, {'stable' if orbit.stable else 'unstable'}, slope {orbit.slope:.12g}: "
            + ", ".join(f"{point:.15g}" for point in orbit.points)
            for orbit in orbits
        ] or [f"no orbit of period {iterate}"]
    if plot is not None:
        from rig_sim.dynamics.maps.plot import map_figure, save

        save(map_figure(found, iterate), plot, force=force)
        data["file"] = plot
        lines.append(str(plot))
    return Answer(data, "\n".join(lines))


def stick_map(name: str, changes: list[str] | None) -> "StickMap":
    """Return the map of a scene of two masses.

    Raises
    ------
    InputError
        One mass, or a belt at rest.
    """
    from rig_sim.dynamics.maps.stick_map import StickMap
    from rig_sim.scenes.scene import parse_changes, scene

    flow = scene(name, **parse_changes(changes)).two_mass_flow()
    try:
        return StickMap(flow)
    except ValueError as error:
        raise InputError(str(error), f"scene {name}", "change that value with --set") from None


def _chain(found: "StickMap", d: float, times: int) -> "list[StickEvent]":
    """Return the events that follow a global stick, up to ``times``."""
    chain: list[StickEvent] = []
    for _ in range(times):
        chain.append(found.event(d))
        if chain[-1].outcome != "completed":
            break
        d = chain[-1].d
    return chain


def _numbers(given: list[str]) -> tuple[list[float], bool]:
    """Return the numbers of ``--d``, and whether it is a list."""
    parts = [part for text in given for part in text.strip("[] ").split(",")]
    try:
        return [float(part) for part in parts], len(parts) > 1 or "[" in given[0]
    except ValueError:
        raise InputError(f"{','.join(given)!r} holds something that is no number", "--d", "write 0.1,0.2") from None
