"""The flags of `fit-friction` as options of the fit and as files to write, checked before anything is fitted."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from daq.runfile import joint
from fitting.flags import CalibrationFlags, LawFlags, OutputFlags, PartFlags, WorkFlags
from fitting.laws import Competitors, numbers
from fitting.options import Options
from fitting.report import comparison, page, stage
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.output import atomic, suffix


class Places(NamedTuple):
    """Files of results besides the runs and the tables."""

    reports: Sequence[Path]  # of a joint fit one, with --each one a run
    joint_file: Path | None
    comparison: Path | None  # page that compares runs fitted separately


def read_options(laws: LawFlags, rig: CalibrationFlags, part: PartFlags, work: WorkFlags) -> Options:
    competitors = Competitors.typed(
        laws.laws, laws.law or (), laws.ramp or (), laws.fix or (), laws.bound or (), laws.start or ()
    )
    return Options(
        competitors,
        **vars(rig),
        excluded=tuple(numbers(part.exclude_cycles, "--exclude-cycles")),
        begin=part.begin,
        end=part.end,
        alpha=_read_alpha(part),
        jobs=work.jobs,
        scheduler=work.scheduler,
    )


def _read_alpha(part: PartFlags) -> float:
    if part.alpha is not None:
        return part.alpha
    if not 0 < part.confidence < 1:
        raise InputError(
            f"confidence is {part.confidence:g}", "--confidence", "it must be between 0 and 1, such as 0.95"
        )
    return round(1 - part.confidence, 12)


def select_runs(files: list[Path], *, each: bool) -> list[Path]:
    """Return the files without joint fits, which a pattern such as *.h5 also matches."""
    for path in files:
        if path.is_dir():
            raise InputError("is a folder", str(path), f"name the runs in it: fit-friction --each {path / '*.h5'}")
    if not each:
        return files
    fits = [path for path in files if path.name.endswith(joint.SUFFIX) and joint.is_joint_fit(path)]
    for path in fits:
        application.note(f"{path} contains a joint fit and is skipped")
    runs = [path for path in files if path not in fits]
    if not runs:
        raise InputError("all files contain joint fits, not runs", "command line", "name the runs instead")
    return runs


def place_outputs(runs: list[Path], outputs: OutputFlags, *, each: bool) -> Places:
    """Return the files of results, if they can be combined, have the right suffix and replace no other files."""
    given, alone = "command line", "fit the runs one at a time instead"
    twice = len({path.resolve() for path in runs}) < len(runs)
    for wrong, what, where, do in (
        (twice, "a run is named twice", ", ".join(map(str, runs)), "name each run once"),
        (
            outputs.no_report and outputs.report,
            "--report and --no-report cannot be combined",
            given,
            "use only one of them",
        ),
        (each and outputs.curve_csv, "--curve-csv and --each cannot be combined", given, alone),
        (each and outputs.save_scene, "--save-scene and --each cannot be combined", given, alone),
    ):
        if wrong:
            raise InputError(what, where, do)
    report, several, joined = outputs.report, len(runs) > 1, len(runs) > 1 and not each
    reports: Sequence[Path] = ()
    if not outputs.no_report:
        reports = [report or joint.name_output(runs, page.SUFFIX)] if joined else page.report_paths(runs, report)
    compared = None
    if several and each and not outputs.no_report:
        beside = joint.name_output(runs, comparison.SUFFIX)
        compared = beside if report is None else report.with_stem(f"{report.stem}-each")
    places = Places(reports, joint.name_output(runs) if joined else None, compared)
    _refuse_outputs(runs, outputs, places)
    return places


def _refuse_outputs(runs: list[Path], outputs: OutputFlags, places: Places) -> None:
    csv, curve_csv, scene, force = outputs.csv, outputs.curve_csv, outputs.save_scene, outputs.force
    for place, form, flag in (
        (outputs.report, suffix.PAGE, "--report"),
        (csv, suffix.CSV, "--csv"),
        (curve_csv, suffix.CSV, "--curve-csv"),
        (scene, suffix.TOML, "--save-scene"),
    ):
        if place is not None:
            suffix.check(place, form, flag, {suffix.PDF: "to obtain a PDF, print this page from a browser"})
    seen: set[Path] = set()
    for output in (*places.reports, places.comparison, places.joint_file, csv, curve_csv, scene):
        if output is not None and output.resolve() in seen:
            raise InputError("is used for two outputs", str(output), "give each output a different name")
        if output is not None:
            seen.add(output.resolve())
    if places.comparison is not None:
        comparison.refuse_foreign_file(places.comparison, runs, force=force)
    if csv is not None:
        stage.refuse_foreign_file(csv, runs, force=force)
    if curve_csv is not None:
        atomic.refuse_existing(curve_csv, force, *runs, flag="--curve-csv")
    if scene is not None:
        atomic.refuse_existing(scene, force, *runs, kind="scene", flag="--save-scene")
