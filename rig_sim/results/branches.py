"""Fixed points and orbits over a parameter, and where draws from a fit put the special points."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from rig_sim.analyses import special_points
from rig_sim.analyses.limit_cycles.branches import MovingPoint, PointInterval, continuation, estimate_interval
from rig_sim.analyses.map_branches import map_continuation
from rig_sim.analyses.special_points import SpecialPoint
from rig_sim.results.arguments import ParameterRange, SceneLike, load_scene, parse_range, parse_whole
from rig_sim.results.result import PALE, STABLE, UNIT, UNSTABLE, Result
from rig_sim.results.scene_systems import SweptScene, make_stick_map, require_interval
from rig_sim.scenes.draws import draw_changes
from rig_sim.systems.formula import FormulaMap
from rig_sim.systems.interface import StepBudget
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

MOST_DRAWS = 100_000
STEPS_PER_VALUE = 1_000_000  # integrator steps of two masses; those of the thesis take 300 000


@dataclass(frozen=True)
class Draws:
    """Special points over draws of a fit's parameters: ``intervals``, and the number of draws that are not a rig."""

    number: int
    refused: int
    seed: int
    intervals: tuple[PointInterval, ...]


@dataclass(frozen=True, repr=False)
class Continuation(Result, special_points.Continuation):
    """Branches over a parameter, and their special points: what `rig_sim.continue_` returns.

    Attributes
    ----------
    parameter : str
    branches : tuple of Branch
        Kind, stability, and rows with the value and the state: a fixed point or an orbit.
    points : tuple of SpecialPoint
        Kind and value.
    draws : Draws or None
    """

    parameter: str
    draws: Draws | None = field(default=None, repr=False)

    UNITS: ClassVar[Mapping[str, str]] = {"x": "m", "x_min": "m", "x_max": "m", "period": "s"}

    def as_json(self) -> dict[str, Any]:
        branches = [
            {
                "kind": branch.kind,
                "stable": branch.stable,
                "rows": [{"value": row.value, **asdict(row.state)} for row in branch.rows],
            }
            for branch in self.branches
        ]
        points: list[dict[str, Any]] = [
            {"kind": point.kind, "parameter": self.parameter, "value": point.value} for point in self.points
        ]
        data: dict[str, Any] = {"parameter": self.parameter, "branches": branches, "points": points}
        if self.draws is not None:
            for row, interval in zip(points, self.draws.intervals, strict=True):
                row |= {
                    "lo": interval.lo,
                    "hi": interval.hi,
                    "draws": interval.inside,
                    "below": interval.below,
                    "above": interval.above,
                }
            data |= {"draws": self.draws.number, "refused": self.draws.refused, "seed": self.draws.seed}
        return data

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return a row for each value of each branch: the number of the branch, its kind and stability, the state."""
        return [
            {
                self.parameter: row.value,
                "branch": number,
                "kind": branch.kind,
                "stable": branch.stable,
                **{name: value for name, value in asdict(row.state).items() if name != "stable"},
            }
            for number, branch in enumerate(self.branches, 1)
            for row in branch.rows
        ]

    def special_points(self) -> "pd.DataFrame":
        """Return a row for each special point: its kind, its value, with ``draws`` its 95 % interval."""
        import pandas as pd

        return pd.DataFrame(self.as_json()["points"])

    def lines(self) -> list[str]:
        width = 11 if any(branch.kind in ("orbit", "fixed point") for branch in self.branches) else 8
        lines = [
            f"{'stable' if branch.stable else 'unstable':8} {branch.kind:{width}} {self.parameter} "
            f"from {branch.rows[0].value:.6g} to {branch.rows[-1].value:.6g}, {len(branch.rows)} values"
            for branch in self.branches
        ]
        if self.draws is None:
            point_lines = [f"{point.kind}: {self.parameter} = {point.value:.12g}" for point in self.points]
            return lines + (point_lines or ["no special point"])
        point_lines = [
            f"{point.kind}: {self.parameter} = {point.value:.6g}, 95 % interval {format_interval(interval)}"
            for point, interval in zip(self.points, self.draws.intervals, strict=True)
        ]
        lines += point_lines or ["there is no special point, so the draws were not needed"]
        number, refused = self.draws.number, self.draws.refused
        return lines + ([f"{refused} of {number} draws are physically impossible and were omitted"] if refused else [])

    def draw(self, ax: "Axes") -> None:
        for branch in self.branches:
            values = [row.value for row in branch.rows]
            colour, line = (STABLE, "-") if branch.stable else (UNSTABLE, "--")
            for heights in zip(*(list_heights(row.state) for row in branch.rows), strict=True):
                ax.plot(values, heights, line if len(values) > 1 else ".", color=colour, lw=1.3)
        for point in self.points:
            ax.axvline(point.value, color=PALE, lw=0.8, ls=":")
            style = {"xycoords": ("data", "axes fraction"), "rotation": 90, "va": "top", "ha": "right"}
            ax.annotate(point.kind, (point.value, 0.98), **style)  # type: ignore[arg-type]
        ax.set(xlabel=f"{self.parameter} {UNIT}", ylabel=f"x {UNIT}", title=f"{self.name}; dashed: unstable")


def list_heights(state: Any) -> tuple[float, ...]:
    """Return the drawn values of a state: a fixed point's position, an orbit's extremes, a map's periodic points."""
    if hasattr(state, "points"):
        return tuple(sorted(state.points))
    return (state.x,) if hasattr(state, "x") else (state.x_min, state.x_max)


def continue_(
    scene: SceneLike | Callable[[float], FormulaMap],
    over: "str | tuple[str, Sequence[float]]",
    *,
    draws: int | None = None,
    progress: Stages = silent,
) -> Continuation:
    """Continue fixed points and periodic orbits over a parameter: ``rig-sim continue``.

    The special points are hopf, fold (the stable and the unstable orbit meet), grazing (the orbit no longer sticks) and
    border-collision (the fixed point crosses the edge of a ramp).  For two masses, orbits of periods 1 and 2 of their
    map are followed, with the points period-doubling, fold and crisis (a chaotic attractor meets the unstable orbit
    that bounds its basin).  The start and all random effects are ignored.

    Parameters
    ----------
    scene : str, Path, Scene or callable
        Scene of one or two masses: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also the result
        of `rig_sim.scene`, or a function that returns, for a value of the parameter, a `rig_sim.FormulaMap` of an
        interval.
    over : str or (str, sequence of float)
        'section.key=START:STOP', or 'section.key=START:STOP:N' for N values (default 41).  In Python also a key and
        its values.
    draws : int, optional
        Compute a 95 % interval of each special point from this number of draws of the parameters.  The section ``fit``
        of the scene, which ``fit-friction --save-scene`` writes, contains their covariance.  A parameter that no longer
        has its fitted value is not drawn.  In Python `fitting.rank(...).save_scene(path)` writes it.
    progress : callable, optional
        Called with the stage, the work done and the total work.

    Returns
    -------
    Continuation

    Raises
    ------
    InputError
        If the scene or key does not exist, ``over`` is invalid, or draws are requested for two masses or without a
        section ``fit``.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.continue_("damped", over="damper.c=0.3:0.6:4")
    >>> [(point.kind, round(point.value, 6)) for point in found.points]
    [('hopf', 0.382653), ('fold', 0.556168)]
    """
    if draws is not None:
        draws = parse_whole(draws, "--draws", 2, MOST_DRAWS)
    if callable(scene):
        return follow_custom_system(scene, parse_range(over, of_scene=False), draws, progress)
    span = parse_range(over)
    loaded = load_scene(scene)
    swept = SweptScene(loaded, span.key)
    first = swept.with_value(span.start)
    if first.coupling is not None:
        if draws is not None:
            raise InputError("--draws does not support two masses", "--draws", "omit it")
        return follow_two_masses(SweptScene(first, span.key), span, progress)
    changes = None if draws is None else draw_changes(first, draws, first.name)
    result = continuation(swept.flow, span.values(), progress=report_to("following", span.number, progress))
    drawn = None
    if changes is not None:
        intervals, refused = find_point_intervals(swept, result.points, span, changes, progress)
        drawn = Draws(len(changes), refused, first.seed, intervals)
    return Continuation(**vars(result), parameter=span.key, draws=drawn, name=first.name)


def report_to(name: str, total: int, progress: Stages) -> Callable[[float], None]:
    return lambda done: progress(name, done, total)


def follow_two_masses(swept: SweptScene, span: ParameterRange, progress: Stages) -> Continuation:
    from rig_sim.systems.stick import STEPS_IN_ALL

    budget = StepBudget(max(STEPS_IN_ALL, STEPS_PER_VALUE * span.number))
    return follow_maps(lambda value: make_stick_map(swept.with_value(value), budget), span, swept.scene.name, progress)


def follow_custom_system(
    system_at: Callable[[float], FormulaMap], span: ParameterRange, draws: int | None, progress: Stages
) -> Continuation:
    if draws is not None:
        raise InputError("--draws does not support custom systems", "--draws", "omit it")
    name = type(system_at(span.start)).__name__
    return follow_maps(lambda value: require_interval(system_at(value)), span, name, progress)


def follow_maps(map_at: Callable[[float], Any], span: ParameterRange, name: str, progress: Stages) -> Continuation:
    report = report_to("following", span.number, progress)
    result = map_continuation(map_at, span.values().tolist(), progress=report)
    return Continuation(**vars(result), parameter=span.key, name=name)


def find_point_intervals(
    swept: SweptScene,
    points: Sequence[SpecialPoint],
    span: ParameterRange,
    draws: list[dict[str, object]],
    progress: Stages = silent,
) -> tuple[tuple[PointInterval, ...], int]:
    """Return the interval of each special point over the draws, and the number of draws that are not a rig."""
    moving_points = [MovingPoint(point, swept.flow, span.values()) for point in points]
    values_of_points: list[list[float]] = [[] for _ in moving_points]
    refused = 0
    for done, changes in enumerate(draws, start=1):
        try:
            values = [
                point.locate(lambda value, changes=changes: swept.with_value(value, **changes).flow())  # type: ignore[misc]
                for point in moving_points
            ]
        except (InputError, ValueError):
            refused += 1
            continue
        for point_values, value in zip(values_of_points, values, strict=True):
            point_values.append(value)
        progress("drawing", float(done), len(draws))
    return tuple(estimate_interval(point_values) for point_values in values_of_points), refused


def format_interval(interval: PointInterval) -> str:
    """Return an interval as text, with the draws whose point lies beyond the followed values."""
    lo, hi = ("beyond" if end is None else f"{end:.6g}" for end in (interval.lo, interval.hi))
    beyond = [f"{count} {name} the first value" for name, count in (("below", interval.below),) if count]
    beyond += [f"{interval.above} above the last value"] if interval.above else []
    outside = f"; of the draws {', '.join(beyond)}" if beyond else ""
    return f"{lo} to {hi} ({interval.inside} draws{outside})"
