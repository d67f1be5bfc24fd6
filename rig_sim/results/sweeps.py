"""Attractors over a parameter, here, in processes or on a dask cluster.

At every value they are searched anew: an attractor followed from value to value depends on the direction and is lost
where it ends.  Afterwards each takes the number of the closest one at the value before.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from rig_sim.analyses import sweep as attractors
from rig_sim.analyses.sweep import AttractorAt
from rig_sim.results.arguments import ParameterRange, SceneLike, load_scene, parse_range, parse_whole
from rig_sim.results.result import COLOURS, UNIT, Result
from rig_sim.results.resume import ResumeFile, open_resume_file
from rig_sim.results.scene_systems import (
    SweptScene,
    find_custom_attractors,
    find_driven_attractors,
    find_two_mass_attractors,
    load_driven_start,
    make_stick_map,
)
from rig_sim.systems.formula import FormulaMap
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError, check_known

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


Section = Literal["poincare", "map", "slip"]
SECTIONS = ("poincare", "map", "slip")
ORDINATES = {  # drawn quantity, by the section and whether the mass is driven
    ("poincare", False): "x1 where the first mass turns forwards",
    ("map", False): "d = x2 - x1 in global stick",
    ("poincare", True): "x at phase 0 of the drive",
    ("slip", True): "x at break-away",
}
COLUMNS = ("attractor", "points", "period", "drive_periods", "share", "outcome")  # of the table, after the parameter
Find = Callable[[float], list[AttractorAt]]
SHARP = 480.0  # number of values times size of a drawn point: many values are drawn as fine points
MOST_DRAWN = 5000  # points drawn as shapes; more become an image


@dataclass(frozen=True, repr=False)
class Sweep(Result):
    """Attractors over a parameter, a bifurcation diagram: what `rig_sim.sweep` returns.

    Attributes
    ----------
    parameter : str
    section : str
        'poincare', 'map' or 'slip'.
    attractors : tuple of AttractorAt
        A row for each attractor at each value, in order.
    """

    parameter: str
    section: str
    attractors: tuple[AttractorAt, ...]
    ordinate: str = field(default="", repr=False, compare=False)

    SIZE = (8.6, 5.6)

    def as_json(self) -> dict[str, Any]:
        return {"parameter": self.parameter, "section": self.section, "rows": self.rows()}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [{"parameter": row.value, **{name: getattr(row, name) for name in COLUMNS}} for row in self.attractors]

    def to_dataframe(self) -> "pd.DataFrame":
        """Return a row for each attractor at each value; ``explode("points")`` makes one for each point."""
        import pandas as pd

        whole_or_none = {"period": "Int64", "drive_periods": "Int64"}
        return pd.DataFrame(list(self.rows()), columns=["parameter", *COLUMNS]).astype(whole_or_none)

    def lines(self) -> list[str]:
        lines = [f"{self.parameter:>14}  attractor  share  period  points"]
        for row in self.attractors:
            few = ", ".join(f"{point:.6g}" for point in row.points[:4]) + (" ..." if len(row.points) > 4 else "")
            period = str(row.period or "-")
            points = few if row.outcome == "completed" else f"{few} ({row.outcome})".strip()
            share = f"{row.share:.3f}" if math.isfinite(row.share) else "-"
            lines.append(f"{row.value:14.8g}  {row.attractor:9}  {share:>5}  {period:>6}  {points}")
        if not self.attractors:
            lines.append(
                "there is no attractor at any value, because the motion comes to rest, or both masses never stick "
                "at once"
            )
        return lines

    def draw(self, ax: "Axes") -> None:
        """Draw a bifurcation diagram: the points of every attractor."""
        rows = [row for row in self.attractors if row.points]
        size = min(max(SHARP / max(len({row.value for row in self.attractors}), 1), 2.4), 5.0)
        for number in sorted({row.attractor for row in rows}):
            of_attractor = [row for row in rows if row.attractor == number]
            x = np.concatenate([np.full(len(row.points), row.value) for row in of_attractor])
            y = np.concatenate([row.points for row in of_attractor])
            colour, label = COLOURS[(number - 1) % len(COLOURS)], f"attractor {number}"
            ax.plot(x, y, ".", ms=size, mew=0, color=colour, rasterized=len(x) > MOST_DRAWN, label=label)
        if ax.lines:
            ax.legend(markerscale=14.4 / size, framealpha=0.85, edgecolor="none", frameon=True)
        ax.set(xlabel=f"{self.parameter} {UNIT}", ylabel=f"{self.ordinate} {UNIT}")
        ax.set_title(f"Attractors over {self.parameter}")


def sweep(
    scene: SceneLike | Callable[[float], FormulaMap],
    over: "str | tuple[str, Sequence[float]]",
    *,
    section: Section = "poincare",
    jobs: int = 1,
    scheduler: str | None = None,
    resume: str | Path | None = None,
    progress: Stages = silent,
) -> Sweep:
    """Find the attractors of two masses, or of a driven mass, at each value of a parameter: ``rig-sim sweep``.

    Attractor 1 has the largest basin at the first value; at the next values, the numbers follow the attractors.  For
    two masses, the starts cover all values of d = x2 - x1 in a global stick.  A motion without a global stick counts as
    an additional attractor, with points only in the section 'poincare'.  For a driven mass there are ten starts: that
    of the scene, the mass at rest on the moving belt, and eight sticks that end at different phases of the drive.

    Parameters
    ----------
    scene : str, Path, Scene or callable
        Scene of two masses or of a driven mass: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python
        also the result of `rig_sim.scene`, or a function that returns, for a value of the parameter, a
        `rig_sim.FormulaMap`.
    over : str or (str, sequence of float)
        'section.key=START:STOP', or 'section.key=START:STOP:N' for N values (default 41).  In Python also a key and
        its values.
    section : str
        Section that defines the points.  For two masses: x1 where the first mass begins to move forwards ('poincare'),
        or d = x2 - x1 while both stick ('map').  For a driven mass: x at phase 0 of the drive ('poincare'), or at
        break-away ('slip').
    jobs : int
        Number of processes; the results do not depend on it.
    scheduler : str, optional
        Address of a running dask scheduler whose workers compute the values; requires stickslip[cluster].
    resume : str or Path, optional
        File that stores each finished value.  After an interruption, the same call reads it and computes only the
        missing values.
    progress : callable, optional
        Called with the stage, the work done and the total work.

    Returns
    -------
    Sweep

    Raises
    ------
    InputError
        If the scene or key does not exist, ``over`` is invalid, the section does not apply to the scene, the scene has
        one mass without a drive, or the file belongs to another sweep.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.sweep("two-mass", over="belt.speed=0.165:0.175:2", section="map")
    >>> found.to_dataframe()[["parameter", "attractor", "period"]]
       parameter  attractor  period
    0      0.165          1       2
    1      0.165          2       2
    2      0.175          1       2
    """
    jobs = parse_whole(jobs, "--jobs", 1)
    check_known(section, SECTIONS, "section", "--section")
    is_custom = callable(scene)
    span = parse_range(over, of_scene=not is_custom)
    find: Find
    if callable(scene):
        find, name = partial(find_custom_attractors, scene), type(scene(span.start)).__name__
        ordinate = "first coordinate of the state"
        content: dict[str, Any] = {"name": name}
        if jobs > 1 or scheduler is not None:
            from stickslip.compute.cluster import check_sendable

            check_sendable(find)
    else:
        find, name, ordinate, content = prepare_scene(scene, span, section)
    if resume is None:
        rows = sweep_values(find, span, jobs, scheduler, None, progress)
    else:
        path = Path(resume)
        with open_resume_file(path, make_header(content, span, section)) as file:
            rows = sweep_values(find, span, jobs, scheduler, file, progress)
    return Sweep(span.key, section, tuple(rows), ordinate, name=name)


def prepare_scene(source: SceneLike, span: ParameterRange, section: str) -> tuple[Find, str, str, dict[str, Any]]:
    """Return the search for attractors, the scene's name, the drawn quantity, and the content of a ``resume`` file."""
    swept = SweptScene(load_scene(source), span.key)
    ends = swept.with_value(span.start), swept.with_value(span.stop)
    first = ends[0]
    coupled = first.coupling is not None
    swept = SweptScene(first, span.key)
    if not coupled and section == "map":
        raise InputError("is 'map', which applies only to two masses", "--section", "use 'poincare' or 'slip'")
    if coupled and section == "slip":
        raise InputError("is 'slip', which applies only to a driven mass", "--section", "use 'poincare' or 'map'")
    for end in ends:
        if coupled:
            make_stick_map(end)
        else:
            load_driven_start(end)
    find = partial(find_two_mass_attractors if coupled else find_driven_attractors, swept, section)
    content = first.model_dump(exclude={"name", "title"}, exclude_unset=True)
    return find, first.name, ORDINATES[section, not coupled], content


def sweep_values(
    find: Find,
    span: ParameterRange,
    jobs: int,
    scheduler: str | None,
    file: ResumeFile | None,
    progress: Stages,
) -> list[AttractorAt]:
    """Return the attractors at every value: those in the file are read, the others are appended to it."""
    from stickslip.compute.workers import workers
    from stickslip.console.application import plain

    values = span.values().tolist()
    finished = read_finished(file) if file is not None else {}

    def keep(value: float, rows: list[AttractorAt]) -> None:
        if file is not None:
            file.append(plain({"value": value, "attractors": [asdict(row) for row in rows]}))

    if all(value in finished for value in values):
        jobs, scheduler = 1, None  # nothing to share out
    with workers(jobs, scheduler, join=True) as spread:
        return attractors.sweep(
            find,
            values,
            spread=spread,
            progress=lambda done: progress("sweeping", done, span.number),
            finished=finished,
            keep=keep,
        )


def make_header(content: dict[str, Any], span: ParameterRange, section: str) -> dict[str, Any]:
    """Return everything that the attractors depend on, for the first line of the file of ``resume``."""
    from stickslip.console.application import plain
    from stickslip.version import VERSION

    over: dict[str, Any] = {"key": span.key, "start": span.start, "stop": span.stop, "number": span.number}
    over |= {"values": list(span.uneven)} if span.uneven else {}
    return {"command": "rig-sim sweep", "version": VERSION, "over": over, "section": section, "scene": plain(content)}


def read_finished(file: ResumeFile) -> dict[float, list[AttractorAt]]:
    nan = math.nan
    finished = {}
    try:
        for row in file.rows:
            finished[row["value"]] = [
                AttractorAt(
                    **stored
                    | {
                        "points": tuple(stored["points"]),
                        "extent": tuple(nan if end is None else end for end in stored["extent"]),
                        "share": nan if stored["share"] is None else stored["share"],
                    }
                )
                for stored in row["attractors"]
            ]
    except (KeyError, TypeError):
        raise InputError("contains a row that was not written by a sweep", str(file.path), "use another file") from None
    return finished
