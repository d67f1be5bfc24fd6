"""Chapter 6, figures 6.10 to 6.17: shaker feedback in its amplification-phase plane, locking onto unstable orbits."""

import math
from functools import cache, partial

import numpy as np

from rig_sim.atlas.chapters.axes import T, V, X
from rig_sim.atlas.chapters.chapter6 import U0, flow_at
from rig_sim.atlas.figure import Computed, Panel, Trace
from rig_sim.atlas.statements import entries
from rig_sim.dynamics.control.locking import Locking, find_and_lock
from rig_sim.dynamics.control.ogy import Lock
from rig_sim.dynamics.control.phasor import phasor
from rig_sim.dynamics.control.search_and_lock import SearchAndLock, search_and_lock
from rig_sim.dynamics.control.stability import ShakerCurve, ShakerPlane
from rig_sim.dynamics.return_maps.landing import LandingMap
from stickslip.compute.arrays import Array

S = 0.3  # gamma_lin - c: the thesis's least amplification at phi = pi
HIGHEST = 5.5  # amplification drawn, that of figure 6.11
PHASE, LEVEL = "phase shift phi (rad)", "amplification a (sqrt(km))"
BAND = (0.9, 1.1)  # band of the filter, relative to the resonance
SAMPLES = 200  # per drive period
BEFORE, TURNS = 12, 6  # landings drawn before the control; turns of the orbit drawn in time
EVENTS = 20_000
ORBITS = {2: (1.6, 0.0006), 5: (1.1, 0.0047)}  # by period: the drive's frequency, and its printed change


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

    minimum = minimize_scalar(growth, bounds=(2.0, math.pi), method="bounded", options={"xatol": 1e-10})
    return float(minimum.x)


def growth_curves() -> Computed:
    """Return curves of constant growth rate."""
    plane = ShakerPlane(1.0, 1.0, S)
    traces = tuple(
        curve(plane.growth_curve(delta, 2.0 * HIGHEST), f"delta = {delta:g} omega0" if delta else "delta = 0", place)
        for place, delta in enumerate((0.0, -0.1, -0.2))
    )
    ((least, _),) = plane.stable_amplifications(math.pi)
    ((low, high),) = plane.stable_phases(1e6)
    return Computed(plane_panel(traces), {"least": least, "low": low, "high": high, "best": best_phase(0.5) / math.pi})


def widths(levels: tuple[float, ...]) -> list[float]:
    """Return how wide the stable phases within the filter's band are, in all, at amplifications."""
    plane = ShakerPlane(1.0, 1.0, S, BAND)
    return [math.fsum(high - low for low, high in plane.stable_phases(a)) for a in levels]


def frequency_curves() -> Computed:
    """Return curves of constant frequency."""
    plane = ShakerPlane(1.0, 1.0, S)
    traces = [curve(plane.growth_curve(0.0, 2.0 * HIGHEST), "delta = 0", 0)]
    traces += [
        curve(plane.frequency_curve(omega, 2.0 * HIGHEST), f"omega = {omega:g} omega0", place, dashed=True)
        for place, omega in enumerate((0.5, 0.9, 1.0, 1.1, 2.0), 1)
    ]
    levels = (0.5, 0.7, 1.0, 1.5)
    found = widths(levels)
    numbers = {
        "widths": ", ".join(f"{width:.3f} at a = {a:g}" for a, width in zip(levels, found, strict=True)),
        "narrows": found == sorted(found, reverse=True),
        "widest": max(widths(tuple(np.linspace(0.301, 1.5, 200).tolist()))),
    }
    return Computed(plane_panel(tuple(traces)), numbers)


@cache
def locked(period: int) -> tuple[LandingMap, Locking, SearchAndLock]:
    """Return the map, the lock within the printed budget, and what the thesis's own search finds within it."""
    omega, change = ORBITS[period]
    f = LandingMap(flow_at(omega))
    start = f.first(0.0, 0.0).state
    budget = change / U0
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


def lock_portrait(period: int) -> Computed:
    """Return the phase portrait of an orbit under control, and of the motion before."""
    lock, found = held(period), locked(period)[1]
    begin, end = lock.events_to_lock or 0, len(lock.changes)
    _, x_before, v_before = part(period, max(begin - BEFORE, 0), begin)
    _, x, v = part(period, end - period, end)
    size = abs(found.orbits[0].multipliers[0]) if found.orbits else math.nan
    curves = Trace(x_before, v_before, "before the control", "thin", None), Trace(x, v, f"period {period}", "thick", 0)
    numbers = {"period": period, "omega": ORBITS[period][0], "outcome": lock.outcome, "locked": lock.locked}
    return Computed((Panel(X, V, curves),), {**numbers, "size": size, "unstable": size > 1.0})


def perturbation(period: int) -> Computed:
    """Return the change of the drive's amplitude from landing to landing."""
    lock, searched, (_, printed) = held(period), locked(period)[2], ORBITS[period]
    count = np.arange(1.0, len(lock.changes) + 1.0)
    limit = np.full(2, printed)
    curves = (
        Trace(count[[0, -1]], limit, "limit", "dashed", None),
        Trace(count[[0, -1]], -limit, "limit", "dashed", None),
        Trace(count, lock.changes, "change", "line", 1),
    )
    largest, last = float(np.max(np.abs(lock.changes))), abs(float(lock.changes[-1]))
    numbers = {
        "period": period,
        "u0": U0,
        "largest": largest,
        "landings": lock.events_to_lock,
        "within": lock.locked and largest <= printed * (1.0 + 1e-9),
        "by_search": "the section does not repeat" if searched.change is None else f"repeats at {searched.change:.5f}",
        "search_locks": searched.stays,
        "last": last,
        "removed": last < 1e-9,
    }
    return Computed((Panel("landing (1)", "change of u0 (Fs)", curves),), numbers)


def lock_velocity(period: int) -> Computed:
    """Return the velocity on an orbit under control."""
    f, lock = locked(period)[0], held(period)
    end = len(lock.changes)
    t, _, v = part(period, max(end - TURNS * period, 0), end)
    duration = math.fsum(f.landing(lock.states[i], lock.changes[i]).duration for i in range(end - period, end))
    turn = duration / f.period
    numbers = {"period": period, "omega": ORBITS[period][0], "turn": turn, "repeats": abs(turn - round(turn)) < 1e-6}
    return Computed((Panel(T, V, (Trace(t, v),)),), numbers)


FIGURES = entries(
    "chapter6.toml",
    {
        "6.10": growth_curves,
        "6.11": frequency_curves,
        "6.12": partial(lock_portrait, 2),
        "6.13": partial(perturbation, 2),
        "6.14": partial(lock_velocity, 2),
        "6.15": partial(lock_portrait, 5),
        "6.16": partial(perturbation, 5),
        "6.17": partial(lock_velocity, 5),
    },
)
