"""The commands of ``rig-sim`` that control a mass: shaker, lock."""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from daq.base.console import application, flags
from daq.base.console.application import Answer, Json, SetChanges
from daq.base.console.flags import Force, Plot, check_plot
from daq.base.errors import InputError
from rig_sim.flow.flow import LARGEST, SMALLEST

if TYPE_CHECKING:
    from daq.base.compute.arrays import Array
    from rig_sim.dynamics.analyses.unstable_orbits import UnstableOrbit
    from rig_sim.dynamics.control.locking import Locking
    from rig_sim.dynamics.rig.landing import LandingMap

MOST_PERIOD = 100  # of a search; the multipliers of longer orbits leave no digit of a motion
MOST_EVENTS = 10_000_000
# Integrator steps of a lock, 5 s, or so many for each event asked for.  Of the thesis's motions periods 1 to 5 take 5e5
# and 100 takes 6e6; an event takes 80.  Where every close return is tried in vain a search took 24 s and more.
STEPS_IN_ALL, STEPS_PER_EVENT = 10_000_000, 200
SHOWN = 5  # orbits, and positions of an orbit, in the text


def shaker(
    *,
    m: Annotated[float, flags.quantity("--m", "mass", "Mass, kg or with a unit: '300 g'.")],
    k: Annotated[float, flags.quantity("--k", "stiffness", "Spring, N/m or with a unit.")],
    c: Annotated[float, flags.quantity("--c", "damping", "Damper, N s/m or with a unit.")],
    gamma: Annotated[
        float,
        flags.quantity(
            "--gamma",
            "damping",
            "Slope of friction at the belt's speed, N s/m: above 0 where it falls with the slip speed.",
        ),
    ],
    a: Annotated[float, flags.quantity("--a", "damping", "Amplification, N s/m.")],
    phi: Annotated[
        float,
        flags.quantity("--phi", "angle", "Phase by which the force leads the velocity, rad, or '170 deg'."),
    ],
    band: Annotated[
        str | None,
        Parameter(help="LOW:HIGH, the frequencies that the filter passes, rad/s or '0.8 Hz'; stable needs them."),
    ] = None,
    plot: Plot = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Find frequency and growth rate of the small oscillation under a shaker that feeds the velocity back.

    The shaker's force is the velocity times a, ahead of it by phi; phi = 3.14159265 is a damper. The picture shows the
    curves of constant growth rate and frequency over phase and amplification, and shades where the oscillation decays.

    Example: rig-sim shaker --m 1 --k 1 --c 0 --gamma 0.3 --a 0.5 --phi 3 --band 0.9:1.1
    """
    from rig_sim.dynamics.control.phasor import phasor_roots
    from rig_sim.dynamics.control.stability import ShakerPlane

    for name, value in (("m", m), ("k", k), ("c", c), ("gamma", gamma), ("a", a), ("phi", phi)):
        _check(name, value, positive=name in ("m", "k"), negative=name in ("c", "gamma", "phi"))
    plane = ShakerPlane(m, k, gamma - c, None if band is None else _band(band))
    roots = phasor_roots(m, k, plane.S, a, phi)
    data: dict[str, Any] = {
        "omega": roots[0].real,
        "delta": roots[0].imag,
        "stable": plane.stable(a, phi),
        "roots": roots,
        "band": plane.band,
        "in_band": plane.passes(roots[0].real),
        "stable_phases": plane.stable_phases(a),
        "stable_amplifications": plane.stable_amplifications(phi),
    }
    kind = "decays" if data["delta"] < 0.0 else "grows" if data["delta"] > 0.0 else "neither grows nor decays"
    outside = "" if data["in_band"] else ", but its frequency lies outside the filter's band"
    lines = [
        f"omega  {data['omega']:.15g} rad/s",
        f"delta  {data['delta']:.15g} 1/s: the oscillation {kind}{outside}",
        f"stable {data['stable']}",
        f"stable phases at a = {a:g}: {_intervals(data['stable_phases'])}",
        f"stable amplifications at phi = {phi:g}: {_intervals(data['stable_amplifications'])}",
    ]
    if plot is not None:
        from daq.base.output.plot import save
        from rig_sim.dynamics.pictures.shaker import shaker_figure

        save(shaker_figure(plane, a, phi), plot, force=force)
        data["file"] = plot
        lines.append(str(plot))
    return Answer(data, "\n".join(lines))


def lock(
    scene: str,
    /,
    *,
    period: Annotated[int, Parameter(help="Landings in one turn of the orbit.")],
    budget: Annotated[float, Parameter(help="Largest change of the drive's amplitude, as a fraction of drive.u0.")],
    method: Annotated[
        Literal["ogy", "search"],
        Parameter(
            help="ogy (Ott, Grebogi and Yorke: a change at each landing), or search (the thesis's: raise the amplitude "
            "until the section repeats, then take it back)."
        ),
    ] = "ogy",
    events: Annotated[int, application.Whole, Parameter(help="Landings after which the control gives up.")] = 20_000,
    plot: Plot = None,
    force: Force = False,
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find an unstable orbit of a driven mass, and lock the motion onto it by small changes of the drive's amplitude.

    The orbits are found by close returns of the uncontrolled motion; of several, the least unstable one is taken. An
    event is a landing: a passage from slip to stick.

    Example: rig-sim lock forced --period 2 --budget 0.0235

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file, with a drive.
    """
    from rig_sim.dynamics.control.locking import find_and_lock
    from rig_sim.dynamics.rig.landing import LandingMap
    from rig_sim.dynamics.system.step_budget import StepBudget
    from rig_sim.scenes.scene import parse_changes
    from rig_sim.scenes.scene import scene as read

    _check("budget", budget)
    if budget > 1.0:
        raise InputError(f"is {budget:g}", "--budget", "give a fraction of drive.u0, from 0 to 1")
    if not 1 <= period <= MOST_PERIOD:
        raise InputError(f"is {period}", "--period", f"give 1 to {MOST_PERIOD} landings")
    if not 1 <= events <= MOST_EVENTS:
        raise InputError(f"is {events}", "--events", f"give 1 to {MOST_EVENTS}")
    if method == "search" and plot is not None:
        raise InputError("draws --method ogy alone", "--plot", "drop one of the two")
    check_plot(plot, force)
    played = read(scene, **parse_changes(set_))
    flow = played.flow()
    if played.drive is None:
        raise InputError("has no drive to control", f"scene {scene}", "set drive.u0 and drive.omega")
    steps = StepBudget(max(STEPS_IN_ALL, STEPS_PER_EVENT * events))
    try:
        f = LandingMap(flow, budget=steps)
    except ValueError as error:
        raise InputError(str(error), f"scene {scene}", "change that value with --set") from None
    data: dict[str, Any] = {"method": method, "period": period, "budget": budget, "du_limit": budget * f.strength}
    data |= {"outcome": "", "advice": "", "orbit": None, "orbits": [], "regular_period": None, "locked": False}
    data |= {"events_to_lock": None, "events": 0, "du_max": 0.0, "du_final": 0.0}
    first = f.first(float(played.start.x), float(played.start.v))
    if first.outcome != "completed":
        data |= {"outcome": first.outcome, "advice": "the motion does not reach a stick: change the drive or the belt"}
    elif method == "search":
        with application.progress("raising the amplitude", 100) as show:
            data |= _searched(f, first.state, period, budget, show)
    else:
        with application.progress("following the motion", events) as show:
            found = find_and_lock(f, first.state, period, budget, events, show.stage)
        data |= _locked(f, found)
        if plot is not None and found.lock is not None:
            from daq.base.output.plot import save
            from rig_sim.dynamics.pictures.driven import lock_figure

            save(lock_figure(f, found.lock, period, budget), plot, force=force)
            data["file"] = plot
    lines = _lock_lines(data)
    if plot is not None:
        lines.append(str(data.get("file", "nothing drawn: there is no motion under control")))
    return Answer(data, "\n".join(lines))


def _locked(f: "LandingMap", found: "Locking") -> dict[str, Any]:
    """Return what a lock has found, as JSON keys."""
    rows = [_orbit_row(f, orbit) for orbit in found.orbits]
    data: dict[str, Any] = {"outcome": found.outcome, "advice": found.advice, "orbits": rows}
    data |= {"orbit": rows[0] if rows else None, "regular_period": found.regular}
    if found.lock is not None:
        sizes = [abs(float(change)) for change in found.lock.changes]
        data |= {"locked": found.lock.locked, "events_to_lock": found.lock.events_to_lock, "events": len(sizes)}
        data |= {"du_max": max(sizes, default=0.0), "du_final": float(found.lock.changes[-1]) if sizes else 0.0}
    return data


def _orbit_row(f: "LandingMap", orbit: "UnstableOrbit") -> dict[str, Any]:
    """Return an orbit as JSON keys."""
    landings = [f.landing(point) for point in orbit.points]
    duration = math.fsum(landing.duration for landing in landings)
    return {
        "x_slip": [landing.x_slip for landing in landings],
        "t": orbit.points[:, 0],
        "x": orbit.points[:, 1],
        "duration": duration,
        "drive_periods": round(duration / f.period),
        "multipliers": orbit.multipliers,
    }


def _searched(
    f: "LandingMap", start: "Array", period: int, budget: float, show: application.Progress
) -> dict[str, Any]:
    """Return what the thesis's search-and-lock has found, as JSON keys."""
    from rig_sim.dynamics.control.locking import ADVICE
    from rig_sim.dynamics.control.search_and_lock import search_and_lock
    from rig_sim.dynamics.system.step_budget import StepLimitError

    try:
        found = search_and_lock(f, start, period, budget, progress=show.stage)
    except StepLimitError:
        return {"outcome": "step limit", "advice": ADVICE["step limit"]}
    if found.change is None or found.points is None:
        advice = "the section did not repeat with this period: raise the budget"
        return {"outcome": "not locked", "advice": advice, "events": found.events, "du_max": budget * f.strength}
    x_slip = [f.landing(point, found.change).x_slip for point in found.points]
    orbit = {"x_slip": x_slip, "t": found.points[:, 0], "x": found.points[:, 1]}
    data = {"orbit": orbit, "events_to_lock": found.events, "events": found.events, "kept": found.kept}
    data |= {"du_max": found.change, "du_final": 0.0, "locked": found.stays}
    advice = "without the change the motion leaves the orbit: take --method ogy"
    return data | ({"outcome": "locked"} if found.stays else {"outcome": "locked while changed", "advice": advice})


def _lock_lines(data: dict[str, Any]) -> list[str]:
    """Return what a lock has found, in words."""
    lines = [f"outcome        {data['outcome']}" + (f" ({data['advice']})" if data["advice"] else "")]
    if data["regular_period"] is not None:
        lines.append(f"without control the motion settles on period {data['regular_period']}")
    for number, orbit in enumerate(data["orbits"][:SHOWN] or [data["orbit"]]):
        if orbit is not None:
            more = " ..." if len(orbit["x_slip"]) > SHOWN else ""
            places = ", ".join(f"{x:.12g}" for x in orbit["x_slip"][:SHOWN]) + more
            size = f", multiplier {_shown(orbit['multipliers'][0])}" if "multipliers" in orbit else ""
            lines.append(f"{'orbit' if number == 0 else '':14} x at break-away {places}{size}")
    lines.append(f"locked         {data['locked']}")
    if data["events_to_lock"] is not None:
        lines.append(f"events to lock {data['events_to_lock']}")
    lines.append(f"largest change {data['du_max']:.6g} of {data['du_limit']:.6g} allowed, last {data['du_final']:.3g}")
    return lines


def _shown(number: complex) -> str:
    return f"{number.real:.10g}" if number.imag == 0.0 else f"{number:.10g}"


def _check(name: str, value: float, *, positive: bool = False, negative: bool = False) -> None:
    """Refuse a number that is not finite, too large or too small, or of the wrong sign.

    Raises
    ------
    InputError
        Naming the flag.
    """
    if not math.isfinite(value) or abs(value) > LARGEST or 0.0 < abs(value) < SMALLEST:
        raise InputError(f"is {value:g}", f"--{name}", f"give 0 or a size from {SMALLEST:g} to {LARGEST:g}")
    if (positive and value <= 0.0) or (not negative and value < 0.0):
        raise InputError(f"is {value:g}", f"--{name}", "give a number above 0" if positive else "give 0 or more")


def _band(text: str) -> tuple[float, float]:
    """Return the two frequencies of ``--band LOW:HIGH``.

    Raises
    ------
    InputError
        Another form, or not 0 <= LOW < HIGH.
    """
    from daq.base import units

    ends = text.split(":")
    if len(ends) != 2:
        raise InputError(f"{text!r} is no band", "--band", "write LOW:HIGH in rad/s, as in 0.9:1.1")
    low, high = (units.quantity(end, "angular frequency", "--band") for end in ends)
    if not 0.0 <= low < high < math.inf:
        raise InputError(f"{text!r} is no band", "--band", "give 0 <= LOW < HIGH, in rad/s")
    return low, high


def _intervals(found: list[tuple[float, float]]) -> str:
    return ", ".join(f"{low:.6g} to {high:.6g}" for low, high in found) or "none"
