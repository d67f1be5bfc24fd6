"""Chapter 4, figures 4.2 to 4.17: the motion of two masses, limits of its parameters, its events and failure locus."""

from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from daq.base.compute.arrays import Array
from rig_sim.atlas.figure import Drawing, Entry, Label, Panel, StatementCheck, Trace, compare, state
from rig_sim.dynamics.analyses.exponent import Exponent, exponent
from rig_sim.dynamics.orbits.fixed_point import two_mass_fixed_point
from rig_sim.dynamics.rig.stick import StickMap
from rig_sim.friction.contact import force
from rig_sim.friction.law import LAWS
from rig_sim.motion.two_masses import TwoMassEvent, TwoMassPlayer, stretch, two_mass_events
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene

V = 0.08075  # the belt velocity that the thesis gives with figures 4.2 and 4.3
RATE = 100.0  # samples per unit of time
PRINTED = {"start.x1": 0.2, "start.v1": V, "start.x2": -1.10, "start.v2": V, "belt.speed": V}
FREE, HEAVY = {**PRINTED, "coupling.b": 0.0}, {**PRINTED, "coupling.b": 1e9}
T = "dimensionless time"
CHAOTIC = {"belt.speed": V, "start.attractor": 2}
ON_ATTRACTOR = (
    f"the belt velocity, {V} as for figures 4.2 and 4.3, and the start, on attractor 2, which is chaotic there"
)
# The fixed point (4.15) at V = 0.1, as printed: two real eigenvalues and the real and imaginary part of a pair.
PRINTED_EIGENVALUES = ("0.483167789", "3.036888037", "0.281392203", "1.495980660")
WRONG_H2 = "the thesis's H2 has b gamma/psi^4 where b gamma^2/psi^4 belongs, with psi = 1 + gamma V; still unstable"
STARTS = 200  # stretches d from which events are searched


@cache
def columns(until: float, changes: tuple[tuple[str, float], ...]) -> tuple[Array, ...]:
    """Return t, x1, v1, F1, x2, v2, F2 of the two masses with changes."""
    return TwoMassPlayer(scene("two-mass", **dict(changes))).columns(np.arange(0.0, until, 1.0 / RATE))


def moved(changes: dict[str, float], until: float) -> tuple[Array, ...]:
    """Return the motion of the two masses with changes."""
    return columns(until, tuple(changes.items()))


def contact(events: tuple[TwoMassEvent, ...], mass: int, kind: str) -> list[TwoMassEvent]:
    """Return the events at which the contact of a mass changes as in ``kind``: 'S>N' is its break-away."""
    return [event for event in events if event.kind[mass - 1] == kind[0] and event.kind[mass + 2] == kind[2] != kind[0]]


def phase_axes(mass: int) -> tuple[str, str]:
    """Return the names of the axes of a mass's phase portrait."""
    return f"displacement X{mass} (Fs1/k)", f"velocity V{mass} (Fs1/sqrt(km))"


def limit(
    mass: int,
    changes: dict[str, float],
    sentence: str,
    table: tuple[StatementCheck, ...],
    y_range: tuple[float, float] | None = None,
) -> Drawing:
    """Return the phase portrait of a mass where the second friction level is 0 or very large."""
    _, x1, v1, _, x2, v2, _ = moved(changes, 60.0)
    x, v = (x1, v1) if mass == 1 else (x2, v2)
    across, up = phase_axes(mass)
    start = Trace(x[:1], v[:1], "start", "filled", 1)
    belt = Trace(np.array([x.min(), x.max()]), np.full(2, V), "belt", "dashed", None)
    return Drawing(sentence, (Panel(across, up, (belt, Trace(x, v), start), y_range=y_range),), table)


def second_mass_free() -> Drawing:
    """Figure 4.2."""
    _, _, _, _, x2, v2, _ = moved(FREE, 60.0)
    found = two_mass_events(scene("two-mass", **FREE), 60.0).events
    return limit(
        2,
        FREE,
        "Without friction (beta = 0) the second mass passes the belt's velocity both ways and never sticks; the first "
        "one, which does, pulls at it through the coupling spring.",
        (
            compare("largest velocity", "1.7", float(v2.max())),
            compare("largest displacement", "1.05", float(x2.max())),
            state(
                "sticks of the second mass",
                "none",
                str(sum(event.kind[4] == "S" != event.kind[1] for event in found)),
                not contact(found, 2, "N>S") and not contact(found, 2, "P>S"),
            ),
        ),
    )


def first_mass_free() -> Drawing:
    """Figure 4.3."""
    found = contact(two_mass_events(scene("two-mass", **FREE), 60.0).events, 1, "S>N")
    return limit(
        1,
        FREE,
        "Beside a second mass without friction (beta = 0) the first one sticks and slips.",
        (state("the first mass sticks and slips", "yes", f"{len(found)} break-aways in 60", len(found) > 1),),
    )


def second_mass_held() -> Drawing:
    """Figure 4.4."""
    v2 = moved(HEAVY, 60.0)[5]
    return limit(
        2,
        HEAVY,
        "With unlimited friction (beta = 1e9) the second mass rides on the belt without end.",
        (
            state(
                "the second mass moves with the belt",
                "yes",
                f"velocity {v2.min():.8g} to {v2.max():.8g}",
                bool(np.all(np.abs(v2 - V) < 1e-15)),
            ),
        ),
        (-0.1, 0.25),
    )


def first_mass_pulled() -> Drawing:
    """Figure 4.5."""
    found = contact(two_mass_events(scene("two-mass", **HEAVY), 60.0).events, 1, "S>N")
    a = scene("two-mass").two_mass_flow().a
    off = max(abs(event.x1 - (1.0 + a * event.x2) / (1.0 + a)) for event in found)
    rises = bool(np.all(np.diff([event.x1 for event in found]) > 0.0))
    return limit(
        1,
        HEAVY,
        "Beside a second mass that rides on the belt (beta = 1e9) each break-away and each landing of the first mass "
        "lies further to the right: the coupling spring pulls it after the other one.",
        (
            state("positions of break-away shift to the right", "at each slip", f"in {len(found)} slips", rises),
            state("break-away where X1 + a (X1 - X2) = 1", "(4.8)", f"within {off:.1g} at all of them", off < 1e-12),
        ),
    )


def friction_curves() -> Drawing:
    """Figure 4.6."""
    w = np.linspace(1e-6, 2.5, 501)
    gammas = (0.0, 1.0, 3.0, 10.0)
    curves = tuple(
        Trace(w, force(LAWS[5], -w, gamma=gamma), f"gamma = {gamma:g}", "thick" if gamma == 3.0 else "line", place)
        for place, gamma in enumerate(gammas)
    )
    return Drawing(
        "Friction falls with the slip speed the faster, the larger gamma; the thesis uses 3.",
        (Panel("slip speed V - V1 (Fs1/sqrt(km))", "friction force (Fs1)", curves, y_range=(0.0, 1.08)),),
        (
            compare(
                "friction at V - V1 = 1 for gamma = 3: 1/(1 + gamma)", "0.25", float(force(LAWS[5], -1.0, gamma=3.0))
            ),
        ),
        choices="the other values of gamma",
    )


def history(mass: int, of_velocity: bool) -> Drawing:
    """Figures 4.7, 4.8, 4.10 and 4.11: velocity or displacement of a mass in time."""
    t, x1, v1, _, x2, v2, _ = moved(CHAOTIC, 150.0)
    shown = ((x1, v1), (x2, v2))[mass - 1][of_velocity]
    what = "velocity" if of_velocity else "displacement"
    curves = [Trace(t, shown)]
    if of_velocity:
        curves.insert(0, Trace(t[[0, -1]], np.full(2, V), "belt", "dashed", None))
    found = chaotic_exponent()
    return Drawing(
        f"The {what} of mass {mass} in time: stick-slip whose slips differ from one to the next.",
        (Panel(T, phase_axes(mass)[of_velocity], tuple(curves)),),
        (
            state(
                f"the motion of mass {mass} is aperiodic",
                "yes",
                f"Lyapunov exponent {found.exponent:.2f} +- {found.stderr:.2f} per event",
                found.exponent > 3.0 * found.stderr > 0.0,
            ),
        ),
        choices=ON_ATTRACTOR,
    )


@cache
def chaotic_exponent() -> Exponent:
    """Return the Lyapunov exponent on the attractor that figures 4.7 to 4.12 show."""
    run = scene("two-mass", **CHAOTIC)
    return exponent(StickMap(run.two_mass_flow()).motion(np.array([stretch(run)])), 4000)


def portrait(mass: int) -> Drawing:
    """Figures 4.9 and 4.12: phase portrait of a mass."""
    _, x1, v1, _, x2, v2, _ = moved(CHAOTIC, 150.0)
    x, v = ((x1, v1), (x2, v2))[mass - 1]
    across, up = phase_axes(mass)
    table: tuple[StatementCheck, ...] = ()
    if mass == 2:
        table = fixed_point_table()
    return Drawing(
        f"Phase portrait of mass {mass}: slips of several sizes out of stick at the belt's velocity.",
        (Panel(across, up, (Trace(x, v, style="thin"),)),),
        table,
        choices=ON_ATTRACTOR,
    )


def fixed_point_table() -> tuple[StatementCheck, ...]:
    """Return the comparisons of the fixed point's eigenvalues (4.15), at V = 0.1."""
    found = two_mass_fixed_point(scene("two-mass").two_mass_flow())
    real = sorted(root.real for root in found.eigenvalues if root.imag == 0.0)
    (pair,) = (root for root in found.eigenvalues if root.imag > 0.0)
    values = (*real, pair.real, pair.imag)
    names = ("first", "second", "real part of the third", "imaginary part of the third")
    rows = (
        compare(f"eigenvalue (4.15) of the fixed point at V = 0.1: {name}", printed, value, WRONG_H2)
        for name, printed, value in zip(names, PRINTED_EIGENVALUES, values, strict=True)
    )
    return (*rows, state("the fixed point is unstable", "yes", "yes" if not found.stable else "no", not found.stable))


@dataclass(frozen=True)
class Search:
    """An event figure: the belt velocity, the words of the events in order, and the thesis's own."""

    speed: float
    words: tuple[str, ...]
    thesis: str
    sentence: str


EVENTS = {
    "4.14": Search(
        0.1,
        ("21", "21"),
        "",
        "A global stick moves along a line of slope 1 until it meets the failure locus, where a mass slips.",
    ),
    "4.15": Search(
        0.12,
        ("2", "1"),
        "mass 1, then mass 2",
        "Two one-mass events: one mass slips and sticks again before the other one slips.",
    ),
    "4.16": Search(
        0.1, ("21",), "mass 2, then mass 1", "A two-mass event: mass 1 begins to slip while mass 2 still slips."
    ),
    "4.17": Search(
        0.1,
        ("212",),
        "mass 2, then mass 1, then mass 2",
        "A multiple-mass event: three break-aways before both masses stick again.",
    ),
}


@cache
def followers(speed: float) -> tuple[tuple[float, str, str], ...]:
    """Return stretches d with the words of the next two events, over the whole interval of d."""
    f = StickMap(at_speed(speed).two_mass_flow())
    rows = []
    for d in np.linspace(0.99 * f.lo, 0.99 * f.hi, STARTS).tolist():
        event = f.event(d)
        rows.append((d, event.word, f.event(event.d).word))
    return tuple(rows)


def at_speed(speed: float, **start: float) -> Scene:
    """Return the two masses on a belt of this velocity."""
    return scene("two-mass", **{"belt.speed": speed, **{f"start.{key}": value for key, value in start.items()}})


def locus(number: str) -> Drawing:
    """Figures 4.14 to 4.17: the failure locus with the path of an event."""
    search = EVENTS[number]
    wanted = [d for d, first, then in followers(search.speed) if (first, then)[: len(search.words)] == search.words]
    d = wanted[len(wanted) // 2]
    run = at_speed(search.speed, d=d)
    found = two_mass_events(run, 200.0).events
    sticks = [event for event in found if event.kind.endswith(">SS")][: len(search.words)]
    until = sticks[-1].t
    end = next(event.t for event in found if event.t > until)  # of the global stick that follows
    _, x1, v1, _, x2, v2, _ = TwoMassPlayer(run).columns(np.arange(0.0, end, 0.005))
    both = (v1 == search.speed) & (v2 == search.speed)
    before = np.array([-0.45, 0.0])
    marks = [event for event in found if event.t <= until and (broke(event) or event in sticks)]
    words = [f"P{place}" for place in range(1, len(marks) + 1)]
    flow = run.two_mass_flow()
    path = (
        Trace(np.where(both, np.nan, x1), np.where(both, np.nan, x2), "slip of one mass or both", "line", 1),
        Trace(x1[0] + before, x2[0] + before, "global stick", "thick", 0),
        Trace(np.where(both, x1, np.nan), np.where(both, x2, np.nan), "", "thick", 0),
        Trace(np.array([x.x1 for x in marks]), np.array([x.x2 for x in marks]), "", "open", -1),
    )
    labels = (
        ()
        if number == "4.14"
        else tuple(Label(event.x1, event.x2, word) for event, word in zip(marks, words, strict=True))
    )
    order = ", then ".join(
        f"mass {1 if event.kind[0] == 'S' != event.kind[3] else 2}" for event in marks if broke(event)
    )
    return Drawing(
        search.sentence,
        (
            Panel(
                "displacement X1 (Fs1/k)",
                "displacement X2 (Fs1/k)",
                (*failure_lines(flow.a, flow.b), *path),
                x_range=(-1.25, 1.35),
                y_range=(-1.35, 1.35),
                equal=True,
                texts=labels,
            ),
        ),
        locus_table(number, order),
        choices=f"the belt velocity, {search.speed}, and the start, d = X2 - X1 = {d:.4g}",
    )


def locus_table(number: str, order: str) -> tuple[StatementCheck, ...]:
    """Return what the thesis says of the order in which masses break away."""
    search = EVENTS[number]
    if not search.thesis:
        return ()
    agrees = search.thesis == order
    none = not any((first, then) == ("1", "2") for _, first, then in followers(search.speed))
    why = (
        f"of {STARTS} starts over the whole interval of d none leads to an event of mass 1 followed by one of mass 2; "
        "the opposite order is part of attractor 1"
    )
    return (state("order of break-aways", search.thesis, order, agrees, why if none else "another start was drawn"),)


def broke(event: TwoMassEvent) -> bool:
    """Return whether a mass breaks away at an event."""
    return any(event.kind[mass] == "S" != event.kind[mass + 3] for mass in (0, 1))


def failure_lines(a: float, b: float) -> tuple[Trace, ...]:
    """Return the four lines (4.8) on which a mass breaks away, as far as the other one sticks: the failure locus."""
    ends = np.array([-1.0, 1.0])
    lines = []
    one = np.ones(2)
    for load1, load2, mass in ((one, b * ends, 1), (-one, b * ends, 1), (ends, b * one, 2), (ends, -b * one, 2)):
        x1 = ((1.0 + a) * load1 + a * load2) / (1.0 + 2.0 * a)
        x2 = ((1.0 + a) * load2 + a * load1) / (1.0 + 2.0 * a)
        lines.append(Trace(x1, x2, f"failure line of mass {mass}", "dashed", mass + 1))
    return tuple(lines)


FIGURES = (
    Entry("4.2", "phase portrait of the second mass, beta = 0", second_mass_free),
    Entry("4.3", "phase portrait of the first mass, beta = 0", first_mass_free),
    Entry("4.4", "the second mass as beta grows without bound", second_mass_held),
    Entry("4.5", "the first mass as beta grows without bound", first_mass_pulled),
    Entry("4.6", "dynamic friction curve, gamma = 3 and others", friction_curves),
    Entry("4.7", "velocity of the first mass in time", partial(history, 1, True)),
    Entry("4.8", "displacement of the first mass in time", partial(history, 1, False)),
    Entry("4.9", "phase portrait of the first mass", partial(portrait, 1)),
    Entry("4.10", "velocity of the second mass in time", partial(history, 2, True)),
    Entry("4.11", "displacement of the second mass in time", partial(history, 2, False)),
    Entry("4.12", "phase portrait of the second mass", partial(portrait, 2)),
    Entry("4.14", "failure locus", partial(locus, "4.14")),
    Entry("4.15", "failure locus with one-mass events", partial(locus, "4.15")),
    Entry("4.16", "failure locus with a two-mass event", partial(locus, "4.16")),
    Entry("4.17", "failure locus with a multiple-mass event", partial(locus, "4.17")),
)
