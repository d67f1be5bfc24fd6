"""`process`: smooth a recorded run, compare the methods, show it, export it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import Parameter

from stickslip.console import application, flags
from stickslip.console.application import Answer, Json
from stickslip.console.flags import Force
from stickslip.errors import InputError

if TYPE_CHECKING:
    from daq.runfile.recording import Recording
    from processing.compare import MethodError
    from processing.record.kinematics import Kinematics, SmoothingSummary


Run = Annotated[Path, Parameter(help="Run file written by daq record, import or replay.")]
From = Annotated[
    float | None,
    flags.quantity("--from", "time", "Start of the smoothed part, such as '5' or '1.5 min'."),
    flags.OF_PART,
]
To = Annotated[float | None, flags.quantity("--to", "time", "End of the smoothed part."), flags.OF_PART]

app = application.application(
    "process", "Estimate position, velocity and acceleration from a recorded run.", "process smooth run.h5"
)


@app.command
def smooth(
    file: Run,
    /,
    *,
    method: Annotated[
        str,
        Parameter(
            help="'auto' ('segment' if the record clearly contains sticks, otherwise 'rts'), 'segment', 'rts', "
            "'sg' (Savitzky-Golay) or 'fd' (finite differences)."
        ),
    ] = "auto",
    window: Annotated[
        str, Parameter(help="Savitzky-Golay window: 'auto', an odd number of samples, or a duration such as 20ms.")
    ] = "auto",
    order: Annotated[
        int | None,
        Parameter(help="Degree of the Savitzky-Golay polynomial; by default chosen together with the window."),
    ] = None,
    times: Annotated[
        str, Parameter(help="Sample times: 'recorded' by the board, or 'nominal' (evenly spaced).")
    ] = "recorded",
    repair_counts: Annotated[
        str,
        Parameter(
            help="How to treat steps of the position (lost counts, a shifted zero): 'off' (ignore), 'flag' or 'fix'."
        ),
    ] = "flag",
    belt_speed: Annotated[
        str, Parameter(help="Signed belt speed, or 'auto' to estimate it from belt counts or sticks.")
    ] = "auto",
    begin: From = None,
    end: To = None,
    json: Json = False,
) -> Answer:
    """Estimate the motion, sticks and slips, and add them to the run file; the raw data do not change.

    With --from or --to, only a part of the run is smoothed, and later commands use only that part.

    Example: process smooth run.h5

    Example: process smooth run.h5 --window 20ms

    Example: process smooth run.h5 --from 5 --to 1.5min
    """
    from daq.runfile import store
    from processing import smoothing, stage, summary
    from stickslip.units import quantity

    speed = belt_speed if belt_speed == "auto" else quantity(belt_speed, "speed", "--belt-speed")
    options = (method, window, order, times, speed, repair_counts)
    motion: SmoothingSummary
    samples = store.select_between(file, begin, end)
    with store.open_reader(file, samples) as run:
        n = run.samples
    if n > smoothing.LARGE:
        with application.progress("smoothing", n, "samples") as progress:
            motion = smoothing.smooth_file(file, *options, progress=progress, samples=samples)
    else:
        kinematics = smoothing.smooth(store.load(file, samples), *options)
        stage.save(kinematics, file, samples)
        motion = kinematics
    slip_statistics = stage.load_statistics(file)
    data = summary.as_json(motion) | {"statistics": slip_statistics.as_json()}
    lines = summary.format_sentences(motion, chosen=window == "auto") + slip_statistics.sentences(motion.unit)
    return Answer(data, [*lines, f"written to /entry/smooth of {file}"])


@app.command
def compare(file: Run, /, *, json: Json = False) -> Answer:
    """Compare the error and the run time of all methods on a run.

    A setting gives window and order of sg (55,6: 55 samples, degree 6), and the times used: recorded, or nominal (an
    even grid).  The stated error is the standard error that the method estimates.  The true errors are known only for a
    simulated run that contains its exact motion (daq record --set output.truth=true).

    Example: process compare run.h5
    """
    from daq.runfile import store
    from processing import compare as comparison

    recording = store.load(file)
    with application.progress("comparing", 100, "%") as show:
        rows = comparison.compare_methods(recording, store.truth(file), show)
    has_truth = any(row.rms_error is not None for row in rows)
    return Answer(
        {"rows": [vars(row) for row in rows], "truth": has_truth}, _table(rows, file, recording.unit, has_truth)
    )


@app.command
def inspect(
    file: Run,
    /,
    *,
    plot: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o", "--plot"],
            metavar="FILE",
            help="File of the figure (.png, .svg or .pdf); default RUN.inspect.png.",
            group=flags.OUTPUT,
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Show a run: summary, time series and phase portrait.

    A run that has not been smoothed is smoothed in memory.  An older picture of the same run is replaced; any other
    file is replaced only with --force.

    Example: process inspect run.h5

    Example: process inspect run.h5 -o portrait.png
    """
    from processing import statistics, summary
    from processing.plot import draw_inspection
    from stickslip.output.plot import check_place, save

    target = plot if plot is not None else file.with_name(f"{file.stem}.inspect.png")
    recording, stored = _load_motion(file)
    check_place(target, file, force=force, digest=recording.digest)
    motion = _smooth_in_memory(recording) if stored is None else stored
    save(draw_inspection(motion), target, file, force=force, digest=recording.digest)
    slip_statistics = statistics.from_kinematics(motion)
    data = summary.run_as_json(motion) | {
        "statistics": slip_statistics.as_json(),
        "smoothed_in_memory": stored is None,
        "plot": target,
    }
    lines = summary.format_run_sentences(motion, file) + slip_statistics.sentences(motion.unit)
    if stored is None:
        lines.append(
            "the run has not been smoothed yet, so it is smoothed in memory; 'process smooth' stores the result"
        )
    return Answer(data, [*lines, f"picture: {target}"])


@app.command
def export(
    file: Run,
    /,
    *,
    csv: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o", "--csv"], metavar="FILE", help="File of the table (.csv).", group=flags.OUTPUT
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Write the motion as a table: time, position, velocity, acceleration, their errors, and the phase.

    A run that has not been smoothed is smoothed in memory.

    Example: process export run.h5 -o motion.csv
    """
    from stickslip.output import atomic, suffix, tables

    if csv is None:
        raise InputError("no output file was given", "command line", "add -o FILE.csv")
    atomic.refuse_existing(csv, force, file)
    suffix.check(csv, suffix.CSV)
    recording, stored = _load_motion(file)
    motion = _smooth_in_memory(recording) if stored is None else stored
    table = motion.to_dataframe()
    tables.write(table, csv, "csv", force=force)
    rows, columns = len(table), list(table.columns)
    data = {"rows": rows, "columns": columns, "file": csv, "smoothed_in_memory": stored is None}
    return Answer(data, f"{csv}: {rows} rows; columns {', '.join(columns)}")


def _load_motion(file: Path) -> "tuple[Recording, Kinematics | None]":
    """Return the recording of a run, and its motion where it has been smoothed."""
    from daq.runfile import store
    from processing import stage

    motion = stage.load(file)
    return (store.load(file), None) if motion is None else (motion.recording, motion)


def _smooth_in_memory(recording: "Recording") -> "Kinematics":
    """Return the motion, smoothed in memory."""
    from processing.smoothing import smooth as rebuild

    return rebuild(recording)


def _table(rows: "list[MethodError]", file: Path, unit: str, has_truth: bool) -> Any:
    factor, name = (1e3, "mm/s") if unit == "m" else (1.0, f"{unit}/s")
    headings = ("method", "setting", "CPU ms", "stated", "true rms", "true max")
    table = application.table(f"{file}: errors of the velocity, {name}", headings, left=2)
    for row in rows:
        errors = (row.sigma_v, row.rms_error, row.max_error)
        texts = ["-" if value is None else f"{factor * value:.3g}" for value in errors]
        table.add_row(row.method, row.setting, f"{1e3 * row.cpu_s:.1f}", *texts)
    if has_truth:
        return table
    return [table, "this run does not contain the exact motion; to record it, use: daq record --set output.truth=true"]


def main() -> NoReturn:
    """Run the command line."""
    application.main(app)


if __name__ == "__main__":
    main()
