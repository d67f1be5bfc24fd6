"""Chapter 6, figures 6.2 to 6.8: the driven mass; its phase portraits, its bifurcation diagram, quenching by dither."""

import math
from functools import cache, partial

import numpy as np

from rig_sim.analyses.control.dither import Quench, quench
from rig_sim.analyses.exponent import Exponent, exponent
from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.analyses.settling import find_attractors
from rig_sim.analyses.sweep import AttractorAt, sweep
from rig_sim.atlas.chapters.axes import T, V, X, play_motion
from rig_sim.atlas.figure import Computed, Panel, Trace
from rig_sim.atlas.statements import read_entries
from rig_sim.flow.flow import Flow
from rig_sim.scenes.scene import scene
from rig_sim.systems.driven import DrivenMap, driven_map_with_starts

SPEED, U0 = 0.085, 0.2  # of the scene `forced`
OMEGAS = np.linspace(0.2, 2.0, 241)  # of figure 6.6; 0.13 s of CPU each
LANDINGS = 4000  # landings of a Lyapunov exponent
SLOW, FAST = (0.2, 0.3), (0.4, 4.0)  # u0 and omega of the unquenched and the quenched motion
SETTLED = 300.0  # time after which a motion counts as settled


def flow_at(omega: float, u0: float = U0) -> Flow:
    return scene("forced", **{"drive.omega": omega, "drive.u0": u0}).flow()


def attractors_at(omega: float) -> list[AttractorAt]:
    """Return the attractors at a drive frequency, with the positions of break-away."""
    return find_attractors(*driven_map_with_starts(flow_at(omega), 0.0, 0.0, "slip"), omega)


@cache
def find_slip_period(omega: float) -> int | None:
    """Return the number of break-aways in one period of the motion of most starts; None where it does not repeat."""
    return attractors_at(omega)[0].period


@cache
def compute_landing_exponent(omega: float) -> Exponent:
    """Return the Lyapunov exponent per landing of the motion from (0, 0)."""
    return exponent(DrivenMap(flow_at(omega), "landing").motion(np.zeros(2)), LANDINGS)


def draw_unforced() -> Computed:
    changes = (("belt.speed", SPEED),)
    free = cycle(scene("base", **dict(changes)))
    t, x, v, _ = play_motion("base", 90.0, 100.0, changes)
    last = t > 90.0 - 1.02 * (free.period or 0.0)
    curves = Trace(x, v, "from (0, 0)", "thin"), Trace(x[last], v[last], "limit cycle", "thick")
    return Computed((Panel(X, V, curves),), {**vars(free), "is_cycle": free.outcome == "cycle"})


def draw_portrait(omega: float) -> Computed:
    t, x, v, _ = play_motion("forced", 3.0 * SETTLED, 50.0, (("drive.omega", omega),))
    late = t > SETTLED
    repeats, growth = find_slip_period(omega), compute_landing_exponent(omega)
    numbers = {
        "omega": omega,
        "period": float(repeats or 0),
        "kind": f"period {repeats}" if repeats else "a motion that does not repeat",
        "exponent": growth.exponent,
        "stderr": growth.stderr,
        "chaotic": growth.exponent > 5.0 * growth.stderr,
    }
    return Computed((Panel(X, V, (Trace(x[late], v[late], "", "line" if repeats else "thin"),)),), numbers)


@cache
def sweep_frequencies() -> tuple[AttractorAt, ...]:
    """Return the attractors over the drive frequencies of figure 6.6."""
    return tuple(sweep(attractors_at, OMEGAS.tolist()))


def draw_bifurcations() -> Computed:
    rows = [row for row in sweep_frequencies() if row.points]
    x = np.concatenate([np.full(len(row.points), row.value) for row in rows])
    y = np.concatenate([row.points for row in rows])
    periods = sorted({row.period for row in rows if row.period})
    low, high = compute_landing_exponent(1.1), compute_landing_exponent(1.6)
    numbers = {
        "periods": ", ".join(map(str, periods)),
        "windows_in_chaos": {1, 2} <= set(periods) and any(row.period is None for row in rows),
        "largest_period": max(periods),
        "up_to_9": max(periods) >= 9,
        "low": low.exponent,
        "low_error": low.stderr,
        "low_chaotic": low.exponent > 5.0 * low.stderr,
        "high": high.exponent,
        "high_error": high.stderr,
        "high_chaotic": high.exponent > 5.0 * high.stderr,
        "least": y.min(),
        "largest": y.max(),
    }
    panel = Panel("drive frequency omega (sqrt(k/m))", "X_A (Fs/k)", (Trace(x, y, "", "points"),))
    return Computed((panel,), numbers)


@cache
def compute_dither() -> Quench:
    return quench(flow_at(FAST[1], FAST[0]), 0.0, 0.0)


def draw_quenched(of_velocity: bool) -> Computed:
    traces: list[Trace] = []
    for setting, name in ((SLOW, "unquenched"), (FAST, "quenched")):
        t, x, v, _ = play_motion("forced", 120.0, 50.0, (("drive.u0", setting[0]), ("drive.omega", setting[1])))
        label = f"{name}: u0 = {setting[0]}, omega = {setting[1]}"
        traces.append(Trace(t, v if of_velocity else x, label, "line" if traces else "thin", len(traces)))
    result = compute_dither()
    numbers = vars(result) | {
        "what": "velocity" if of_velocity else "displacement",
        "simulated_threshold": result.simulated_threshold or math.nan,
        "tiny": result.swing < 0.1 * result.free_swing,
    }
    return Computed((Panel(T, V if of_velocity else X, tuple(traces)),), numbers)


FIGURES = read_entries(
    "chapter6.toml",
    {
        "6.2": draw_unforced,
        "6.3": partial(draw_portrait, 0.30),
        "6.4": partial(draw_portrait, 0.41),
        "6.5": partial(draw_portrait, 0.20),
        "6.6": draw_bifurcations,
        "6.7": partial(draw_quenched, False),
        "6.8": partial(draw_quenched, True),
    },
)
