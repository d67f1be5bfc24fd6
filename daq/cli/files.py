"""The commands on files: `daq import`, `daq replay`, `daq decode`, `daq export`."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from daq.cli import sentences
from daq.imports.options import NO_CAPTURE, NO_OPTIONS, NO_PROBES, CaptureOptions, ImportOptions, ProbeOptions
from daq.recorder.notes import NO_NOTES, NoteFlags
from stickslip import toml
from stickslip.console import application
from stickslip.console.application import Answer, Json
from stickslip.console.flags import OUTPUT, Force
from stickslip.console.rig_flags import NO_RIG, RigFlags
from stickslip.errors import InputError

if TYPE_CHECKING:
    from daq.runfile.rig import Rig

Output = Annotated[
    Path | None, Parameter(name=["--output", "-o"], metavar="RUN.h5", help="Run file to write.", group=OUTPUT)
]


def import_table(
    file: Annotated[
        Path,
        Parameter(
            help="Table to import: text (.csv, .txt, .lvm ...) or MATLAB (.mat); .xlsx and .tdms require the extra "
            "'formats'."
        ),
    ],
    /,
    *,
    output: Output = None,
    options: ImportOptions = NO_OPTIONS,
    notes: NoteFlags = NO_NOTES,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Convert a table of times and positions, from a camera, a sensor or another program, to a run file.

    Delimiter, decimal sign, preamble, header and units are detected.  Numbers without a unit are read in SI units; if
    the result is implausible, you are asked for the unit.  If mass and stiffness are stated, the frame rate is checked
    against the duration of the slips.

    Use --spring-force for the force of a pulling spring, as recorded by a tribometer.  The position is then force /
    stiffness, relative to the pulling end, which moves at --belt-speed.  If the belt was measured, name its column with
    --belt-column.

    Example: daq import track.csv

    Example: daq import track.csv -o run.h5 --x-unit cm --mass "300 g" --x0 "60 mm +- 0.1 mm"

    Example: daq import measurement.lvm -o run.h5 --belt-column stage

    Example: daq import encoder.xlsx -o run.h5 --counts-per-rev 16384 --circumference "125.66 mm"

    Example: daq import force.csv --spring-force F --force-unit mN --stiffness "168 N/m" --belt-speed "42 um/s"
    """
    from dataclasses import replace

    from daq.imports import table_to_run
    from daq.recorder import names
    from daq.runfile import store
    from stickslip.output import atomic, suffix

    written = notes.collect()
    target = names.complete_name(output or Path(f"{os.path.splitext(file)[0]}.h5"))
    suffix.check_run(target)
    atomic.refuse_existing(target, force, file)
    with application.progress("reading", None, "lines") as show:
        imported = table_to_run.read(file, options, show.stage)
    store.write(target, replace(imported.run, **written), force=force)
    data = sentences.describe_run(imported.run, target, imported.warnings) | {
        key: getattr(imported, key) for key in ("columns", "delimiter", "decimal", "even", "skipped", "assumed")
    }
    return Answer(data, sentences.format_run("imported", imported.run, data, sentences.format_columns(imported)))


def replay(
    source: Annotated[Path, Parameter(help="Journal (.part), run file (.h5) or capture (.sr).")],
    /,
    *,
    output: Output = None,
    options: CaptureOptions = NO_CAPTURE,
    rig: Annotated[Path | None, Parameter(help="Calibration (rig.toml) to use instead of the recorded one.")] = None,
    known: RigFlags = NO_RIG,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Rebuild a run file from a journal, a run file, or a sigrok .sr capture.

    Values given as flags (--mass, --metres-per-count ...) override those of --rig and of the record.

    Example: daq replay capture.sr --channels A=XA,B=XB -o run.h5

    Example: daq replay run.h5 --counts-per-rev 16384 --circumference "125.66 mm" -o calibrated.h5
    """
    from daq.imports import replay as replaying
    from daq.runfile import store
    from daq.runfile.rig import Rig, find_replaced
    from stickslip.output import atomic, suffix

    kind = replaying.recognise_kind(source)
    target = output or _choose_output(source, kind)
    suffix.check_run(target)
    atomic.refuse_existing(target, force, source)
    calibration = None if rig is None else Rig.from_toml(toml.read_text(rig, "--rig"), str(rig))
    stated = known.stated()
    if kind == "capture":
        return _replay_capture(source, target, options, (calibration or Rig()).stating(stated), force)
    for name, value in vars(options).items():
        if value is not None:
            flag = "--dir" if name == "direction" else f"--{name.replace('_', '-')}"
            raise InputError(f"{flag} applies only to .sr captures, but this file is a {kind}", str(source), "omit it")
    if kind == "journal":
        from daq.finalise import run as finalise
        from daq.runfile import journal
        from daq.runfile.spill import read_columns

        markers = journal.read_markers(journal.markers_path(source))
        run, summary = finalise.run_data(journal.read(source), markers, "daq replay")
        run, extra = read_columns(run), summary.as_json()
    else:
        run = replaying.decode_run(source)
        extra = replaying.count_faults(run) | {"warnings": [], "clock_ppm": run.clock_ppm}
    if calibration is not None or stated:
        used = (calibration or run.rig).stating(stated)
        extra["warnings"] = [*extra["warnings"], *(row.text for row in find_replaced(run.rig, used))]
        run = replaying.recalibrate(run, used)
    store.write(target, run, force=force)
    data = sentences.describe_run(run, target, extra["warnings"]) | extra | {"file": target}
    return Answer(data, sentences.format_run(f"replayed the {kind} {source}:", run, data))


def decode(
    file: Annotated[Path, Parameter(help="Capture file (.sr).")],
    /,
    *,
    options: ProbeOptions = NO_PROBES,
    json: Json = False,
) -> Answer:
    """Count the edges of a quadrature pair, or of step and direction signals, in a sigrok .sr capture.

    Example: daq decode capture.sr --channels A=XA,B=XB --decoder x4
    """
    from daq.imports import capture as decoding
    from daq.imports import sigrok

    capture = sigrok.read(file)
    wiring = decoding.choose_wiring(capture, options)
    with application.progress("decoding", capture.samples, "samples") as progress:
        totals = decoding.decode(capture, wiring, progress)
    names = [capture.probes[bit] for bit in wiring.bits]
    data = vars(totals) | {
        "decoder": wiring.decoder,
        "probes": names,
        "samples": capture.samples,
        "rate_hz": capture.rate_hz,
        "file": file,
        "warnings": sentences.warn_of_counts(totals),
    }
    line = f"{sentences.format_counts(totals)}  ({wiring.decoder} on probes {names[0]} and {names[1]})"
    return Answer(data, "\n".join([line, *(f"warning: {warning}" for warning in data["warnings"])]))


def export(
    file: Annotated[Path, Parameter(help="Run file.")],
    /,
    *,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], metavar="FILE", help="File of the table (.csv or .parquet).", group=OUTPUT),
    ] = None,
    csv: Annotated[Path | None, Parameter(show=False)] = None,
    parquet: Annotated[Path | None, Parameter(show=False)] = None,
    force: Force = False,
    json: Json = False,
) -> Answer:
    """Write a run as a table with one row per sample and units in the column names.

    Example: daq export run.h5 -o run.csv
    """
    from daq.runfile import store
    from stickslip.output import atomic, suffix, tables

    forms = {"csv": suffix.CSV, "parquet": suffix.PARQUET}
    targets = [] if output is None else [(suffix.choose_form(output, forms), output)]
    for form, path in (("csv", csv), ("parquet", parquet)):
        if path is not None:
            suffix.check(path, forms[form], f"--{form}")
            targets.append((form, path))
    if not targets:
        raise InputError("no output file was given", "command line", "add -o FILE.csv or -o FILE.parquet")
    for _, target in targets:
        atomic.refuse_existing(target, force, file)
    if len({target.resolve() for _, target in targets}) < len(targets):
        raise InputError("is used for two outputs", str(targets[-1][1]), "use a different name for each output")
    rows = store.load(file).to_dataframe()
    for form, target in targets:
        with application.progress(f"writing {form}", len(rows), "rows") as show:
            tables.write(rows, target, form, force=force, progress=show)
    names = [str(target) for _, target in targets]
    data = {"rows": len(rows), "columns": list(rows.columns), "files": names}
    return Answer(data, f"{', '.join(names)}: {len(rows)} rows")


def _replay_capture(source: Path, target: Path, options: CaptureOptions, rig: "Rig", force: bool) -> Answer:
    from dataclasses import replace

    from daq.imports import capture as decoding
    from daq.imports import replay as replaying
    from daq.imports import sigrok
    from daq.runfile import store

    capture = sigrok.read(source)
    if options.capture_rate is not None:
        capture = replace(capture, rate_hz=options.capture_rate)
    wiring = decoding.choose_wiring(capture, options)
    rate_hz = options.rate or min(1000.0, capture.rate_hz or 1000.0)
    with application.progress("replaying", capture.samples, "samples") as progress:
        run, totals = replaying.sample_capture(capture, wiring, rate_hz, rig, progress)
    store.write(target, run, force=force)
    warnings = sentences.warn_of_counts(totals)
    if run.rig.metres_per_count is None:
        warnings.append(
            "the metres per count are not known, so positions are in counts; add --metres-per-count or --rig"
        )
    data = (
        replaying.count_faults(run) | {"clock_ppm": None} | sentences.describe_run(run, target, warnings) | vars(totals)
    )
    return Answer(
        data, sentences.format_run(f"replayed the capture {source}:", run, data, sentences.format_counts(totals))
    )


def _choose_output(source: Path, kind: str) -> Path:
    if kind == "run":
        raise InputError("no output file was given", str(source), "add -o FILE.h5")
    return source.with_suffix("") if source.suffix == ".part" else source.with_suffix(".h5")
