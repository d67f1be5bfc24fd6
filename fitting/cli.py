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
    from collections.abc import Sequence

    from fitting.options import Options
    from fitting.request import Places
    from fitting.result import Ranking


app = application.application("fit-friction", usage="Usage: fit-friction [OPTIONS] RUN.h5 [RUN.h5 ...]")


@app.default
def fit(
    file: Annotated[Path, Parameter(metavar="RUN.h5", help="Run file written by 'daq record' or 'daq import'.")],
    /,
    *more: Annotated[Path, Parameter(metavar="RUN.h5", help="More runs of the same contact.")],
    laws: LawFlags = DEFAULT_LAWS,
    rig: CalibrationFlags = DEFAULT_RIG,
    part: PartFlags = DEFAULT_PART,
    outputs: OutputFlags = DEFAULT_OUTPUTS,
    work: WorkFlags = DEFAULT_WORK,
    json: Json = False,
) -> Answer:
    """Fit the friction laws to a run, rank them, and write a report next to the run.

    Example: fit-friction run.h5

    Example: fit-friction run.h5 --laws 3,5,6 --mass "300 g" --x0 "60 mm +- 0.1 mm"

    Example: fit-friction run.h5 --from 5 --to "1.5 min" --no-report

    Example: fit-friction --each monday/*.h5 --jobs 4

    Several runs are fitted jointly, as one contact, and the result is written to RUN+N.fit.h5.  With --each, runs are
    fitted separately, and a page compares them.  Exit codes: 0 if one law describes the data, 5 if several do, 6 if
    none does, and 4 if the data are insufficient.
    """
    from fitting import request

    options = request.read_options(laws, rig, part, work)
    runs = request.select_runs([file, *more], each=work.each)
    places = request.place_outputs(runs, outputs, each=work.each)
    return (_fit_each if work.each else _fit_together)(runs, options, outputs, places)


def _fit_each(files: "Sequence[Path]", options: "Options", outputs: OutputFlags, places: "Places") -> Answer:
    from fitting import batch
    from fitting.report import comparison, stage

    force, compared = outputs.force, places.comparison
    with application.progress("fitting", float(len(files)), "runs") as progress:
        rows = batch.fit(files, places.reports, options, progress, force=force)
    if outputs.csv is not None:
        stage.write(outputs.csv, [(row.file, row.document.get("ranking", ())) for row in rows])
    if compared is not None:
        comparison.write(rows, compared, options.alpha, batch.summary(rows), force=force)
    data = {"runs": [row.as_json() for row in rows], "comparison": compared}
    return Answer(data, batch.text(rows, compared), batch.exit_code(rows))


def _fit_together(files: "Sequence[Path]", options: "Options", outputs: OutputFlags, places: "Places") -> Answer:
    from daq.runfile import joint
    from fitting import job
    from fitting.report import page, terminal

    force, place, joint_file = outputs.force, next(iter(places.reports), None), places.joint_file
    runs = [job.load_run(path, options) for path in files]
    recordings = [run.recording for run in runs]
    if place is not None:
        page.refuse_foreign_file(place, [recording.digest for recording in recordings], files=files, force=force)
    if joint_file is not None:
        joint.refuse_foreign_file(joint_file, recordings, force=force)
    searched = len(options.competitors.searched)
    with application.progress("fitting", float(searched), "laws") as show:

        def count(laws: float) -> None:
            show(laws)
            if laws >= searched:
                show.stage("goodness of fit", laws, None)

        ranking = job.fit_runs(runs, options, count)
        text = page.render(ranking) if place is not None else ""
    job.save(ranking, place, text, force=force)
    _write_tables(ranking, files, outputs)
    document = ranking.as_json() | {"report": place}
    if joint_file is not None:
        document["joint_file"] = joint_file
        document["runs"] = [
            {"file": path, "report": place} | run for path, run in zip(files, document["runs"], strict=True)
        ]
    return Answer(document, terminal.of_ranking(ranking, [joint_file, place]), job.exit_code(document))


def _write_tables(ranking: "Ranking", files: "Sequence[Path]", outputs: OutputFlags) -> None:
    from fitting import scene
    from fitting.report import stage

    if outputs.csv is not None:
        sides = zip(files, ranking.sides, strict=True)
        stage.write(outputs.csv, [(path, [row.as_json() for row in side.table]) for path, side in sides])
    if outputs.curve_csv is not None:
        if ranking.adequacy.curve is None:
            raise DataError("no friction curve could be measured", str(files[0]), "omit --curve-csv")
        stage.write_curve(outputs.curve_csv, ranking, ranking.adequacy.curve)
    if outputs.save_scene is not None:
        scene.save(outputs.save_scene, ranking, files[0])


def main() -> NoReturn:
    application.main(app)


if __name__ == "__main__":
    main()
