"""The commands of ``rig-sim`` over a parameter: continue, sweep."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from rig_sim.cli.answer import SceneName, answered, changed
from stickslip.console import application
from stickslip.console.application import Answer, Json, SetChanges
from stickslip.console.flags import Force, Plot, check_plot

Over = Annotated[str, Parameter(help="section.key=START:STOP, or START:STOP:N for N values (default 41).")]


def continue_(
    scene: SceneName,
    /,
    *,
    over: Over,
    draws: Annotated[
        int | None,
        Parameter(help="Give each special point its 95 % interval from so many draws of the section fit's parameters."),
    ] = None,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Follow fixed points and periodic orbits over a parameter; find where they appear, vanish or change stability.

    Example: rig-sim continue damped --over damper.c=0.3:0.6

    Example: rig-sim continue fitted.toml --over belt.speed=0.1:1 --draws 200

    Special points: hopf, fold (the stable and the unstable orbit meet), grazing (the orbit no longer sticks),
    border-collision (the fixed point crosses the edge of a ramp). Of two masses, orbits of periods 1 and 2 of their
    map, with the points period-doubling, fold and crisis (a chaotic attractor meets the unstable orbit that bounds its
    basin). Start and the random sections are ignored.

    Draws need a scene written by fit-friction --save-scene, and are the same for the same seed. Keys changed by --set
    are not drawn. An end of an interval that lies beyond the values of --over is null.
    """
    import rig_sim

    with application.progress("following", None) as show:
        result = rig_sim.continue_(changed(scene, set_), over, draws=draws, progress=show.stage)
    return answered(result)


def sweep(
    scene: SceneName,
    /,
    *,
    over: Over,
    section: Annotated[
        Literal["poincare", "map", "slip"],
        Parameter(
            help="Points of two masses: x1 where the first turns forwards (poincare), or d = x2 - x1 while both stick "
            "(map). Of a driven mass: x at phase 0 of the drive (poincare), or at break-away (slip)."
        ),
    ] = "poincare",
    jobs: Annotated[int, Parameter(help="Processes; the results do not depend on it.")] = 1,
    scheduler: Annotated[
        str | None, Parameter(help="Address of a running dask scheduler whose workers do it; needs stickslip[cluster].")
    ] = None,
    resume: Annotated[
        Path | None,
        Parameter(
            help="File of the finished values: written while they are found, and read when the same command is given "
            "again after an interruption, so that none is computed twice."
        ),
    ] = None,
    plot: Plot = None,
    force: Force = False,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find the attractors of two masses, or of a driven one, at each value of a parameter: a bifurcation diagram.

    Attractor 1 has the largest basin at the first value; then the numbers follow.

    Two masses: the starts lie all over the stretches that a global stick can have. A motion without global stick counts
    as one more attractor, with points in the section poincare alone.

    A driven mass: the scene's start, the sliding mass at rest, and eight starts in stick, all over the drive's phases
    of break-away. period: points of the section until the motion repeats; drive_periods: drive periods.

    Example: rig-sim sweep two-mass --over belt.speed=0.08:0.2:400 --jobs 2 --plot bifurcations.png

    Example: rig-sim sweep two-mass --over belt.speed=0.08:0.2:4000 --jobs 2 --resume bifurcations.jsonl

    Example: rig-sim sweep forced --over drive.omega=0.2:2:400 --section slip --plot bifurcations.png
    """
    import rig_sim

    check_plot(plot, force)
    with kept(resume, over), application.progress("sweeping", None) as show:
        result = rig_sim.sweep(
            changed(scene, set_),
            over,
            section=section,
            jobs=jobs,
            scheduler=scheduler,
            resume=resume,
            progress=show.stage,
        )
    return answered(result, plot, force)


@contextmanager
def kept(path: Path | None, over: str) -> Iterator[None]:
    """Where the block is interrupted, say on stderr how many values the file of ``--resume`` has."""
    try:
        yield
    except BaseException:
        number = path.read_bytes().count(b"\n") - 1 if path is not None and path.is_file() else 0
        if number > 0:
            from rig_sim.functions.arguments import parameter_range

            whole = parameter_range(over).number
            application.note(f"{number} of {whole} values are in {path}: the same command continues there")
        raise
