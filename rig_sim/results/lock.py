"""An unstable orbit of a driven mass, held by small changes of the drive: thesis figures 6.12 to 6.17."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from rig_sim.analyses.control import locking as ogy
from rig_sim.analyses.control.locking import ADVICE, Locking, find_and_lock
from rig_sim.analyses.control.search_and_lock import search_and_lock
from rig_sim.analyses.unstable_orbits import UnstableOrbit
from rig_sim.results.arguments import SceneLike, check_size, load_scene, parse_plain_number, parse_whole
from rig_sim.results.result import PALE, STABLE, UNIT, UNSTABLE, Result
from rig_sim.results.scene_systems import make_landing_map
from rig_sim.systems.formula import FormulaMap
from rig_sim.systems.interface import StepBudget, StepLimitError
from rig_sim.systems.landing import LandingMap
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError, check_known

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METHODS = ("ogy", "search")
MOST_PERIOD = 100  # longest period of a search; the multipliers of longer orbits are beyond the digits of a motion
MOST_EVENTS = 10_000_000
# Integrator steps of a lock, 5 s, or of each requested event.  Of the thesis's motions periods 1 to 5 take 5e5 and
# period 100 takes 6e6; an event takes 80.
STEPS_IN_ALL, STEPS_PER_EVENT = 10_000_000, 200
SHOWN = 5  # orbits, and positions of an orbit, in the text
SAMPLES = 200  # per drive period, of a drawn motion
BEFORE = 12  # landings before the control in the phase portrait
TURNS = 3  # turns of the orbit drawn over time


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
    system: Any = field(default=None, repr=False, compare=False)
    control: ogy.Lock | None = field(default=None, repr=False, compare=False)

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
        import pandas as pd

        is_formula = not isinstance(self.system, LandingMap)
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

    def draw_page(self, page: "Figure") -> None:
        """Draw the landings; of a driven mass also the changes of the amplitude, the phase portrait, the velocity."""
        if self.control is None or not isinstance(self.system, LandingMap):
            return super().draw_page(page)
        page.set_size_inches(10.0, 7.0)
        ((landings, changes), (portrait, velocity)) = page.subplots(2, 2)
        self.draw(landings)
        self.draw_control(self.system, self.control, changes, portrait, velocity)

    def draw_control(
        self, f: LandingMap, control: ogy.Lock, changes: "Axes", portrait: "Axes", velocity: "Axes"
    ) -> None:
        """Draw the change of the amplitude, the phase portrait and the velocity."""
        changes.plot(100.0 * control.changes / f.strength, ".-", ms=3, lw=0.8, color=UNSTABLE)
        for side in (-1, 1):
            changes.axhline(side * 100.0 * self.budget, color=PALE, lw=0.8, ls="--")
        changes.set(xlabel="landing", ylabel="change of u0 (%)", title="Control; dashed: the budget")
        if control.events_to_lock is not None:
            changes.axvline(control.events_to_lock, color="black", lw=0.8, ls=":")
        first, last = max((control.events_to_lock or 0) - BEFORE, 0), len(control.changes)
        for part, colour, width in (
            (slice(first, first + BEFORE), "0.75", 0.7),
            (slice(last - self.period, last), STABLE, 1.6),
        ):
            _, x, v = f.sample_motion(control.states[:last][part], control.changes[part], SAMPLES / f.period)
            portrait.plot(x, v, color=colour, lw=width)
        portrait.set(xlabel=f"x {UNIT}", ylabel=f"v {UNIT}")
        portrait.set_title(f"Last {self.period} landings; grey: before the control")
        drawn = slice(max(last - TURNS * self.period, 0), last)
        time, _, v = f.sample_motion(control.states[drawn], control.changes[drawn], SAMPLES / f.period)
        velocity.plot(time, v, color=STABLE, lw=1.0)
        velocity.set(xlabel="time (the scene's unit)", ylabel=f"v {UNIT}", title="Velocity on the orbit")

    def undrawn(self) -> str:
        """Return why there is nothing to draw; "" where there is something."""
        return "no motion was controlled" if self.control is None else ""

    def draw(self, ax: "Axes") -> None:
        if self.control is not None:
            ax.plot(self.control.states[:, -1], ".", ms=3, color=STABLE)
            if self.control.events_to_lock is not None:
                ax.axvline(self.control.events_to_lock, color="black", lw=0.8, ls=":")
        ax.set(xlabel="landing", ylabel=f"x at landing {UNIT}", title="Landings")


def lock(
    scene: SceneLike | FormulaMap,
    period: int,
    budget: float,
    *,
    method: Literal["ogy", "search"] = "ogy",
    events: int = 20_000,
    progress: Stages = silent,
) -> Lock:
    """Lock a driven mass onto an unstable orbit by small changes of the drive: ``rig-sim lock``.

    The control changes the amplitude of the drive.  The orbits are found from close returns of the uncontrolled motion,
    and the least unstable one is used.  An event is a landing, that is, a transition from slip to stick.

    Parameters
    ----------
    scene : str, Path, Scene or FormulaMap
        Scene of one mass with a drive: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also the
        result of `rig_sim.scene`, or a `rig_sim.FormulaMap` whose `step` takes changes of its parameter.
    period : int
        Number of landings in one period of the orbit, 1 to 100.
    budget : float
        Largest relative change of the drive amplitude, from 0 to 1.
    method : str
        'ogy' (Ott, Grebogi and Yorke: a change at each landing), or 'search' (the method of the thesis: increase the
        amplitude until the section repeats, then undo the change).
    events : int
        Number of landings after which the control stops.
    progress : callable, optional
        Called with the stage, the work done and the total work.

    Returns
    -------
    Lock

    Raises
    ------
    InputError
        If the scene or method does not exist, the scene has two masses or no drive, or a number is out of range.

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
        raise InputError(f"is {size:g}", "--budget", "use a fraction of drive.u0, from 0 to 1")
    orbit_period = parse_whole(period, "--period", 1, MOST_PERIOD, " landings")
    max_events = parse_whole(events, "--events", 1, MOST_EVENTS)
    check_known(method, METHODS, "method", "--method")
    f: FormulaMap
    outcome = "completed"
    if isinstance(scene, FormulaMap):
        f, start, name = scene, scene.start, type(scene).__name__
    else:
        loaded = load_scene(scene)
        f = landings = make_landing_map(loaded, StepBudget(max(STEPS_IN_ALL, STEPS_PER_EVENT * max_events)))
        first = landings.first_landing(float(loaded.start.x), float(loaded.start.v))
        start, name, outcome = first.state, loaded.name, first.outcome
    result = partial(Lock, method, orbit_period, size, size * f.strength, name=name, system=f)
    if outcome != "completed":
        return result(outcome=outcome, advice="the motion does not reach a stick; change the drive or the belt")
    if method == "search":
        return result(**search_orbit(f, start, orbit_period, size, progress))
    locking = find_and_lock(f, start, orbit_period, size, max_events, progress)
    return result(**collect_fields(f, locking), control=locking.lock)


def collect_fields(f: FormulaMap, locking: Locking) -> dict[str, Any]:
    """Return an attempt to lock as the result's fields, by name."""
    rows = [describe_orbit(f, orbit) for orbit in locking.orbits]
    data: dict[str, Any] = {"outcome": locking.outcome, "advice": locking.advice, "orbits": rows}
    data |= {"orbit": rows[0] if rows else None, "regular_period": locking.regular}
    if locking.lock is not None:
        sizes = [abs(float(change)) for change in locking.lock.changes]
        data |= {"locked": locking.lock.locked, "events_to_lock": locking.lock.events_to_lock, "events": len(sizes)}
        data |= {"du_max": max(sizes, default=0.0), "du_final": float(locking.lock.changes[-1]) if sizes else 0.0}
    return data


def describe_orbit(f: FormulaMap, orbit: UnstableOrbit) -> dict[str, Any]:
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


def search_orbit(f: FormulaMap, start: Array, period: int, budget: float, progress: Stages) -> dict[str, Any]:
    """Return the result of the thesis's search-and-lock as the result's fields, by name."""
    try:
        search = search_and_lock(f, start, period, budget, progress=progress)
    except StepLimitError:
        return {"outcome": "step limit", "advice": ADVICE["step limit"]}
    if search.change is None or search.points is None:
        advice = "the section did not repeat with this period; increase the budget"
        return {"outcome": "not locked", "advice": advice, "events": search.events, "du_max": budget * f.strength}
    orbit: dict[str, Any] = {"points": search.points, "x": search.points[:, 0]}
    if isinstance(f, LandingMap):
        x_slip = [f.find_landing(point, search.change).x_slip for point in search.points]
        orbit = {"x_slip": x_slip, "t": search.points[:, 0], "x": search.points[:, 1]}
    data = {"orbit": orbit, "events_to_lock": search.events, "events": search.events, "kept": search.kept}
    data |= {"du_max": search.change, "du_final": 0.0, "locked": search.stays}
    advice = "the motion leaves the orbit without the change; use the method ogy"
    return data | ({"outcome": "locked"} if search.stays else {"outcome": "locked while changed", "advice": advice})


def format_multiplier(value: complex) -> str:
    return f"{value.real:.10g}" if value.imag == 0.0 else f"{value:.10g}"
