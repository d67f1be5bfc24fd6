"""Maps of two masses from stick to stick, or of one's own: map, basins, and Lyapunov exponents of any system."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rig_sim.analyses import basins as cell_mapping
from rig_sim.analyses import exponent as growth
from rig_sim.analyses.exponent import BLOCKS, exponent, rotation_number
from rig_sim.analyses.periodic_points import PeriodicPoint, find_periodic_orbits
from rig_sim.motion.two_masses import find_stretch
from rig_sim.results.arguments import SceneLike, load_scene, parse_whole
from rig_sim.results.result import COLOURS, PALE, STABLE, UNIT, Result
from rig_sim.results.scene_systems import make_driven_map, make_stick_map, require_interval
from rig_sim.scenes.model import Scene
from rig_sim.systems import stick
from rig_sim.systems.formula import FormulaMap
from rig_sim.systems.interface import OnInterval, StepBudget
from rig_sim.systems.stick import StickEvent, StickMap
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_CELLS = 1_000_000
MOST_EVENTS = 10_000_000
STEPS_PER_EVENT = 1000  # of basins and of lyapunov, whose slopes take four more events; the thesis's take 30 each
MANY_EVENTS = 500  # interpreted a few seconds; above, compiled code is faster including its compilation
SECTION_PER = {"landing": "landing", "drive period": "poincare"}  # sections of a driven mass, in the order tried
ROTATIONS = 2000  # landings in the mean time between two
PLACES = 4000  # points of the drawn curve of a map
VISIBLE, HALVINGS = 0.005, 30  # least visible jump of a map, of its interval; halvings that tell it from a steep rise


@dataclass(frozen=True, repr=False)
class Map(Result):
    """What a map makes of places, and its periodic orbits: what `rig_sim.map` returns.

    Attributes
    ----------
    d, f : tuple of float
        Stretches x2 - x1 (m) of a global stick, and those that follow; of a map of one's own x and its images.
    word : tuple of str
        Which mass broke away, in order; of several events the words are separated by spaces.
    duration : tuple of float
        Of the events, s.
    outcome, advice : tuple of str
        'completed', or how an event ended instead, and what to do.
    periodic : tuple of PeriodicPoint or None
        The orbits of the period ``iterate``, where they were asked for.
    several : bool
        Whether a list of places was given, of which JSON has lists too.
    """

    d: tuple[float, ...]
    f: tuple[float, ...]
    word: tuple[str, ...]
    duration: tuple[float, ...]
    outcome: tuple[str, ...]
    advice: tuple[str, ...]
    periodic: tuple[PeriodicPoint, ...] | None = None
    several: bool = field(default=True, repr=False, compare=False)
    has_places: bool = field(default=True, repr=False, compare=False)
    iterate: int = field(default=1, repr=False, compare=False)
    system: Any = field(default=None, repr=False, compare=False)

    UNITS: ClassVar[Mapping[str, str]] = {"d": "m", "f": "m", "duration": "s"}
    SIZE = (6.4, 6.2)

    def as_json(self) -> dict[str, Any]:
        data: dict[str, Any] = {}
        if self.has_places:
            names = ("d", "f", "word", "duration", "outcome", "advice")
            data = {name: list(getattr(self, name)) for name in names}
            if not self.several:
                data = {name: values[0] for name, values in data.items()}
        if self.periodic is not None:
            data["periodic"] = [
                {**asdict(orbit), "period": orbit.period, "stable": orbit.stable} for orbit in self.periodic
            ]
        return data

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return a row for each place; where only periodic orbits were requested, one for each of these."""
        if not self.has_places:
            return self.as_json().get("periodic", [])  # type: ignore[no-any-return]
        columns = {name: getattr(self, name) for name in ("d", "f", "word", "duration", "outcome", "advice")}
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def lines(self) -> list[str]:
        lines = [f"{'d':>22} {'f(d)':>22}  word"] if self.has_places else []
        for d, f, word, outcome, advice in zip(self.d, self.f, self.word, self.outcome, self.advice, strict=True):
            end = "" if outcome == "completed" else f"  {outcome} ({advice})"
            lines.append(f"{d:22.15g} {format(f, '.15g') if math.isfinite(f) else '-':>22}  {word}{end}")
        if self.periodic is not None:
            lines += [
                f"period {orbit.period}, {'stable' if orbit.stable else 'unstable'}, slope {orbit.slope:.12g}: "
                + ", ".join(f"{point:.15g}" for point in orbit.points)
                for orbit in self.periodic
            ] or [f"no orbit of period {self.iterate} was found"]
        return lines

    def draw(self, ax: "Axes") -> None:
        """Draw the iterate of the map, with the points where it meets the diagonal."""
        f, times = self.system, self.iterate
        x = np.linspace(f.lo, f.hi, PLACES)
        y = f.images(x, times)
        cuts = find_jumps(f, times, x, y) + 1
        ax.plot([f.lo, f.hi], [f.lo, f.hi], color="0.6", lw=0.8)
        ax.plot(np.insert(x, cuts, np.nan), np.insert(y, cuts, np.nan), lw=1.2)
        for period in range(1, times + 1):
            if times % period:
                continue
            for orbit in find_periodic_orbits(f, period):
                kind = "stable" if orbit.stable else "unstable"
                face = "black" if orbit.stable else "white"
                label = f"{kind}, period {period}"
                ax.plot(orbit.points, orbit.points, "o", ms=6, mfc=face, mec="black", label=label)
        handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
        if handles:
            ax.legend(handles.values(), handles.keys(), loc="best")
        name = "f" if times == 1 else f"f^{times}"
        ax.set(xlabel=f"d = x2 - x1 in global stick {UNIT}", ylabel=f"{name}(d) {UNIT}")
        ax.set_title(f"Map {name} from stick to stick")
        ax.set_aspect("equal")


@dataclass(frozen=True, repr=False)
class Basins(Result, cell_mapping.Basins):
    """Attractors of a map, and their basins: what `rig_sim.basins` returns."""

    UNITS: ClassVar[Mapping[str, str]] = {"centre": "m"}
    SIZE = (8.6, 2.6)

    def as_json(self) -> dict[str, Any]:
        return super().as_json() | {"attractors": [asdict(attractor) for attractor in self.attractors]}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        """Return a row for each attractor."""
        return [{"attractor": number, **asdict(attractor)} for number, attractor in enumerate(self.attractors, 1)]

    def lines(self) -> list[str]:
        lines = []
        for number, attractor in enumerate(self.attractors, 1):
            kind = f"period {attractor.period}" if attractor.period else "not periodic"
            few = ", ".join(f"{point:.12g}" for point in attractor.points[:4])
            more = " ..." if len(attractor.points) > 4 else ""
            lines.append(f"attractor {number}: {100.0 * attractor.share:.3f} %, {kind}: {few}{more}")
        if self.nowhere or not self.attractors:
            lines.append(f"no global stick: {100.0 * self.nowhere:.3f} %")
        return lines

    def draw(self, ax: "Axes") -> None:
        """Draw which attractor each start d leads to; above, the points of the attractors."""
        centres = self.centres
        half = 0.5 * (centres[1] - centres[0])
        for index, attractor in enumerate(self.attractors):
            colour = COLOURS[index % len(COLOURS)]
            label = f"attractor {index + 1}: {100.0 * attractor.share:.1f} %"
            ax.fill_between(centres, 0.0, 1.0, where=self.fate == index, color=colour, step="mid", lw=0, label=label)
            ax.plot(attractor.points, np.full(len(attractor.points), 1.15), "o", ms=4, mew=0, color=colour)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        ax.set(xlim=(centres[0] - half, centres[-1] + half), ylim=(0.0, 1.3), yticks=[])
        ax.set(xlabel=f"d = x2 - x1 at the start {UNIT}", title="Basins; above, the attractors")


@dataclass(frozen=True, repr=False)
class Exponent(Result, growth.Exponent):
    """A Lyapunov exponent: what `rig_sim.lyapunov` returns.

    Attributes
    ----------
    exponent, stderr : float
        Mean logarithm by which a small deviation grows, and its standard error: 0 on a periodic attractor.
    events : int
        That it was taken over.
    period : int or None
        Of a periodic attractor.
    outcome : str
        'completed', or why there is none.
    per : str
        'event' (from one global stick to the next), 'landing', 'drive period', or 'step' of a system of one's own.
    drive_periods_per_landing : float or None
        Rotation number of a driven mass.
    """

    per: str
    drive_periods_per_landing: float | None = None
    advice: str = field(default="", repr=False, compare=False)

    def as_json(self) -> dict[str, Any]:
        data = super().as_json()
        if self.drive_periods_per_landing is None:
            del data["drive_periods_per_landing"]
        return data

    def lines(self) -> list[str]:
        if self.outcome != "completed":
            return [f"{self.outcome}: {self.advice}"]
        orbit = f"period {self.period}, exact" if self.period else f"over {self.events} {self.per}s"
        return [f"{format_with_error(self.exponent, self.stderr)} per {self.per} ({orbit})"]

    def draw(self, ax: "Axes") -> None:
        ax.axhline(0.0, color=PALE, lw=0.8)
        ax.errorbar([0.0], [self.exponent], yerr=[self.stderr], fmt="o", capsize=4, color=STABLE)
        ax.set(xticks=[], ylabel=f"Lyapunov exponent per {self.per}", title=self.name)


def find_jumps(f: OnInterval, times: int, x: Array, y: Array) -> Integers:
    """Return after which of the places ``x``, ascending, with the values ``y``, the ``times``-th iterate jumps.

    Between two places whose values differ visibly the greater half of the difference is followed: where the iterate is
    continuous, however steep, it becomes small.
    """
    after = np.flatnonzero(np.abs(np.diff(y)) > VISIBLE * (f.hi - f.lo))
    lower, upper, low, high = x[after], x[after + 1], y[after], y[after + 1]
    initial_difference = np.abs(high - low)
    for _ in range(HALVINGS if after.size else 0):
        middle = 0.5 * (lower + upper)
        value = f.images(middle, times)
        first = np.abs(value - low) >= np.abs(high - value)
        lower, low = np.where(first, lower, middle), np.where(first, low, value)
        upper, high = np.where(first, middle, upper), np.where(first, value, high)
    return after[np.abs(high - low) > 0.5 * initial_difference]


def map(
    scene: SceneLike | FormulaMap,
    d: float | Sequence[float] | None = None,
    *,
    iterate: int = 1,
    periodic: bool = False,
) -> Map:
    """Compute the map of d = x2 - x1 of two masses from one global stick to the next: ``rig-sim map``.

    The word lists the masses in the order of their break-aways; spaces separate the words of several events.  The start
    of the masses and of the belt is ignored.

    Parameters
    ----------
    scene : str, Path, Scene or FormulaMap
        Scene of two masses: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also the result of
        `rig_sim.scene`, or a `rig_sim.FormulaMap` of an interval, whose x is ``d``.
    d : float or sequence of float, optional
        Value of d while both masses stick, in m, or several values such as 0.05,0.1.
    iterate : int
        Number of iterations of the map.
    periodic : bool
        Find the periodic orbits of the map with the period ``iterate``.

    Returns
    -------
    Map
        With ``plot()``, the iterate over its interval.

    Raises
    ------
    InputError
        If the scene has one mass or a belt at rest, or ``iterate`` is below 1.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.map("two-mass", d=[0.05, 0.1], iterate=2)
    >>> found.to_dataframe()[["d", "f", "word"]].round(6)
          d         f   word
    0  0.05  0.142806  12 21
    1  0.10  0.123401  21 21
    """
    count = parse_whole(iterate, "--iterate", 1)
    f, name = load_interval_map(scene)
    several = not (d is None or isinstance(d, int | float))
    starts = parse_places(d)
    chains = [
        follow_events(f, d_start, count, len(starts)) if isinstance(f, StickMap) else map_place(f, d_start, count)
        for d_start in starts
    ]
    orbits = None
    if periodic:
        orbits = find_periodic_orbits(f, count)
    columns: list[Any] = list(zip(*chains, strict=True)) or [()] * 5
    images, word, duration, outcome, advice = columns
    parts = (word, duration, outcome, advice, orbits, several, d is not None, count, f)
    return Map(tuple(starts), images, *parts, name=name)


def parse_places(d: Any) -> list[float]:
    try:
        return [] if d is None else [float(d)] if isinstance(d, int | float) else [float(number) for number in d]
    except (TypeError, ValueError):
        problem = f"{d!r:.60} contains something that is not a number"
        raise InputError(problem, "--d", "write 0.1,0.2", python="use one number or several") from None


def follow_events(f: StickMap, d: float, times: int, places: int) -> tuple[float, str, float, str, str]:
    """Return d, word, duration, outcome and advice after ``times`` events that follow a global stick."""
    chain: list[StickEvent] = []
    for _ in range(times):
        chain.append(f.event(d, compiled=places * times > MANY_EVENTS))
        if chain[-1].outcome != "completed":
            break
        d = chain[-1].d
    last = chain[-1]
    word, duration = " ".join(event.word for event in chain), sum(event.duration for event in chain)
    return last.d, word, duration, last.outcome, last.advice


def map_place(f: FormulaMap, x: float, times: int) -> tuple[float, str, float, str, str]:
    image = float(f.images(np.array([x]), times)[0])
    is_defined = math.isfinite(image)
    end = ("completed", "") if is_defined else ("outside", f"the map is defined only from {f.lo:g} to {f.hi:g}")
    return (image, "", float(times), *end)


def basins(scene: SceneLike | FormulaMap, cells: int = 4000, *, progress: Stages = silent) -> Basins:
    """Find the attractors of two masses and the share of all values of d that leads to each: ``rig-sim basins``.

    The method is cell mapping.  The start of the masses and of the belt is ignored.

    Parameters
    ----------
    scene : str, Path, Scene or FormulaMap
        Scene of two masses: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also the result of
        `rig_sim.scene`, or a `rig_sim.FormulaMap` of an interval.
    cells : int
        Number of cells into which the interval is divided.
    progress : callable, optional
        Called with the stage, the work done and the total work.

    Returns
    -------
    Basins

    Raises
    ------
    InputError
        If the scene has one mass or a belt at rest, or the number of cells is out of range.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.basins(rig_sim.scene("two-mass", **{"belt.speed": 0.165}), cells=1000)
    >>> [attractor.period for attractor in found.attractors], found.shares[0] > found.shares[1]
    ([2, 2], True)
    """
    number = parse_whole(cells, "--cells", 2, MOST_CELLS)
    f, name = load_interval_map(scene, number)
    return Basins(**vars(cell_mapping.basins(f, number, progress)), name=name)


def load_interval_map(scene: SceneLike | FormulaMap, events: int = 0) -> tuple[StickMap | FormulaMap, str]:
    """Return a map of an interval with its name; of two masses with integrator steps for so many events, or more."""
    if isinstance(scene, FormulaMap):
        return require_interval(scene), type(scene).__name__
    loaded = load_scene(scene)
    return make_stick_map(loaded, StepBudget(max(stick.STEPS_IN_ALL, STEPS_PER_EVENT * events))), loaded.name


def lyapunov(scene: SceneLike | FormulaMap, events: int = 20_000, *, progress: Stages = silent) -> Exponent:
    """Find the Lyapunov exponent on the attractor that is reached from the start: ``rig-sim lyapunov``.

    For two masses, the exponent is computed from their map, per event.  For a driven mass, it is computed from the
    variational equation, per landing, or per drive period if the mass does not stick.  It is positive for chaos, and
    exact on a periodic attractor.

    Parameters
    ----------
    scene : str, Path, Scene or FormulaMap
        Scene of two masses with ``start.d`` or ``start.attractor``, or of a driven mass: a built-in name (see ``rig-sim
        scenes``) or a TOML file.  In Python also the result of `rig_sim.scene`, or a `rig_sim.FormulaMap`.
    events : int
        Number of events (global sticks, landings or steps) over which the mean is taken.
    progress : callable, optional
        Called with the stage, the work done and the total work.

    Returns
    -------
    Exponent

    Raises
    ------
    InputError
        If the scene has one mass without a drive, the start is not a global stick, or the number of events is out of
        range.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.lyapunov(rig_sim.scene("forced", **{"drive.omega": 1.1}), events=500)
    >>> found.per, found.exponent > 5 * found.stderr > 0
    ('landing', True)
    """
    number = parse_whole(events, "--events", BLOCKS, MOST_EVENTS)
    if isinstance(scene, FormulaMap):
        result = exponent(scene.motion(scene.start), number, progress)
        advice = "no exponent was found; use another start or other parameters"
        return Exponent(**vars(result), per="step", name=type(scene).__name__, advice=advice)
    loaded = load_scene(scene)
    if loaded.coupling is None:
        return _driven_lyapunov(loaded, number, progress)
    (f, name), start = load_interval_map(loaded, number), find_stretch(loaded)
    if not abs(start) <= f.hi:
        raise InputError(f"is {start:g}", "start.d", f"both masses can stick only with abs(d) up to {f.hi:.6g}")
    result = exponent(f.motion(np.array([start])), number, progress)
    advice = "the motion stops sticking; list its events instead"
    return Exponent(**vars(result), per="event", name=name, advice=advice)


def _driven_lyapunov(loaded: Scene, events: int, progress: Stages) -> Exponent:
    """Return the exponent of a driven mass per landing, or per drive period where it does not stick."""
    for per in SECTION_PER:
        f, start = make_driven_map(loaded, SECTION_PER[per])
        motion = f.motion(start)
        result = exponent(motion, events, progress)
        if result.outcome != "no stick":
            break
    rotation = None
    if per == "landing" and result.outcome == "completed":
        rotation = rotation_number(motion.follow(ROTATIONS))
    advice = "no exponent was found; list the events instead"
    return Exponent(**vars(result), per=per, drive_periods_per_landing=rotation, name=loaded.name, advice=advice)


def format_with_error(value: float, stderr: float) -> str:
    """Return a value with the digits significant for its standard error (two digits): "0.865 +- 0.013"."""
    if not (math.isfinite(stderr) and stderr > 0.0):
        return f"{value:.8g} +- {stderr:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(stderr)))
    return f"{value:.{decimals}f} +- {stderr:.2g}"
