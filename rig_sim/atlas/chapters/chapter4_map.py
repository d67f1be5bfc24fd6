"""Chapter 4, figures 4.18 to 4.24: bifurcation diagrams of two masses, the map from stick to stick, its exponents."""

from collections.abc import Iterable
from functools import cache, partial

import numpy as np

from rig_sim.atlas.figure import Computed, Panel, Trace
from rig_sim.atlas.statements import entries
from rig_sim.dynamics.analyses.basins import TRANSIENT, Attractor, basins
from rig_sim.dynamics.analyses.exponent import exponent
from rig_sim.dynamics.analyses.map_branches import map_continuation
from rig_sim.dynamics.analyses.periodic_points import periodic_points
from rig_sim.dynamics.analyses.sweep import AttractorAt, sweep
from rig_sim.dynamics.return_maps.section import CELLS, attractors_at
from rig_sim.dynamics.return_maps.stick import StickMap
from rig_sim.dynamics.system.interface import slope
from rig_sim.flow.two_mass import TwoMassFlow
from rig_sim.scenes.scene import scene
from stickslip.compute.arrays import Array

SPEEDS = np.linspace(0.08, 0.2, 161)  # of figure 4.18; 0.2 s of CPU each
NEAR_CRISIS = np.linspace(0.0802, 0.0846, 56)  # of figure 4.19, 0.1 s of CPU each
BELT, SECTION = "belt velocity Vdr (Fs1/sqrt(km))", "X1p: X1 where V1 = 0, rising (Fs1/k)"
D, NEXT = "stretch d_n = X2 - X1 (Fs1/k)", "d_n+1 (Fs1/k)"
CRISIS_SPEEDS = (0.0820196, 0.0813048, 0.08090, 0.08059)
CRISIS, DOUBLING, FOLD = (0.0802, 0.0810), (0.0830, 0.0850), (0.165, 0.175)  # belt velocities on either side of each
EXPONENT_SPEEDS, ITERATIONS = (0.08075, 0.083, 0.1), 700
LONG = 20_000  # events of a Lyapunov exponent that is compared
PLACES = 1500  # drawn of a map

Span = tuple[float, float]


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


def both_attractors() -> Computed:
    """Return the attractors over the belt velocity."""
    numbers = sorted({row.attractor for row in diagram()})
    traces = tuple(
        points_of((row for row in diagram() if row.attractor == number), f"attractor {number}", number - 1)
        for number in numbers
    )
    third = [row.value for row in diagram() if row.attractor == 3]
    at_021, at_025 = (len(attractors(speed)) for speed in (0.21, 0.25))
    found = {
        "attractors": len(numbers),
        "third": f"; the third from V = {min(third):.5g} to {max(third):.5g}" if third else "",
        "two": len(numbers) == 2,
        "at_021": at_021,
        "at_025": at_025,
        "none_beyond": at_021 == at_025 == 0,
    }
    return Computed((Panel(BELT, SECTION, traces),), found)


def second_attractor() -> Computed:
    """Return attractor 2 over the belt velocity."""
    panel = Panel(BELT, SECTION, (points_of(detail(), "", 1),), x_range=(0.079, 0.172))
    return Computed((panel,), {"crisis": special("crisis", *CRISIS), "fold": special("fold", *FOLD)})


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


def collision() -> Computed:
    """Return the map with attractor 2 within the square of the orbit that bounds its basin, towards the crisis."""
    low, high = 0.02, 0.2
    panels = []
    for letter, speed in zip("abcd", CRISIS_SPEEDS, strict=True):
        f = map_at(speed)
        visited = np.array(attractors(speed)[1].points)
        left, right = bounding_orbit(f)
        corners, sides = np.array([left, left, right, right, left]), np.array([left, right, right, left, left])
        curves = (
            *graph(f, 1, low, high),
            Trace(corners, sides, "unstable period 2", "dashed", 2),
            Trace(visited, f.images(visited), "attractor 2", "points", 1),
        )
        panels.append(Panel(D, NEXT, curves, f"({letter}) V = {speed}", (low, high), (low, high)))
    first, last = reach(CRISIS_SPEEDS[0]), reach(CRISIS_SPEEDS[-1])
    numbers = {"crisis": special("crisis", *CRISIS), "first": first, "last": last, "collides": 0.0 < last < first}
    return Computed(tuple(panels), numbers, columns=2)


def bounding_orbit(f: StickMap) -> tuple[float, ...]:
    """Return the points of the unstable orbit of period 2 that encloses attractor 2: the widest one."""
    return max(
        (orbit.points for orbit in periodic_points(f, 2) if not orbit.stable), key=lambda points: points[1] - points[0]
    )


def reach(speed: float) -> float:
    """Return how far inside the square of the bounding orbit the largest point of attractor 2 lies."""
    return bounding_orbit(map_at(speed))[1] - max(attractors(speed)[1].points)


def second_iterate(kind: str, speeds: tuple[float, float], range_: Span, counted_in: Span, between: Span) -> Computed:
    """Return the second iterate at two belt velocities on either side of a special point, with its fixed points."""
    panels = tuple(
        Panel(
            "d_n (Fs1/k)",
            "d_n+2 (Fs1/k)",
            (*graph(map_at(speed), 2, *range_), *orbits(map_at(speed), 2, *range_)),
            f"({letter}) V = {speed}",
            range_,
            range_,
        )
        for letter, speed in zip("ab", speeds, strict=True)
    )
    before, after = (counted(speed, *counted_in) for speed in speeds)
    value = special(kind, *between)
    numbers = {"before": before, "after": after, "special": value, "between": 0.0820 < value < 0.0842}
    return Computed(panels, numbers, columns=2)


def counted(speed: float, low: float, high: float) -> str:
    """Return how many stable and unstable fixed points the second iterate has between two stretches."""
    kinds = [
        (orbit.stable, point) for n in (1, 2) for orbit in periodic_points(map_at(speed), n) for point in orbit.points
    ]
    inside = [stable for stable, point in kinds if low <= point <= high]
    return f"{sum(inside)} stable, {len(inside) - sum(inside)} unstable"


def secant() -> Computed:
    """Return how the slope of the map is taken."""
    f, low, high = map_at(EXPONENT_SPEEDS[0]), 0.04, 0.2
    d, step = 0.08, 0.02
    x = np.array([d, d + step])
    y = f.images(x)
    ends = np.array([low, high])
    curves = (
        *graph(f, 1, low, high),
        Trace(x, y, "secant over delta", "line", 1),
        Trace(ends, y[0] + float(slope(f, x[:1])[0]) * (ends - d), "tangent at d_n", "dashed", 2),
        Trace(x, y, "d_n and d_n + delta", "open", -1),
    )
    panel = Panel(D, NEXT, curves, x_range=(low, high), y_range=(low, high), equal=True)
    return Computed((panel,), {"speed": EXPONENT_SPEEDS[0], "d": d, "step": step})


def running(speed: float) -> Array:
    """Return the mean of log abs(slope) over the first 1, 2 ... events on attractor 2: (ITERATIONS,)."""
    f = map_at(speed)
    orbit = f.orbit(attractors(speed)[-1].points[0], TRANSIENT + ITERATIONS)[TRANSIENT:]
    means: Array = np.cumsum(np.log(np.abs(slope(f, orbit)))) / np.arange(1, ITERATIONS + 1)
    return means


def exponents() -> Computed:
    """Return attractor 2 over the belt velocity, and running means of its exponent at three velocities."""
    count = np.arange(1.0, ITERATIONS + 1)
    means = [running(speed) for speed in EXPONENT_SPEEDS]
    found = [
        exponent(map_at(speed).motion(np.array(attractors(speed)[-1].points[:1])), LONG) for speed in EXPONENT_SPEEDS
    ]
    in_words = (
        f"{one.exponent:.5f} +- {one.stderr:.1g} per event; {run[-1]:.3f} after {ITERATIONS}"
        for one, run in zip(found, means, strict=True)
    )
    extent = [point for row in detail() for point in row.points]
    traces = (
        Trace(count, run, f"V = {speed}", "line", place)
        for place, (speed, run) in enumerate(zip(EXPONENT_SPEEDS, means, strict=True))
    )
    numbers = {
        **dict(zip(("first", "second", "third"), in_words, strict=True)),
        "first_chaotic": found[0].exponent > 0.0,
        "second_periodic": found[1].exponent <= 0.0,
        "third_periodic": found[2].exponent <= 0.0,
        "least": min(extent),
        "largest": max(extent),
        "exponents_in_a": all(-0.7 <= one.exponent <= -0.2 for one in found),
    }
    room = (-0.8, 2.6)  # for the legend
    panels = (
        Panel(BELT, "X1p (Fs1/k)", (points_of(detail(), "", 1),), "(a)", (0.079, 0.172)),
        Panel("number of iterations", "exponent (1/event)", tuple(traces), "(b)", y_range=room),
    )
    return Computed(panels, numbers)


FIGURES = entries(
    "chapter4.toml",
    {
        "4.18": both_attractors,
        "4.19": second_attractor,
        "4.20": collision,
        "4.21": partial(second_iterate, "period-doubling", (0.0838, 0.0842), (0.155, 0.185), (0.155, 0.185), DOUBLING),
        "4.22": partial(second_iterate, "fold", FOLD, (0.0, 0.25), (0.05, 0.18), FOLD),
        "4.23": secant,
        "4.24": exponents,
    },
)
