"""`fit-friction`: which friction law does the recorded contact obey, and how sure is that."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import Parameter

from daq.base.console import application, flags
from daq.base.console.application import Answer, Json
from daq.base.errors import DataError, InputError
from daq.base.measured import Measured

if TYPE_CHECKING:
    from rich.table import Table

    from fitting.adequacy.result import Adequacy
    from fitting.batch import BatchRow
    from fitting.selection.result import LawResult, Ranking
    from fitting.selection.rivals import RivalResult

MOST_FORMS = 4  # shown on the terminal; the document and the report have all
INTERVAL = 3  # column of the table of parameters that may be broken over two lines

app = application.application("fit-friction", usage="Usage: fit-friction [OPTIONS] RUN.h5 [RUN.h5 ...]")


@app.default
def fit(
    file: Annotated[Path, Parameter(help="Run file written by daq record, import or replay.")],
    /,
    *more: Annotated[Path, Parameter(help="More runs of the same contact, fitted jointly with the first.")],
    laws: Annotated[str, Parameter(help="Laws to fit: 1-6, or a list such as 3,5,6.")] = "1-6",
    mass: Annotated[
        Measured | None, flags.measured("--mass", "mass", "Mass, kg or with a unit and error: '300 g +- 1 g'.", "mass")
    ] = None,
    stiffness: Annotated[
        Measured | None,
        flags.measured("--stiffness", "stiffness", "Spring: '10.5 N/m +- 0.1 N/m'; instead of the mass.", "stiffness"),
    ] = None,
    x0: Annotated[
        Measured | None,
        flags.measured(
            "--x0", "length", "Position at which the spring is at rest: '60 mm +- 0.1 mm'; without +- exact.", "x0"
        ),
    ] = None,
    datum: Annotated[
        Measured | None,
        flags.measured("--datum", "length", "-x0, from the readings of which the run was made; use --x0.", "datum"),
    ] = None,
    datum_sd: Annotated[
        float | None, flags.quantity("--datum-sd", "length", "Standard deviation of --datum; use --x0 with +-.")
    ] = None,
    damping: Annotated[
        Measured | None,
        flags.measured("--damping", "damping", "Viscous damping from a ring-down, N s/m: '0.02 +- 0.001'.", "damping"),
    ] = None,
    damping_sd: Annotated[
        float | None, flags.quantity("--damping-sd", "damping", "Standard deviation of --damping, N s/m.")
    ] = None,
    belt_speed: Annotated[
        Measured | str | None,
        flags.measured(
            "--belt-speed",
            "speed",
            "Belt speed, signed: '22 cm/s +- 1 mm/s'; channel: from belt counts, the default if the run contains them.",
            word="channel",
        ),
    ] = None,
    exclude_cycles: Annotated[str, Parameter(help="Cycles to leave out, counted from 1: 3,7-9.")] = "",
    begin: Annotated[
        float | None, flags.quantity("--from", "time", "Fit from this time of the run, s or with a unit.")
    ] = None,
    end: Annotated[float | None, flags.quantity("--to", "time", "Fit up to this time of the run, likewise.")] = None,
    alpha: Annotated[float, Parameter(help="1 - confidence level of the intervals and the set.")] = 0.05,
    report: Annotated[
        Path | None,
        Parameter(
            help="Report to write; default RUN.report.html, of a joint fit RUN+N.report.html; with --each numbered."
        ),
    ] = None,
    no_report: Annotated[bool, Parameter(negative=(), help="Write no report.")] = False,
    csv: Annotated[
        Path | None, Parameter(help="Also write the ranking as a table with one row per run and law.")
    ] = None,
    curve_csv: Annotated[
        Path | None,
        Parameter(help="Also write the measured friction curve with its band: relative speed, friction, lo, hi."),
    ] = None,
    save_scene: Annotated[
        Path | None,
        Parameter(help="Also write the fitted rig as a scene (.toml) for rig-sim: the law, or the measured curve."),
    ] = None,
    each: Annotated[bool, Parameter(negative=(), help="Fit every run by itself: a batch.")] = False,
    jobs: Annotated[int, Parameter(help="Processes to fit in; a joint fit uses at most three.")] = 1,
    scheduler: Annotated[str | None, Parameter(help="Fit on the workers of a dask scheduler: tcp://host:8786.")] = None,
    force: Annotated[
        bool, Parameter(negative=(), help="Replace a report, table or joint fit that is not of these runs.")
    ] = False,
    json: Json = False,
) -> Answer:
    """Fit the friction laws to a run, rank them, and write a report beside it.

    Ends with exit code 0 when one law is left, 5 when the record cannot distinguish several (they are
    named), 6 when it is stick-slip that none of the laws describes, or that a published curve besides them describes
    better, and 4 when it holds too little or no belt stick-slip. Results are added to the run file; raw data stay as
    they are.

    Several runs are fitted together, as one contact: the law's parameters, spring and damping are one for all, belt
    speed, rest position and wear are each run's own. Runs at other belt speeds distinguish laws that one run cannot.
    Their fit is written into a file of its own beside the first run, named after it and the number of further runs:
    run1+2.fit.h5 for three runs, with the report run1+2.report.html. The run files stay as they are.

    With --each every run is fitted by itself: a failed one stops no other, its error stands in its row. A page compares
    verdicts and parameters: run1+2.each.html for three runs. Exit code 0
    when all are decided, 5 when one is undecided, 6 when no law describes one, else that of the worst error.

    With --from or --to a part of each run is smoothed by itself and fitted; times are those of the run.  Results and
    reports of the same run are replaced by new ones, and run.report.html of a run.h5 that was itself replaced; those of
    another run only with --force.

    Example: fit-friction run.h5 --report run.html

    Example: fit-friction run.h5 --laws 3,5,6 --mass "300 g"

    Example: fit-friction run.h5 --x0 "60 mm +- 0.1 mm"

    Example: fit-friction run.h5 --from 5 --to "1.5 min" --no-report

    Example: fit-friction run.h5 --save-scene rig.toml; rig-sim continue rig.toml --over damper.c=0:0.5 --draws 200

    Example: fit-friction --each monday/*.h5 --jobs 4
    """
    from daq.base.output import atomic, suffix
    from daq.runfile import joint
    from fitting import batch, job
    from fitting.report import comparison, table
    from fitting.report import page as pages
    from fitting.rig_scene import fitted_scene, scene_file
    from processing.statistics import pooled

    files = [file, *more]
    if each:  # a pattern such as *.h5 names the joint fits of a folder, too
        fits = [path for path in files if path.name.endswith(joint.SUFFIX) and joint.recognised(path)]
        files = [path for path in files if path not in fits]
        for path in fits:
            application.note(f"{path} is the file of a joint fit, left out")
        if not files:
            raise InputError("no run among the files", "command line", "name the runs that were fitted")
    if len({path.resolve() for path in files}) < len(files):
        raise InputError("a run is named twice", ", ".join(map(str, files)), "name each run once")
    if no_report and report is not None:
        raise InputError("--report and --no-report together", "command line", "give one")
    for place, form, flag in (
        (report, suffix.PAGE, "--report"),
        (csv, suffix.CSV, "--csv"),
        (curve_csv, suffix.CSV, "--curve-csv"),
        (save_scene, suffix.TOML, "--save-scene"),
    ):
        if place is not None:
            suffix.check(place, form, flag, {suffix.PDF: "then print the page from a browser"})
    joint_file = joint.beside(files) if len(files) > 1 and not each else None
    places: list[Path] = []
    if not no_report:
        beside = None if joint_file is None else joint.beside(files, pages.SUFFIX)
        places = pages.report_paths(files, report) if beside is None else [report or beside]
    compared = None
    if each and len(files) > 1 and not no_report:
        compared = joint.beside(files, comparison.SUFFIX) if report is None else report.with_stem(f"{report.stem}-each")
        comparison.refuse_foreign_file(compared, files, force=force)
    _refuse_same([*places, compared, joint_file, csv, curve_csv, save_scene])
    if csv is not None:
        table.refuse_foreign_file(csv, files, force=force)
    if curve_csv is not None:
        if each:
            raise InputError("--curve-csv with --each", "command line", "fit the runs one at a time")
        atomic.refuse_existing(curve_csv, force, *files, flag="--curve-csv")
    if save_scene is not None:
        if each:
            raise InputError("--save-scene with --each", "command line", "fit the runs one at a time")
        scene_file.refuse_existing(save_scene, files, force=force)
    if mass is not None and stiffness is not None:
        raise InputError("--mass and --stiffness together", "command line", "give one: the fit finds the other")
    options = job.FitOptions(
        laws=tuple(numbers(laws, "--laws")),
        mass=mass,
        stiffness=stiffness,
        x0=x0,
        datum=datum,
        datum_sd=datum_sd,
        damping=damping,
        damping_sd=damping_sd,
        belt_speed=belt_speed,
        excluded=tuple(numbers(exclude_cycles, "--exclude-cycles")),
        alpha=alpha,
        begin=begin,
        end=end,
        report=not no_report,
    )
    if each:
        with application.progress("fitting", float(len(files)), "runs") as progress:
            rows = batch.fit(files, places, options, jobs, scheduler, progress, force=force)
        if csv is not None:
            table.write(csv, [(row.file, row.document) for row in rows])
        if compared is not None:
            batch.compare(rows, compared, alpha, force=force)
        data = {"runs": [row.as_json() for row in rows], "comparison": compared}
        return Answer(data, _batch(rows, compared), batch.exit_code(rows))
    runs = [job.load_run(path, options) for path in files]
    place = places[0] if places else None
    if place is not None:
        pages.refuse_foreign_file(place, [run.recording.digest for run in runs], files=files, force=force)
    if joint_file is not None:
        joint.refuse_foreign_file(joint_file, [run.named for run in runs], force=force)
    with application.progress("fitting", float(len(options.laws)), "laws") as show:

        def count(laws: float) -> None:
            show(laws)
            show.status("then goodness of fit" if laws >= len(options.laws) else "")

        done = job.fit_runs(runs, options, jobs, scheduler, count)
    done.save(place, force=force)
    if csv is not None:
        table.write(csv, [(path, side.as_json()) for path, side in zip(files, done.ranking.sides, strict=True)])
    ranking = done.ranking
    if curve_csv is not None:
        measured_curve = ranking.adequacy.curve
        if measured_curve is None:
            raise DataError("no friction curve could be measured", str(file), "leave out --curve-csv")
        table.write_curve(curve_csv, measured_curve, ranking.adequacy.unit)
    if save_scene is not None:
        rig = fitted_scene.of_ranking(ranking, done.statistics[0])
        scene_file.write(save_scene, scene_file.text(rig, ranking, file))
    counted = pooled(done.statistics)
    document = done.as_json() | {"report": place}
    if joint_file is not None:
        document["joint_file"] = joint_file
        document["runs"] = [
            {"file": path, "report": place} | run for path, run in zip(files, document["runs"], strict=True)
        ]
    text = _text(ranking, counted.sentences("m"), [joint_file, place], alpha)
    return Answer(document, text, job.exit_code(document))


def _refuse_same(outputs: "Sequence[Path | None]") -> None:
    """Raise InputError when two of the outputs are one file."""
    seen: set[Path] = set()
    for output in outputs:
        if output is not None and output.resolve() in seen:
            raise InputError("is the name of two outputs", str(output), "give each output a name of its own")
        if output is not None:
            seen.add(output.resolve())


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
            raise InputError(f"{part!r} is not a number or range", flag, "write for example 1-3,6") from None
        if not 1 <= low <= high <= 100_000:
            raise InputError(f"{part!r} is not an increasing range from 1", flag, "write for example 1-3,6")
        found.extend(range(low, high + 1))
    return found


def _batch(rows: "Sequence[BatchRow]", compared: Path | None) -> list[Any]:
    """Return the table of a batch: file, set, and the verdict or what went wrong."""
    from fitting import batch

    table = application.table("runs fitted one by one", ("file", "set", "verdict"))
    table.columns[0].overflow = table.columns[2].overflow = "fold"
    table.columns[2].justify, table.columns[2].no_wrap = "left", False
    common = Path(os.path.commonpath([row.file.absolute().parent for row in rows]))
    for row in rows:
        failed = row.failure
        members = "-" if failed else ", ".join(map(str, row.document["set"])) or "none"
        verdict = f"error: {failed.what}; {failed.do}" if failed else row.document["verdict"]
        table.add_row(str(row.file.absolute().relative_to(common)), members, verdict)
    lines: list[Any] = [table]
    for row in rows:
        lines += [f"warning: {row.file.name}: {warning}" for warning in row.document.get("warnings", ())]
    lines.append(f"{len(rows)} runs: {batch.summary(rows)}" + (f"; comparison: {compared}" if compared else ""))
    return lines


def _text(ranking: "Ranking", statistics: list[str], written: "Sequence[Path | None]", alpha: float) -> list[Any]:
    from fitting.report.symbols import MOTION, formula

    # The last line is the verdict too: it is what a long output ends on, and what scripts read.
    lines: list[Any] = [f"verdict: {ranking.verdict}"]
    if ranking.rows:
        law = f"law {ranking.best.law}: {formula(ranking.best.law)}; {MOTION}"
        lines += [_laws(ranking), _parameters(ranking, alpha), law, *_adequacy(ranking.adequacy)]
    lines += [f"warning: {warning}" for warning in ranking.warnings]
    lines += statistics
    named = [f"; {kind}: {path}" for kind, path in zip(("joint fit", "report"), written, strict=True) if path]
    cycles = f"{ranking.best.cycles} cycles, " if ranking.rows else ""
    lines.append(f"{cycles}{ranking.cpu_s:.1f} s of CPU time{''.join(named)}")
    lines.append(f"verdict: {ranking.verdict}")
    return lines


def _laws(ranking: "Ranking") -> "Table":
    """Return the ranking; ``behind`` is the mean log error behind the best law's, with its standard error."""
    from daq.base.output.lengths import format_length

    table = application.table("friction laws, best first", ("law", "rms error", "behind", "weight", "in set"))
    for row in ranking.candidates:
        behind = "best" if row.score == 0 else f"{row.behind[0]:.2f} ± {row.behind[1]:.2f}"
        weight = f"{row.weight:.2f}" if row.weight >= 0.005 else "<0.01"
        style = "bold" if row.in_set else None
        member = "yes" if row.in_set else "-"
        table.add_row(_title(row), format_length(row.rms_m), behind, weight, member, style=style)
    return table


def _title(row: "LawResult | RivalResult") -> str:
    return f"{row.law} {row.name}" if isinstance(row.law, int) else f"{row.name}: {row.formula}"


def _adequacy(adequacy: "Adequacy") -> list[Any]:
    """Return goodness of fit, the published forms of the measured curve, and the departures, in words."""
    from fitting.selection.verdict import format_probability

    lines: list[Any] = []
    found, curve = adequacy.goodness, adequacy.curve
    if found is not None:
        visible = adequacy.smallest_visible
        size = f"{visible:.2g} % of Fs" if visible is not None else "not determined by this record"
        lines.append(
            f"goodness of fit: {adequacy.said}; residuals {found.misfit:.3g} times the noise of "
            f"{1e6 * found.noise_m:.3g} um, repeating share {found.repeat:.2g}, p {format_probability(found.p_value)}; "
            f"smallest visible departure of friction: {size}"
        )
    if curve is not None and adequacy.rejected and adequacy.of_speed:
        table = application.table("published forms of the measured curve", ("form", "chi", "inside band", "parameters"))
        table.columns[0].justify = table.columns[3].justify = "left"
        table.columns[0].no_wrap = table.columns[3].no_wrap = False
        for form in curve.forms[:MOST_FORMS]:
            values = ", ".join(f"{name} = {item.value:.4g} {item.unit}" for name, item in form.determined.items())
            table.add_row(form.name.replace("-", " "), f"{form.chi:.2f}", "yes" if form.inside_band else "-", values)
        lines.append(table)
    if adequacy.departures:
        title = "departures that would explain it" if adequacy.rejected else "beside the law"
        table = application.table(title, ("departure", "sigmas", "size", "std. error", "unit", "explained"))
        table.columns[0].justify, table.columns[0].overflow = "left", "fold"
        for one in adequacy.departures:
            value, error = (f"{one.value:.4g}", f"{one.stderr:.2g}") if one.parameter else ("-", "-")
            table.add_row(one.name, f"{one.sigmas:.1f}", value, error, one.unit, f"{100 * one.explained:.0f} %")
        lines.append(table)
    return lines


def _parameters(ranking: "Ranking", alpha: float) -> "Table":
    """Return the best law's parameters."""
    from fitting.report import page as report

    headings = ("parameter", "value", "std. error", f"{100 * (1 - alpha):g} % interval", "unit")
    table = application.table(f"law {ranking.best.law}", headings)
    rows = [(name, *report.format_interval(item)[:3], item.unit) for name, item in ranking.best.parameters.items()]
    for row in rows:
        table.add_row(*row)
    # A narrow terminal breaks the intervals and the headings between words, and never a name or a number.
    for place, column in enumerate(table.columns):
        cells = [row[place] for row in rows]
        whole = [word for cell in cells for word in cell.split()] if place == INTERVAL else cells
        column.no_wrap = False
        column.min_width = max(map(len, (*whole, *headings[place].split())))
    return table


def main() -> NoReturn:
    """Run the command."""
    application.main(app)


if __name__ == "__main__":
    main()
