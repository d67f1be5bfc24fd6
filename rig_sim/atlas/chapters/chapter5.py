"""Chapter 5, figures 5.3, 5.4 and 5.6: one mass with damping, its fixed point and its orbits in the phase plane."""

import math
from functools import cache

import numpy as np

from rig_sim.analyses.limit_cycles.branches import continuation
from rig_sim.analyses.limit_cycles.fixed_point import FixedPoint, fixed_point
from rig_sim.analyses.limit_cycles.floquet import FloquetOrbit, floquet
from rig_sim.analyses.limit_cycles.limit_cycle import Orbit, cycle
from rig_sim.atlas.chapters.axes import V, X, play_motion
from rig_sim.atlas.figure import Computed, Panel, Style, Trace
from rig_sim.atlas.statements import read_entries
from rig_sim.flow.flow import Flow
from rig_sim.scenes.scene import scene
from stickslip.compute.arrays import Array

SPEED = 0.6  # speed of the belt
STRONGEST = 0.62  # largest drawn damping
PORTRAITS = {
    "a": (0.0, (0.5, 1.6)),
    "b": (0.1, (0.5, 1.6)),
    "c": (0.2, (0.5, 1.6)),
    "d": (0.4, (0.25, 0.05, 1.6)),
    "e": (0.5, (0.2, -0.2, 1.6)),
    "f": (0.6, (-0.3, 1.6)),
}  # damping, and the starts of drawn motions (v = 0)
FIXED_POINT: dict[bool, tuple[str, Style]] = {True: ("stable", "filled"), False: ("unstable", "open")}


def flow_at(c: float) -> Flow:
    return scene("damped", **{"damper.c": c, "belt.speed": SPEED}).flow()


@cache
def find_fixed_point(c: float) -> FixedPoint:
    return fixed_point(flow_at(c))


@cache
def find_stick_slip(c: float) -> Orbit:
    return cycle(flow_at(c))


@cache
def find_unstable_orbit(c: float) -> FloquetOrbit:
    return floquet(flow_at(c), "unstable", orbit=find_stick_slip(c))


@cache
def find_special_points() -> dict[str, float]:
    return {point.kind: point.value for point in continuation(flow_at, np.linspace(0.2, STRONGEST, 4)).points}


def find_special_damping(kind: str) -> float:
    return find_special_points()[kind]


def play(c: float, x: float, v: float, until: float) -> tuple[Array, Array]:
    changes = (("damper.c", c), ("belt.speed", SPEED), ("start.x", x), ("start.v", v))
    _, x_played, speed, _ = play_motion("damped", until, 100.0, changes)
    return x_played, speed


def trace_stable_orbit(c: float, label: str = "stable orbit") -> list[Trace]:
    """Return the stick-slip orbit; empty without one."""
    orbit = find_stick_slip(c)
    if orbit.x_slip is None or orbit.period is None:
        return []
    return [Trace(*play(c, orbit.x_slip, SPEED, orbit.period + 0.02), label, "thick", 0)]


def trace_unstable_orbit(c: float) -> list[Trace]:
    """Return the unstable orbit; empty without one."""
    orbit = find_unstable_orbit(c)
    if orbit.x_min is None or orbit.period is None:
        return []
    return [Trace(*play(c, orbit.x_min, 0.0, orbit.period + 0.02), "unstable orbit", "dashed", 1)]


def trace_fixed_point(c: float) -> Trace:
    """Return the fixed point: filled where it is stable."""
    kind, style = FIXED_POINT[find_fixed_point(c).stable is True]
    return Trace(np.array([find_fixed_point(c).x or math.nan]), np.zeros(1), f"{kind} fixed point", style, -1)


def draw_portrait(c: float, starts: tuple[float, ...], until: float, title: str, with_unstable: bool) -> Panel:
    """Return a phase portrait: motions from (x, 0), the stable and the unstable orbit, the fixed point."""
    thin = [Trace(*play(c, x, 0.0, until), "", "thin", 2) for x in starts]
    orbits = [*trace_stable_orbit(c), *(trace_unstable_orbit(c) if with_unstable else [])]
    return Panel(X, V, (*thin, *orbits, trace_fixed_point(c)), title, (-1.35, 1.75), (-1.6, 0.75))


def draw_undamped() -> Computed:
    ends = [play(0.0, x, 0.0, 60.0) for x in (0.5, 1.6)]
    orbit = find_stick_slip(0.0)
    on_it = all(abs(float(x[-700:].min()) - (orbit.x_min or math.nan)) < 1e-3 for x, _ in ends)
    panel = draw_portrait(0.0, (0.5, 0.37, 1.6), 40.0, "", False)
    return Computed((panel,), {"unstable": not find_fixed_point(0.0).stable, "on_it": on_it})


def draw_increasing() -> Computed:
    panels = tuple(
        draw_portrait(c, starts, 40.0, f"({letter}) c = {c:g}", False) for letter, (c, starts) in PORTRAITS.items()
    )
    sizes = [(orbit.x_max or 0.0) - (orbit.x_min or 0.0) for orbit in map(find_stick_slip, (0.0, 0.1, 0.2, 0.4, 0.5))]
    inner, outer = (find_end(0.4, x) for x in PORTRAITS["d"][1][:2])
    numbers = {
        "widths": ", ".join(f"{size:.4g}" for size in sizes),
        "shrinks": sizes == sorted(sizes, reverse=True),
        "inner": inner,
        "outer": outer,
        "both": (inner, outer) == ("fixed point", "limit cycle"),
        "at_06": find_stick_slip(0.6).outcome,
        "only_rest": find_stick_slip(0.6).outcome == "fixed point" and find_fixed_point(0.6).stable is True,
    }
    return Computed(panels, numbers, columns=2)


def find_end(c: float, x: float) -> str:
    """Return the end of a motion from (x, 0): the fixed point, if its largest velocity stays below the belt's."""
    _, v = play(c, x, 0.0, 400.0)
    return "limit cycle" if float(v[-1000:].max()) == SPEED else "fixed point"


def draw_around_fold() -> Computed:
    dampings = {"a": 0.38, "b": 0.45, "c": 0.55, "d": 0.6}
    panels = tuple(draw_portrait(c, (), 1.0, f"({letter}) c = {c:g}", True) for letter, c in dampings.items())
    has = ("no" if find_unstable_orbit(c).period is None else "yes" for c in dampings.values())
    gap = (find_unstable_orbit(0.55).x_min or math.nan) - (find_stick_slip(0.55).x_min or math.nan)
    return Computed(panels, {"exists": ", ".join(has), "gap": gap, "close": 0.0 < gap < 0.1}, columns=2)


FIGURES = read_entries("chapter5.toml", {"5.3": draw_undamped, "5.4": draw_increasing, "5.6": draw_around_fold})
