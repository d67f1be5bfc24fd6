"""``rig-sim continue``: fixed points and orbits over a parameter, and where draws from a fit put the special points."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from daq.base.console import application
from daq.base.console.application import Answer, Json, SetChanges
from daq.base.errors import InputError
from rig_sim.cli import maps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rig_sim.cli.parameter_range import ParameterRange
    from rig_sim.dynamics.analyses.special_points import SpecialPoint
    from rig_sim.dynamics.orbits.point_draws import PointInterval
    from rig_sim.flow.flow import Flow

MOST_DRAWS = 100_000


def continue_(
    scene: str,
    /,
    *,
    over: Annotated[str, Parameter(help="section.key=START:STOP, or START:STOP:N for N values (default 41).")],
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

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.cli.parameter_range import parse
    from rig_sim.dynamics.orbits.branches import continuation
    from rig_sim.scenes.scene import parse_changes
    from rig_sim.scenes.scene import scene as read

    span = parse(over)
    changes = parse_changes(set_)
    first = read(scene, **{**changes, span.key: span.start})
    if draws is not None and not 2 <= draws <= MOST_DRAWS:
        raise InputError(f"is {draws}", "--draws", f"give 2 to {MOST_DRAWS}")
    if first.coupling is not None:
        from rig_sim.scenes.swept import SweptScene

        if draws is not None:
            raise InputError("--draws with two masses", "--draws", "leave it out")
        return maps.continue_map(SweptScene(first, span.key), scene, span)
    if draws is not None:
        from rig_sim.scenes.draws import drawn_changes

        drawn = drawn_changes(first, draws, scene)
    swept = SweptFlow(scene, changes, span.key)
    with application.progress("following", span.number) as show:
        found = continuation(swept, span.values(), progress=show)
    branches = [
        {
            "kind": branch.kind,
            "stable": branch.stable,
            "rows": [{"value": row.value, **asdict(row.state)} for row in branch.rows],
        }
        for branch in found.branches
    ]
    points: list[dict[str, Any]] = [
        {"kind": point.kind, "parameter": span.key, "value": point.value} for point in found.points
    ]
    data: dict[str, Any] = {"parameter": span.key, "branches": branches, "points": points}
    lines = [
        f"{'stable' if branch.stable else 'unstable':8} {branch.kind:11} {span.key} from {branch.rows[0].value:.6g} "
        f"to {branch.rows[-1].value:.6g}, {len(branch.rows)} values"
        for branch in found.branches
    ]
    lines += [f"{point.kind}: {span.key} = {point.value:.12g}" for point in found.points] or ["no special point"]
    if draws is not None:
        intervals, refused = point_intervals(swept, found.points, span, drawn)
        for row, one in zip(points, intervals, strict=True):
            row |= {"lo": one.lo, "hi": one.hi, "draws": one.found, "below": one.below, "above": one.above}
        data |= {"draws": draws, "refused": refused, "seed": first.seed}
        lines[len(found.branches) :] = [
            f"{point.kind}: {span.key} = {point.value:.6g}, 95 % interval {interval_text(one)}"
            for point, one in zip(found.points, intervals, strict=True)
        ] or ["no special point: none to find again in the draws"]
        lines += [f"{refused} of {draws} draws are no rig and were left out"] if refused else []
    return Answer(data, "\n".join(lines))


@dataclass(frozen=True)
class SweptFlow:
    """The flow of a scene at a value of the key ``key``, with ``changes``."""

    scene: str
    changes: dict[str, object]
    key: str

    def __call__(self, value: float) -> "Flow":
        """Return the flow at a value of the parameter."""
        from rig_sim.scenes.scene import scene as read

        return read(self.scene, **{**self.changes, self.key: value}).flow()


def point_intervals(
    swept: SweptFlow, points: "Sequence[SpecialPoint]", span: "ParameterRange", drawn: "list[dict[str, object]]"
) -> "tuple[list[PointInterval], int]":
    """Return the interval of each special point, and how many draws were no rig."""
    from rig_sim.dynamics.orbits.point_draws import MovingPoint, interval

    moving = [MovingPoint(point, swept, span.values()) for point in points]
    places: list[list[float]] = [[] for _ in moving]
    refused = 0
    with application.progress("drawing", len(drawn)) as show:
        for done, changes in enumerate(drawn, start=1):
            flow_at = SweptFlow(swept.scene, {**changes, **swept.changes}, swept.key)
            try:
                found = [one.for_draw(flow_at) for one in moving]
            except (InputError, ValueError):
                refused += 1
                continue
            for mine, value in zip(places, found, strict=True):
                mine.append(value)
            show(float(done))
    return [interval(mine) for mine in places], refused


def interval_text(one: "PointInterval") -> str:
    """Return an interval in words, with the draws that put the point beyond the values followed."""
    lo, hi = ("beyond" if end is None else f"{end:.6g}" for end in (one.lo, one.hi))
    beyond = [f"{count} {name} the first value" for name, count in (("below", one.below),) if count]
    beyond += [f"{one.above} above the last value"] if one.above else []
    outside = f"; of the draws {', '.join(beyond)}" if beyond else ""
    return f"{lo} to {hi} ({one.found} draws{outside})"
