"""The commands that meet files: `daq import`, `daq replay`, `daq decode`, `daq export`."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts
from cyclopts import Parameter

from daq.console import application
from daq.console.application import Answer, Json
from daq.errors import InputError

if TYPE_CHECKING:
    from daq.imports.capture import Totals
    from daq.runfile.recording import Recording
    from daq.runfile.rig import Measured, Rig

Output = Annotated[Path | None, Parameter(name=["--output", "-o"], help="Run file to write.")]
Force = Annotated[bool, Parameter(negative=(), help="Replace an existing output file.")]
Channels = Annotated[str | None, Parameter(help="Quadrature pair: A=NAME,B=NAME, by name or by index from 0.")]
Step = Annotated[str | None, Parameter(help="Probe of the step pulses, by name or by index from 0.")]
Direction = Annotated[str | None, Parameter(name="--dir", help="Probe of the direction; high counts up.")]
DecoderName = Annotated[str | None, Parameter(name="--decoder", help="x4 (default), x1, jk or jk-latched.")]


def register(app: cyclopts.App) -> None:
    """Add these commands to the `daq` application."""
    app.command(import_table, name="import")
    app.command(replay)
    app.command(decode)
    app.command(export)


def import_table(
    file: Path,
    /,
    *,
    output: Output = None,
    position: Annotated[str | None, Parameter(help="Column of positions: its name, or its number from 1.")] = None,
    time: Annotated[str | None, Parameter(help="Column of times: its name, or its number from 1.")] = None,
    x_unit: Annotated[
        str | None, Parameter(help="Unit of positions; default the header's, else m. '0.25 mm' for such a pixel.")
    ] = None,
    t_unit: Annotated[str | None, Parameter(help="Unit of times; default the header's, else s.")] = None,
    frame_rate: Annotated[
        str | None, Parameter(help="The camera's true rate, '400 fps': makes the times, or corrects them.")
    ] = None,
    mass: Annotated[str | None, Parameter(help="Moving mass: '0.3', '300 g', '300 g +- 1 g'.")] = None,
    stiffness: Annotated[str | None, Parameter(help="Spring: '10.5', '10.5 N/m'.")] = None,
    belt: Annotated[str | None, Parameter(help="Belt speed towards +x: '0.22', '22 cm/s'.")] = None,
    datum: Annotated[str | None, Parameter(help="Where the table's x = 0 lies, seen from the spring's rest.")] = None,
    start: Annotated[str | None, Parameter(help="When it began, ISO 8601 with zone; default the file's date.")] = None,
    title: Annotated[str | None, Parameter(help="Title of the run.")] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Make a run file of a table of times and positions: a CSV, from a camera for instance, or a MATLAB file.

    Delimiter, decimal sign, header and units in it are found; bare numbers are SI.  With mass and stiffness the
    frame rate is checked against the slips.

    Example: daq import track.csv -o run.h5 --x-unit cm --mass "300 g" --stiffness "10.5 N/m"
    """
    from daq.imports import track
    from daq.output import atomic
    from daq.runfile import store

    target = output or file.with_suffix(".h5")
    atomic.refuse_existing(target, force, file)
    wishes = track.Wishes(
        time=time,
        position=position,
        t_unit=t_unit,
        x_unit=x_unit,
        frame_rate_hz=_rate(frame_rate, "--frame-rate"),
        mass=_measured(mass, "mass", "--mass"),
        stiffness=_measured(stiffness, "stiffness", "--stiffness"),
        belt_speed=_measured(belt, "speed", "--belt", key="belt_speed"),
        datum=_measured(datum, "length", "--datum", key="datum"),
        started=start,
        title=title,
    )
    found = track.read(file, wishes)
    store.write(target, found.run, force=force)
    data = _summary(found.run, target, list(found.warnings)) | {
        "columns": found.columns,
        "delimiter": found.delimiter,
        "decimal": found.decimal,
        "even": found.even,
    }
    read_as = f"delimiter {found.delimiter}, decimal {found.decimal!r}, time from {found.columns['time']}"
    read_as += f", position from {found.columns['position']}" + ("" if found.even else "; unevenly sampled")
    return Answer(data, _text("imported", found.run, data, f"read as: {read_as}"))


def replay(
    source: Path,
    /,
    *,
    output: Output = None,
    channels: Channels = None,
    step: Step = None,
    direction: Direction = None,
    decoder: DecoderName = None,
    rate: Annotated[
        str | None, Parameter(help="Sample rate of a capture's run; default 1000, or the capture's.")
    ] = None,
    capture_rate: Annotated[
        str | None, Parameter(help="The capture's own rate, where its metadata do not say.")
    ] = None,
    rig: Annotated[Path | None, Parameter(help="Calibration (rig.toml) to use instead of the recorded one.")] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Make a run file again from a journal, a run file, or a sigrok .sr capture.

    Example: daq replay capture.sr --channels A=XA,B=XB -o run.h5
    """
    from daq.imports import replay as again
    from daq.output import atomic
    from daq.runfile import store

    kind = again.kind_of(source)
    target = output or _default_output(source, kind)
    atomic.refuse_existing(target, force, source)
    calibration = _rig(rig)
    if kind == "capture":
        return _replay_capture(source, target, (channels, step, direction, decoder), rate, capture_rate, rig, force)
    given = {
        "--channels": channels,
        "--step": step,
        "--dir": direction,
        "--decoder": decoder,
        "--rate": rate,
        "--capture-rate": capture_rate,
    }
    for flag, value in given.items():
        if value is not None:
            raise InputError(f"{flag} is for .sr captures; this is a {kind}", str(source), "leave it out")
    if kind == "journal":
        from daq.finalise import run as finalise
        from daq.runfile import journal

        markers = journal.read_markers(journal.markers_path(source))
        run, summary = finalise.run_data(journal.read(source), markers, "daq replay")
        extra = summary.as_json()
    else:
        run = again.from_run(source)
        extra = again.findings(run) | {"warnings": [], "clock_ppm": run.clock_ppm}
    if calibration is not None:
        run = again.recalibrated(run, calibration)
    store.write(target, run, force=force)
    data = _summary(run, target, extra["warnings"]) | extra | {"file": target}
    return Answer(data, _text(f"replayed the {kind} {source}:", run, data))


def decode(
    file: Path,
    /,
    *,
    channels: Channels = None,
    step: Step = None,
    direction: Direction = None,
    decoder: DecoderName = None,
    json: Json = False,
) -> Answer:
    """Count the edges in a sigrok .sr capture: a quadrature pair, or step and direction.

    Example: daq decode capture.sr --channels A=XA,B=XB --decoder x4
    """
    from daq.imports import capture as decoding
    from daq.imports import sigrok

    capture = sigrok.read(file)
    wired = decoding.wiring(capture, channels, step, direction, decoder)
    with application.progress("decoding", capture.samples, "samples") as tell:
        totals = decoding.decode(capture, wired, tell)
    names = [capture.probes[bit] for bit in wired.bits]
    data = vars(totals) | {
        "decoder": wired.decoder,
        "probes": names,
        "samples": capture.samples,
        "rate_hz": capture.rate_hz,
        "file": file,
        "warnings": _count_warnings(totals),
    }
    line = f"up {totals.up}, down {totals.down}, net {totals.net}, illegal {totals.illegal}, edges {totals.edges}"
    line += f"  ({wired.decoder} on probes {names[0]} and {names[1]})"
    return Answer(data, "\n".join([line, *(f"warning: {warning}" for warning in data["warnings"])]))


def export(
    file: Path,
    /,
    *,
    csv: Annotated[Path | None, Parameter(help="CSV file to write.")] = None,
    parquet: Annotated[Path | None, Parameter(help="Parquet file to write.")] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Write a run as a flat table, one row a sample, units in the column names.

    Example: daq export run.h5 --csv run.csv
    """
    from daq.output import atomic, tables
    from daq.runfile import store

    targets = {form: target for form, target in (("csv", csv), ("parquet", parquet)) if target is not None}
    if not targets:
        raise InputError("nothing to write", "command line", "give --csv FILE or --parquet FILE")
    for target in targets.values():
        atomic.refuse_existing(target, force, file)
    rows = tables.frame(store.load(file))
    for form, target in targets.items():
        tables.write(rows, target, form, force=force)
    names = [str(target) for target in targets.values()]
    data = {"rows": len(rows), "columns": list(rows.columns), "files": names}
    return Answer(data, f"{', '.join(names)}: {len(rows)} rows")


def _replay_capture(
    source: Path,
    target: Path,
    wires: tuple[str | None, str | None, str | None, str | None],
    rate: str | None,
    capture_rate: str | None,
    rig: Path | None,
    force: bool,
) -> Answer:
    from dataclasses import replace

    from daq.imports import capture as decoding
    from daq.imports import replay as again
    from daq.imports import sigrok
    from daq.runfile import store
    from daq.runfile.rig import Rig

    capture = sigrok.read(source)
    stated = _rate(capture_rate, "--capture-rate")
    if stated is not None:
        capture = replace(capture, rate_hz=stated)
    wired = decoding.wiring(capture, *wires)
    rate_hz = _rate(rate, "--rate") or min(1000.0, capture.rate_hz or 1000.0)
    with application.progress("replaying", capture.samples, "samples") as tell:
        run, totals = again.from_capture(capture, wired, rate_hz, _rig(rig) or Rig(), tell)
    store.write(target, run, force=force)
    warnings = _count_warnings(totals)
    if run.rig.metres_per_count is None:
        warnings.append("metres per count are not known: positions are counts; give --rig to calibrate")
    data = again.findings(run) | {"clock_ppm": None} | _summary(run, target, warnings) | vars(totals)
    counts = f"up {totals.up}, down {totals.down}, net {totals.net}, illegal {totals.illegal}, edges {totals.edges}"
    return Answer(data, _text(f"replayed the capture {source}:", run, data, counts))


def _default_output(source: Path, kind: str) -> Path:
    if kind == "run":
        raise InputError("where to?", str(source), "give -o")
    return source.with_suffix("") if source.suffix == ".part" else source.with_suffix(".h5")


def _summary(run: "Recording", target: Path, warnings: list[str]) -> dict[str, Any]:
    segment = run.segment
    return {
        "samples": int(run.time.size),
        "segments": 1 if segment is None else len(set(segment.tolist())),
        "rate_hz": run.rate_hz,
        "duration_s": float(run.time[-1] - run.time[0]) + 1 / run.rate_hz,  # to one period after the last sample
        "file": target,
        "warnings": warnings,
    }


def _count_warnings(totals: "Totals") -> list[str]:
    if totals.illegal:
        return [f"{totals.illegal} illegal transitions: both channels changed at once, the count is uncertain by them"]
    return [] if totals.edges else ["no edges: are these the right probes?"]


def _text(done: str, run: "Recording", data: dict[str, Any], *lines: str) -> str:
    counted = run.count is not None and run.rig.metres_per_count is None
    scale, unit = (1.0, "counts") if counted else (1e3, "mm")
    low, high = (scale * float(edge) for edge in (run.position.min(), run.position.max()))
    told = [
        f"{done} {data['samples']} samples in {data['duration_s']:.4g} s at {run.rate_hz:.6g} Hz",
        *lines,
        f"the mass moved between {low:.4g} and {high:.4g} {unit}",
        *(f"warning: {warning}" for warning in data["warnings"]),
        f"-> {data['file']}",
        f"next: process smooth {shlex.quote(str(data['file']))}",
    ]
    return "\n".join(told)


def _rate(text: str | None, flag: str) -> float | None:
    if text is None:
        return None
    from daq.console import units

    rate = units.quantity(text, "rate", flag)
    if rate <= 0:
        raise InputError(f"{text!r} is not positive", flag, "give a rate like '400 fps'")
    return rate


def _measured(text: str | None, dimension: str, flag: str, key: str | None = None) -> "Measured | None":
    if text is None:
        return None
    from daq.console import units
    from daq.runfile.rig import checked

    found = units.measured(text, dimension, flag)
    return checked(key or dimension, found.value, found.sd, flag)


def _rig(path: Path | None) -> "Rig | None":
    if path is None:
        return None
    from daq.runfile.rig import Rig

    if not path.is_file():
        raise InputError("no such file", str(path), "check --rig")
    return Rig.from_toml(path.read_text(encoding="utf-8"), str(path))
