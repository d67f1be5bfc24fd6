"""Chapter 6, figures 6.10 to 6.17: shaker feedback in its amplification-phase plane, locking onto unstable orbits."""

import math
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from daq.base.compute.arrays import Array
from rig_sim.atlas.chapters.axes import T, V, X
from rig_sim.atlas.chapters.chapter6 import U0, UNPRINTED, flow_at
from rig_sim.atlas.figure import Drawing, Entry, Panel, StatementCheck, Trace, compare, state
from rig_sim.dynamics.control.locking import Locking, find_and_lock
from rig_sim.dynamics.control.ogy import Lock
from rig_sim.dynamics.control.phasor import phasor
from rig_sim.dynamics.control.search_and_lock import SearchAndLock, search_and_lock
from rig_sim.dynamics.control.stability import ShakerCurve, ShakerPlane
from rig_sim.dynamics.rig.landing import LandingMap

S = 0.3  # gamma_lin - c: the thesis's least amplification at phi = pi
HIGHEST = 5.5  # amplification drawn, that of figure 6.11
PHASE, LEVEL = "phase shift phi (rad)", "amplification a (sqrt(km))"
BAND = (0.9, 1.1)  # of the filter, relative to the resonance
SAMPLES = 200  # per drive period
BEFORE, TURNS = 12, 6  # landings drawn before the control; turns of the orbit drawn in time
EVENTS = 20_000
LOST_CAPTION = "its caption is lost in the text: taken to show what 6.16 and 6.17 show of the other orbit"


@dataclass(frozen=True)
class PrintedLock:
    """What the thesis prints of an orbit that it locked onto: frequency, period, final change of u0, in percent."""

    omega: float
    period: int
    change: str
    percent: str


ORBITS = {2: PrintedLock(1.6, 2, "0.0006", "0.3"), 5: PrintedLock(1.1, 5, "0.0047", "2.3")}


def curve(found: ShakerCurve, label: str, colour: int, dashed: bool = False) -> Trace:
    """Return a curve of the plane, with a gap where its phase passes 2 pi."""
    jumps = np.flatnonzero(np.abs(np.diff(found.phi)) > math.pi) + 1
    phi, a = np.insert(found.phi, jumps, np.nan), np.insert(found.a, jumps, np.nan)
    return Trace(phi, a, label, "dashed" if dashed else "line", colour)


def plane_panel(traces: tuple[Trace, ...]) -> tuple[Panel, ...]:
    """Return the amplification-phase plane."""
    return (Panel(PHASE, LEVEL, traces, x_range=(0.0, 2.0 * math.pi), y_range=(0.0, HIGHEST)),)


def best_phase(a: float) -> float:
    """Return the phase (rad, up to pi) at which a shaker of amplification a makes the oscillation decay fastest."""
    from scipy.optimize import minimize_scalar

    def growth(phi: float) -> float:
        return phasor(1.0, 1.0, S, a, phi).imag

    found = minimize_scalar(growth, bounds=(2.0, math.pi), method="bounded", options={"xatol": 1e-10})
    return float(found.x)


def growth_curves() -> Drawing:
    """Figure 6.10."""
    plane = ShakerPlane(1.0, 1.0, S)
    traces = tuple(
        curve(plane.growth_curve(delta, 2.0 * HIGHEST), f"delta = {delta:g} omega0" if delta else "delta = 0", place)
        for place, delta in enumerate((0.0, -0.1, -0.2))
    )
    ((least, _),) = plane.stable_amplifications(math.pi)
    ((low, high),) = plane.stable_phases(1e6)
    best = best_phase(0.5) / math.pi
    return Drawing(
        "Curves of constant growth rate in the amplification-phase plane: above delta = 0 the oscillation decays.",
        plane_panel(traces),
        (
            compare("least amplification at phi = pi", "0.3", least, within=1e-12),
            compare("smallest stable phase at a large amplification", "pi/2", low, of=0.5 * math.pi, within=1e-5),
            compare("largest stable phase at a large amplification", "3 pi/2", high, of=1.5 * math.pi, within=1e-5),
            compare(
                "optimum phase (pi), at a = 0.5",
                "1",
                best,
                "pi is the optimum only as a tends to gamma_lin - c: a phase beside pi changes the frequency too",
                within=1e-3,
            ),
        ),
        choices="gamma_lin - c = 0.3, which the least amplification gives, and m = k = 1",
    )


def widths(levels: tuple[float, ...]) -> list[float]:
    """Return how wide the stable phases within the filter's band are, in all, at amplifications."""
    plane = ShakerPlane(1.0, 1.0, S, BAND)
    return [math.fsum(high - low for low, high in plane.stable_phases(a)) for a in levels]


def frequency_curves() -> Drawing:
    """Figure 6.11."""
    plane = ShakerPlane(1.0, 1.0, S)
    traces = [curve(plane.growth_curve(0.0, 2.0 * HIGHEST), "delta = 0", 0)]
    traces += [
        curve(plane.frequency_curve(omega, 2.0 * HIGHEST), f"omega = {omega:g} omega0", place, dashed=True)
        for place, omega in enumerate((0.5, 0.9, 1.0, 1.1, 2.0), 1)
    ]
    levels = (0.4, 0.5, 0.7, 1.0, 1.5)
    found = widths(levels)
    return Drawing(
        "Curves of constant frequency in the amplification-phase plane: between two of them lies what a filter of that "
        "band leaves of the stable region.",
        plane_panel(tuple(traces)),
        (
            state(
                "with increasing amplification the phase range becomes narrower",
                "yes",
                ", ".join(f"{width:.3f} at a = {a:g}" for a, width in zip(levels[1:], found[1:], strict=True)),
                found[1:] == sorted(found[1:], reverse=True),
                "it widens up to a = 0.365, where the edges of the band begin to cut it",
            ),
            compare(
                "phase range within a band of 10 % (rad), the largest over a",
                "pi/2",
                max(widths(tuple(np.linspace(0.301, 1.5, 200).tolist()))),
                "the widest range, at a = 0.37, and the phases stable at any a within the band span less than pi/2",
                of=0.5 * math.pi,
                within=0.25,
            ),
        ),
        choices="gamma_lin - c = 0.3 and m = k = 1, as in 6.10",
    )


@cache
def locked(period: int) -> tuple[LandingMap, Locking, SearchAndLock]:
    """Return the map, the lock within the printed budget, and what the thesis's own search finds within it."""
    printed = ORBITS[period]
    f = LandingMap(flow_at(printed.omega))
    start = f.first(0.0, 0.0).state
    budget = float(printed.change) / U0
    return f, find_and_lock(f, start, period, budget, EVENTS), search_and_lock(f, start, period, budget)


def held(period: int) -> Lock:
    """Return the motion under control.

    Raises
    ------
    RuntimeError
        No orbit was found.
    """
    found = locked(period)[1].lock
    if found is None:
        raise RuntimeError(f"no orbit of period {period}")
    return found


def part(period: int, first: int, last: int) -> tuple[Array, Array, Array]:
    """Return t, x, v of the controlled motion between two of its landings."""
    f, lock = locked(period)[0], held(period)
    return f.sampled(lock.states[first:last], lock.changes[first:last], SAMPLES / f.period)


def lock_portrait(period: int) -> Drawing:
    """Figures 6.12 and 6.15."""
    printed, lock = ORBITS[period], held(period)
    found = locked(period)[1]
    begin, end = lock.events_to_lock or 0, len(lock.changes)
    before = part(period, max(begin - BEFORE, 0), begin)
    after = part(period, end - period, end)
    size = abs(found.orbits[0].multipliers[0]) if found.orbits else math.nan
    return Drawing(
        f"The unstable orbit of period {period} at omega = {printed.omega} that control holds (thick), and the chaotic "
        "motion before (thin).",
        (
            Panel(
                X,
                V,
                (
                    Trace(before[1], before[2], "before the control", "thin", None),
                    Trace(after[1], after[2], f"period {period}", "thick", 0),
                ),
            ),
        ),
        (
            state(f"a period-{period} orbit was locked onto", "yes", lock.outcome, lock.locked),
            state("the orbit is unstable", "yes", f"multiplier of size {size:.4g} per turn", size > 1.0),
        ),
        choices=UNPRINTED,
    )


def perturbation(period: int, choices: str) -> Drawing:
    """Figures 6.13 and 6.16."""
    printed, lock = ORBITS[period], held(period)
    count = np.arange(1.0, len(lock.changes) + 1.0)
    limit = np.full(2, float(printed.change))
    return Drawing(
        f"The change of the drive's amplitude from landing to landing until the motion stays on the orbit of period "
        f"{period}; dashed: the thesis's final change.",
        (
            Panel(
                "landing (1)",
                "change of u0 (Fs)",
                (
                    Trace(count[[0, -1]], limit, "limit", "dashed", None),
                    Trace(count[[0, -1]], -limit, "limit", "dashed", None),
                    Trace(count, lock.changes, "change", "line", 1),
                ),
            ),
        ),
        perturbation_table(period),
        choices=choices,
    )


def perturbation_table(period: int) -> tuple[StatementCheck, ...]:
    """Return the comparisons of the perturbation of an orbit."""
    printed, lock = ORBITS[period], held(period)
    searched = locked(period)[2]
    largest = float(np.max(np.abs(lock.changes)))
    return (
        compare(
            f"u0 from the printed change: {printed.change} is {printed.percent} %",
            f"{float(printed.change) / float(printed.percent) * 100.0:.4g}",
            U0,
            within=0.005,
        ),
        state(
            "largest change needed to lock",
            f"{printed.change}, {printed.percent} %",
            f"{largest:.5f}, after {lock.events_to_lock} landings",
            lock.locked and largest <= float(printed.change) * (1.0 + 1e-9),
        ),
        state(
            "method: raise the amplitude until the section repeats, then take it back (6.4.4)",
            "locks within that change",
            "the section does not repeat" if searched.change is None else f"repeats at {searched.change:.5f}",
            searched.stays,
            "within that change the section nowhere repeats with this period; what locks here is the control of Ott, "
            "Grebogi and Yorke, which changes the amplitude anew at each landing",
        ),
        state(
            "the change is removed at the end",
            "yes",
            f"the last change is {abs(float(lock.changes[-1])):.1g}",
            abs(float(lock.changes[-1])) < 1e-9,
        ),
    )


def lock_velocity(period: int, choices: str) -> Drawing:
    """Figures 6.14 and 6.17."""
    printed, lock = ORBITS[period], held(period)
    end = len(lock.changes)
    first = max(end - TURNS * period, 0)
    t, _, v = part(period, first, end)
    f = locked(period)[0]
    turn = math.fsum(f.landing(lock.states[i], lock.changes[i]).duration for i in range(end - period, end))
    return Drawing(
        f"The velocity on the orbit of period {period} at omega = {printed.omega}.",
        (Panel(T, V, (Trace(t, v),)),),
        (
            state(
                "the velocity repeats after one turn",
                "yes",
                f"one turn takes {turn / f.period:.9g} drive periods",
                abs(turn / f.period - round(turn / f.period)) < 1e-6,
            ),
        ),
        choices=choices,
    )


FIGURES = (
    Entry("6.10", "curves of constant growth rate", growth_curves),
    Entry("6.11", "curves of constant frequency", frequency_curves),
    Entry("6.12", "period-2 orbit locked onto, omega = 1.6", partial(lock_portrait, 2)),
    Entry("6.13", "perturbation, period 2, omega = 1.6", partial(perturbation, 2, f"{LOST_CAPTION}; {UNPRINTED}")),
    Entry("6.14", "velocity, period 2, omega = 1.6", partial(lock_velocity, 2, f"{LOST_CAPTION}; {UNPRINTED}")),
    Entry("6.15", "period-5 orbit locked onto, omega = 1.1", partial(lock_portrait, 5)),
    Entry("6.16", "perturbation, period 5, omega = 1.1", partial(perturbation, 5, UNPRINTED)),
    Entry("6.17", "velocity, period 5, omega = 1.1", partial(lock_velocity, 5, UNPRINTED)),
)
