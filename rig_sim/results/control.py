"""A mass under control: dither, an orbit held by small changes of the drive, a shaker that feeds the velocity back."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from rig_sim.analyses.control.dither import Quench as Quenching
from rig_sim.flow.flow import LARGEST, SMALLEST
from rig_sim.results.arguments import SceneLike, load_scene, parse_number, parse_plain_number, parse_whole
from rig_sim.results.result import Result
from rig_sim.results.systems import make_landing_map, require_period
from rig_sim.systems.formula import FormulaMap
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError, check_known

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rig_sim.analyses.control.locking import Locking
    from rig_sim.analyses.control.ogy import Lock as Controlling
    from rig_sim.analyses.control.stability import ShakerPlane
    from rig_sim.analyses.unstable_orbits import UnstableOrbit
    from rig_sim.flow.flow import Flow
    from stickslip.compute.arrays import Array

METHODS = ("ogy", "search")
MOST_PERIOD = 100  # longest period of a search; the multipliers of longer orbits are beyond the digits of a motion
MOST_EVENTS = 10_000_000
# Integrator steps of a lock, 5 s, or of each requested event.  Of the thesis's motions periods 1 to 5 take 5e5 and
# period 100 takes 6e6; an event takes 80.
STEPS_IN_ALL, STEPS_PER_EVENT = 10_000_000, 200
SHOWN = 5  # orbits, and positions of an orbit, in the text


@dataclass(frozen=True, repr=False)
class Quench(Result, Quenching):
    """Whether a fast drive quenches stick-slip, and from which amplitude on: what `rig_sim.quench` returns."""

    name: str = field(default="", repr=False, compare=False, kw_only=True)
    flow: "Flow" = field(repr=False, compare=False, kw_only=True)
    start: tuple[float, float] = field(repr=False, compare=False, kw_only=True)

    UNITS: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("threshold", "threshold_with_slope", "simulated_threshold"), "N"),
        **dict.fromkeys(("swing", "linear_ripple", "free_swing"), "m"),
    }

    def lines(self) -> list[str]:
        lines = [f"{self.outcome}: u0 = {self.flow.u0:.6g}"]
        simulated = self.simulated_threshold
        by_formula = ("by formula", self.threshold), ("with the slope of friction", self.threshold_with_slope)
        for name, value in by_formula:
            lines.append(f"threshold {name} {value:.6g}")
            if simulated is not None and value > 0.0:
                lines[-1] += f" (simulation {simulated / value - 1.0:+.2%})"
        if simulated is not None:
            lines.append(f"threshold by simulation {simulated:.6g}")
        swings = [format(swing, ".4g") if math.isfinite(swing) else "-" for swing in (self.swing, self.free_swing)]
        lines.append(f"peak to peak of x {swings[0]}; without the drive {swings[1]}")
        if self.linear_ripple is not None:
            lines.append(f"of spring and mass alone under the drive {self.linear_ripple:.4g}")
        return lines

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the motion with and without its drive; without ``ax`` also its swing over the amplitude, below."""
        if ax is not None:
            return super().plot(ax)
        from rig_sim.results.pictures.control import quench_figure

        return quench_figure(self.flow, *self.start)

    def draw(self, ax: "Axes") -> None:
        from rig_sim.results.pictures.control import draw_dither

        draw_dither(ax, self.flow, *self.start)


@dataclass(frozen=True, repr=False)
class Lock(Result):
    """An unstable orbit, and how the motion was locked onto it: what `rig_sim.lock` returns.

    Attributes
    ----------
    method : str
    period : int
        Landings in one turn of the orbit.
    budget, du_limit : float
        Largest change of the drive's amplitude, as a fraction of it, and N.
    outcome, advice : str
        'locked', or why not and what to do.
    orbit : dict or None
        The orbit locked onto: x at break-away (m), t and x of its landings, duration, drive periods, multipliers.
    orbits : list of dict
        All that were found, the least unstable first.
    regular_period : int or None
        On which the motion settles without control.
    locked : bool
    events_to_lock : int or None
        Landings before the control that held.
    events : int
    du_max, du_final : float
        Largest and last change of the amplitude, N.
    """

    method: str
    period: int
    budget: float
    du_limit: float
    outcome: str = ""
    advice: str = ""
    orbit: dict[str, Any] | None = None
    orbits: list[dict[str, Any]] = field(default_factory=list)
    regular_period: int | None = None
    locked: bool = False
    events_to_lock: int | None = None
    events: int = 0
    du_max: float = 0.0
    du_final: float = 0.0
    kept: int | None = None
    name: str = field(default="", repr=False, compare=False)
    system: Any = field(default=None, repr=False, compare=False)
    control: "Controlling | None" = field(default=None, repr=False, compare=False)

    UNITS: ClassVar[Mapping[str, str]] = {"t": "s", "x": "m", "change": "N", "x_slip": "m"}

    def as_json(self) -> dict[str, Any]:
        data = super().as_json()
        if self.kept is None:
            del data["kept"]
        return data

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [{name: value for name, value in self.as_json().items() if name not in ("orbit", "orbits")}]

    def to_dataframe(self) -> "pd.DataFrame":
        """Return a row for each landing under control: t within the drive's period, x, and the change of the amplitude.

        Of a custom system: each coordinate of the state, and the change of the parameter.  Empty where there was
        no motion under control.
        """
        import numpy as np
        import pandas as pd

        is_formula = not hasattr(self.system, "find_landing")
        d = len(self.system.scale)
        names = [f"x{i}" for i in range(d)] if is_formula else ["t", "x"]
        if self.control is None:
            return pd.DataFrame(columns=[*names, "change"], dtype=np.float64)
        changes = np.append(self.control.changes, np.nan)
        table = pd.DataFrame(np.column_stack([self.control.states, changes]), columns=[*names, "change"])
        table.attrs["units"] = {} if is_formula else {name: self.UNITS[name] for name in (*names, "change")}
        return table

    def lines(self) -> list[str]:
        lines = [f"outcome        {self.outcome}" + (f" ({self.advice})" if self.advice else "")]
        if self.regular_period is not None:
            lines.append(f"without control the motion settles on period {self.regular_period}")
        for rank, orbit in enumerate(self.orbits[:SHOWN] or [self.orbit]):  # type: ignore[list-item]
            if orbit is not None:
                where, points = ("x at break-away", orbit["x_slip"]) if "x_slip" in orbit else ("x", orbit["x"])
                more = " ..." if len(points) > SHOWN else ""
                positions = ", ".join(f"{x:.12g}" for x in points[:SHOWN]) + more
                size = f", multiplier {format_multiplier(orbit['multipliers'][0])}" if "multipliers" in orbit else ""
                lines.append(f"{'orbit' if rank == 0 else '':14} {where} {positions}{size}")
        lines.append(f"locked         {self.locked}")
        if self.events_to_lock is not None:
            lines.append(f"events to lock {self.events_to_lock}")
        limit = f"{self.du_max:.6g} of {self.du_limit:.6g} allowed, last {self.du_final:.3g}"
        return [*lines, f"largest change {limit}"]

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the landings; without ``ax`` also the changes of the amplitude, the phase portrait and the velocity."""
        if ax is not None or self.control is None or not hasattr(self.system, "find_landing"):
            return super().plot(ax)
        from rig_sim.results.pictures.control import lock_figure

        return lock_figure(self.system, self.control, self.period, self.budget)

    def undrawn(self) -> str:
        """Return why there is nothing to draw; "" where there is something."""
        return "there is no motion under control" if self.control is None else ""

    def draw(self, ax: "Axes") -> None:
        from rig_sim.results.pictures.control import draw_landings

        draw_landings(ax, self.control)


@dataclass(frozen=True, repr=False)
class Shaker(Result):
    """The small oscillation under a shaker that feeds the velocity back: what `rig_sim.shaker` returns.

    Attributes
    ----------
    omega, delta : float
        Frequency (rad/s) and growth rate (1/s).
    stable : bool
        Whether it decays and its frequency lies within the band.
    roots : tuple of complex
        Both roots omega + i delta.
    band : (float, float) or None
        The frequencies that the filter passes, rad/s.
    in_band : bool
    stable_phases, stable_amplifications : list of (float, float)
        Intervals of phi (rad) at this a, and of a (N s/m) at this phi.
    """

    omega: float
    delta: float
    stable: bool
    roots: tuple[complex, complex]
    band: tuple[float, float] | None
    in_band: bool
    stable_phases: list[tuple[float, float]]
    stable_amplifications: list[tuple[float, float]]
    a: float = field(default=0.0, repr=False, compare=False)
    phi: float = field(default=0.0, repr=False, compare=False)
    plane: "ShakerPlane | None" = field(default=None, repr=False, compare=False)
    name: str = field(default="a mass", repr=False, compare=False)

    UNITS: ClassVar[Mapping[str, str]] = {"omega": "rad/s", "delta": "1/s", "band": "rad/s", "stable_phases": "rad"}
    SIZE = (8.6, 6.2)

    def lines(self) -> list[str]:
        kind = "decays" if self.delta < 0.0 else "grows" if self.delta > 0.0 else "neither grows nor decays"
        outside = "" if self.in_band else ", but its frequency lies outside the filter's band"
        return [
            f"omega  {self.omega:.15g} rad/s",
            f"delta  {self.delta:.15g} 1/s: the oscillation {kind}{outside}",
            f"stable {self.stable}",
            f"stable phases at a = {self.a:g}: {format_intervals(self.stable_phases)}",
            f"stable amplifications at phi = {self.phi:g}: {format_intervals(self.stable_amplifications)}",
        ]

    def draw(self, ax: "Axes") -> None:
        from rig_sim.results.pictures.control import draw_shaker

        if self.plane is not None:
            draw_shaker(ax, self.plane, self.a, self.phi)


def quench(scene: SceneLike, *, progress: Stages = silent) -> Quench:
    """Find whether a fast drive (dither) quenches stick-slip, and from which amplitude on: ``rig-sim quench``.

    ``threshold`` is the amplitude u0 with which the mass alone reaches the belt's speed: v_belt abs(k - m omega^2 + i c
    omega) / omega; ``threshold_with_slope`` counts the slope of friction there as damping.  ``simulated_threshold`` is
    the least u0 with which the simulated motion, from the scene's start, loses its stick-slip; ``quenched`` says so for
    the scene's own u0.

    Parameters
    ----------
    scene : str, Path or Scene
        A built-in name (see ``rig-sim scenes``) or a TOML file, of one mass with a drive.  In Python also what
        `rig_sim.scene` returns.
    progress : callable, optional
        Called with the stage, what is done of it, and its whole.

    Returns
    -------
    Quench

    Raises
    ------
    InputError
        No such scene, two masses, no drive, or a drive without a period.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.quench(rig_sim.scene("forced", **{"drive.omega": 20, "drive.u0": 1.75}))
    >>> found.quenched, round(found.threshold, 4)
    (True, 1.6957)
    """
    from rig_sim.analyses.control.dither import quench as find

    loaded = load_scene(scene)
    flow, x, v = require_period(loaded)
    return Quench(**vars(find(flow, x, v, progress)), name=loaded.name, flow=flow, start=(x, v))


def lock(
    scene: SceneLike | FormulaMap,
    period: int,
    budget: float,
    *,
    method: Literal["ogy", "search"] = "ogy",
    events: int = 20_000,
    progress: Stages = silent,
) -> Lock:
    """Find an unstable orbit of a driven mass, and lock the motion onto it by small changes: ``rig-sim lock``.

    What changes is the drive's amplitude.  The orbits are found by close returns of the uncontrolled motion; of
    several, the least unstable one is taken.  An event is a landing: a passage from slip to stick.

    Parameters
    ----------
    scene : str, Path, Scene or FormulaMap
        A built-in name (see ``rig-sim scenes``) or a TOML file, of one mass with a drive.  In Python also what
        `rig_sim.scene` returns, or a `rig_sim.FormulaMap` whose `step` takes changes of its parameter.
    period : int
        Landings in one turn of the orbit, 1 to 100.
    budget : float
        Largest change of the drive's amplitude, as a fraction of it, from 0 to 1.
    method : str
        'ogy' (Ott, Grebogi and Yorke: a change at each landing), or 'search' (the thesis's: raise the amplitude until
        the section repeats, then take it back).
    events : int
        Landings after which the control gives up.
    progress : callable, optional
        Called with the stage, what is done of it, and its whole.

    Returns
    -------
    Lock

    Raises
    ------
    InputError
        No such scene or method, two masses, no drive, or a number out of range.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.lock("forced", period=2, budget=0.0235)
    >>> found.locked, found.du_max <= found.du_limit
    (True, True)
    """
    size = parse_plain_number(budget, "--budget")
    check_size("budget", size)
    if size > 1.0:
        raise InputError(f"is {size:g}", "--budget", "give a fraction of drive.u0, from 0 to 1")
    orbit_period, max_events = parse_whole(period, "--period"), parse_whole(events, "--events")
    if not 1 <= orbit_period <= MOST_PERIOD:
        raise InputError(f"is {period}", "--period", f"give 1 to {MOST_PERIOD} landings")
    if not 1 <= max_events <= MOST_EVENTS:
        raise InputError(f"is {events}", "--events", f"give 1 to {MOST_EVENTS}")
    check_known(method, METHODS, "method", "--method")
    fields, f, control, name = lock_motion(scene, orbit_period, size, method, max_events, progress)
    return Lock(method, orbit_period, size, size * f.strength, **fields, name=name, system=f, control=control)


def lock_motion(
    scene: SceneLike | FormulaMap, period: int, budget: float, method: str, events: int, progress: Stages
) -> "tuple[dict[str, Any], FormulaMap, Controlling | None, str]":
    """Return the fields of a lock, the map, the motion under control, and the system's name."""
    from rig_sim.analyses.control.locking import find_and_lock
    from rig_sim.systems.step_budget import StepBudget

    f: FormulaMap
    if isinstance(scene, FormulaMap):
        f, start, name = scene, scene.start, type(scene).__name__
    else:
        loaded = load_scene(scene)
        f = landings = make_landing_map(loaded, StepBudget(max(STEPS_IN_ALL, STEPS_PER_EVENT * events)))
        first = landings.first_landing(float(loaded.start.x), float(loaded.start.v))
        start, name = first.state, loaded.name
        if first.outcome != "completed":
            advice = "the motion does not reach a stick: change the drive or the belt"
            return {"outcome": first.outcome, "advice": advice}, f, None, name
    if method == "search":
        return search_orbit(f, start, period, budget, progress), f, None, name
    locking = find_and_lock(f, start, period, budget, events, progress)
    return collect_fields(f, locking), f, locking.lock, name


def collect_fields(f: FormulaMap, locking: "Locking") -> dict[str, Any]:
    """Return an attempt to lock as the result's fields, by name."""
    rows = [describe_orbit(f, orbit) for orbit in locking.orbits]
    data: dict[str, Any] = {"outcome": locking.outcome, "advice": locking.advice, "orbits": rows}
    data |= {"orbit": rows[0] if rows else None, "regular_period": locking.regular}
    if locking.lock is not None:
        sizes = [abs(float(change)) for change in locking.lock.changes]
        data |= {"locked": locking.lock.locked, "events_to_lock": locking.lock.events_to_lock, "events": len(sizes)}
        data |= {"du_max": max(sizes, default=0.0), "du_final": float(locking.lock.changes[-1]) if sizes else 0.0}
    return data


def describe_orbit(f: FormulaMap, orbit: "UnstableOrbit") -> dict[str, Any]:
    from rig_sim.systems.landing import LandingMap

    if not isinstance(f, LandingMap):
        return {"points": orbit.points, "x": orbit.points[:, 0], "multipliers": orbit.multipliers}
    landings = [f.find_landing(point) for point in orbit.points]
    duration = math.fsum(landing.duration for landing in landings)
    return {
        "x_slip": [landing.x_slip for landing in landings],
        "t": orbit.points[:, 0],
        "x": orbit.points[:, 1],
        "duration": duration,
        "drive_periods": round(duration / f.period),
        "multipliers": orbit.multipliers,
    }


def search_orbit(f: FormulaMap, start: "Array", period: int, budget: float, progress: Stages) -> dict[str, Any]:
    """Return the result of the thesis's search-and-lock as the result's fields, by name."""
    from rig_sim.analyses.control.locking import ADVICE
    from rig_sim.analyses.control.search_and_lock import search_and_lock
    from rig_sim.systems.landing import LandingMap
    from rig_sim.systems.step_budget import StepLimitError

    try:
        search = search_and_lock(f, start, period, budget, progress=progress)
    except StepLimitError:
        return {"outcome": "step limit", "advice": ADVICE["step limit"]}
    if search.change is None or search.points is None:
        advice = "the section did not repeat with this period: raise the budget"
        return {"outcome": "not locked", "advice": advice, "events": search.events, "du_max": budget * f.strength}
    orbit: dict[str, Any] = {"points": search.points, "x": search.points[:, 0]}
    if isinstance(f, LandingMap):
        x_slip = [f.find_landing(point, search.change).x_slip for point in search.points]
        orbit = {"x_slip": x_slip, "t": search.points[:, 0], "x": search.points[:, 1]}
    data = {"orbit": orbit, "events_to_lock": search.events, "events": search.events, "kept": search.kept}
    data |= {"du_max": search.change, "du_final": 0.0, "locked": search.stays}
    advice = "without the change the motion leaves the orbit: take the method ogy"
    return data | ({"outcome": "locked"} if search.stays else {"outcome": "locked while changed", "advice": advice})


def shaker(
    m: float | str,
    k: float | str,
    c: float | str,
    gamma: float | str,
    a: float | str,
    phi: float | str,
    *,
    band: "str | tuple[float, float] | None" = None,
) -> Shaker:
    """Find frequency and growth rate of the small oscillation under a shaker that feeds the velocity back.

    The shaker's force is the velocity times ``a``, ahead of it by ``phi``; ``phi`` = pi is a damper.  The picture shows
    the curves of constant growth rate and frequency over phase and amplification, and shades where the oscillation
    decays.

    Parameters
    ----------
    m : float or str
        Mass, kg or with a unit, '300 g'.
    k : float or str
        Spring, N/m or with a unit.
    c : float or str
        Damper, N s/m or with a unit.
    gamma : float or str
        Slope of friction at the belt's speed, N s/m: above 0 where it falls with the slip speed.
    a : float or str
        Amplification, N s/m.
    phi : float or str
        Phase by which the force leads the velocity, rad, or '170 deg'.
    band : str or (float, float), optional
        The frequencies that the filter passes, 'LOW:HIGH' in rad/s; ``stable`` needs them.  In Python also (low, high).

    Returns
    -------
    Shaker

    Raises
    ------
    InputError
        A number that is not finite, or of the wrong sign; another form of ``band``.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.shaker(m=1, k=1, c=0, gamma=0.3, a=0.5, phi=3, band=(0.9, 1.1))
    >>> found.stable, round(found.delta, 4)
    (True, -0.101)
    """
    from rig_sim.analyses.control.phasor import phasor_roots
    from rig_sim.analyses.control.stability import ShakerPlane

    kinds = {"m": "mass", "k": "stiffness", "c": "damping", "gamma": "damping", "a": "damping", "phi": "angle"}
    arguments = {"m": m, "k": k, "c": c, "gamma": gamma, "a": a, "phi": phi}
    values = {name: parse_number(arguments[name], kinds[name], f"--{name}") for name in kinds}
    for name, size in values.items():
        check_size(name, size, positive=name in ("m", "k"), negative=name in ("c", "gamma", "phi"))
    passband = None if band is None else parse_band(band)
    plane = ShakerPlane(values["m"], values["k"], values["gamma"] - values["c"], passband)
    level, phase = values["a"], values["phi"]
    roots = phasor_roots(plane.m, plane.k, plane.S, level, phase)
    return Shaker(
        roots[0].real,
        roots[0].imag,
        plane.is_stable(level, phase),
        roots,
        plane.band,
        plane.passes(roots[0].real),
        plane.stable_phases(level),
        plane.stable_amplifications(phase),
        level,
        phase,
        plane,
    )


def check_size(name: str, value: float, *, positive: bool = False, negative: bool = False) -> None:
    if not math.isfinite(value) or abs(value) > LARGEST or 0.0 < abs(value) < SMALLEST:
        raise InputError(f"is {value:g}", f"--{name}", f"give 0 or a size from {SMALLEST:g} to {LARGEST:g}")
    if (positive and value <= 0.0) or (not negative and value < 0.0):
        raise InputError(f"is {value:g}", f"--{name}", "give a number above 0" if positive else "give 0 or more")


def parse_band(band: "str | tuple[float, float]") -> tuple[float, float]:
    do, python = "write LOW:HIGH in rad/s, as in 0.9:1.1", "give (low, high) in rad/s, as in (0.9, 1.1)"
    ends: Sequence[Any] = band.split(":") if isinstance(band, str) else band
    try:
        first, last = ends
    except (TypeError, ValueError):
        raise InputError(f"{band!r} is no band", "--band", do, python=python) from None
    low, high = (parse_number(end, "angular frequency", "--band") for end in (first, last))
    if not 0.0 <= low < high < math.inf:
        raise InputError(f"{band!r} is no band", "--band", "give 0 <= LOW < HIGH, in rad/s")
    return low, high


def format_intervals(intervals: list[tuple[float, float]]) -> str:
    return ", ".join(f"{low:.6g} to {high:.6g}" for low, high in intervals) or "none"


def format_multiplier(value: complex) -> str:
    return f"{value.real:.10g}" if value.imag == 0.0 else f"{value:.10g}"
