"""The commands of ``rig-sim`` about maps of two masses, and Lyapunov exponents: map, basins, lyapunov."""

from typing import Annotated

from cyclopts import Parameter

from rig_sim.cli.answer import SceneName, answered, changed
from stickslip.console import application
from stickslip.console.application import Answer, Json, SetChanges
from stickslip.console.flags import Force, Plot, check_plot
from stickslip.errors import InputError


def map_(
    scene: SceneName,
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
    """
    import rig_sim

    if iterate < 1:
        raise InputError(f"is {iterate}", "--iterate", "give 1 or more")
    if d is None and not periodic and plot is None:
        raise InputError("nothing to do", "--d", "give --d, --periodic or --plot")
    found = changed(scene, set_)
    places = None if d is None else _numbers(d)
    return answered(rig_sim.map(found, places, iterate=iterate, periodic=periodic), plot, force)


def basins(
    scene: SceneName,
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
    """
    import rig_sim

    check_plot(plot, force)
    with application.progress("mapping cells", cells) as show:
        result = rig_sim.basins(changed(scene, set_), cells, progress=show.stage)
    return answered(result, plot, force)


def lyapunov(
    scene: Annotated[
        str,
        Parameter(
            help="A built-in name (see rig-sim scenes) or a TOML file; of two masses with start.d or start.attractor."
        ),
    ],
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
    """
    import rig_sim

    with application.progress("following the motion", events) as show:
        return answered(rig_sim.lyapunov(changed(scene, set_), events, progress=show.stage))


def _numbers(given: list[str]) -> float | list[float]:
    """Return the number of ``--d``, or the numbers where it is a list."""
    parts = [part for text in given for part in text.strip("[] ").split(",")]
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        raise InputError(f"{','.join(given)!r} holds something that is no number", "--d", "write 0.1,0.2") from None
    return numbers if len(parts) > 1 or "[" in given[0] else numbers[0]
