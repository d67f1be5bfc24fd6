"""Chapter 6, figures 6.2 to 6.8: the driven mass; its phase portraits, its bifurcation diagram, quenching by dither."""

import math
from functools import cache, partial

import numpy as np

from rig_sim.atlas.chapters.axes import T, V, X, motion
from rig_sim.atlas.figure import Drawing, Entry, Panel, StatementCheck, Trace, compare, state
from rig_sim.dynamics.analyses.exponent import Exponent, exponent
from rig_sim.dynamics.analyses.settling import attractors
from rig_sim.dynamics.analyses.sweep import AttractorAt, sweep
from rig_sim.dynamics.control.dither import Quench, quench
from rig_sim.dynamics.orbits.limit_cycle import cycle
from rig_sim.dynamics.rig.driven import DrivenMap, with_starts
from rig_sim.flow.flow import Flow
from rig_sim.scenes.scene import scene

SPEED, U0 = 0.085, 0.2  # of the scene `forced`
OMEGAS = np.linspace(0.2, 2.0, 241)  # of figure 6.6; 0.13 s of CPU each
LANDINGS = 4000  # of a Lyapunov exponent
SLOW, FAST = (0.2, 0.3), (0.4, 4.0)  # u0 and omega of the unquenched and the quenched motion
SETTLED = 300.0  # time after which a motion counts as settled
UNPRINTED = (
    f"the belt velocity, {SPEED}, and c = 0, which the thesis does not print; u0 = {U0} follows from its percentages"
)
REPRODUCED = "neither belt velocity nor damping is printed; of all sets tried none gives chaos here"


def flow_at(omega: float, u0: float = U0) -> Flow:
    """Return the driven mass at a drive frequency."""
    return scene("forced", **{"drive.omega": omega, "drive.u0": u0}).flow()


def attractors_at(omega: float) -> list[AttractorAt]:
    """Return the attractors at a drive frequency, with the positions of break-away."""
    return attractors(*with_starts(flow_at(omega), 0.0, 0.0, "slip"), omega)


@cache
def period(omega: float) -> int | None:
    """Return after how many break-aways the motion of most starts repeats; None where it does not."""
    return attractors_at(omega)[0].period


@cache
def landing_exponent(omega: float) -> Exponent:
    """Return the Lyapunov exponent per landing of the motion from (0, 0)."""
    return exponent(DrivenMap(flow_at(omega), "landing").motion(np.zeros(2)), LANDINGS)


def unforced() -> Drawing:
    """Figure 6.2."""
    changes = (("belt.speed", SPEED),)
    found = cycle(scene("base", **dict(changes)))
    t, x, v, _ = motion("base", 90.0, 100.0, changes)
    last = t > 90.0 - 1.02 * (found.period or 0.0)
    return Drawing(
        "The limit cycle of the mass without a drive, and the way to it from rest (thin).",
        (Panel(X, V, (Trace(x, v, "from (0, 0)", "thin"), Trace(x[last], v[last], "limit cycle", "thick"))),),
        (
            state(
                "without a drive the motion is a limit cycle",
                "yes",
                f"{found.outcome} of period {found.period:.6g}",
                found.outcome == "cycle",
            ),
        ),
        choices=UNPRINTED,
    )


def portrait(omega: float, says: str) -> Drawing:
    """Figures 6.3 to 6.5."""
    t, x, v, _ = motion("forced", 3.0 * SETTLED, 50.0, (("drive.omega", omega),))
    late = t > SETTLED
    repeats, growth = period(omega), landing_exponent(omega)
    if says == "chaos":
        row = state(
            f"motion at omega = {omega}",
            "chaotic",
            f"Lyapunov exponent {growth.exponent:.4f} +- {growth.stderr:.4f} per landing: quasi-periodic",
            growth.exponent > 5.0 * growth.stderr,
            REPRODUCED,
        )
    else:
        row = compare(f"period in break-aways at omega = {omega}", says, float(repeats or 0), within=0.0)
    kind = f"period {repeats}" if repeats else "a motion that does not repeat"
    return Drawing(
        f"Phase portrait of the driven mass at omega = {omega}, after the transient: {kind}.",
        (Panel(X, V, (Trace(x[late], v[late], "", "line" if repeats else "thin"),)),),
        (row,),
        choices=UNPRINTED,
    )


@cache
def diagram() -> tuple[AttractorAt, ...]:
    """Return the attractors over the drive frequencies of figure 6.6."""
    return tuple(sweep(attractors_at, OMEGAS.tolist()))


def bifurcations() -> Drawing:
    """Figure 6.6."""
    rows = [row for row in diagram() if row.points]
    x = np.concatenate([np.full(len(row.points), row.value) for row in rows])
    y = np.concatenate([row.points for row in rows])
    periods = {row.period for row in rows}
    chaos = {omega: landing_exponent(omega) for omega in (1.1, 1.6)}
    return Drawing(
        "Position at break-away, X_A, over the drive frequency: periodic windows and bands of chaos.",
        (Panel("drive frequency omega (sqrt(k/m))", "X_A (Fs/k)", (Trace(x, y, "", "points"),)),),
        (
            state(
                "period 1, period doubling, and windows of periodic motion within chaos",
                "yes",
                f"periods {', '.join(str(n) for n in sorted(periods - {None}))}, and chaos",  # type: ignore[type-var]
                {1, 2, None} <= periods,
            ),
            state(
                "p-periodic motions up to p = 9 (6.5)",
                "p = 1 to 9",
                f"largest period in the diagram {max(n for n in periods if n)}",
                max(n for n in periods if n) >= 9,
            ),
            *(
                state(
                    f"chaos at omega = {omega}",
                    "dense",
                    f"Lyapunov exponent {found.exponent:.3f} +- {found.stderr:.3f} per landing",
                    found.exponent > 5.0 * found.stderr,
                )
                for omega, found in chaos.items()
            ),
            compare("smallest X_A, not below 1 - u0", "0.8", float(y.min()), within=0.01),
            compare("largest X_A, not above 1 + u0", "1.2", float(y.max()), within=0.01),
        ),
        choices=UNPRINTED,
    )


@cache
def dither() -> Quench:
    """Return whether the fast drive quenches the stick-slip, and its threshold."""
    return quench(flow_at(FAST[1], FAST[0]), 0.0, 0.0)


def dither_table() -> tuple[StatementCheck, ...]:
    """Return the comparisons of the quenched motion."""
    found = dither()
    return (
        state(
            "stick-slip decays under a high frequency of larger amplitude",
            "yes",
            f"{found.outcome}; from u0 = {found.simulated_threshold or math.nan:.4f} on, by the formula "
            f"u0 omega/(omega^2 - 1) = v_dr from {found.threshold:.4f} on",
            found.quenched,
        ),
        state(
            "tiny oscillations about a non-zero equilibrium remain",
            "yes",
            f"{found.swing:.4f} peak to peak, without the drive {found.free_swing:.4f}",
            found.swing < 0.1 * found.free_swing,
        ),
    )


def drive(setting: tuple[float, float]) -> tuple[tuple[str, float], ...]:
    """Return the changes of a scene for an amplitude and a frequency."""
    return ("drive.u0", setting[0]), ("drive.omega", setting[1])


def quenched(of_velocity: bool) -> Drawing:
    """Figures 6.7 and 6.8."""
    until = 120.0
    traces: list[Trace] = []
    for setting, name in ((SLOW, "unquenched"), (FAST, "quenched")):
        t, x, v, _ = motion("forced", until, 50.0, drive(setting))
        label = f"{name}: u0 = {setting[0]}, omega = {setting[1]}"
        traces.append(Trace(t, v if of_velocity else x, label, "line" if traces else "thin", len(traces)))
    what = "velocity" if of_velocity else "displacement"
    return Drawing(
        f"The {what} under a slow drive, which leaves the stick-slip, and under a fast one, which quenches it.",
        (Panel(T, V if of_velocity else X, tuple(traces)),),
        dither_table(),
        choices=f"both drives, and {UNPRINTED}",
    )


FIGURES = (
    Entry("6.2", "limit cycle without a drive", unforced),
    Entry("6.3", "phase portrait, period 1, omega = 0.30", partial(portrait, 0.30, "1")),
    Entry("6.4", "phase portrait, period 2, omega = 0.41", partial(portrait, 0.41, "2")),
    Entry("6.5", "phase portrait, omega = 0.20", partial(portrait, 0.20, "chaos")),
    Entry("6.6", "bifurcation diagram over the drive frequency", bifurcations),
    Entry("6.7", "displacement, quenched and unquenched", partial(quenched, False)),
    Entry("6.8", "velocity, quenched and unquenched", partial(quenched, True)),
)
