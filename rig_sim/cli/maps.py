"""The commands of ``rig-sim`` about maps of two masses: map, basins, lyapunov; and what continue answers for them."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from daq.base.console import application
from daq.base.console.application import Answer, Json, SetChanges
from daq.base.console.flags import Force, Plot, check_plot
from daq.base.errors import InputError
from rig_sim.cli import forced
from rig_sim.cli.numbers import with_error

if TYPE_CHECKING:
    from rig_sim.cli.parameter_range import ParameterRange
    from rig_sim.dynamics.rig.stick import StickEvent, StickMap
    from rig_sim.dynamics.system.step_budget import StepBudget
    from rig_sim.flow.two_mass import TwoMassFlow
    from rig_sim.scenes.swept import SweptScene

MOST_CELLS = 1_000_000
MOST_EVENTS = 10_000_000
STEPS_PER_EVENT = 1000  # of basins and of lyapunov, whose slopes take four events more; the thesis's take 30 each
STEPS_PER_VALUE = 1_000_000  # of continue; those of the thesis take 300 000
MANY_EVENTS = 500  # interpreted some seconds; above, compiled code is faster with its compilation


def map_(
    scene: str,
    /,
    *,
    d: Annotated[
        list[str] | None,
        Parameter(
            allow_leading_hyphen=True,
            negative=(),
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
        many = len(stretches) * iterate > MANY_EVENTS
        chains = [_chain(found, stretch, iterate, compiled=many) for stretch in stretches]
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
            lines.append(f"{row[0]:22.15g} {application.shown(row[1], '.15g'):>22}  {row[2]}{ended}")
        if not several:
            data = {key: values[0] for key, values in data.items()}
    if periodic:
        from rig_sim.dynamics.analyses.periodic_points import periodic_points

        orbits = periodic_points(found, iterate)
        data["periodic"] = [{**asdict(orbit), "period": orbit.period, "stable": orbit.stable} for orbit in orbits]
        lines += [
            f"period {orbit.period}, {'stable' if orbit.stable else 'unstable'}, slope {orbit.slope:.12g}: "
            + ", ".join(f"{point:.15g}" for point in orbit.points)
            for orbit in orbits
        ] or [f"no orbit of period {iterate}"]
    if plot is not None:
        from daq.base.output.plot import save
        from rig_sim.dynamics.pictures.maps import map_figure

        save(map_figure(found, iterate), plot, force=force)
        data["file"] = plot
        lines.append(str(plot))
    return Answer(data, "\n".join(lines))


def continue_map(flow_at: "SweptScene", name: str, span: "ParameterRange") -> Answer:
    """Return the answer of ``rig-sim continue`` for two masses."""
    from rig_sim.dynamics.analyses.map_branches import map_continuation
    from rig_sim.dynamics.rig.stick import STEPS_IN_ALL
    from rig_sim.dynamics.system.step_budget import StepBudget

    budget = StepBudget(max(STEPS_IN_ALL, STEPS_PER_VALUE * span.number))
    with application.progress("following", span.number) as show:
        found = map_continuation(
            lambda value: checked(flow_at(value), name, budget), span.values().tolist(), progress=show
        )
    branches = [
        {
            "kind": branch.kind,
            "stable": branch.stable,
            "rows": [{"value": row.value, **asdict(row.state)} for row in branch.rows],
        }
        for branch in found.branches
    ]
    points = [{"kind": point.kind, "parameter": span.key, "value": point.value} for point in found.points]
    lines = [
        f"{'stable' if branch.stable else 'unstable':8} {branch.kind} {span.key} from {branch.rows[0].value:.6g} "
        f"to {branch.rows[-1].value:.6g}, {len(branch.rows)} values"
        for branch in found.branches
    ]
    lines += [f"{point.kind}: {span.key} = {point.value:.12g}" for point in found.points] or ["no special point"]
    return Answer({"parameter": span.key, "branches": branches, "points": points}, "\n".join(lines))


def basins(
    scene: str,
    /,
    *,
    cells: Annotated[int, Parameter(help="Cells that the interval of d is divided into.")] = 4000,
    plot: Plot = None,
    force: Force = False,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find the attractors of two masses, and which share of the stretches d leads to each: cell mapping.

    Start and the belt's start are ignored.

    Example: rig-sim basins two-mass --cells 4000

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.dynamics.analyses.basins import basins as find

    if not 2 <= cells <= MOST_CELLS:
        raise InputError(f"is {cells}", "--cells", f"give 2 to {MOST_CELLS}")
    check_plot(plot, force)
    f = stick_map(scene, set_, cells)
    with application.progress("mapping cells", cells) as show:
        found = find(f, cells, show.stage)
    data: dict[str, Any] = {
        "range": [f.lo, f.hi],
        "shares": [attractor.share for attractor in found.attractors],
        "attractors": [asdict(attractor) for attractor in found.attractors],
        "nowhere": found.nowhere,
        "cells": cells,
        "cycles": found.cycles,
    }
    lines = []
    for number, attractor in enumerate(found.attractors, 1):
        kind = f"period {attractor.period}" if attractor.period else "not periodic"
        few = ", ".join(f"{point:.12g}" for point in attractor.points[:4]) + (
            " ..." if len(attractor.points) > 4 else ""
        )
        lines.append(f"attractor {number}: {100.0 * attractor.share:.3f} %, {kind}: {few}")
    if found.nowhere or not found.attractors:
        lines.append(f"no global stick: {100.0 * found.nowhere:.3f} %")
    if plot is not None:
        from daq.base.output.plot import save
        from rig_sim.dynamics.pictures.maps import basins_figure

        save(basins_figure(found), plot, force=force)
        data["file"] = plot
        lines.append(str(plot))
    return Answer(data, "\n".join(lines))


def lyapunov(
    scene: str,
    /,
    *,
    events: Annotated[
        int, Parameter(help="Events to take the mean over: from one global stick to the next, or landings.")
    ] = 20_000,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find the Lyapunov exponent on the attractor that the start leads to: per event of two masses, from their map.

    Of a driven mass per landing, by the variational equation; per drive period where the mass does not stick. Positive
    for chaos. On a periodic attractor it is exact and its standard error 0.

    Example: rig-sim lyapunov two-mass --events 20000 --set belt.speed=0.08075

    Example: rig-sim lyapunov forced --set drive.omega=1.1

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file; of two masses with start.d or start.attractor.
    """
    import numpy as np

    from rig_sim.dynamics.analyses.exponent import BLOCKS, exponent
    from rig_sim.motion.two_masses import stretch
    from rig_sim.scenes.scene import parse_changes
    from rig_sim.scenes.scene import scene as read

    if not BLOCKS <= events <= MOST_EVENTS:
        raise InputError(f"is {events}", "--events", f"give {BLOCKS} to {MOST_EVENTS}")
    changes = parse_changes(set_)
    if read(scene, **changes).coupling is None:
        return forced.driven_lyapunov(scene, changes, events)
    f = stick_map(scene, set_, events)
    start = stretch(read(scene, **changes))
    if not abs(start) <= f.hi:
        raise InputError(f"is {start:g}", "start.d", f"both masses can stick with abs(d) up to {f.hi:.6g}")
    with application.progress("following the motion", events) as show:
        found = exponent(f.motion(np.array([start])), events, show.stage)
    data = {**asdict(found), "per": "event"}
    if found.outcome != "completed":
        return Answer(data, f"{found.outcome}: the motion stops sticking; list its events instead")
    orbit = f"period {found.period}, exact" if found.period else f"over {found.events} events"
    return Answer(data, f"{with_error(found.exponent, found.stderr)} per event ({orbit})")


def stick_map(name: str, changes: list[str] | None, events: int = 0) -> "StickMap":
    """Return the map of a scene of two masses, with integrator steps for an analysis or, if more, for ``events``.

    Raises
    ------
    InputError
        One mass, or a belt at rest.
    """
    from rig_sim.dynamics.rig.stick import STEPS_IN_ALL
    from rig_sim.dynamics.system.step_budget import StepBudget
    from rig_sim.scenes.scene import parse_changes, scene

    budget = StepBudget(max(STEPS_IN_ALL, STEPS_PER_EVENT * events))
    return checked(scene(name, **parse_changes(changes)).two_mass_flow(), name, budget)


def checked(flow: "TwoMassFlow", name: str, budget: "StepBudget | None" = None) -> "StickMap":
    """Return the map of two masses, with integrator steps of its own or from a ``budget`` that maps share.

    Raises
    ------
    InputError
        They are not physical, or their belt is at rest.
    """
    from rig_sim.dynamics.rig.stick import StickMap

    try:
        return StickMap(flow, budget=budget)
    except ValueError as error:
        raise InputError(str(error), f"scene {name}", "change that value with --set") from None


def _chain(found: "StickMap", d: float, times: int, *, compiled: bool) -> "list[StickEvent]":
    """Return the events that follow a global stick, up to ``times``."""
    chain: list[StickEvent] = []
    for _ in range(times):
        chain.append(found.event(d, compiled=compiled))
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
