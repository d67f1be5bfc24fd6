"""Chapter 4, figures 4.18 to 4.24: bifurcation diagrams of two masses, the map from stick to stick, its exponents."""

from collections.abc import Iterable
from functools import cache, partial

import numpy as np

from daq.base.compute.arrays import Array
from rig_sim.atlas.figure import Drawing, Entry, Panel, StatementCheck, Trace, compare, state
from rig_sim.dynamics.analyses.basins import TRANSIENT, Attractor, basins
from rig_sim.dynamics.analyses.exponent import exponent
from rig_sim.dynamics.analyses.map_branches import map_continuation
from rig_sim.dynamics.analyses.periodic_points import periodic_points
from rig_sim.dynamics.analyses.sweep import AttractorAt, sweep
from rig_sim.dynamics.rig.section import CELLS, attractors_at
from rig_sim.dynamics.rig.stick import StickMap
from rig_sim.dynamics.system.interface import slope
from rig_sim.flow.two_mass import TwoMassFlow
from rig_sim.scenes.scene import scene

SPEEDS = np.linspace(0.08, 0.2, 161)  # of figure 4.18; 0.2 s of CPU each
NEAR_CRISIS = np.linspace(0.0802, 0.0846, 56)  # of figure 4.19, 0.1 s of CPU each
BELT, SECTION = "belt velocity Vdr (Fs1/sqrt(km))", "X1p: X1 where V1 = 0, rising (Fs1/k)"
D, NEXT = "stretch d_n = X2 - X1 (Fs1/k)", "d_n+1 (Fs1/k)"
CRISIS_SPEEDS = (0.0820196, 0.0813048, 0.08090, 0.08059)
DOUBLING_SPEEDS, FOLD_SPEEDS = (0.0838, 0.0842), (0.165, 0.175)
EXPONENT_SPEEDS, ITERATIONS = (0.08075, 0.083, 0.1), 700
LONG = 20_000  # events of a Lyapunov exponent that is compared
PLACES = 1500  # drawn of a map


def flow_at(speed: float) -> TwoMassFlow:
    """Return the two masses on a belt of this velocity."""
    return scene("two-mass", **{"belt.speed": speed}).two_mass_flow()


@cache
def map_at(speed: float) -> StickMap:
    """Return the map from stick to stick at a belt velocity."""
    return StickMap(flow_at(speed))


@cache
def attractors(speed: float) -> tuple[Attractor, ...]:
    """Return the attractors of the map at a belt velocity, the largest basin first."""
    return basins(map_at(speed), CELLS).attractors


@cache
def diagram() -> tuple[AttractorAt, ...]:
    """Return the attractors over the belt velocities of figure 4.18."""
    return tuple(sweep(partial(attractors_at, flow_at, "poincare"), SPEEDS.tolist()))


@cache
def special(kind: str, low: float, high: float) -> float:
    """Return the belt velocity of a special point of the map between two others."""
    points = map_continuation(map_at, np.linspace(low, high, 5).tolist()).points
    (found,) = [point.value for point in points if point.kind == kind]
    return found


@cache
def detail() -> tuple[AttractorAt, ...]:
    """Return attractor 2 over the belt velocities of figure 4.18, and more of them beside the crisis."""
    near = sweep(partial(attractors_at, flow_at, "poincare"), NEAR_CRISIS.tolist())
    rows = [row for row in (*diagram(), *near) if row.attractor == 2]
    return tuple(sorted(rows, key=lambda row: row.value))


def points_of(rows: Iterable[AttractorAt], label: str, colour: int) -> Trace:
    """Return the points of rows of a diagram."""
    rows = list(rows)
    x = np.concatenate([np.full(len(row.points), row.value) for row in rows])
    y = np.concatenate([row.points for row in rows])
    return Trace(x, y, label, "points", colour)


def both_attractors() -> Drawing:
    """Figure 4.18."""
    numbers = sorted({row.attractor for row in diagram()})
    traces = tuple(
        points_of((row for row in diagram() if row.attractor == number), f"attractor {number}", number - 1)
        for number in numbers
    )
    third = [row.value for row in diagram() if row.attractor == 3]
    beyond = [len(attractors(speed)) for speed in (0.21, 0.25)]
    return Drawing(
        "X1 at each crossing of the Poincare section against the belt velocity: the attractors of the two masses.",
        (Panel(BELT, SECTION, traces),),
        (
            state(
                "number of attractors",
                "2",
                f"{len(numbers)}" + f"; the third from V = {min(third):.5g} to {max(third):.5g}" * bool(third),
                len(numbers) == 2,
                "a third one exists in a narrow window beside the other two; the thesis's grid of starts missed it",
            ),
            state(
                "global stick only below V = 0.20 (section 4.7)",
                "yes",
                f"attractors with global stick at V = 0.21 and 0.25: {beyond[0]} and {beyond[1]}",
                beyond == [0, 0],
                "both masses still stick together there, on an attractor",
            ),
        ),
        choices="the range of velocities",
    )


def second_attractor() -> Drawing:
    """Figure 4.19."""
    begins, ends = special("crisis", 0.0802, 0.0810), special("fold", 0.165, 0.175)
    return Drawing(
        "Attractor 2 in detail: from the crisis, where it appears as chaos, to the fold where its period 2 ends.",
        (Panel(BELT, SECTION, (points_of(detail(), "", 1),), x_range=(0.079, 0.172)),),
        (
            compare("smallest velocity of attractor 2", "0.0806", begins),
            compare("largest velocity of attractor 2", "0.170", ends),
        ),
    )


def graph(f: StickMap, times: int, low: float, high: float) -> list[Trace]:
    """Return the diagonal and the ``times``-th iterate of a map between two stretches, with gaps where it jumps."""
    x = np.linspace(low, high, PLACES)
    y = f.images(x, times)
    y[np.flatnonzero(np.abs(np.diff(y)) > 0.1 * (high - low))] = np.nan
    ends = np.array([low, high])
    return [Trace(ends, ends, "", "thin", None), Trace(x, y, "", "line", 0)]


def orbits(f: StickMap, period: int, low: float, high: float) -> list[Trace]:
    """Return the periodic points between two stretches, stable ones filled."""
    found = [orbit for n in range(1, period + 1) if period % n == 0 for orbit in periodic_points(f, n)]
    traces = []
    for orbit in found:
        points = np.array([point for point in orbit.points if low <= point <= high])
        if len(points):
            kind = "stable" if orbit.stable else "unstable"
            name = f"{kind}, period {orbit.period}"
            traces.append(Trace(points, points, name, "filled" if orbit.stable else "open", orbit.period))
    return traces


def crisis() -> Drawing:
    """Figure 4.20."""
    low, high = 0.02, 0.2
    panels = []
    for letter, speed in zip("abcd", CRISIS_SPEEDS, strict=True):
        f = map_at(speed)
        visited = np.array(attractors(speed)[1].points)
        bound = bounding_orbit(f)
        corners = np.array([bound[0], bound[0], bound[1], bound[1], bound[0]])
        sides = np.array([bound[0], bound[1], bound[1], bound[0], bound[0]])
        panels.append(
            Panel(
                D,
                NEXT,
                (
                    *graph(f, 1, low, high),
                    Trace(corners, sides, "unstable period 2", "dashed", 2),
                    Trace(visited, f.images(visited), "attractor 2", "points", 1),
                ),
                f"({letter}) V = {speed}",
                (low, high),
                (low, high),
            )
        )
    return Drawing(
        "The map from stick to stick with attractor 2 (points) inside the square of the unstable orbit of period 2 "
        "that bounds its basin: at the crisis the attractor touches the square.",
        tuple(panels),
        (
            compare("velocity of the crisis", "0.08059", special("crisis", 0.0802, 0.0810)),
            state(
                "the attractor collides with",
                "its basin boundary",
                f"{reach(CRISIS_SPEEDS[0]):.2g} inside the square at (a), {reach(CRISIS_SPEEDS[-1]):.2g} at (d)",
                0.0 < reach(CRISIS_SPEEDS[-1]) < reach(CRISIS_SPEEDS[0]),
            ),
        ),
        columns=2,
    )


def bounding_orbit(f: StickMap) -> tuple[float, ...]:
    """Return the points of the unstable orbit of period 2 that encloses attractor 2: the widest one."""
    return max(
        (orbit.points for orbit in periodic_points(f, 2) if not orbit.stable), key=lambda points: points[1] - points[0]
    )


def reach(speed: float) -> float:
    """Return how far inside the square of the bounding orbit the largest point of attractor 2 lies."""
    return bounding_orbit(map_at(speed))[1] - max(attractors(speed)[1].points)


def second_iterate(speeds: tuple[float, float], low: float, high: float) -> tuple[Panel, ...]:
    """Return the panels of the second iterate at two velocities."""
    return tuple(
        Panel(
            "d_n (Fs1/k)",
            "d_n+2 (Fs1/k)",
            (*graph(map_at(speed), 2, low, high), *orbits(map_at(speed), 2, low, high)),
            f"({letter}) V = {speed}",
            (low, high),
            (low, high),
        )
        for letter, speed in zip("ab", speeds, strict=True)
    )


def counted(speed: float, low: float, high: float) -> str:
    """Return how many stable and unstable fixed points the second iterate has between two stretches."""
    kinds = [
        (orbit.stable, point) for n in (1, 2) for orbit in periodic_points(map_at(speed), n) for point in orbit.points
    ]
    inside = [stable for stable, point in kinds if low <= point <= high]
    return f"{sum(inside)} stable, {len(inside) - sum(inside)} unstable"


def doubling() -> Drawing:
    """Figure 4.21."""
    low, high = 0.155, 0.185
    before, after = (counted(speed, low, high) for speed in DOUBLING_SPEEDS)
    value = special("period-doubling", 0.0830, 0.0850)
    return Drawing(
        "The second iterate of the map on either side of the reverse period doubling: two stable points about an "
        "unstable one become one stable point.",
        second_iterate(DOUBLING_SPEEDS, low, high),
        (
            *(
                state(f"fixed points of the second iterate at V = {speed}", says, found, says == found)
                for speed, says, found in zip(
                    DOUBLING_SPEEDS, ("2 stable, 1 unstable", "1 stable, 0 unstable"), (before, after), strict=True
                )
            ),
            state(
                "the reverse period doubling lies between",
                "0.0820 and 0.0842",
                f"{value:.10g}",
                0.0820 < value < 0.0842,
            ),
        ),
        columns=2,
    )


def fold() -> Drawing:
    """Figure 4.22."""
    low, high = 0.0, 0.25
    before, after = (counted(speed, 0.05, 0.18) for speed in FOLD_SPEEDS)
    return Drawing(
        "The second iterate of the map on either side of the fold in which the stable orbit of period 2 vanishes.",
        second_iterate(FOLD_SPEEDS, low, high),
        (
            compare("velocity at which attractor 2 disappears", "0.170", special("fold", 0.165, 0.175)),
            *(
                state(f"fixed points of the second iterate at V = {speed}", says, found, says == found)
                for speed, says, found in zip(
                    FOLD_SPEEDS, ("2 stable, 1 unstable", "0 stable, 1 unstable"), (before, after), strict=True
                )
            ),
        ),
        columns=2,
    )


def secant() -> Drawing:
    """Figure 4.23."""
    f, low, high = map_at(EXPONENT_SPEEDS[0]), 0.04, 0.2
    d, step = 0.08, 0.02
    x = np.array([d, d + step])
    y = f.images(x)
    tangent = float(slope(f, x[:1])[0])
    return Drawing(
        "The slope of the map at a point d_n of an orbit, from the images of d_n and d_n + delta; the Lyapunov "
        "exponent is the mean of log abs(slope) on the orbit.",
        (
            Panel(
                D,
                NEXT,
                (
                    *graph(f, 1, low, high),
                    Trace(x, y, "secant over delta", "line", 1),
                    Trace(
                        np.array([low, high]),
                        y[0] + tangent * (np.array([low, high]) - d),
                        "tangent at d_n",
                        "dashed",
                        2,
                    ),
                    Trace(x, y, "d_n and d_n + delta", "open", -1),
                ),
                x_range=(low, high),
                y_range=(low, high),
                equal=True,
            ),
        ),
        choices=f"the belt velocity, {EXPONENT_SPEEDS[0]}, d_n = {d}, and delta = {step}, large enough to be seen",
    )


def running(speed: float) -> Array:
    """Return the mean of log abs(slope) over the first 1, 2 ... events on attractor 2: (ITERATIONS,)."""
    f = map_at(speed)
    orbit = f.orbit(attractors(speed)[-1].points[0], TRANSIENT + ITERATIONS)[TRANSIENT:]
    means: Array = np.cumsum(np.log(np.abs(slope(f, orbit)))) / np.arange(1, ITERATIONS + 1)
    return means


def exponents() -> Drawing:
    """Figure 4.24."""
    count = np.arange(1.0, ITERATIONS + 1)
    runs = {speed: running(speed) for speed in EXPONENT_SPEEDS}
    rows: list[StatementCheck] = []
    found_exponents = []
    for speed, expected in zip(
        EXPONENT_SPEEDS, ("chaotic: above 0", "periodic: below 0", "periodic: below 0"), strict=True
    ):
        found = exponent(map_at(speed).motion(np.array(attractors(speed)[-1].points[:1])), LONG)
        found_exponents.append(found.exponent)
        rows.append(
            state(
                f"Lyapunov exponent at V = {speed}",
                expected,
                f"{found.exponent:.5f} +- {found.stderr:.1g} per event; {runs[speed][-1]:.3f} after {ITERATIONS}",
                (found.exponent > 0.0) == expected.startswith("chaotic"),
            )
        )
    extent = [point for row in detail() for point in row.points]
    rows.append(
        state(
            "axis from -0.2 to -0.7 of (a)",
            "Lyapunov exponent (text on 4.24)",
            f"X1p of attractor 2 lies from {min(extent):.3g} to {max(extent):.3g}",
            all(-0.7 <= exponent <= -0.2 for exponent in found_exponents),
            "(a) shows attractor 2 and (b) the exponents, as the caption says; the text places the exponents in (a)",
        )
    )
    return Drawing(
        "(a) Attractor 2 against the belt velocity; (b) the mean of log abs(slope) over the events so far, which tends "
        "to the Lyapunov exponent, at three velocities.",
        (
            Panel(BELT, "X1p (Fs1/k)", (points_of(detail(), "", 1),), "(a)", (0.079, 0.172)),
            Panel(
                "number of iterations",
                "exponent (1/event)",
                tuple(
                    Trace(count, run, f"V = {speed}", "line", place) for place, (speed, run) in enumerate(runs.items())
                ),
                "(b)",
                y_range=(-0.8, 2.6),  # room for the legend
            ),
        ),
        tuple(rows),
        choices="two of the three velocities of (b), 0.083 and 0.1: one of them, 0.08075, can be read",
    )


FIGURES = (
    Entry("4.18", "bifurcation diagram, X1p against belt velocity", both_attractors),
    Entry("4.19", "bifurcation diagram of attractor 2", second_attractor),
    Entry("4.20", "one-dimensional map, collision of the attractor with its basin boundary", crisis),
    Entry("4.21", "second iterate of the map, reverse period doubling", doubling),
    Entry("4.22", "second iterate of the map, fold", fold),
    Entry("4.23", "Lyapunov exponent from the one-dimensional map", secant),
    Entry("4.24", "attractor 2 and Lyapunov exponents at three velocities", exponents),
)
