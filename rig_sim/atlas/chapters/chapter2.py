"""Chapter 2: one mass on a belt under each of the six laws: friction curve, motion in time, phase portrait."""

import math
from functools import cache, partial
from typing import Any

import numpy as np

from rig_sim.analyses.limit_cycles.limit_cycle import Orbit, cycle
from rig_sim.atlas.chapters.axes import F, T, V, X, play_motion
from rig_sim.atlas.figure import Computed, Panel, Trace
from rig_sim.atlas.statements import read_entries
from rig_sim.friction.contact import force
from rig_sim.friction.law import LAWS
from rig_sim.motion.play import Event, events
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene
from stickslip.compute.arrays import Array

UNTIL, RATE = 40.0, 200.0
COMES_TO = {
    "grazing": "a circle of period {period:.5g} that touches the edge of stick",
    "cycle": "a cycle of period {period:.5g}, of which the mass sticks {share:.0f} %",
}
CONTACT = {"jump": "jumps at the belt's velocity", "ramp": "falls steeply through the belt's velocity"}


@cache
def base_case(law: int) -> Scene:
    return scene("base", **{"friction.law": law})


@cache
def find_orbit(law: int) -> Orbit:
    return cycle(base_case(law))


@cache
def list_first_events(law: int) -> tuple[Event, ...]:
    return events(base_case(law), 10.0).events


def compute_friction(law: int, v: Array) -> Array:
    """Return the friction force at velocities v over ground: (n,)."""
    case = base_case(law)
    parameters = case.friction.parameters() if case.friction else {}
    return force(LAWS[law], v - belt_speed(law), **parameters)


def belt_speed(law: int) -> float:
    belt = base_case(law).belt
    return belt.speed if belt else 0.0


def find_first_stick(law: int) -> tuple[float, float]:
    """Return the start and the end of the first stick (or ramp) of the motion from (0, 0)."""
    begins, ends = (next(event.t for event in list_first_events(law) if event.kind == kind) for kind in ("N>S", "S>N"))
    return begins, ends


def read_numbers(orbit: Orbit) -> dict[str, Any]:
    """Return the numbers of an orbit by name; NaN where it has none, so that a comparison fails."""
    return {name: math.nan if value is None else value for name, value in vars(orbit).items()}


def draw_history(law: int) -> Computed:
    t, x, v, f = play_motion("base", UNTIL, RATE, (("friction.law", law),))
    belt = Trace(t[[0, -1]], np.full(2, belt_speed(law)), "belt", "dashed", None)
    sticks = "  in stick the line is the load that friction balances" if LAWS[law].contact == "jump" else ""
    panels = (
        Panel(T, X, (Trace(t, x),), "(a)"),
        Panel(T, V, (belt, Trace(t, v)), "(b)"),
        Panel(T, F, (Trace(t, f),), f"(c){sticks}"),
    )
    orbit = read_numbers(find_orbit(law))
    begins, ends = find_first_stick(law)
    top = float(np.max(v[t <= ends]))
    return Computed(
        panels,
        {
            **orbit,
            "comes_to": COMES_TO["grazing" if orbit["outcome"] == "grazing" else "cycle"].format(
                period=orbit["period"], share=100.0 * orbit["t_stick"] / orbit["period"]
            ),
            "begins": begins,
            "ends": ends,
            "first_stick": ends - begins,
            "top": top,
            "friction_at_top": friction_at_velocity(law, top),
            "friction_at_v_min": friction_at_velocity(law, orbit["v_min"]),
            "friction_at_v_max": friction_at_velocity(law, orbit["v_max"]),
            "longer": orbit["period"] > 2.0 * math.pi,
            "below_the_belt": 0.4 < top < belt_speed(law),
            "out_of_the_ramp": orbit["v_max"] <= 0.3,
            "a_little_higher": 0.3 < orbit["v_max"] < 0.4,
        },
    )


def friction_at_velocity(law: int, v: float) -> float:
    return float(compute_friction(law, np.array([v]))[0])


def draw_portrait(law: int) -> Computed:
    t, x, v, _ = play_motion("base", UNTIL, RATE, (("friction.law", law),))
    orbit = read_numbers(find_orbit(law))
    late = t > UNTIL - 1.02 * orbit["period"]
    flow = base_case(law).flow()
    edge = belt_speed(law) - (flow.d if LAWS[law].contact == "ramp" else 0.0)
    curves = (
        Trace(np.array([x.min(), x.max()]), np.full(2, belt_speed(law)), "belt", "dashed", None),
        Trace(x, v, "from (0, 0)", "thin", 0),
        Trace(x[late], v[late], "last turn", "thick", 0),
        Trace(np.array([orbit["x_slip"]]), np.array([edge]), "slip point", "open", 1),
    )
    fast = read_numbers(cycle(scene("base", **{"friction.law": 5, "friction.gamma": 10.0})))["v_max"]
    numbers = {
        **orbit,
        "edge": edge,
        "v_dr1": belt_speed(law) - flow.d,
        "fast": fast,
        "none_faster": fast <= 0.5,
        "slower_than_the_belt": orbit["v_max"] <= belt_speed(law),
        "short": orbit["t_stick"] < 0.2 * orbit["period"],
        "apart": orbit["x_slip"] - orbit["x_stick"] > 0.1,
    }
    return Computed((Panel(X, V, curves, equal=True),), numbers)


def draw_curve(law: int) -> Computed:
    v = np.linspace(-1.5, 2.5, 2001)
    belt, flow = belt_speed(law), base_case(law).flow()
    edges = np.array([belt - flow.d, belt + flow.d])
    on_belt = Trace(np.array([belt]), np.zeros(1), "belt", "filled", 1)
    if LAWS[law].contact == "jump":
        below, above = v[v < belt], v[v >= belt][1:]
        curves: tuple[Trace, ...] = (
            Trace(below, compute_friction(law, below)),
            Trace(above, compute_friction(law, above)),
            Trace(np.full(2, belt), np.array([-flow.Fs, flow.Fs])),
            on_belt,
        )
    else:
        marks = Trace(edges, compute_friction(law, edges), "v_dr1 and v_dr2", "open", 1)
        curves = (Trace(v, compute_friction(law, v)), marks, on_belt)
    reversal = belt - flow.Fs / flow.G_slip if flow.G_slip else math.nan
    numbers = {
        "contact": CONTACT[LAWS[law].contact],
        "curve": LAWS[law].curve,
        "at_v_dr1": friction_at_velocity(law, float(edges[0])),
        "stick_slope": (friction_at_velocity(law, belt + 0.1) - friction_at_velocity(law, belt - 0.1)) / 0.2,
        "constant": flow.Fs + flow.G_slip * flow.d,
        "reversal": reversal,
        "v_min": find_orbit(law).v_min,
        "never_so_slow": read_numbers(find_orbit(law))["v_min"] > reversal,
    }
    return Computed((Panel("velocity v of the mass (Fs/sqrt(km))", F, curves),), numbers)


FIGURES = read_entries(
    "chapter2.toml",
    {  # of each law its curve, its time histories and its phase portrait; the thesis has no curve of law 1
        f"2.{5 + number}": partial((draw_curve, draw_history, draw_portrait)[number % 3], 1 + number // 3)
        for number in range(1, 18)
    },
)
