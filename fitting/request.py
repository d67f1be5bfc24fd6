"""One command line of `fit-friction` as one value: the runs, the fit, and the outputs.

Invalid requests are rejected here, before anything is fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from daq.runfile import joint
from fitting import rig_scene
from fitting.competitors import Competitors, numbers
from fitting.flags import CalibrationFlags, LawFlags, OutputFlags, PartFlags, WorkFlags
from fitting.job import FitOptions
from fitting.report import comparison, table
from fitting.report import page as pages
from fitting.selection.asked import check_numbers
from stickslip.console import application
from stickslip.errors import InputError
from stickslip.output import atomic, suffix


@dataclass(frozen=True)
class FitRequest:
    files: tuple[Path, ...]  # the runs
    options: FitOptions  # how each is fitted
    outputs: OutputFlags  # names that were given
    work: WorkFlags  # with ``each`` every run is fitted by itself, else all of them together
    # where reports go: of a joint fit one, with ``each`` one a run; none where no report is wanted
    places: tuple[Path, ...]
    joint_file: Path | None  # where a joint fit is stored
    comparison: Path | None  # where the page goes that compares runs fitted one by one

    @classmethod
    def of(
        cls,
        files: Sequence[Path],
        laws: LawFlags,
        rig: CalibrationFlags,
        part: PartFlags,
        outputs: OutputFlags,
        work: WorkFlags,
    ) -> "FitRequest":
        """Return the request of a command line; contradictory flags and unwritable outputs raise InputError."""
        check_numbers(part.alpha, work.jobs)
        runs = tuple(_without_fits(files) if work.each else files)
        _refuse_together(runs, rig, outputs, work)
        options = FitOptions(
            **vars(rig),
            competitors=Competitors.typed(
                laws.laws, laws.law or (), laws.ramp or (), laws.fix or (), laws.bound or (), laws.start or ()
            ),
            excluded=tuple(numbers(part.exclude_cycles, "--exclude-cycles")),
            alpha=part.alpha,
            begin=part.begin,
            end=part.end,
            report=not outputs.no_report,
        )
        several, report = len(runs) > 1, outputs.report
        joined = several and not work.each
        places, compared = [], None
        if not outputs.no_report:
            places = [report or joint.beside(runs, pages.SUFFIX)] if joined else pages.report_paths(runs, report)
            if several and not joined:
                beside = joint.beside(runs, comparison.SUFFIX)
                compared = beside if report is None else report.with_stem(f"{report.stem}-each")
        joint_file = joint.beside(runs) if joined else None
        request = cls(runs, options, outputs, work, tuple(places), joint_file, compared)
        request._refuse_outputs()
        return request

    def _refuse_outputs(self) -> None:
        """Raise InputError for outputs with the suffix of another format, repeated, or in place of other files."""
        outputs, files, force = self.outputs, list(self.files), self.outputs.force
        for place, form, flag in (
            (outputs.report, suffix.PAGE, "--report"),
            (outputs.csv, suffix.CSV, "--csv"),
            (outputs.curve_csv, suffix.CSV, "--curve-csv"),
            (outputs.save_scene, suffix.TOML, "--save-scene"),
        ):
            if place is not None:
                suffix.check(place, form, flag, {suffix.PDF: "then print the page from a browser"})
        _refuse_same(
            [*self.places, self.comparison, self.joint_file, outputs.csv, outputs.curve_csv, outputs.save_scene]
        )
        if self.comparison is not None:
            comparison.refuse_foreign_file(self.comparison, files, force=force)
        if outputs.csv is not None:
            table.refuse_foreign_file(outputs.csv, files, force=force)
        if outputs.curve_csv is not None:
            atomic.refuse_existing(outputs.curve_csv, force, *files, flag="--curve-csv")
        if outputs.save_scene is not None:
            rig_scene.refuse_existing(outputs.save_scene, files, force=force)


def _without_fits(files: Sequence[Path]) -> list[Path]:
    """Return the files that are runs: a pattern such as *.h5 also matches the joint fits of a folder."""
    fits = [path for path in files if path.name.endswith(joint.SUFFIX) and joint.recognised(path)]
    for path in fits:
        application.note(f"{path} is the file of a joint fit, left out")
    runs = [path for path in files if path not in fits]
    if not runs:
        raise InputError("no run among the files", "command line", "name the runs that were fitted")
    return runs


def _refuse_together(runs: Sequence[Path], rig: CalibrationFlags, outputs: OutputFlags, work: WorkFlags) -> None:
    """Raise InputError for flags and runs that cannot be combined."""
    given, alone = "command line", "fit the runs one at a time"
    twice = len({path.resolve() for path in runs}) < len(runs)
    for wrong, what, where, do in (
        (twice, "a run is named twice", ", ".join(map(str, runs)), "name each run once"),
        (outputs.no_report and outputs.report, "--report and --no-report together", given, "give one"),
        (work.each and outputs.curve_csv, "--curve-csv with --each", given, alone),
        (work.each and outputs.save_scene, "--save-scene with --each", given, alone),
        (rig.mass and rig.stiffness, "--mass and --stiffness together", given, "give one: the fit finds the other"),
    ):
        if wrong:
            raise InputError(what, where, do)


def _refuse_same(outputs: Sequence[Path | None]) -> None:
    """Raise InputError when two of the outputs are one file."""
    seen: set[Path] = set()
    for output in outputs:
        if output is not None and output.resolve() in seen:
            raise InputError("is the name of two outputs", str(output), "give each output a name of its own")
        if output is not None:
            seen.add(output.resolve())
