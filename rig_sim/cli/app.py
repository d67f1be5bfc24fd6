"""``rig-sim``: the simulated rig on the command line: scenes, periodic orbit, events, exact motion into a file."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from rig_sim.cli.atlas import atlas
from rig_sim.cli.derived import derive
from stickslip.console import application
from stickslip.console.application import Answer, Json
from stickslip.errors import InputError

app = application.application(
    "rig-sim",
    "Simulate the stick-slip rig with exact motion between events, six friction laws and four laws with memory.",
    "rig-sim cycle base --set friction.law=3",
)


@app.command
def scenes(*, json: Json = False) -> Answer:
    """List the built-in scenes and their sections.

    Example: rig-sim scenes
    """
    from rig_sim.scenes.scene import builtin_names, scene

    rows = [{"name": name, "title": (built := scene(name)).title, "terms": built.terms()} for name in builtin_names()]
    text = "\n".join(f"{row['name']:8} {row['title']}\n         {', '.join(row['terms'])}" for row in rows)
    return Answer(rows, text)


@contextmanager
def count_finished(values: dict[str, Any]) -> Iterator[None]:
    """Where the block is interrupted, print on stderr how many values the file of ``--resume`` has."""
    try:
        yield
    except BaseException:
        path = values.get("resume")
        number = path.read_bytes().count(b"\n") - 1 if path is not None and path.is_file() else 0
        if number > 0:
            from rig_sim.results.arguments import parse_range

            total = parse_range(values["over"]).number
            application.note(f"{number} of {total} values are in {path}; the same command continues from there")
        raise


@contextmanager
def refuse_search_plot(values: dict[str, Any]) -> Iterator[None]:
    if values.get("method") == "search" and values.get("plot") is not None:
        raise InputError("draws only --method=ogy", "--plot", "remove one of the two")
    yield


@contextmanager
def refuse_empty_request(values: dict[str, Any]) -> Iterator[None]:
    if values.get("d") is None and not values.get("periodic") and values.get("plot") is None:
        raise InputError("there is nothing to do", "--d", "use --d, --periodic or --plot")
    yield


for command in (
    derive("cycle", "rig-sim cycle base --set friction.law=6 --set friction.G_stick=-5e6"),
    derive("fixed_point", "rig-sim fixed-point damped --set damper.c=0.38"),
    derive("floquet", "rig-sim floquet damped --orbit unstable"),
    derive("events", "rig-sim events base --until 60 --set drive.u0=0.2 --set drive.omega=0.3"),
    derive("run", "rig-sim run rig --until 20 --rate 1000 -o motion.h5", required="output"),
    derive("compare", "rig-sim compare base --until 100 --set friction.law=6"),
    derive(
        "continue_",
        "rig-sim continue damped --over damper.c=0.3:0.6",
        "rig-sim continue fitted.toml --over belt.speed=0.1:1 --draws 200",
    ),
    derive("map", "rig-sim map two-mass --d 0.05,0.1,0.15 --iterate 2", plots=True, within=refuse_empty_request),
    derive(
        "sweep",
        "rig-sim sweep two-mass --over belt.speed=0.08:0.2:400 --jobs 2 --plot bifurcations.png",
        "rig-sim sweep two-mass --over belt.speed=0.08:0.2:4000 --jobs 2 --resume bifurcations.jsonl",
        "rig-sim sweep forced --over drive.omega=0.2:2:400 --section slip --plot bifurcations.png",
        plots=True,
        within=count_finished,
    ),
    derive("basins", "rig-sim basins two-mass --cells 4000", plots=True),
    derive(
        "lyapunov",
        "rig-sim lyapunov two-mass --events 20000 --set belt.speed=0.08075",
        "rig-sim lyapunov forced --set drive.omega=1.1",
    ),
    derive("quench", "rig-sim quench forced --set drive.omega=20 --set drive.u0=1.75", plots=True),
    derive("shaker", "rig-sim shaker --m 1 --k 1 --c 0 --gamma 0.3 --a 0.5 --phi 3 --band 0.9:1.1", plots=True),
    atlas,
    derive("lock", "rig-sim lock forced --period 2 --budget 0.0235", plots=True, within=refuse_search_plot),
):
    app.command(command, name=command.__name__.rstrip("_").replace("_", "-"))


def main() -> NoReturn:
    application.main(app)


if __name__ == "__main__":
    main()
