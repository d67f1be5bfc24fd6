"""Chapter 6, figures 6.10 to 6.17: shaker feedback in its amplification-phase plane, locking onto unstable orbits."""

import math
from functools import cache, partial

import numpy as np

from rig_sim.analyses.control.locking import Lock, Locking, find_and_lock
from rig_sim.analyses.control.search_and_lock import SearchAndLock, search_and_lock
from rig_sim.analyses.control.shaker import ShakerCurve, ShakerPlane, phasor
from rig_sim.atlas.chapters.axes import T, V, X
from rig_sim.atlas.chapters.chapter6 import U0, flow_at
from rig_sim.atlas.figure import Computed, Panel, Trace
from rig_sim.atlas.statements import read_entries
from rig_sim.systems.landing import LandingMap
from stickslip.compute.arrays import Array

S = 0.3  # gamma_lin - c: the thesis's least amplification at phi = pi
HIGHEST = 5.5  # largest drawn amplification, of figure 6.11
PHASE, LEVEL = "phase shift phi (rad)", "amplification a (sqrt(km))"
BAND = (0.9, 1.1)  # band of the filter, relative to the resonance
SAMPLES = 200  # per drive period
BEFORE, TURNS = 12, 6  # landings drawn before the control; turns of the orbit drawn in time
EVENTS = 20_000
ORBITS = {2: (1.6, 0.0006), 5: (1.1, 0.0047)}  # by period: the drive's frequency, and its printed change


def trace_curve(curve: ShakerCurve, label: str, colour: int, dashed: bool = False) -> Trace:
    return Trace(*curve.with_gaps(), label, "dashed" if dashed else "line", colour)


def make_plane_panel(traces: tuple[Trace, ...]) -> tuple[Panel, ...]:
    return (Panel(PHASE, LEVEL, traces, x_range=(0.0, 2.0 * math.pi), y_range=(0.0, HIGHEST)),)


def find_best_phase(a: float) -> float:
    """Return the phase (rad, up to pi) at which a shaker of amplification a makes the oscillation decay fastest."""
    from scipy.optimize import minimize_scalar

    def growth(phi: float) -> float:
        return phasor(1.0, 1.0, S, a, phi).imag

    minimum = minimize_scalar(growth, bounds=(2.0, math.pi), method="bounded", options={"xatol": 1e-10})
    return float(minimum.x)


def draw_growth_curves() -> Computed:
    plane = ShakerPlane(1.0, 1.0, S)
    traces = tuple(
        trace_curve(
            plane.growth_curve(delta, 2.0 * HIGHEST), f"delta = {delta:g} omega0" if delta else "delta = 0", colour
        )
        for colour, delta in enumerate((0.0, -0.1, -0.2))
    )
    ((least, _),) = plane.stable_amplifications(math.pi)
    ((low, high),) = plane.stable_phases(1e6)
    return Computed(
        make_plane_panel(traces), {"least": least, "low": low, "high": high, "best": find_best_phase(0.5) / math.pi}
    )


def measure_widths(levels: tuple[float, ...]) -> list[float]:
    """Return the total width of the stable phases within the filter's band at each amplification."""
    plane = ShakerPlane(1.0, 1.0, S, BAND)
    return [math.fsum(high - low for low, high in plane.stable_phases(a)) for a in levels]


def draw_frequency_curves() -> Computed:
    plane = ShakerPlane(1.0, 1.0, S)
    traces = [trace_curve(plane.growth_curve(0.0, 2.0 * HIGHEST), "delta = 0", 0)]
    traces += [
        trace_curve(plane.frequency_curve(omega, 2.0 * HIGHEST), f"omega = {omega:g} omega0", colour, dashed=True)
        for colour, omega in enumerate((0.5, 0.9, 1.0, 1.1, 2.0), 1)
    ]
    levels = (0.5, 0.7, 1.0, 1.5)
    widths = measure_widths(levels)
    numbers = {
        "widths": ", ".join(f"{width:.3f} at a = {a:g}" for a, width in zip(levels, widths, strict=True)),
        "narrows": widths == sorted(widths, reverse=True),
        "widest": max(measure_widths(tuple(np.linspace(0.301, 1.5, 200).tolist()))),
    }
    return Computed(make_plane_panel(tuple(traces)), numbers)


@cache
def lock_motion(period: int) -> tuple[LandingMap, Locking, SearchAndLock]:
    """Return the map, the lock within the printed budget, and the result of the thesis's own search within it."""
    omega, change = ORBITS[period]
    f = LandingMap(flow_at(omega))
    start = f.first_landing(0.0, 0.0).state
    budget = change / U0
    return f, find_and_lock(f, start, period, budget, EVENTS), search_and_lock(f, start, period, budget)


def find_lock(period: int) -> Lock:
    lock = lock_motion(period)[1].lock
    if lock is None:
        raise RuntimeError(f"no orbit of period {period}")
    return lock


def sample_landings(period: int, first: int, last: int) -> tuple[Array, Array, Array]:
    f, lock = lock_motion(period)[0], find_lock(period)
    return f.sample_motion(lock.states[first:last], lock.changes[first:last], SAMPLES / f.period)


def draw_lock_portrait(period: int) -> Computed:
    lock, locking = find_lock(period), lock_motion(period)[1]
    start, end = lock.events_to_lock or 0, len(lock.changes)
    _, x_before, v_before = sample_landings(period, max(start - BEFORE, 0), start)
    _, x, v = sample_landings(period, end - period, end)
    size = abs(locking.orbits[0].multipliers[0]) if locking.orbits else math.nan
    curves = Trace(x_before, v_before, "before the control", "thin", None), Trace(x, v, f"period {period}", "thick", 0)
    numbers = {"period": period, "omega": ORBITS[period][0], "outcome": lock.outcome, "locked": lock.locked}
    return Computed((Panel(X, V, curves),), {**numbers, "size": size, "unstable": size > 1.0})


def draw_perturbation(period: int) -> Computed:
    lock, searched, (_, printed) = find_lock(period), lock_motion(period)[2], ORBITS[period]
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


def draw_lock_velocity(period: int) -> Computed:
    f, lock = lock_motion(period)[0], find_lock(period)
    end = len(lock.changes)
    t, _, v = sample_landings(period, max(end - TURNS * period, 0), end)
    duration = math.fsum(f.find_landing(lock.states[i], lock.changes[i]).duration for i in range(end - period, end))
    turn = duration / f.period
    numbers = {"period": period, "omega": ORBITS[period][0], "turn": turn, "repeats": abs(turn - round(turn)) < 1e-6}
    return Computed((Panel(T, V, (Trace(t, v),)),), numbers)


FIGURES = read_entries(
    "chapter6.toml",
    {
        "6.10": draw_growth_curves,
        "6.11": draw_frequency_curves,
        "6.12": partial(draw_lock_portrait, 2),
        "6.13": partial(draw_perturbation, 2),
        "6.14": partial(draw_lock_velocity, 2),
        "6.15": partial(draw_lock_portrait, 5),
        "6.16": partial(draw_perturbation, 5),
        "6.17": partial(draw_lock_velocity, 5),
    },
)
