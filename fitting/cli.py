"""`fit-friction`: which friction law does the recorded contact obey, and how sure is that."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

from cyclopts import Parameter

from fitting.flags import (
    DEFAULT_LAWS,
    DEFAULT_OUTPUTS,
    DEFAULT_PART,
    DEFAULT_RIG,
    DEFAULT_WORK,
    CalibrationFlags,
    LawFlags,
    OutputFlags,
    PartFlags,
    WorkFlags,
)
from stickslip.console import application
from stickslip.console.application import Answer, Json
from stickslip.errors import DataError

if TYPE_CHECKING:
    from fitting.job import FitOutput
    from fitting.request import FitRequest

app = application.application("fit-friction", usage="Usage: fit-friction [OPTIONS] RUN.h5 [RUN.h5 ...]")


@app.default
def fit(
    file: Annotated[Path, Parameter(help="Run file written by daq record, import or replay.")],
    /,
    *more: Annotated[Path, Parameter(help="More runs of the same contact, fitted jointly with the first.")],
    laws: LawFlags = DEFAULT_LAWS,
    rig: CalibrationFlags = DEFAULT_RIG,
    part: PartFlags = DEFAULT_PART,
    outputs: OutputFlags = DEFAULT_OUTPUTS,
    work: WorkFlags = DEFAULT_WORK,
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
    from fitting.request import FitRequest

    request = FitRequest.of([file, *more], laws, rig, part, outputs, work)
    return _fit_each(request) if work.each else _fit_together(request)


def _fit_each(request: "FitRequest") -> Answer:
    from fitting import batch
    from fitting.report import table

    outputs, work, force = request.outputs, request.work, request.outputs.force
    with application.progress("fitting", float(len(request.files)), "runs") as progress:
        rows = batch.fit(
            request.files, request.places, request.options, work.jobs, work.scheduler, progress, force=force
        )
    if outputs.csv is not None:
        table.write(outputs.csv, [(row.file, row.document.get("ranking", ())) for row in rows])
    if request.comparison is not None:
        batch.compare(rows, request.comparison, request.options.alpha, force=force)
    data = {"runs": [row.as_json() for row in rows], "comparison": request.comparison}
    return Answer(data, batch.text(rows, request.comparison), batch.exit_code(rows))


def _fit_together(request: "FitRequest") -> Answer:
    from daq.runfile import joint
    from fitting import job
    from fitting.report import page, terminal
    from processing.statistics import pooled

    files, options, force = request.files, request.options, request.outputs.force
    place = next(iter(request.places), None)
    runs = [job.load_run(path, options) for path in files]
    if place is not None:
        page.refuse_foreign_file(place, [run.recording.digest for run in runs], files=files, force=force)
    if request.joint_file is not None:
        joint.refuse_foreign_file(request.joint_file, [run.named for run in runs], force=force)
    searched = len(options.competitors.searched)
    with application.progress("fitting", float(searched), "laws") as show:

        def count(laws: float) -> None:
            show(laws)
            show.status("then goodness of fit" if laws >= searched else "")

        done = job.fit_runs(runs, options, request.work.jobs, request.work.scheduler, count)
    done.save(place, force=force)
    _write_tables(done, request)
    document = done.as_json() | {"report": place}
    if request.joint_file is not None:
        document["joint_file"] = request.joint_file
        document["runs"] = [
            {"file": path, "report": place} | run for path, run in zip(files, document["runs"], strict=True)
        ]
    said = pooled(done.statistics).sentences("m")
    text = terminal.of_ranking(done.ranking, said, [request.joint_file, place], options.alpha)
    return Answer(document, text, job.exit_code(document))


def _write_tables(done: "FitOutput", request: "FitRequest") -> None:
    from fitting import rig_scene
    from fitting.report import table

    outputs, files, ranking = request.outputs, request.files, done.ranking
    if outputs.csv is not None:
        sides = zip(files, ranking.sides, strict=True)
        table.write(outputs.csv, [(path, [row.as_json() for row in side.table]) for path, side in sides])
    if outputs.curve_csv is not None:
        curve = ranking.adequacy.curve
        if curve is None:
            raise DataError("no friction curve could be measured", str(files[0]), "leave out --curve-csv")
        table.write_curve(outputs.curve_csv, ranking, curve)
    if outputs.save_scene is not None:
        rig_scene.save(outputs.save_scene, ranking, done.statistics[0], files[0])


def main() -> NoReturn:
    application.main(app)


if __name__ == "__main__":
    main()
