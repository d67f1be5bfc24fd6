"""Chapter 4, figures 4.2 to 4.17: the motion of two masses, limits of its parameters, its events and failure locus."""

from functools import cache, partial
from typing import Any

import numpy as np

from rig_sim.analyses.exponent import Exponent, exponent
from rig_sim.analyses.limit_cycles.fixed_point import two_mass_fixed_point
from rig_sim.atlas.figure import Computed, Label, Panel, Trace
from rig_sim.atlas.statements import read_entries
from rig_sim.friction.contact import force
from rig_sim.friction.law import LAWS
from rig_sim.motion.two_masses import TwoMassEvent, TwoMassPlayer, find_stretch, two_mass_events
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene
from rig_sim.systems.stick import StickMap
from stickslip.compute.arrays import Array

V = 0.08075  # belt velocity of figures 4.2 and 4.3 in the thesis
RATE = 100.0  # samples per unit of time
PRINTED = {"start.x1": 0.2, "start.v1": V, "start.x2": -1.10, "start.v2": V, "belt.speed": V}
FREE, HEAVY = {**PRINTED, "coupling.b": 0.0}, {**PRINTED, "coupling.b": 1e9}
T = "dimensionless time"
CHAOTIC = {"belt.speed": V, "start.attractor": 2}
STARTS = 200  # stretches d tried for events


@cache
def play_columns(until: float, changes: tuple[tuple[str, float], ...]) -> tuple[Array, ...]:
    """Return t, x1, v1, F1, x2, v2, F2 of the two masses with changes."""
    return TwoMassPlayer(scene("two-mass", **dict(changes))).columns(np.arange(0.0, until, 1.0 / RATE))


def play_masses(changes: dict[str, float], until: float) -> tuple[Array, ...]:
    return play_columns(until, tuple(changes.items()))


def select_contact_changes(events: tuple[TwoMassEvent, ...], mass: int, kind: str) -> list[TwoMassEvent]:
    """Return the events at which the contact of a mass changes as in ``kind``: 'S>N' is its break-away."""
    return [event for event in events if event.kind[mass - 1] == kind[0] and event.kind[mass + 2] == kind[2] != kind[0]]


def phase_axes(mass: int) -> tuple[str, str]:
    return f"displacement X{mass} (Fs1/k)", f"velocity V{mass} (Fs1/sqrt(km))"


def draw_limit(mass: int, changes: dict[str, float], y_range: tuple[float, float] | None = None) -> Computed:
    """Return the phase portrait of a mass where the second friction level is 0 or very large."""
    _, x1, v1, _, x2, v2, _ = play_masses(changes, 60.0)
    x, v = (x1, v1) if mass == 1 else (x2, v2)
    run = scene("two-mass", **changes)
    events, a = two_mass_events(run, 60.0).events, run.two_mass_flow().a
    slips = select_contact_changes(events, 1, "S>N")
    deviation = max(abs(event.x1 - (1.0 + a * event.x2) / (1.0 + a)) for event in slips)
    start = Trace(x[:1], v[:1], "start", "filled", 1)
    belt = Trace(np.array([x.min(), x.max()]), np.full(2, V), "belt", "dashed", None)
    numbers = {
        "v_max": v.max(),
        "v_min": v.min(),
        "x_max": x.max(),
        "sticks2": sum(event.kind[4] == "S" != event.kind[1] for event in events),
        "none_sticks2": not select_contact_changes(events, 2, "N>S") and not select_contact_changes(events, 2, "P>S"),
        "slips1": len(slips),
        "stick_slip1": len(slips) > 1,
        "on_belt": bool(np.all(np.abs(v - V) < 1e-15)),
        "shifts": bool(np.all(np.diff([event.x1 for event in slips]) > 0.0)),
        "off": deviation,
        "on_line": deviation < 1e-12,
    }
    return Computed((Panel(*phase_axes(mass), (belt, Trace(x, v), start), y_range=y_range),), numbers)


def draw_friction_curves() -> Computed:
    w = np.linspace(1e-6, 2.5, 501)
    curves = tuple(
        Trace(w, force(LAWS[5], -w, gamma=gamma), f"gamma = {gamma:g}", "thick" if gamma == 3.0 else "line", colour)
        for colour, gamma in enumerate((0.0, 1.0, 3.0, 10.0))
    )
    panel = Panel("slip speed V - V1 (Fs1/sqrt(km))", "friction force (Fs1)", curves, y_range=(0.0, 1.08))
    return Computed((panel,), {"at_1": force(LAWS[5], -1.0, gamma=3.0)})


def draw_history(mass: int, of_velocity: bool) -> Computed:
    t, x1, v1, _, x2, v2, _ = play_masses(CHAOTIC, 150.0)
    drawn = ((x1, v1), (x2, v2))[mass - 1][of_velocity]
    curves = [Trace(t, drawn)]
    if of_velocity:
        curves.insert(0, Trace(t[[0, -1]], np.full(2, V), "belt", "dashed", None))
    lyapunov = compute_chaotic_exponent()
    numbers = {**vars(lyapunov), "mass": mass, "aperiodic": lyapunov.exponent > 3.0 * lyapunov.stderr > 0.0}
    return Computed((Panel(T, phase_axes(mass)[of_velocity], tuple(curves)),), numbers)


@cache
def compute_chaotic_exponent() -> Exponent:
    """Return the Lyapunov exponent on the attractor of figures 4.7 to 4.12."""
    run = scene("two-mass", **CHAOTIC)
    return exponent(StickMap(run.two_mass_flow()).motion(np.array([find_stretch(run)])), 4000)


def draw_portrait(mass: int) -> Computed:
    _, x1, v1, _, x2, v2, _ = play_masses(CHAOTIC, 150.0)
    x, v = ((x1, v1), (x2, v2))[mass - 1]
    panel = Panel(*phase_axes(mass), (Trace(x, v, style="thin"),))
    return Computed((panel,), {**compute_eigenvalues(), "mass": mass})


def compute_eigenvalues() -> dict[str, Any]:
    """Return the eigenvalues of the fixed point at V = 0.1, two real ones and a pair, and whether it is unstable."""
    fixed_point = two_mass_fixed_point(scene("two-mass").two_mass_flow())
    first, second = sorted(root.real for root in fixed_point.eigenvalues if root.imag == 0.0)
    (pair,) = (root for root in fixed_point.eigenvalues if root.imag > 0.0)
    return {
        "first": first,
        "second": second,
        "real": pair.real,
        "imaginary": pair.imag,
        "unstable": not fixed_point.stable,
    }


@cache
def list_event_words(speed: float) -> tuple[tuple[float, str, str], ...]:
    """Return stretches d with the words of the next two events, over the whole interval of d."""
    f = StickMap(masses_at_speed(speed).two_mass_flow())
    rows = []
    for d in np.linspace(0.99 * f.lo, 0.99 * f.hi, STARTS).tolist():
        event = f.event(d)
        rows.append((d, event.word, f.event(event.d).word))
    return tuple(rows)


def masses_at_speed(speed: float, **start: float) -> Scene:
    return scene("two-mass", **{"belt.speed": speed, **{f"start.{key}": value for key, value in start.items()}})


def draw_locus(speed: float, *words: str, named: bool = True) -> Computed:
    """Return the failure locus with the path of the events that have these words, their break-aways named or not."""
    stretches = [d for d, *words_found in list_event_words(speed) if tuple(words_found[: len(words)]) == words]
    d = stretches[len(stretches) // 2]
    run = masses_at_speed(speed, d=d)
    words_found = two_mass_events(run, 200.0).events
    sticks = [event for event in words_found if event.kind.endswith(">SS")][: len(words)]
    until = sticks[-1].t
    end = next(event.t for event in words_found if event.t > until)  # of the global stick that follows
    _, x1, v1, _, x2, v2, _ = TwoMassPlayer(run).columns(np.arange(0.0, end, 0.005))
    in_global_stick = (v1 == speed) & (v2 == speed)
    before = np.array([-0.45, 0.0])
    marks = [event for event in words_found if event.t <= until and (is_break_away(event) or event in sticks)]
    flow = run.two_mass_flow()
    path = (
        Trace(
            np.where(in_global_stick, np.nan, x1),
            np.where(in_global_stick, np.nan, x2),
            "slip of one mass or both",
            "line",
            1,
        ),
        Trace(x1[0] + before, x2[0] + before, "global stick", "thick", 0),
        Trace(np.where(in_global_stick, x1, np.nan), np.where(in_global_stick, x2, np.nan), "", "thick", 0),
        Trace(np.array([x.x1 for x in marks]), np.array([x.x2 for x in marks]), "", "open", -1),
    )
    labels = tuple(Label(event.x1, event.x2, f"P{number}") for number, event in enumerate(marks, 1)) if named else ()
    panel = Panel(
        "displacement X1 (Fs1/k)",
        "displacement X2 (Fs1/k)",
        (*trace_failure_lines(flow.a, flow.b), *path),
        x_range=(-1.25, 1.35),
        y_range=(-1.35, 1.35),
        equal=True,
        texts=labels,
    )
    masses = [1 if event.kind[0] == "S" != event.kind[3] else 2 for event in marks if is_break_away(event)]
    return Computed((panel,), {"speed": speed, "d": d, "order": ", then ".join(f"mass {mass}" for mass in masses)})


def is_break_away(event: TwoMassEvent) -> bool:
    return any(event.kind[mass] == "S" != event.kind[mass + 3] for mass in (0, 1))


def trace_failure_lines(a: float, b: float) -> tuple[Trace, ...]:
    """Return the four lines (4.8) on which a mass breaks away, as far as the other one sticks: the failure locus."""
    ends = np.array([-1.0, 1.0])
    lines = []
    ones = np.ones(2)
    for load1, load2, mass in ((ones, b * ends, 1), (-ones, b * ends, 1), (ends, b * ones, 2), (ends, -b * ones, 2)):
        x1 = ((1.0 + a) * load1 + a * load2) / (1.0 + 2.0 * a)
        x2 = ((1.0 + a) * load2 + a * load1) / (1.0 + 2.0 * a)
        lines.append(Trace(x1, x2, f"failure line of mass {mass}", "dashed", mass + 1))
    return tuple(lines)


FIGURES = read_entries(
    "chapter4.toml",
    {
        "4.2": partial(draw_limit, 2, FREE),
        "4.3": partial(draw_limit, 1, FREE),
        "4.4": partial(draw_limit, 2, HEAVY, (-0.1, 0.25)),
        "4.5": partial(draw_limit, 1, HEAVY),
        "4.6": draw_friction_curves,
        "4.7": partial(draw_history, 1, True),
        "4.8": partial(draw_history, 1, False),
        "4.9": partial(draw_portrait, 1),
        "4.10": partial(draw_history, 2, True),
        "4.11": partial(draw_history, 2, False),
        "4.12": partial(draw_portrait, 2),
        "4.14": partial(draw_locus, 0.1, "21", "21", named=False),
        "4.15": partial(draw_locus, 0.12, "2", "1"),
        "4.16": partial(draw_locus, 0.1, "21"),
        "4.17": partial(draw_locus, 0.1, "212"),
    },
)
