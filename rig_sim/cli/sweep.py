"""The command ``rig-sim sweep``: attractors over a parameter, here, in processes or on a dask cluster."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from daq.base.console import application
from daq.base.console.application import Answer, Json, SetChanges
from daq.base.console.flags import Force, Plot, check_plot
from daq.base.errors import InputError
from rig_sim.cli import forced
from rig_sim.cli.maps import checked

if TYPE_CHECKING:
    from daq.base.output.resume import ResumeFile
    from rig_sim.cli.parameter_range import ParameterRange
    from rig_sim.dynamics.analyses.sweep import AttractorAt
    from rig_sim.scenes.model import Scene


def sweep(
    scene: str,
    /,
    *,
    over: Annotated[str, Parameter(help="section.key=START:STOP, or START:STOP:N for N values (default 41).")],
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

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.cli.parameter_range import parse
    from rig_sim.dynamics.rig.section import attractors_at
    from rig_sim.scenes.scene import parse_changes
    from rig_sim.scenes.scene import scene as read
    from rig_sim.scenes.swept import SweptScene

    if jobs < 1:
        raise InputError(f"is {jobs}", "--jobs", "give 1 or more")
    check_plot(plot, force)
    span = parse(over)
    first, last = (read(scene, **{**parse_changes(set_), span.key: value}) for value in (span.start, span.stop))
    coupled = first.coupling is not None
    find: Callable[[float], list[AttractorAt]]
    if not coupled:
        if section == "map":
            raise InputError("is map, which is for two masses", "--section", "give poincare or slip")
        find = forced.DrivenAttractors(first, span.key, section)
        for end in (first, last):
            forced.driven(end, scene)
    else:
        if section == "slip":
            raise InputError("is slip, which is for a driven mass", "--section", "give poincare or map")
        find = partial(attractors_at, SweptScene(first, span.key), section)
        for end in (first, last):
            checked(end.two_mass_flow(), scene)
    if resume is None:
        rows = _swept(find, span, jobs, scheduler, None)
    else:
        from daq.base.output.resume import resuming

        with resuming(resume, _header(first, span, section)) as file, _kept(file, span.number):
            rows = _swept(find, span, jobs, scheduler, file)
    data: dict[str, Any] = {
        "parameter": span.key,
        "section": section,
        "rows": [
            {
                "parameter": row.value,
                "attractor": row.attractor,
                "points": row.points,
                "period": row.period,
                "drive_periods": row.drive_periods,
                "share": row.share,
                "outcome": row.outcome,
            }
            for row in rows
        ],
    }
    lines = [f"{span.key:>14}  attractor  share  period  points"]
    for row in rows:
        few = ", ".join(f"{point:.6g}" for point in row.points[:4]) + (" ..." if len(row.points) > 4 else "")
        period = str(row.period or "-")
        shown = few if row.outcome == "completed" else f"{few} ({row.outcome})".strip()
        share = application.shown(row.share, ".3f")
        lines.append(f"{row.value:14.8g}  {row.attractor:9}  {share:>5}  {period:>6}  {shown}")
    lines += [] if rows else ["no attractor at any value: the motion comes to rest, or never sticks as a whole"]
    if plot is not None:
        from daq.base.output.plot import save
        from rig_sim.dynamics.pictures.maps import sweep_figure

        save(sweep_figure(rows, span.key, section, driven=not coupled), plot, force=force)
        data["file"] = plot
        lines.append(str(plot))
    return Answer(data, "\n".join(lines))


def _swept(
    find: "Callable[[float], list[AttractorAt]]",
    span: "ParameterRange",
    jobs: int,
    scheduler: str | None,
    file: "ResumeFile | None",
) -> "list[AttractorAt]":
    """Return the attractors at every value, those taken from the file that are there; the others go there."""
    from daq.base.compute.workers import workers
    from rig_sim.dynamics.analyses.sweep import sweep as follow

    values = span.values().tolist()
    finished = _finished(file) if file is not None else {}

    def keep(value: float, rows: "list[AttractorAt]") -> None:
        if file is not None:
            file.append(application.plain({"value": value, "attractors": [asdict(row) for row in rows]}))

    if all(value in finished for value in values):
        jobs, scheduler = 1, None  # nothing to share out
    with workers(jobs, scheduler, join=True) as spread, application.progress("sweeping", span.number) as show:
        return follow(find, values, spread=spread, progress=show, finished=finished, keep=keep)


def _header(scene: "Scene", span: "ParameterRange", section: str) -> dict[str, Any]:
    """Return what the attractors depend on, for the first line of the file of ``--resume``."""
    from daq.base.version import VERSION

    over = {"key": span.key, "start": span.start, "stop": span.stop, "number": span.number}
    content = application.plain(scene.model_dump(exclude={"name", "title"}, exclude_unset=True))
    return {"command": "rig-sim sweep", "version": VERSION, "over": over, "section": section, "scene": content}


def _finished(file: "ResumeFile") -> "dict[float, list[AttractorAt]]":
    """Return the attractors by value from the file of ``--resume``."""
    from rig_sim.dynamics.analyses.sweep import AttractorAt

    nan = float("nan")
    found = {}
    try:
        for row in file.rows:
            found[row["value"]] = [
                AttractorAt(
                    **kept
                    | {
                        "points": tuple(kept["points"]),
                        "extent": tuple(nan if end is None else end for end in kept["extent"]),
                        "share": nan if kept["share"] is None else kept["share"],
                    }
                )
                for kept in row["attractors"]
            ]
    except (KeyError, TypeError):
        raise InputError("holds a row that is not of a sweep", str(file.path), "name another file") from None
    return found


@contextmanager
def _kept(file: "ResumeFile", number: int) -> Iterator[None]:
    """Where the block is interrupted, say on stderr how many values the file has."""
    try:
        yield
    except BaseException:
        if file.number:
            application.note(f"{file.number} of {number} values are in {file.path}: the same command continues there")
        raise
