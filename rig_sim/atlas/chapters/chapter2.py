"""Chapter 2: one mass on a belt under each of the six laws: friction curve, motion in time, phase portrait."""

import math
from functools import cache, partial

import numpy as np

from daq.base.compute.arrays import Array
from rig_sim.atlas.chapters.axes import F, T, V, X, motion
from rig_sim.atlas.figure import Drawing, Entry, Panel, StatementCheck, Trace, compare, state
from rig_sim.dynamics.orbits.limit_cycle import Orbit, cycle
from rig_sim.friction.contact import force
from rig_sim.friction.law import LAWS
from rig_sim.motion.play import Event, events
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene

UNTIL, RATE = 40.0, 200.0
NAMES = {
    1: "classic Coulomb friction",
    2: "continuous Coulomb friction",
    3: "discontinuous friction, linear slip curve",
    4: "continuous friction, linear slip curve",
    5: "discontinuous friction, non-linear slip curve",
    6: "continuous friction, non-linear slip curve",
}
IMPOSSIBLE = "impossible at the belt's velocity 0.5: "


@cache
def base(law: int) -> Scene:
    """Return the thesis's base case under a law."""
    return scene("base", **{"friction.law": law})


@cache
def orbit(law: int) -> Orbit:
    """Return the periodic orbit of the base case."""
    return cycle(base(law))


@cache
def first_events(law: int) -> tuple[Event, ...]:
    """Return the events of the motion from (0, 0)."""
    return events(base(law), 10.0).events


def friction(law: int, v: Array) -> Array:
    """Return the friction force at velocities v over ground: (n,)."""
    found = base(law)
    own = found.friction.parameters() if found.friction else {}
    return force(LAWS[law], v - speed(law), **own)


def speed(law: int) -> float:
    """Return the belt's velocity."""
    belt = base(law).belt
    return belt.speed if belt else 0.0


def first_stick(law: int) -> tuple[float, float]:
    """Return when the first stick (or ramp) of the motion from (0, 0) begins and ends."""
    begins, ends = (next(event.t for event in first_events(law) if event.kind == kind) for kind in ("N>S", "S>N"))
    return begins, ends


def initial(law: int) -> tuple[float, float]:
    """Return the largest velocity before the first slip out of stick, and friction there."""
    t, _, v, _ = motion("base", UNTIL, RATE, (("friction.law", law),))
    top = float(np.max(v[t <= first_stick(law)[1]]))
    return top, float(friction(law, np.array([top]))[0])


def lowest(law: int) -> float:
    """Return the least friction in slip on the periodic orbit: where the mass is slowest."""
    return float(friction(law, np.array([number(orbit(law).v_min)]))[0])


def number(value: float | None) -> float:
    """Return a number of an orbit; NaN where it has none, so that a comparison fails."""
    return math.nan if value is None else value


def extremes(law: int, low: str, high: str, slowest: str, why: str = "") -> tuple[StatementCheck, ...]:
    """Return the comparisons of the extremes that the thesis reads off."""
    found = orbit(law)
    return (
        compare("largest displacement", high, number(found.x_max)),
        compare("smallest displacement", low, number(found.x_min)),
        compare("smallest velocity", slowest, number(found.v_min), why),
    )


def history_table(law: int) -> tuple[StatementCheck, ...]:
    """Return what the thesis says of the time histories of a law."""
    begins, ends = first_stick(law)
    if law == 1:
        return (
            *extremes(1, "0.5", "1.5", "-0.5"),
            compare("period after the first stick", "2 pi", number(orbit(1).period), of=2.0 * math.pi),
            compare(
                "beginning of the first stick",
                "1.0",
                begins,
                "exactly pi/6: until then x = 1 - cos t, and the mass has the belt's velocity where sin t = 0.5",
            ),
            compare("end of the first stick", "3.0", ends, "exactly pi/6 + sqrt(3)"),
            compare(
                "duration of the first stick",
                "2.5",
                ends - begins,
                f"{IMPOSSIBLE}the mass would move by 1.25, and stick ends at x = 1; exactly sqrt(3)",
            ),
            compare(
                "duration of the later sticks",
                "0.0088",
                number(orbit(1).t_stick),
                "exactly 0: the circle touches the belt's velocity in one point.  The thesis leaves stick at the first "
                "step of its time grid after the slip point, so that each stick lasts as long as the grid is coarse",
            ),
        )
    if law == 2:
        top, least = initial(2)
        return (
            compare("smallest velocity", "-0.3", number(orbit(2).v_min)),
            compare("period", "2 pi", number(orbit(2).period), of=2.0 * math.pi),
            compare("least friction, in the first passage of the ramp", "0.27", least, "0.27 is the ramp at v = 0.446"),
            state("largest velocity", "just below the belt's, 0.5", f"{top:.6g}", 0.4 < top < speed(2)),
            state(
                "the mass reaches the amplitude v_dr1 = 0.3 and stays out of the ramp",
                "after the first stick",
                f"amplitude {number(orbit(2).v_max):.6g}, approached algebraically",
                number(orbit(2).v_max) <= 0.3,
            ),
        )
    if law == 3:
        return (
            *extremes(3, "0.4", "1.5", "-0.55"),
            compare(
                "least friction in slip",
                "0.9475",
                lowest(3),
                "0.9475 is the curve at the rounded velocity -0.55: 1 - 0.05 x 1.05",
            ),
            state(
                "stick lengthens the period beyond 2 pi",
                "yes",
                f"period {number(orbit(3).period):.10g}, stick {number(orbit(3).t_stick):.10g}",
                number(orbit(3).period) > 2.0 * math.pi,
            ),
        )
    if law == 4:
        top, least = initial(4)
        wrong = "contradicts the thesis's own extremes of x: 0.65 to 1.3 about the fixed point allow no more than 0.34"
        return (
            *extremes(4, "0.65", "1.3", "-0.45", wrong),
            compare("largest velocity before the first slip", "0.45", top),
            compare("friction there", "0.3", least),
            compare("least friction in slip", "0.95", lowest(4), "belongs to the wrong velocity -0.45"),
            state(
                "largest velocity on the cycle",
                "a little higher than v_dr1 = 0.3",
                f"{number(orbit(4).v_max):.6g}",
                0.3 < number(orbit(4).v_max) < 0.4,
            ),
        )
    if law == 5:
        return (
            *extremes(5, "-0.97", "1.4", "-1.15"),
            compare(
                "duration of the first stick",
                "3.0",
                ends - begins,
                f"{IMPOSSIBLE}the mass would move by 1.5 from x > 0, and stick ends at x = 1",
            ),
            compare(
                "duration of the later sticks",
                "5.0",
                number(orbit(5).t_stick),
                f"{IMPOSSIBLE}the mass would move by 2.5, and from its least x to the end of stick it is 1.96",
            ),
            compare("least friction in slip", "0.15", lowest(5), "the curve at -1.156 is 1/(1 + 3 x 1.656)"),
        )
    top, least = initial(6)
    return (
        *extremes(6, "-0.7", "1.2", "-0.95", "read off a coarse scale"),
        compare("largest velocity before the first slip", "0.45", top),
        compare("friction there", "0.25", least, "0.25 is the ramp at the rounded velocity 0.45"),
        compare("least friction in slip", "0.2", lowest(6)),
        compare("largest velocity on the cycle, above the belt's", "0.58", number(orbit(6).v_max)),
        compare("friction there", "-0.4", float(friction(6, np.array([number(orbit(6).v_max)]))[0])),
    )


def history(law: int) -> Drawing:
    """Return the time histories under a law."""
    t, x, v, f = motion("base", UNTIL, RATE, (("friction.law", law),))
    belt = Trace(t[[0, -1]], np.full(2, speed(law)), "belt", "dashed", None)
    sticks = "in stick the line is the load that friction balances" if LAWS[law].contact == "jump" else ""
    return Drawing(
        f"Displacement, velocity and friction force in time from rest at x = 0: {settling(law)}",
        (
            Panel(T, X, (Trace(t, x),), "(a)"),
            Panel(T, V, (belt, Trace(t, v)), "(b)"),
            Panel(T, F, (Trace(t, f),), "(c)" + f"  {sticks}" * bool(sticks)),
        ),
        history_table(law),
        choices="the duration, 40",
    )


def settling(law: int) -> str:
    """Return what the motion from (0, 0) comes to."""
    found = orbit(law)
    if found.outcome == "grazing":
        return f"after one stick a circle of period {number(found.period):.5g} that touches the edge of stick."
    return (
        f"after one stick a cycle of period {number(found.period):.5g}, of which the mass sticks "
        f"{100.0 * number(found.t_stick) / number(found.period):.0f} %."
    )


def portrait(law: int) -> Drawing:
    """Return the phase portrait under a law."""
    t, x, v, _ = motion("base", UNTIL, RATE, (("friction.law", law),))
    late = t > UNTIL - 1.02 * number(orbit(law).period)
    slip = number(orbit(law).x_slip)
    ramp = LAWS[law].contact == "ramp"
    edge = speed(law) - (base(law).flow().d if ramp else 0.0)
    return Drawing(
        f"The phase portrait of the motion from rest at x = 0 (thin) and of its last turn (thick); the circle is the "
        f"slip point of the cycle, ({slip:.4g}, {edge:.4g}).",
        (
            Panel(
                X,
                V,
                (
                    Trace(np.array([x.min(), x.max()]), np.full(2, speed(law)), "belt", "dashed", None),
                    Trace(x, v, "from (0, 0)", "thin", 0),
                    Trace(x[late], v[late], "last turn", "thick", 0),
                    Trace(np.array([slip]), np.array([edge]), "slip point", "open", 1),
                ),
                equal=True,
            ),
        ),
        portrait_table(law),
    )


def portrait_table(law: int) -> tuple[StatementCheck, ...]:
    """Return what the thesis says of the phase portrait of a law."""
    found = orbit(law)
    if law == 1:
        return (
            compare("displacement where slip begins", "1.0", number(found.x_slip)),
            compare("displacement where stick begins", "1.0", number(found.x_stick)),
        )
    if law == 2:
        return (compare("velocity where slip begins, v_dr1", "0.3", speed(2) - base(2).flow().d),)
    if law == 5:
        fast = cycle(scene("base", **{"friction.gamma": 10.0}))
        return (
            state(
                "the mass cannot exceed the belt's velocity (2.3.4)",
                "v <= 0.5 for any parameters",
                f"v_max = {number(fast.v_max):.8g} for gamma = 10",
                number(fast.v_max) <= 0.5,
                "where a slip returns with x < -Fs/k the spring pulls harder than friction can hold: the mass "
                "overtakes the belt, and slip in the other direction follows",
            ),
        )
    if law == 6:
        return (
            state(
                "the velocity in stick stays between v_dr1 and v_dr",
                "v <= 0.5",
                f"v_max = {number(found.v_max):.6g}",
                number(found.v_max) <= speed(6),
                "the thesis contradicts itself: its text on figure 2.21 has 0.58",
            ),
        )
    if law == 4:
        return (
            state(
                "stick is extremely short",
                "after the first one",
                f"{number(found.t_stick):.6g} of {number(found.period):.6g}",
                number(found.t_stick) < 0.2 * number(found.period),
            ),
        )
    return (
        state(
            "slip and stick begin at separate points",
            "yes",
            f"x = {number(found.x_slip):.6g} and {number(found.x_stick):.6g}",
            number(found.x_slip) - number(found.x_stick) > 0.1,
        ),
    )


def curve(law: int) -> Drawing:
    """Return the friction curve of a law."""
    v = np.linspace(-1.5, 2.5, 2001)
    belt = speed(law)
    flow = base(law).flow()
    edges = (belt - flow.d, belt + flow.d)
    if LAWS[law].contact == "jump":
        below = v < belt
        lines: tuple[Trace, ...] = (
            Trace(v[below], friction(law, v[below])),
            Trace(v[~below][1:], friction(law, v[~below][1:])),
            Trace(np.full(2, belt), np.array([-flow.Fs, flow.Fs])),
        )
        marks: tuple[Trace, ...] = (Trace(np.array([belt]), np.zeros(1), "belt", "filled", 1),)
    else:
        lines = (Trace(v, friction(law, v)),)
        marks = (
            Trace(np.array(edges), friction(law, np.array(edges)), "v_dr1 and v_dr2", "open", 1),
            Trace(np.array([belt]), np.zeros(1), "belt", "filled", 1),
        )
    table: tuple[StatementCheck, ...] = ()
    if LAWS[law].contact == "ramp":
        slope = (friction(law, np.array([belt + 0.1])) - friction(law, np.array([belt - 0.1]))) / 0.2
        table = (
            compare("friction at v_dr1", "1", float(friction(law, np.array([edges[0]]))[0]), within=1e-12),
            compare("slope of the stick section", "-5", float(slope[0]), within=1e-9),
        )
    if law == 4:
        constant = flow.Fs + flow.G_slip * flow.d
        table += (compare("constant of its slip section, Fs + G_slip d", "1.01", constant, within=1e-12),)
    if law == 3:
        v_reversal = belt - flow.Fs / flow.G_slip
        table = (
            state(
                "friction reverses where the slip section meets the axis",
                "unphysical there",
                f"at v = {v_reversal:.6g}, the motion is never slower than {number(orbit(3).v_min):.4g}",
                number(orbit(3).v_min) > v_reversal,
            ),
        )
    shape = (
        "jumps at the belt's velocity" if LAWS[law].contact == "jump" else "falls steeply through the belt's velocity"
    )
    return Drawing(
        f"The friction force against the velocity of the mass: it {shape}, and slip obeys a {LAWS[law].curve} curve.",
        (Panel("velocity v of the mass (Fs/sqrt(km))", F, (*lines, *marks)),),
        table,
        choices=""
        if law != 2
        else "v_dr1 = 0.3 and v_dr2 = 0.7, that is G_stick = -5; they follow from its time histories",
    )


FIGURES = tuple(
    Entry(f"2.{place}", f"{subject}, {NAMES[law]}", partial(make, law))
    for law, places in {
        1: ("", "6", "7"),
        2: ("8", "9", "10"),
        3: ("11", "12", "13"),
        4: ("14", "15", "16"),
        5: ("17", "18", "19"),
        6: ("20", "21", "22"),
    }.items()
    for place, subject, make in zip(
        places, ("friction curve", "time histories", "phase portrait"), (curve, history, portrait), strict=True
    )
    if place
)
