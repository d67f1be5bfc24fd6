"""`fit-friction`: which friction law does the recorded contact obey, and how sure is that."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import Parameter

from daq import terminal
from daq.errors import EXIT_DONE, EXIT_UNDECIDED, InputError
from daq.terminal import Answer, Json

if TYPE_CHECKING:
    from rich.table import Table

    from daq.rig import Rig
    from fitting.result import Ranking

app = terminal.application(
    "fit-friction", "Fit six friction laws to a recorded run and rank them.", "fit-friction run.h5 --report run.html"
)


@app.default
def fit(
    file: Annotated[Path, Parameter(help="Run file, as daq record, import or replay made it.")],
    /,
    *more: Annotated[Path, Parameter(help="More runs of the same contact, fitted together with the first.")],
    laws: Annotated[str, Parameter(help="Laws to fit: 1-6, or a list such as 3,5,6.")] = "1-6",
    mass: Annotated[str | None, Parameter(help="Mass, kg or with a unit and error: '300 g +- 1 g'.")] = None,
    stiffness: Annotated[str | None, Parameter(help="Spring, N/m or with a unit, instead of the mass.")] = None,
    datum: Annotated[
        str | None,
        Parameter(help="Position of count zero relative to the spring's rest, m.", allow_leading_hyphen=True),
    ] = None,
    datum_sd: Annotated[str | None, Parameter(help="Its standard deviation, m.")] = None,
    damping: Annotated[float | None, Parameter(help="Viscous damping from a ring-down, N s/m.")] = None,
    damping_sd: Annotated[float | None, Parameter(help="Its standard deviation, N s/m.")] = None,
    belt_speed: Annotated[
        str | None,
        Parameter(
            help="Belt speed, m/s, with its sign; channel: the belt's own counts, the default where a run has them.",
            allow_leading_hyphen=True,
        ),
    ] = None,
    exclude_cycles: Annotated[str, Parameter(help="Cycles to leave out, counted from 1: 3,7-9.")] = "",
    alpha: Annotated[float, Parameter(help="1 - confidence of intervals and set.")] = 0.05,
    report: Annotated[
        Path | None, Parameter(help="Report to write; default RUN.report.html. Several runs: one each, numbered.")
    ] = None,
    jobs: Annotated[int, Parameter(help="Processes to fit in; up to three are of use.")] = 1,
    json: Json = False,
) -> Answer:
    """Fit the friction laws to a run, rank them, and write a report beside it.

    Ends with exit code 0 when one law is left, 5 when the record cannot tell several apart (they are named), and 4
    when it holds too little or no belt stick-slip. Results are added to the run file; raw data stay untouched.

    Several runs are fitted together, as one contact: the law's parameters, spring and damping are one for all, belt
    speed, rest position and wear are each run's own. Runs at other belt speeds tell laws apart that one run cannot.

    Example: fit-friction run.h5 --laws 3,5,6 --mass "300 g"
    """
    from daq import runfile
    from daq.units import measured, quantity
    from fitting import report as pages
    from fitting import store
    from fitting.ranking import rank
    from processing import stage
    from processing.smoothing import smooth

    files = [file, *more]
    if len({path.resolve() for path in files}) < len(files):
        raise InputError("a run is named twice", ", ".join(map(str, files)), "name each run once")
    wanted, excluded = numbers(laws, "--laws"), numbers(exclude_cycles, "--exclude-cycles")
    places = pages.places(files, report)
    speed = belt_speed if belt_speed in (None, "channel") else quantity(belt_speed, "speed", "--belt-speed")
    changes: dict[str, Any] = {}
    if mass is not None:
        changes["mass"] = measured(mass, "mass", "--mass")
    if stiffness is not None:
        changes["stiffness"] = measured(stiffness, "stiffness", "--stiffness")
        changes.setdefault("mass", None)
    motions, rigs = [], []
    for path in files:
        motion = stage.load(path)
        recording = runfile.load(path) if motion is None else motion.recording
        own = dict(changes)
        if datum_sd is not None and datum is None and recording.rig.datum is None:
            raise InputError("--datum-sd without a datum", "--datum-sd", "give --datum too")
        if datum is not None or datum_sd is not None:
            own["datum"] = _changed(
                recording.rig.datum,
                None if datum is None else quantity(datum, "length", "--datum"),
                None if datum_sd is None else quantity(datum_sd, "length", "--datum-sd"),
            )
        if damping is not None or damping_sd is not None:
            own["damping"] = _changed(recording.rig.damping, damping, damping_sd)
        rigs.append(_rig(recording.rig, own))
        if motion is None:
            motion = smooth(recording, belt_speed="auto" if speed in (None, "channel") else speed)
        motions.append(motion)
    with terminal.progress("fitting", float(len(wanted)), "laws") as tell:
        ranking = rank(
            motions,
            rigs,
            wanted,
            belt_speed=speed,
            excluded=excluded,
            alpha=alpha,
            jobs=jobs,
            progress=tell,
        )
    for path, page, motion, side in zip(files, places, motions, ranking.runs or (ranking,), strict=True):
        store.save(side, path)
        pages.write(side, motion, page, alpha)
    data = ranking.as_json() | {"report": places[0]}
    if ranking.runs:
        data["runs"] = [
            {"file": path, "report": page} | side for path, page, side in zip(files, places, data["runs"], strict=True)
        ]
    code = EXIT_DONE if len(ranking.laws_in_set) == 1 else EXIT_UNDECIDED
    return Answer(data, _text(ranking, places, alpha), code)


def numbers(text: str, flag: str) -> list[int]:
    """Return the whole numbers that a list such as ``1-3,6`` names; an empty text names none.

    Raises
    ------
    InputError
        For anything else.
    """
    found: list[int] = []
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        first, dash, last = part.partition("-")
        try:
            low = int(first)
            high = int(last) if dash else low
        except ValueError:
            raise InputError(f"{part!r} is no number or range", flag, "write for example 1-3,6") from None
        if not 1 <= low <= high <= 100_000:
            raise InputError(f"{part!r} is no range that counts up from 1", flag, "write for example 1-3,6")
        found.extend(range(low, high + 1))
    return found


def _changed(known: Any, value: float | None, sd: float | None) -> Any:
    """Return a calibration with the value, the error, or both replaced; a new value without an error is exact."""
    from daq.rig import Measured

    if value is None:
        value = known.value if known is not None else 0.0
    elif sd is None:
        sd = 0.0
    if sd is None or sd < 0:
        raise InputError(f"standard deviation is {sd}", "command line", "give one of 0 or more")
    return Measured(float(value), float(sd))


def _rig(rig: "Rig", changes: dict[str, Any]) -> "Rig":
    from dataclasses import replace

    for name in ("mass", "stiffness"):
        found = changes.get(name)
        if found is not None and not found.value > 0:
            raise InputError(f"{name} is {found.value}", f"--{name}", "give one above 0")
    damping = changes.get("damping")
    if damping is not None and damping.value < 0:
        raise InputError(f"damping is {damping.value}", "--damping", "give 0 or more, in N s/m")
    changed = replace(rig, **changes)
    if damping is not None and changed.mass is None and changed.stiffness is None:
        raise InputError("--damping in N s/m without a mass", "--damping", "give --mass or --stiffness too")
    return changed


def _text(ranking: "Ranking", places: list[Path], alpha: float) -> list[Any]:
    lines: list[Any] = [_laws(ranking), _parameters(ranking, alpha)]
    lines += [f"warning: {warning}" for warning in ranking.warnings]
    told = ", ".join(map(str, places))
    lines.append(f"{ranking.best.cycles} cycles, {ranking.cpu_s:.1f} s of CPU time; report: {told}")
    lines.append(f"verdict: {ranking.verdict}")
    return lines


def _laws(ranking: "Ranking") -> "Table":
    """Return the ranking; ``behind`` is the mean log error behind the best law's, with its standard error."""
    from fitting.verdict import length

    table = terminal.table("friction laws, best first", ("law", "error", "behind", "weight", "in set"))
    for row in ranking.rows:
        behind = "best" if row.score == 0 else f"{row.behind[0]:.2f} ± {row.behind[1]:.2f}"
        weight = f"{row.weight:.2f}" if row.weight >= 0.005 else "<0.01"
        style = "bold" if row.in_set else None
        told = "yes" if row.in_set else "-"
        table.add_row(f"{row.law} {row.name}", length(row.rms_m), behind, weight, told, style=style)
    return table


def _parameters(ranking: "Ranking", alpha: float) -> "Table":
    """Return the best law's parameters."""
    sure = f"{100 * (1 - alpha):g} % interval"
    table = terminal.table(f"law {ranking.best.law}", ("parameter", "value", "std. error", sure, "unit"))
    for name, item in ranking.best.parameters.items():
        interval = f"{item.lo:.5g} ... {item.hi:.5g}"
        table.add_row(name, f"{item.value:.6g}", f"{item.stderr:.2g}", interval, item.unit)
    return table


def main() -> NoReturn:
    """Run the command."""
    terminal.main(app)


if __name__ == "__main__":
    main()
