"""The motion of a scene: its events, and its samples at a constant rate."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from rig_sim.motion import play
from rig_sim.results.arguments import SceneLike, load_scene, parse_number, parse_whole
from rig_sim.results.result import UNIT, Result, format_outcome

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from stickslip.compute.arrays import Array

MARKS = {"N": "v", "P": "^", "S": "s"}  # of the contact that an event enters
Method = Literal["exact", "rk4-henon", "dop853"]


@dataclass(frozen=True, repr=False)
class Events(Result, play.Events[Any]):
    """The events of one motion, in order, and how it ended: what `rig_sim.events` returns.

    Attributes
    ----------
    events : tuple of Event or TwoMassEvent
        Time t (s), position x (m) or x1 and x2, and kind: 'N>S', of two masses 'SS>SN'.
    outcome, advice : str
        'completed' or the reason why the motion ended early, and what to do about it.
    steps : int
        Of the integrator.
    """

    positions: tuple[str, ...] = field(default=("x",), repr=False, compare=False)

    UNITS: ClassVar[Mapping[str, str]] = {"t": "s", "x": "m", "x1": "m", "x2": "m"}
    SIZE = (9.5, 3.6)

    def as_json(self) -> dict[str, Any]:
        return super().as_json() | {"events": self.rows()}

    def rows(self) -> Sequence[Mapping[str, Any]]:
        return [asdict(event) for event in self.events]

    def to_dataframe(self) -> "pd.DataFrame":
        """Return a row for each event: t, x (x1 and x2 of two masses), kind."""
        import pandas as pd

        columns = ["t", *self.positions, "kind"]
        table = pd.DataFrame([[row[name] for name in columns] for row in self.rows()], columns=columns)
        table.attrs["units"] = {name: unit for name, unit in self.UNITS.items() if name in columns}
        return table

    def lines(self) -> list[str]:
        head = [f"{'t':>22}", *(f"{name:>24}" for name in self.positions)]
        lines = [f"{' '.join(head)}  kind"]
        for event in self.events:
            places = [f"{getattr(event, name):24.16g}" for name in self.positions]
            lines.append(f"{' '.join([f'{event.t:22.15g}', *places])}  {event.kind}")
        end = format_outcome(self.outcome, self.advice)
        return [*lines, f"{len(self.events)} events, {self.steps} steps, outcome: {end}"]

    def __repr__(self) -> str:
        kinds = ", ".join(event.kind for event in self.events[:5]) + (" ..." if len(self.events) > 5 else "")
        end = format_outcome(self.outcome, self.advice)
        return f"<Events of {self.name}\n {len(self.events)} events: {kinds}\n {end}>"

    def draw(self, ax: "Axes") -> None:
        t, kinds = [event.t for event in self.events], [event.kind for event in self.events]
        for number, name in enumerate(self.positions):
            x, colour = [getattr(event, name) for event in self.events], f"C{number}"
            ax.plot(t, x, lw=0.6, color=colour, label=name)
            for letter, mark in MARKS.items():
                entered = [i for i, kind in enumerate(kinds) if kind[-1] == letter]
                ax.plot([t[i] for i in entered], [x[i] for i in entered], mark, ms=4, mew=0, color=colour)
        if len(self.positions) > 1:
            ax.legend()
        ax.set(xlabel=f"t {UNIT}", ylabel=f"x {UNIT}")
        ax.set_title(f"{self.name}: events (square: stick, v: slip slower than the belt, ^: faster)")


@dataclass(frozen=True, repr=False)
class Motion(Result):
    """A motion sampled at a constant rate: what `rig_sim.run` returns.

    Attributes
    ----------
    file : Path or None
        The file it was written to.
    samples : int
    method : str
        'exact', 'rk4-henon' or 'dop853'.
    outcome, advice : str
        'completed' or the reason why the motion ended early, and what to do about it.
    steps : int
        Of the integrator, or evaluations of the right-hand side.
    """

    file: Path | None
    samples: int
    method: str
    outcome: str
    advice: str
    steps: int
    names: tuple[str, ...] = field(default=("t", "x", "v", "F"), repr=False, compare=False)
    stored: "tuple[Array, ...]" = field(default=(), repr=False, compare=False)

    UNITS: ClassVar[Mapping[str, str]] = {
        "t": "s",
        **dict.fromkeys(("x", "x1", "x2"), "m"),
        **dict.fromkeys(("v", "v1", "v2"), "m/s"),
        **dict.fromkeys(("F", "F1", "F2"), "N"),
    }
    SIZE = (9.5, 3.6)

    @cached_property
    def columns(self) -> "dict[str, Array]":
        """The columns by name, (n,) each: t, x, v, F, or of two masses t, x1, v1, F1, x2, v2, F2."""
        if self.file is None:
            return dict(zip(self.names, self.stored, strict=True))
        from rig_sim.motion import file

        return file.read(self.file, self.names)

    @property
    def t(self) -> "Array":
        """Times (s), (n,)."""
        return self.columns["t"]

    @property
    def x(self) -> "Array":
        """Positions (m), (n,); of two masses (n, 2)."""
        return self._stack_masses("x")

    @property
    def v(self) -> "Array":
        """Velocities (m/s), (n,); of two masses (n, 2)."""
        return self._stack_masses("v")

    @property
    def F(self) -> "Array":
        """Friction forces on the mass (N), positive towards +x, (n,); of two masses (n, 2)."""
        return self._stack_masses("F")

    def _stack_masses(self, quantity: str) -> "Array":
        import numpy as np

        if quantity in self.columns:
            return self.columns[quantity]
        return np.column_stack([self.columns[f"{quantity}1"], self.columns[f"{quantity}2"]])

    def lines(self) -> list[str]:
        prefix = f"{self.file}: " if self.file is not None else ""
        return [f"{prefix}{self.samples} samples of t, x, v, F; outcome: {format_outcome(self.outcome, self.advice)}"]

    def to_dataframe(self) -> "pd.DataFrame":
        """Return a row for each sample: t, x, v, F, or of two masses t, x1, v1, F1, x2, v2, F2."""
        import pandas as pd

        table = pd.DataFrame(self.columns)
        table.attrs["units"] = {name: self.UNITS[name] for name in self.names}
        return table

    def draw(self, ax: "Axes") -> None:
        for name in self.names:
            if name[0] == "x":
                ax.plot(self.columns["t"], self.columns[name], lw=1.0, label=name)
        if "x" not in self.names:
            ax.legend()
        ax.set(xlabel=f"t {UNIT}", ylabel=f"x {UNIT}", title=f"{self.name}, method {self.method}")
        ax.margins(x=0.01)


def events(scene: SceneLike, until: float | str, *, since: float | str = 0.0, max_steps: int = 1_000_000) -> Events:
    """List the times and positions at which the mass begins to stick or to slip: ``rig-sim events``.

    The kind of an event is a transition between N (the mass slips and is slower than the belt), P (it is faster) and S
    (stick or ramp).  For two masses it contains the states of both: SS>SN is the break-away of the second mass.

    A motion that repeats exactly is integrated only once.  A list contains at most 10^6 events (outcome 'event limit');
    use ``since`` to list a later part.

    Parameters
    ----------
    scene : str, Path or Scene
        Scene of one or two masses: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also the result
        of `rig_sim.scene`.
    until : float or str
        End of the motion, which begins at 0, in the scene's unit of time or with a unit ('5 min').
    since : float or str
        List only events at or after this time.
    max_steps : int
        Integrator steps after which the motion ends with the outcome 'step limit'.

    Returns
    -------
    Events

    Raises
    ------
    InputError
        If the scene does not exist, a time is not a number, or ``until`` is not positive.

    Examples
    --------
    >>> import rig_sim
    >>> found = rig_sim.events("base", until=10)
    >>> [(round(event.t, 3), event.kind) for event in found.events]
    [(0.974, 'N>S'), (2.533, 'S>N'), (7.05, 'N>S')]
    """
    loaded = load_scene(scene)
    end, start = parse_number(until, "time", "--until"), parse_number(since, "time", "--since")
    steps = parse_whole(max_steps, "--max-steps")
    if loaded.coupling is None:
        return Events(**vars(play.events(loaded, end, since=start, max_steps=steps)), name=loaded.name)
    from rig_sim.motion.two_masses import two_mass_events

    listed = two_mass_events(loaded, end, since=start, max_steps=steps)
    return Events(**vars(listed), positions=("x1", "x2"), name=loaded.name)


def run(
    scene: SceneLike,
    until: float | str,
    rate: float | str,
    *,
    output: str | Path | None = None,
    method: Method = "exact",
    step: float | str | None = None,
    rtol: float | None = None,
    max_steps: int = 1_000_000,
    force: bool = False,
) -> Motion:
    """Simulate a motion, with t, x, v and the friction force F at a constant rate: ``rig-sim run``.

    Parameters
    ----------
    scene : str, Path or Scene
        Scene of one or two masses: a built-in name (see ``rig-sim scenes``) or a TOML file.  In Python also the result
        of `rig_sim.scene`.
    until : float or str
        End of the motion, which begins at 0, in the scene's unit of time or with a unit ('5 min').
    rate : float or str
        Samples per unit of time, or '1 kHz'.
    output : str or Path, optional
        File to write (.h5 or .csv); the motion is then not kept in memory.
    method : str
        Method of integration: 'exact' or, for comparison, 'rk4-henon' (Runge-Kutta with Henon's events) or 'dop853'
        (scipy).
    step : float or str, optional
        Time step of rk4-henon; default 0.01 sqrt(m/k).
    rtol : float, optional
        Relative and absolute tolerance of dop853; default 2.3e-14.
    max_steps : int
        Integrator steps after which the motion ends with the outcome 'step limit'.
    force : bool
        Replace an existing file.

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        If the scene or method does not exist, a number is not positive, there are more samples than a file may contain,
        or the file exists.
    RefusedError
        If the file cannot be written.

    Examples
    --------
    >>> import rig_sim
    >>> motion = rig_sim.run("base", until=20, rate=100)
    >>> motion.to_dataframe().loc[500:501].round(4)
            t       x       v       F
    500  5.00  0.4193 -1.1287  0.1699
    501  5.01  0.4080 -1.1311  0.1697
    """
    from rig_sim.comparison.methods import choose_phases
    from rig_sim.motion import file

    loaded = load_scene(scene)
    time_step = None if step is None else parse_number(step, "time", "--step")
    phases, setting = choose_phases(method, loaded, step=time_step, rtol=rtol)
    arguments: dict[str, Any] = {
        "until": parse_number(until, "time", "--until"),
        "rate": parse_number(rate, "rate", "--rate"),
        "phases": phases,
        "max_steps": parse_whole(max_steps, "--max-steps"),
    }
    names = tuple(file.describe_columns(loaded))
    columns: tuple[Array, ...] = ()
    path = None if output is None else Path(output)
    if path is None:
        columns, written = file.sample_scene(loaded, **arguments)
    else:
        written = file.write(loaded, path, method=f"{method} {setting}".strip(), force=force, **arguments)
    return Motion(
        path, written.samples, method, written.outcome, written.advice, written.steps, names, columns, name=loaded.name
    )
