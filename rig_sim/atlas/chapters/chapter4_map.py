"""Chapter 4, figures 4.18 to 4.24: bifurcation diagrams of two masses, the map from stick to stick, its exponents."""

from collections.abc import Iterable
from functools import cache, partial

import numpy as np

from rig_sim.analyses.basins import TRANSIENT, Attractor, basins
from rig_sim.analyses.exponent import exponent
from rig_sim.analyses.map_branches import map_continuation
from rig_sim.analyses.periodic_points import find_periodic_orbits
from rig_sim.analyses.section import CELLS, attractors_at
from rig_sim.analyses.sweep import AttractorAt, sweep
from rig_sim.atlas.figure import Computed, Panel, Trace
from rig_sim.atlas.statements import read_entries
from rig_sim.flow.two_mass import TwoMassFlow
from rig_sim.scenes.scene import scene
from rig_sim.systems.interface import slope
from rig_sim.systems.stick import StickMap
from stickslip.compute.arrays import Array

SPEEDS = np.linspace(0.08, 0.2, 161)  # of figure 4.18; 0.2 s of CPU each
NEAR_CRISIS = np.linspace(0.0802, 0.0846, 56)  # of figure 4.19, 0.1 s of CPU each
BELT, SECTION = "belt velocity Vdr (Fs1/sqrt(km))", "X1p: X1 where V1 = 0, rising (Fs1/k)"
D, NEXT = "stretch d_n = X2 - X1 (Fs1/k)", "d_n+1 (Fs1/k)"
CRISIS_SPEEDS = (0.0820196, 0.0813048, 0.08090, 0.08059)
CRISIS, DOUBLING, FOLD = (0.0802, 0.0810), (0.0830, 0.0850), (0.165, 0.175)  # belt velocities on either side of each
EXPONENT_SPEEDS, ITERATIONS = (0.08075, 0.083, 0.1), 700
LONG = 20_000  # events of a compared Lyapunov exponent
PLACES = 1500  # points of the curve of a map

Span = tuple[float, float]


def flow_at(speed: float) -> TwoMassFlow:
    return scene("two-mass", **{"belt.speed": speed}).two_mass_flow()


@cache
def map_at(speed: float) -> StickMap:
    return StickMap(flow_at(speed))


@cache
def attractors_at_speed(speed: float) -> tuple[Attractor, ...]:
    """Return the attractors of the map at a belt velocity, the largest basin first."""
    return basins(map_at(speed), CELLS).attractors


@cache
def sweep_speeds() -> tuple[AttractorAt, ...]:
    """Return the attractors over the belt velocities of figure 4.18."""
    return tuple(sweep(partial(attractors_at, flow_at, "poincare"), SPEEDS.tolist()))


@cache
def find_special_speed(kind: str, low: float, high: float) -> float:
    points = map_continuation(map_at, np.linspace(low, high, 5).tolist()).points
    (speed,) = [point.value for point in points if point.kind == kind]
    return speed


@cache
def sweep_second_attractor() -> tuple[AttractorAt, ...]:
    """Return attractor 2 over the belt velocities of figure 4.18, and more of them near the crisis."""
    near = sweep(partial(attractors_at, flow_at, "poincare"), NEAR_CRISIS.tolist())
    rows = [row for row in (*sweep_speeds(), *near) if row.attractor == 2]
    return tuple(sorted(rows, key=lambda row: row.value))


def trace_points(rows: Iterable[AttractorAt], label: str, colour: int) -> Trace:
    rows = list(rows)
    x = np.concatenate([np.full(len(row.points), row.value) for row in rows])
    y = np.concatenate([row.points for row in rows])
    return Trace(x, y, label, "points", colour)


def draw_both_attractors() -> Computed:
    numbers = sorted({row.attractor for row in sweep_speeds()})
    traces = tuple(
        trace_points((row for row in sweep_speeds() if row.attractor == number), f"attractor {number}", number - 1)
        for number in numbers
    )
    third = [row.value for row in sweep_speeds() if row.attractor == 3]
    at_021, at_025 = (len(attractors_at_speed(speed)) for speed in (0.21, 0.25))
    computed_numbers = {
        "attractors": len(numbers),
        "third": f"; the third from V = {min(third):.5g} to {max(third):.5g}" if third else "",
        "two": len(numbers) == 2,
        "at_021": at_021,
        "at_025": at_025,
        "none_beyond": at_021 == at_025 == 0,
    }
    return Computed((Panel(BELT, SECTION, traces),), computed_numbers)


def draw_second_attractor() -> Computed:
    panel = Panel(BELT, SECTION, (trace_points(sweep_second_attractor(), "", 1),), x_range=(0.079, 0.172))
    return Computed(
        (panel,), {"crisis": find_special_speed("crisis", *CRISIS), "fold": find_special_speed("fold", *FOLD)}
    )


def trace_map(f: StickMap, times: int, low: float, high: float) -> list[Trace]:
    """Return the diagonal and the ``times``-th iterate of a map between two stretches, with gaps where it jumps."""
    x = np.linspace(low, high, PLACES)
    y = f.images(x, times)
    y[np.flatnonzero(np.abs(np.diff(y)) > 0.1 * (high - low))] = np.nan
    ends = np.array([low, high])
    return [Trace(ends, ends, "", "thin", None), Trace(x, y, "", "line", 0)]


def trace_orbits(f: StickMap, period: int, low: float, high: float) -> list[Trace]:
    """Return the periodic points between two stretches, stable ones filled."""
    orbits = [orbit for n in range(1, period + 1) if period % n == 0 for orbit in find_periodic_orbits(f, n)]
    traces = []
    for orbit in orbits:
        points = np.array([point for point in orbit.points if low <= point <= high])
        if len(points):
            kind = "stable" if orbit.stable else "unstable"
            name = f"{kind}, period {orbit.period}"
            traces.append(Trace(points, points, name, "filled" if orbit.stable else "open", orbit.period))
    return traces


def draw_collision() -> Computed:
    """Return the map with attractor 2 within the square of the orbit that bounds its basin, towards the crisis."""
    low, high = 0.02, 0.2
    panels = []
    for letter, speed in zip("abcd", CRISIS_SPEEDS, strict=True):
        f = map_at(speed)
        visited = np.array(attractors_at_speed(speed)[1].points)
        lower, upper = find_bounding_orbit(f)
        corners, sides = np.array([lower, lower, upper, upper, lower]), np.array([lower, upper, upper, lower, lower])
        curves = (
            *trace_map(f, 1, low, high),
            Trace(corners, sides, "unstable period 2", "dashed", 2),
            Trace(visited, f.images(visited), "attractor 2", "points", 1),
        )
        panels.append(Panel(D, NEXT, curves, f"({letter}) V = {speed}", (low, high), (low, high)))
    first, last = measure_margin(CRISIS_SPEEDS[0]), measure_margin(CRISIS_SPEEDS[-1])
    numbers = {
        "crisis": find_special_speed("crisis", *CRISIS),
        "first": first,
        "last": last,
        "collides": 0.0 < last < first,
    }
    return Computed(tuple(panels), numbers, columns=2)


def find_bounding_orbit(f: StickMap) -> tuple[float, ...]:
    """Return the points of the unstable orbit of period 2 that encloses attractor 2: the widest one."""
    return max(
        (orbit.points for orbit in find_periodic_orbits(f, 2) if not orbit.stable),
        key=lambda points: points[1] - points[0],
    )


def measure_margin(speed: float) -> float:
    """Return how far inside the square of the bounding orbit the largest point of attractor 2 lies."""
    return find_bounding_orbit(map_at(speed))[1] - max(attractors_at_speed(speed)[1].points)


def draw_second_iterate(
    kind: str, speeds: tuple[float, float], range_: Span, counted_in: Span, between: Span
) -> Computed:
    """Return the second iterate at two belt velocities on either side of a special point, with its fixed points."""
    panels = tuple(
        Panel(
            "d_n (Fs1/k)",
            "d_n+2 (Fs1/k)",
            (*trace_map(map_at(speed), 2, *range_), *trace_orbits(map_at(speed), 2, *range_)),
            f"({letter}) V = {speed}",
            range_,
            range_,
        )
        for letter, speed in zip("ab", speeds, strict=True)
    )
    before, after = (count_fixed_points(speed, *counted_in) for speed in speeds)
    value = find_special_speed(kind, *between)
    numbers = {"before": before, "after": after, "special": value, "between": 0.0820 < value < 0.0842}
    return Computed(panels, numbers, columns=2)


def count_fixed_points(speed: float, low: float, high: float) -> str:
    """Return the numbers of stable and unstable fixed points of the second iterate between two stretches, as text."""
    kinds = [
        (orbit.stable, point)
        for n in (1, 2)
        for orbit in find_periodic_orbits(map_at(speed), n)
        for point in orbit.points
    ]
    inside = [stable for stable, point in kinds if low <= point <= high]
    return f"{sum(inside)} stable, {len(inside) - sum(inside)} unstable"


def draw_secant() -> Computed:
    f, low, high = map_at(EXPONENT_SPEEDS[0]), 0.04, 0.2
    d, step = 0.08, 0.02
    x = np.array([d, d + step])
    y = f.images(x)
    ends = np.array([low, high])
    curves = (
        *trace_map(f, 1, low, high),
        Trace(x, y, "secant over delta", "line", 1),
        Trace(ends, y[0] + float(slope(f, x[:1])[0]) * (ends - d), "tangent at d_n", "dashed", 2),
        Trace(x, y, "d_n and d_n + delta", "open", -1),
    )
    panel = Panel(D, NEXT, curves, x_range=(low, high), y_range=(low, high), equal=True)
    return Computed((panel,), {"speed": EXPONENT_SPEEDS[0], "d": d, "step": step})


def running_exponent(speed: float) -> Array:
    """Return the mean of log abs(slope) over the first 1, 2 ... events on attractor 2: (ITERATIONS,)."""
    f = map_at(speed)
    orbit = f.orbit(attractors_at_speed(speed)[-1].points[0], TRANSIENT + ITERATIONS)[TRANSIENT:]
    means: Array = np.cumsum(np.log(np.abs(slope(f, orbit)))) / np.arange(1, ITERATIONS + 1)
    return means


def draw_exponents() -> Computed:
    count = np.arange(1.0, ITERATIONS + 1)
    means = [running_exponent(speed) for speed in EXPONENT_SPEEDS]
    exponents = [
        exponent(map_at(speed).motion(np.array(attractors_at_speed(speed)[-1].points[:1])), LONG)
        for speed in EXPONENT_SPEEDS
    ]
    texts = (
        f"{result.exponent:.5f} +- {result.stderr:.1g} per event; {run[-1]:.3f} after {ITERATIONS}"
        for result, run in zip(exponents, means, strict=True)
    )
    extent = [point for row in sweep_second_attractor() for point in row.points]
    traces = (
        Trace(count, run, f"V = {speed}", "line", colour)
        for colour, (speed, run) in enumerate(zip(EXPONENT_SPEEDS, means, strict=True))
    )
    numbers = {
        **dict(zip(("first", "second", "third"), texts, strict=True)),
        "first_chaotic": exponents[0].exponent > 0.0,
        "second_periodic": exponents[1].exponent <= 0.0,
        "third_periodic": exponents[2].exponent <= 0.0,
        "least": min(extent),
        "largest": max(extent),
        "exponents_in_a": all(-0.7 <= result.exponent <= -0.2 for result in exponents),
    }
    y_range = (-0.8, 2.6)  # for the legend
    panels = (
        Panel(BELT, "X1p (Fs1/k)", (trace_points(sweep_second_attractor(), "", 1),), "(a)", (0.079, 0.172)),
        Panel("number of iterations", "exponent (1/event)", tuple(traces), "(b)", y_range=y_range),
    )
    return Computed(panels, numbers)


FIGURES = read_entries(
    "chapter4.toml",
    {
        "4.18": draw_both_attractors,
        "4.19": draw_second_attractor,
        "4.20": draw_collision,
        "4.21": partial(
            draw_second_iterate, "period-doubling", (0.0838, 0.0842), (0.155, 0.185), (0.155, 0.185), DOUBLING
        ),
        "4.22": partial(draw_second_iterate, "fold", FOLD, (0.0, 0.25), (0.05, 0.18), FOLD),
        "4.23": draw_secant,
        "4.24": draw_exponents,
    },
)
