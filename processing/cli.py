"""`process`: make the motion out of a recorded run, compare the ways to, look at it, hand it on."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import Parameter

from daq.console import application
from daq.console.application import Answer, Json
from daq.errors import InputError

if TYPE_CHECKING:
    from processing.compare import Row
    from processing.record.kinematics import Kinematics, SmoothingSummary

Run = Annotated[Path, Parameter(help="Run file, as daq record, import or replay made it.")]
Force = Annotated[bool, Parameter(negative=(), help="Replace an existing output file.")]

NAMES = {
    "segment": "sticks and slips smoothed apart, corners fitted",
    "rts": "fixed-interval smoother, noise levels by likelihood",
    "sg": "Savitzky-Golay",
    "fd": "finite differences",
}

app = application.application(
    "process", "Position, velocity and acceleration from a recorded run.", "process smooth run.h5"
)


@app.command
def smooth(
    file: Run,
    /,
    *,
    method: Annotated[
        str,
        Parameter(
            help="auto (segment where sticks are beyond doubt, else rts), segment, rts, "
            "sg (Savitzky-Golay) or fd (differences, the baseline)."
        ),
    ] = "auto",
    window: Annotated[
        str, Parameter(help="Of Savitzky-Golay: auto, an odd number of samples, or a duration: 20ms.")
    ] = "auto",
    order: Annotated[int | None, Parameter(help="Degree of the polynomial; default chosen with the window.")] = None,
    times: Annotated[str, Parameter(help="recorded: the board's sample times; nominal: an even grid.")] = "recorded",
    repair_counts: Annotated[
        str, Parameter(help="Lost counts: off (not looked for), flag (marked), fix (marked and put back).")
    ] = "flag",
    belt_speed: Annotated[str, Parameter(help="auto (belt counts, else plateaus), or m/s with its sign.")] = "auto",
    json: Json = False,
) -> Answer:
    """Rebuild the motion, find sticks and slips, and write both into the run beside the untouched raw data.

    Example: process smooth run.h5 --window 20ms
    """
    from daq.runfile import store
    from processing import smoothing, stage

    asked = (method, window, order, times, belt_speed, repair_counts)
    motion: Kinematics | SmoothingSummary
    n = store.samples(file)
    if n > smoothing.LARGE:
        with application.progress("smoothing", n, "samples") as tell:
            motion = smoothing.smooth_file(file, *asked, progress=tell)
    else:
        made = smoothing.smooth(store.load(file), *asked)
        stage.save(made, file)
        motion = made
    chosen = window == "auto" and motion.method == "sg"
    data = _summary(motion)
    return Answer(data, [*_sentences(motion, data, chosen), f"written to /entry/smooth of {file}"])


@app.command
def compare(file: Run, /, *, json: Json = False) -> Answer:
    """Run every method on the record: error against run time.

    The true errors are known only for a simulated run that tells its truth
    (daq record --set tell.truth=true).

    Example: process compare run.h5
    """
    from daq.runfile import store
    from processing import compare as comparison

    recording = store.load(file)
    rows = comparison.rows(recording, store.truth(file))
    told = any(row.rms_error is not None for row in rows)
    return Answer({"rows": [vars(row) for row in rows], "truth": told}, _table(rows, file, recording.unit, told))


@app.command
def inspect(
    file: Run,
    /,
    *,
    plot: Annotated[
        Path | None, Parameter(help="Picture to write: .png, .svg or .pdf; default RUN.inspect.png.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Show a run: what it holds, its time trace and its phase portrait.

    A run that was not smoothed yet is smoothed in memory.

    Example: process inspect run.h5 --plot portrait.png
    """
    from daq.output import atomic
    from processing import plot as drawing

    target = plot if plot is not None else file.with_name(f"{file.stem}.inspect.png")
    if plot is not None:
        atomic.refuse_existing(plot, force, file)
    motion, now = _motion(file)
    drawing.save(drawing.inspection(motion), target)
    recording = motion.recording
    data = _summary(motion) | {
        "title": recording.title,
        "started": recording.started,
        "duration_s": float(motion.time[-1] - motion.time[0]),
        "rate_hz": recording.rate_hz,
        "segments": len(set(recording.segment.tolist())),
        "unit": recording.unit,
        "position_range": [float(motion.position.min()), float(motion.position.max())],
        "velocity_range": [float(motion.velocity.min()), float(motion.velocity.max())],
        "events": {kind: recording.event_kind.count(kind) for kind in sorted(set(recording.event_kind))},
        "smoothed_in_memory": now,
        "plot": target,
    }
    return Answer(data, _portrayal(file, data, motion))


@app.command
def export(
    file: Run,
    /,
    *,
    csv: Annotated[Path | None, Parameter(help="CSV file to write.")] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Write the motion as a table: time, position, velocity, acceleration, their errors, and the phase.

    A run that was not smoothed yet is smoothed in memory.

    Example: process export run.h5 --csv motion.csv
    """
    from daq.output import atomic
    from processing import export as tables

    if csv is None:
        raise InputError("nothing to write", "command line", "give --csv FILE")
    atomic.refuse_existing(csv, force, file)
    motion, now = _motion(file)
    columns = tables.write_csv(motion, csv, force=force)
    rows = int(motion.time.size)
    data = {"rows": rows, "columns": columns, "file": csv, "smoothed_in_memory": now}
    return Answer(data, f"{csv}: {rows} rows; columns {', '.join(columns)}")


def _motion(file: Path) -> "tuple[Kinematics, bool]":
    """Return the stored motion, or one smoothed in memory and True."""
    from daq.runfile import store
    from processing import stage
    from processing.smoothing import smooth as rebuild

    stored = stage.load(file)
    if stored is not None:
        return stored, False
    return rebuild(store.load(file)), True


def _summary(motion: "Kinematics | SmoothingSummary") -> dict[str, Any]:
    return {
        "method": motion.method,
        "window": motion.window,
        "order": motion.order,
        "times": motion.times,
        "sticks": len(motion.sticks),
        "slips": len(motion.slips),
        "belt_speed": motion.belt_speed,
        "belt_channel": motion.belt_counted,
        "plateau_fraction": motion.plateau_fraction,
        "lost_counts": motion.lost_counts,
        "repaired": motion.repaired,
        "losses": [vars(loss) for loss in motion.losses],
        "kicks": [vars(kick) for kick in motion.kicks],
        "phases": [
            {name: getattr(phase, name) for name in ("kind", "start", "start_sd", "end", "end_sd")}
            for phase in motion.phases
        ],
        "cpu_s": motion.cpu_s,
        "samples": motion.samples,
        "warnings": _warnings(motion),
    }


def _warnings(motion: "Kinematics | SmoothingSummary") -> list[str]:
    found = []
    if motion.lost_counts:
        found.append(
            f"counts went missing {motion.lost_counts} time{'s' if motion.lost_counts > 1 else ''} "
            f"({'put back' if motion.repaired else 'marked, not repaired'}): "
            "look for a bouncing encoder wheel or a slipping coupling"
        )
    if motion.kicks:
        found.append(
            f"the velocity stepped {len(motion.kicks)} time{'s' if len(motion.kicks) > 1 else ''}, as by a belt joint "
            f"(the first by {motion.kicks[0].step:.2g} {motion.unit}/s); marked"
        )
    if motion.phases and not motion.sticks and motion.plateau_speed == motion.plateau_speed:
        found.append(
            f"no stick at the belt speed of {motion.belt_speed:g}, but the mass rides at {motion.plateau_speed:.5g}: "
            "check --belt-speed and its sign, or leave it at auto"
        )
    if not motion.phases:
        found.append("the mass never moves in this record")
    return found


def _sentences(motion: "Kinematics | SmoothingSummary", data: dict[str, Any], chosen: bool) -> list[str]:
    unit = motion.unit
    how = NAMES[motion.method]
    if motion.method == "sg":
        span = 1e3 * (motion.window - 1) * motion.span / max(motion.samples - 1, 1)
        how += f", window {motion.window} samples ({span:.3g} ms), order {motion.order}"
        how += ", chosen from the record" if chosen else ""
    speed = motion.belt_speed
    belt = f"belt {speed:.5g} {unit}/s" if speed == speed else "belt speed unknown"
    belt += " (it has its own counts)" if motion.belt_counted else ""
    sticks, slips = data["sticks"], data["slips"]
    lines = [
        f"{how}; {motion.times} times",
        f"{sticks} stick{'s' if sticks != 1 else ''} and {slips} slip{'s' if slips != 1 else ''}; {belt}; "
        f"stuck for {100 * motion.plateau_fraction:.0f} % of the record",
        f"{data['samples']} samples in {motion.cpu_s:.2f} s of CPU time",
    ]
    if motion.method == "segment" and motion.sticks:
        landing, onset = (_usual([getattr(stick, name) for stick in motion.sticks]) for name in ("start_sd", "end_sd"))
        lines.insert(2, f"corners are told to {landing} (landings) and {onset} (onsets)")
    return lines + [f"warning: {warning}" for warning in data["warnings"]]


def _usual(spreads: list[float]) -> str:
    known = sorted(spread for spread in spreads if spread < math.inf)
    return f"{1e3 * known[len(known) // 2]:.2g} ms" if known else "nothing"


def _table(rows: "list[Row]", file: Path, unit: str, told: bool) -> Any:
    factor, name = (1e3, "mm/s") if unit == "m" else (1.0, f"{unit}/s")
    headings = ("method", "setting", "CPU ms", "stated", "true rms", "true max")
    table = application.table(f"{file}: errors of the velocity, {name}", headings, left=2)
    for row in rows:
        errors = (row.sigma_v, row.rms_error, row.max_error)
        shown = ["-" if value is None else f"{factor * value:.3g}" for value in errors]
        table.add_row(row.method, row.setting, f"{1e3 * row.cpu_s:.1f}", *shown)
    if told:
        return table
    return [table, "no truth in this run; record one with: daq record --set tell.truth=true"]


def _portrayal(file: Path, data: dict[str, Any], motion: "Kinematics") -> Any:
    unit = data["unit"]
    low, high = data["position_range"]
    slow, fast = data["velocity_range"]
    events = ", ".join(f"{count} {kind}" for kind, count in data["events"].items()) or "none"
    segments = f" in {data['segments']} segments" if data["segments"] > 1 else ""
    lines = [
        f"{file}: {data['title']}, {data['started']}",
        f"{data['samples']} samples at {data['rate_hz']:g} Hz, {data['duration_s']:.4g} s{segments}; events: {events}",
        f"position {low:.4g} to {high:.4g} {unit}, velocity {slow:.4g} to {fast:.4g} {unit}/s",
        *_sentences(motion, data, False)[:2],
        f"picture: {data['plot']}",
    ]
    if data["smoothed_in_memory"]:
        lines.append("not smoothed yet, so smoothed in memory; keep it with: process smooth")
    return lines + [f"warning: {warning}" for warning in data["warnings"]]


def main() -> NoReturn:
    """Run the command line."""
    application.main(app)


if __name__ == "__main__":
    main()
