"""``rig-sim``: the simulated rig on the command line: scenes, periodic orbit, events, exact motion into a file."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

from cyclopts import Parameter

from daq.base.console import application, flags
from daq.base.console.application import Answer, Json, SetChanges
from rig_sim.cli import continuation, control, forced, maps, sweep
from rig_sim.cli.atlas import atlas

if TYPE_CHECKING:
    from rig_sim.scenes.model import Scene

Until = Annotated[
    float,
    flags.quantity("--until", "time", "End of the run, in the scene's unit of time; in SI scenes s, or '5 min'."),
]
MaxSteps = Annotated[
    int, application.Whole, Parameter(help="Integrator steps after which the run ends with the outcome 'step limit'.")
]

app = application.application(
    "rig-sim",
    "The stick-slip rig in software: exact motion between events, six friction laws.",
    "rig-sim cycle base --set friction.law=3",
)


@app.command
def scenes(*, json: Json = False) -> Answer:
    """List the built-in scenes and the terms each of them has.

    Example: rig-sim scenes
    """
    from rig_sim.scenes.scene import builtin_names, scene

    rows = [{"name": name, "title": (built := scene(name)).title, "terms": built.terms()} for name in builtin_names()]
    text = "\n".join(f"{row['name']:8} {row['title']}\n         {', '.join(row['terms'])}" for row in rows)
    return Answer(rows, text)


@app.command
def cycle(scene: str, /, *, set_: SetChanges = None, json: Json = False) -> Answer:
    """Find the periodic orbit reached from the slip point; start, belt.start and the random sections are ignored.

    Example: rig-sim cycle base --set friction.law=6 --set friction.G_stick=-5e6

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.dynamics.orbits.limit_cycle import cycle as find

    data = asdict(find(_scene(scene, set_)))
    return Answer(data, _lines(data))


@app.command(name="fixed-point")
def fixed_point(scene: str, /, *, set_: SetChanges = None, json: Json = False) -> Answer:
    """Find the fixed point, where friction and spring balance at rest, with its eigenvalues; start is ignored.

    Example: rig-sim fixed-point damped --set damper.c=0.38

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.dynamics.orbits.fixed_point import fixed_point as find
    from rig_sim.dynamics.orbits.fixed_point import two_mass_fixed_point

    found = _scene(scene, set_)
    data = asdict(find(found.flow()) if found.coupling is None else two_mass_fixed_point(found.two_mass_flow()))
    return Answer(data, _lines(data))


@app.command
def floquet(
    scene: str,
    /,
    *,
    orbit: Annotated[
        Literal["stable", "unstable"],
        Parameter(help="The orbit reached from the slip point, or the one that separates it from the fixed point."),
    ] = "stable",
    set_: SetChanges = None,
    json: Json = False,
) -> Answer:
    """Find a periodic orbit with its Floquet multipliers; start and the random sections are ignored.

    Example: rig-sim floquet damped --orbit unstable

    The first multiplier is 1, along the orbit; the second is 0 for an orbit that sticks, above 1 for an unstable one.

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.dynamics.orbits.floquet import floquet as find

    data = asdict(find(_scene(scene, set_).flow(), orbit))
    return Answer(data, _lines(data))


@app.command
def events(
    scene: str,
    /,
    *,
    until: Until,
    since: Annotated[float, flags.quantity("--since", "time", "List only events at or after this time.")] = 0.0,
    set_: SetChanges = None,
    max_steps: MaxSteps = 10**6,
    json: Json = False,
) -> Answer:
    """List the events: transitions between N (slip slower than the belt), P (slip faster) and S (stick or ramp).

    Of two masses, the contact of both: SS>SN is the second mass's break-away.

    A motion that repeats bit for bit is integrated once. A list holds at most 10^6 events (outcome 'event limit'); use
    --since to list a later part.

    Example: rig-sim events base --until 60 --set drive.u0=0.2 --set drive.omega=0.3

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    played = _scene(scene, set_)
    if played.coupling is not None:
        return _two_mass_events(played, until, since, max_steps)
    from rig_sim.motion.play import events as play

    found = play(played, until, since=since, max_steps=max_steps)
    rows = [{"t": event.t, "x": event.x, "kind": event.kind} for event in found.events]
    lines = [f"{'t':>22} {'x':>24}  kind"]
    lines += [f"{event.t:22.15g} {event.x:24.16g}  {event.kind}" for event in found.events]
    lines.append(f"{len(rows)} events, {found.steps} steps, outcome: {_outcome(found.outcome, found.advice)}")
    data = {"events": rows, "outcome": found.outcome, "advice": found.advice, "steps": found.steps}
    return Answer(data, "\n".join(lines))


@app.command
def run(
    scene: str,
    /,
    *,
    until: Until,
    rate: Annotated[float, flags.quantity("--rate", "rate", "Samples per unit of time; in SI scenes Hz, or '1 kHz'.")],
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="File to write, .h5 or .csv.")],
    method: Annotated[
        Literal["exact", "rk4-henon", "dop853"],
        Parameter(help="exact, or for comparison rk4-henon (Runge-Kutta with Henon's events) or dop853 (scipy)."),
    ] = "exact",
    step: Annotated[
        float | None,
        flags.quantity(
            "--step", "time", "Time step of rk4-henon, in the scene's unit of time; default 0.01 sqrt(m/k)."
        ),
    ] = None,
    rtol: Annotated[float | None, Parameter(help="Relative and absolute tolerance of dop853; default 2.3e-14.")] = None,
    set_: SetChanges = None,
    max_steps: MaxSteps = 10**6,
    force: Annotated[bool, Parameter(negative=(), help="Replace the file if it exists.")] = False,
    json: Json = False,
) -> Answer:
    """Write time t, position x, velocity v and friction force F at a constant rate to a file.

    Example: rig-sim run rig --until 20 --rate 1000 -o motion.h5

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.comparison.methods import phases_by
    from rig_sim.motion.file import write

    played = _scene(scene, set_)
    phases, setting = phases_by(method, played, step=step, rtol=rtol)
    used = f"{method} {setting}".strip()
    found = write(played, output, until=until, rate=rate, phases=phases, method=used, max_steps=max_steps, force=force)
    data = {
        "file": output,
        "samples": found.samples,
        "method": method,
        "outcome": found.outcome,
        "advice": found.advice,
        "steps": found.steps,
    }
    ended = _outcome(found.outcome, found.advice)
    return Answer(data, f"{output}: {found.samples} samples of t, x, v, F; outcome: {ended}")


@app.command
def compare(scene: str, /, *, until: Until, set_: SetChanges = None, json: Json = False) -> Answer:
    """Compare the integration methods: largest error of an event time, CPU time, and CPU time per cycle.

    Example: rig-sim compare base --until 100 --set friction.law=6

    The exact method steps through every cycle, interpreted and compiled; compilation time is reported separately.

    Parameters
    ----------
    scene
        A built-in name (see rig-sim scenes) or a TOML file.
    """
    from rig_sim.comparison.error_vs_time import compare as measure

    with application.progress("measuring", 100, "%") as show:
        found = measure(_scene(scene, set_), until, progress=show)
    data = asdict(found)
    table = application.table("", ["method", "setting", "error", "CPU s", "us/cycle"], left=2)
    for row in found.rows:
        error = row.note if row.error is None else f"{row.error:.1e}"
        per_cycle = "" if row.us_per_cycle is None else f"{row.us_per_cycle:.3g}"
        table.add_row(row.method, row.setting, error, f"{row.cpu_s:.2g}", per_cycle)
    what = f"error: largest error of an event time, against {found.reference}; {found.cycles} cycles"
    return Answer(
        data, [table, what, f"compiling or loading compiled code: {found.compile_s:.1f} s of CPU, not counted"]
    )


app.command(continuation.continue_, name="continue")
app.command(maps.map_, name="map")
app.command(sweep.sweep)
app.command(maps.basins)
app.command(maps.lyapunov)
app.command(forced.quench)
app.command(control.shaker)
app.command(atlas)
app.command(control.lock)


def _two_mass_events(scene: "Scene", until: float, since: float, max_steps: int) -> Answer:
    from rig_sim.motion.two_masses import two_mass_events

    found = two_mass_events(scene, until, since=since, max_steps=max_steps)
    rows = [asdict(event) for event in found.events]
    lines = [f"{'t':>22} {'x1':>24} {'x2':>24}  kind"]
    lines += [f"{event.t:22.15g} {event.x1:24.16g} {event.x2:24.16g}  {event.kind}" for event in found.events]
    lines.append(f"{len(rows)} events, {found.steps} steps, outcome: {_outcome(found.outcome, found.advice)}")
    data = {"events": rows, "outcome": found.outcome, "advice": found.advice, "steps": found.steps}
    return Answer(data, "\n".join(lines))


def _scene(name: str, changes: list[str] | None) -> "Scene":
    from rig_sim.scenes.scene import parse_changes
    from rig_sim.scenes.scene import scene as read

    return read(name, **parse_changes(changes))


def _outcome(name: str, advice: str) -> str:
    return f"{name} ({advice})" if advice else name


def _lines(data: dict[str, Any]) -> str:
    """Return a line for every entry that is there."""
    return "\n".join(f"{key:11} {_shown(value)}" for key, value in data.items() if value not in (None, "", ()))


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(_shown(item) for item in value)
    if isinstance(value, complex):
        return f"{value.real:.15g} {'-' if value.imag < 0 else '+'} {abs(value.imag):.15g}i"
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def main() -> NoReturn:
    """Run ``rig-sim`` on the process's own command line."""
    application.main(app)


if __name__ == "__main__":
    main()
