"""Chapter 5, figures 5.3, 5.4 and 5.6: one mass with damping, its fixed point and its orbits in the phase plane."""

import math
from functools import cache

import numpy as np

from rig_sim.atlas.chapters.axes import V, X, motion
from rig_sim.atlas.figure import Computed, Panel, Style, Trace
from rig_sim.atlas.statements import entries
from rig_sim.dynamics.limit_cycles.branches import continuation
from rig_sim.dynamics.limit_cycles.fixed_point import FixedPoint, fixed_point
from rig_sim.dynamics.limit_cycles.floquet import FloquetOrbit, floquet
from rig_sim.dynamics.limit_cycles.limit_cycle import Orbit, cycle
from rig_sim.flow.flow import Flow
from rig_sim.scenes.scene import scene
from stickslip.compute.arrays import Array

SPEED = 0.6  # speed of the belt
STRONGEST = 0.62  # damping drawn
PORTRAITS = {
    "a": (0.0, (0.5, 1.6)),
    "b": (0.1, (0.5, 1.6)),
    "c": (0.2, (0.5, 1.6)),
    "d": (0.4, (0.25, 0.05, 1.6)),
    "e": (0.5, (0.2, -0.2, 1.6)),
    "f": (0.6, (-0.3, 1.6)),
}  # damping, and where motions drawn begin (v = 0)
FIXED_POINT: dict[bool, tuple[str, Style]] = {True: ("stable", "filled"), False: ("unstable", "open")}


def flow_at(c: float) -> Flow:
    """Return the damped mass."""
    return scene("damped", **{"damper.c": c, "belt.speed": SPEED}).flow()


@cache
def rest(c: float) -> FixedPoint:
    """Return the fixed point."""
    return fixed_point(flow_at(c))


@cache
def stick_slip(c: float) -> Orbit:
    """Return the stick-slip orbit, or what there is in its place."""
    return cycle(flow_at(c))


@cache
def unstable(c: float) -> FloquetOrbit:
    """Return the unstable orbit, or what there is in its place."""
    return floquet(flow_at(c), "unstable", orbit=stick_slip(c))


@cache
def points() -> dict[str, float]:
    """Return the damping of each special point."""
    return {point.kind: point.value for point in continuation(flow_at, np.linspace(0.2, STRONGEST, 4)).points}


def special(kind: str) -> float:
    """Return the damping of a special point: 'hopf' or 'fold'."""
    return points()[kind]


def played(c: float, x: float, v: float, until: float) -> tuple[Array, Array]:
    """Return x and v of a motion from a start."""
    changes = (("damper.c", c), ("belt.speed", SPEED), ("start.x", x), ("start.v", v))
    _, found, speed, _ = motion("damped", until, 100.0, changes)
    return found, speed


def stable_trace(c: float, label: str = "stable orbit") -> list[Trace]:
    """Return the stick-slip orbit, nothing where there is none."""
    found = stick_slip(c)
    if found.x_slip is None or found.period is None:
        return []
    return [Trace(*played(c, found.x_slip, SPEED, found.period + 0.02), label, "thick", 0)]


def unstable_trace(c: float) -> list[Trace]:
    """Return the unstable orbit, nothing where there is none."""
    found = unstable(c)
    if found.x_min is None or found.period is None:
        return []
    return [Trace(*played(c, found.x_min, 0.0, found.period + 0.02), "unstable orbit", "dashed", 1)]


def rest_trace(c: float) -> Trace:
    """Return the fixed point: filled where it is stable."""
    kind, style = FIXED_POINT[rest(c).stable is True]
    return Trace(np.array([rest(c).x or math.nan]), np.zeros(1), f"{kind} fixed point", style, -1)


def portrait(c: float, starts: tuple[float, ...], until: float, title: str, with_unstable: bool) -> Panel:
    """Return a phase portrait: motions from (x, 0), the stable and the unstable orbit, the fixed point."""
    thin = [Trace(*played(c, x, 0.0, until), "", "thin", 2) for x in starts]
    orbits = [*stable_trace(c), *(unstable_trace(c) if with_unstable else [])]
    return Panel(X, V, (*thin, *orbits, rest_trace(c)), title, (-1.35, 1.75), (-1.6, 0.75))


def undamped() -> Computed:
    """Return the phase portrait without damping."""
    ends = [played(0.0, x, 0.0, 60.0) for x in (0.5, 1.6)]
    found = stick_slip(0.0)
    on_it = all(abs(float(x[-700:].min()) - (found.x_min or math.nan)) < 1e-3 for x, _ in ends)
    panel = portrait(0.0, (0.5, 0.37, 1.6), 40.0, "", False)
    return Computed((panel,), {"unstable": not rest(0.0).stable, "on_it": on_it})


def increasing() -> Computed:
    """Return phase portraits with growing damping."""
    panels = tuple(
        portrait(c, starts, 40.0, f"({letter}) c = {c:g}", False) for letter, (c, starts) in PORTRAITS.items()
    )
    sizes = [(orbit.x_max or 0.0) - (orbit.x_min or 0.0) for orbit in map(stick_slip, (0.0, 0.1, 0.2, 0.4, 0.5))]
    inner, outer = (settles(0.4, x) for x in PORTRAITS["d"][1][:2])
    numbers = {
        "widths": ", ".join(f"{size:.4g}" for size in sizes),
        "shrinks": sizes == sorted(sizes, reverse=True),
        "inner": inner,
        "outer": outer,
        "both": (inner, outer) == ("fixed point", "limit cycle"),
        "at_06": stick_slip(0.6).outcome,
        "only_rest": stick_slip(0.6).outcome == "fixed point" and rest(0.6).stable is True,
    }
    return Computed(panels, numbers, columns=2)


def settles(c: float, x: float) -> str:
    """Return what a motion from (x, 0) comes to: with a longest velocity below the belt's the fixed point."""
    _, v = played(c, x, 0.0, 400.0)
    return "limit cycle" if float(v[-1000:].max()) == SPEED else "fixed point"


def around_the_fold() -> Computed:
    """Return stick-slip orbit, unstable orbit and fixed point around the fold."""
    dampings = {"a": 0.38, "b": 0.45, "c": 0.55, "d": 0.6}
    panels = tuple(portrait(c, (), 1.0, f"({letter}) c = {c:g}", True) for letter, c in dampings.items())
    has = ("no" if unstable(c).period is None else "yes" for c in dampings.values())
    gap = (unstable(0.55).x_min or math.nan) - (stick_slip(0.55).x_min or math.nan)
    return Computed(panels, {"exists": ", ".join(has), "gap": gap, "close": 0.0 < gap < 0.1}, columns=2)


FIGURES = entries("chapter5.toml", {"5.3": undamped, "5.4": increasing, "5.6": around_the_fold})
