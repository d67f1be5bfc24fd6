"""``rig-sim``: the simulated rig on the command line: scenes, periodic orbit, events, exact motion into a file."""

from pathlib import Path
from typing import Annotated, Literal, NoReturn

from cyclopts import Parameter

from rig_sim.cli import control, maps, over
from rig_sim.cli.answer import SceneName, answered, changed
from rig_sim.cli.atlas import atlas
from stickslip.console import application, flags
from stickslip.console.application import Answer, Json, SetChanges

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
def cycle(scene: SceneName, /, *, set_: SetChanges = None, json: Json = False) -> Answer:
    """Find the periodic orbit reached from the slip point; start, belt.start and the random sections are ignored.

    Example: rig-sim cycle base --set friction.law=6 --set friction.G_stick=-5e6
    """
    import rig_sim

    return answered(rig_sim.cycle(changed(scene, set_)))


@app.command(name="fixed-point")
def fixed_point(scene: SceneName, /, *, set_: SetChanges = None, json: Json = False) -> Answer:
    """Find the fixed point, where friction and spring balance at rest, with its eigenvalues; start is ignored.

    Example: rig-sim fixed-point damped --set damper.c=0.38
    """
    import rig_sim

    return answered(rig_sim.fixed_point(changed(scene, set_)))


@app.command
def floquet(
    scene: SceneName,
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
    """
    import rig_sim

    return answered(rig_sim.floquet(changed(scene, set_), orbit))


@app.command
def events(
    scene: SceneName,
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
    """
    import rig_sim

    return answered(rig_sim.events(changed(scene, set_), until, since=since, max_steps=max_steps))


@app.command
def run(
    scene: SceneName,
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
    """
    import rig_sim

    result = rig_sim.run(
        changed(scene, set_),
        until,
        rate,
        output=output,
        method=method,
        step=step,
        rtol=rtol,
        max_steps=max_steps,
        force=force,
    )
    return answered(result)


@app.command
def compare(scene: SceneName, /, *, until: Until, set_: SetChanges = None, json: Json = False) -> Answer:
    """Compare the integration methods: largest error of an event time, CPU time, and CPU time per cycle.

    Example: rig-sim compare base --until 100 --set friction.law=6

    The exact method steps through every cycle, interpreted and compiled; compilation time is reported separately.
    """
    import rig_sim

    with application.progress("measuring", 100, "%") as show:
        result = rig_sim.compare(changed(scene, set_), until, progress=show.stage)
    table = application.table("", ["method", "setting", "error", "CPU s", "us/cycle"], left=2)
    for row in result.results:
        error = row.note if row.error is None else f"{row.error:.1e}"
        per_cycle = "" if row.us_per_cycle is None else f"{row.us_per_cycle:.3g}"
        table.add_row(row.method, row.setting, error, f"{row.cpu_s:.2g}", per_cycle)
    return Answer(result.as_json(), [table, *result.remarks()])


app.command(over.continue_, name="continue")
app.command(maps.map_, name="map")
app.command(over.sweep)
app.command(maps.basins)
app.command(maps.lyapunov)
app.command(control.quench)
app.command(control.shaker)
app.command(atlas)
app.command(control.lock)


def main() -> NoReturn:
    """Run ``rig-sim`` on the process's own command line."""
    application.main(app)


if __name__ == "__main__":
    main()
