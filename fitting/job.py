"""One job of `fit-friction`: runs are read, calibrated, smoothed, fitted as one contact, and reported."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.runfile import joint
from daq.runfile import store as runfile
from daq.runfile.joint import FittedRun
from daq.runfile.nexus import EVERY
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig, find_replaced
from fitting.adequacy.result import ADEQUATE
from fitting.competitors import Competitors
from fitting.law import SIX
from fitting.report import page as report
from fitting.report import stage as store
from fitting.selection.ranking import rank
from fitting.selection.result import RankedLaws
from processing import stage
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics
from processing.smoothing import smooth
from processing.statistics import StickSlipStatistics, from_kinematics, pooled
from stickslip.compute.arrays import Array
from stickslip.errors import EXIT_DONE, EXIT_NO_LAW, EXIT_UNDECIDED, DataError, InputError
from stickslip.units import Measured, with_error

# Share of a run that may be missing at either end of the whole: samples left out there as spikes are fewer.
MISSING_AT_ENDS = 0.01


ALL_SIX = Competitors()


@dataclass(frozen=True)
class FitOptions:
    """Options of a fit, the same for every run; None keeps the run's calibration.

    ``begin`` and ``end`` are times (s) of the run; ``report`` is whether to make the page.
    """

    competitors: Competitors = ALL_SIX
    mass: Measured | None = None
    stiffness: Measured | None = None
    x0: Measured | None = None
    datum: Measured | None = None
    datum_sd: float | None = None
    damping: Measured | None = None
    damping_sd: float | None = None
    belt_speed: Measured | float | str | None = None
    excluded: tuple[int, ...] = ()
    alpha: float = 0.05
    begin: float | None = None
    end: float | None = None
    report: bool = True


@dataclass(frozen=True, eq=False)
class LoadedRun:
    """A run with its calibration, smoothed if its file has that ``stage`` (digest); ``whole`` are its end times, s."""

    recording: Recording
    kinematics: Kinematics | None
    rig: Rig
    stage: str
    whole: tuple[float, float]

    @property
    def named(self) -> FittedRun:
        recording = self.recording
        return FittedRun(recording.source, recording.digest, recording.title, recording.started)


@dataclass(frozen=True, eq=False)
class FitOutput:
    """A ranking, the statistics of each run's stick-slip, the runs, and the page if requested.

    ``stages`` are the digests of the smoothed stages of the runs; ``part`` names what was omitted: runs, laws or
    cycles.
    """

    ranking: RankedLaws
    statistics: tuple[StickSlipStatistics, ...]
    runs: tuple[FittedRun, ...]
    stages: tuple[str, ...]
    page: str | None
    part: str

    def as_json(self) -> dict[str, Any]:
        """Return the document of the ranking, with the statistics of stick-slip, total and by run."""
        document = self.ranking.as_json() | {"statistics": pooled(self.statistics).as_json()}
        if self.ranking.runs:
            document["runs"] = [
                side | {"statistics": statistics.as_json()}
                for side, statistics in zip(document["runs"], self.statistics, strict=True)
            ]
        return document

    def save(self, place: Path | None, *, force: bool = False) -> None:
        """Write the results into the run file, of several runs into a new one, and the report to ``place``.

        Raises InputError where the run was recorded or smoothed again meanwhile.
        """
        files = [run.file for run in self.runs]
        if len(files) > 1:
            store.save_joint(self.ranking, self.runs, joint.name_output(files), self.part, force=force)
        else:
            store.save(self.ranking, files[0], self.runs[0].digest, self.stages[0], self.part)
        if place is not None and self.page is not None:
            report.write(self.page, place, [run.digest for run in self.runs], files=files, force=force)


def exit_code(document: Mapping[str, Any]) -> int:
    """Return the exit code of a document by the number of requested laws in the set; other laws do not count."""
    if document["adequacy"]["verdict"] not in (ADEQUATE, None):  # None: goodness of fit could not be judged
        return EXIT_NO_LAW
    rivals = document.get("rivals", ())
    unasked = {row["law"] for row in document.get("ranking", ()) if not row.get("asked", True)}
    if not document["set"] and unasked.issuperset(rivals):
        return EXIT_NO_LAW
    return EXIT_DONE if len(document["set"]) + len(rivals) == 1 else EXIT_UNDECIDED


def load_run(path: Path, options: FitOptions, rig: Rig | None = None) -> LoadedRun:
    """Read a run, with another calibration if given; an unusable file, calibration or time range is an InputError."""
    samples = runfile.select_between(path, options.begin, options.end)
    with runfile.open_run(path) as file:
        beside = stage.digest(file["entry"])  # before the rest: what replaces it later is another one
    kinematics = stage.load(path) if samples == EVERY else None  # of a part, the smoothing is its own
    recording = runfile.load(path, samples) if kinematics is None else kinematics.recording
    time = runfile.read_times(path)
    known = calibrated(recording.rig if rig is None else rig, options)
    return LoadedRun(recording, kinematics, known, beside, (float(time[0]), float(time[-1])))


def fit_runs(
    runs: Sequence[LoadedRun],
    options: FitOptions,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> FitOutput:
    """Smooth the runs, rank the laws, and make the page; a DataError has the statistics and findings."""
    # Sticks are looked for at the record's own speed: a wrong stated one would hide them.
    motions = [smooth(run.recording) if run.kinematics is None else run.kinematics for run in runs]
    motions = [_with_replaced(motion, run.rig, options) for motion, run in zip(motions, runs, strict=True)]
    counted = tuple(from_kinematics(motion) for motion in motions)
    try:
        ranking = rank(
            motions,
            [run.rig for run in runs],
            options.competitors,
            belt_speed=options.belt_speed,
            excluded=options.excluded,
            alpha=options.alpha,
            jobs=jobs,
            progress=progress,
            scheduler=scheduler,
        )
    except DataError as error:
        together = pooled(counted)
        findings = error.data.get("findings", []) + [vars(finding) for motion in motions for finding in motion.findings]
        document = {"statistics": together.as_json(), "findings": findings}
        error.add_result(document, together.sentences(motions[0].unit))
        raise
    ranking = _with_replaced_mass(ranking, runs, options)
    page = report.render(ranking, motions, counted, options.alpha) if options.report else None
    stages = tuple(run.stage for run in runs)
    part = fitted_part(runs, [motion.time for motion in motions], options)
    return FitOutput(ranking, counted, tuple(run.named for run in runs), stages, page, part)


def _with_replaced(motion: Kinematics, rig: Rig, options: FitOptions) -> Kinematics:
    """Return a motion with a finding for each replaced value of its run's calibration."""
    speed = options.belt_speed
    if speed is not None and not isinstance(speed, str):
        rig = replace(rig, belt_speed=speed if isinstance(speed, Measured) else Measured(speed))
    rows = tuple(Finding("replaced", *row) for row in find_replaced(motion.recording.rig, rig))
    return replace(motion, findings=(*rows, *motion.findings)) if rows else motion


def _with_replaced_mass(ranking: RankedLaws, runs: Sequence[LoadedRun], options: FitOptions) -> RankedLaws:
    """Return a ranking with a finding where the mass implied by a stated stiffness is not the stored one."""
    ratio = ranking.rows[0].parameters.get("k/m") if ranking.rows else None
    if options.stiffness is None or ratio is None or not ratio.value > 0:
        return ranking
    stated = with_error(options.stiffness)
    mass = stated.value / ratio.value
    implied = Rig(mass=Measured(mass, mass * math.hypot(stated.sd / stated.value, ratio.stderr / ratio.value)))
    rows = {row for run in runs for row in find_replaced(Rig(mass=run.recording.rig.mass), implied)}
    findings = tuple(Finding("replaced", *row) for row in sorted(rows))
    warnings = (*(finding.text for finding in findings), *ranking.warnings)
    return replace(ranking, findings=(*findings, *ranking.findings), warnings=warnings) if findings else ranking


def fitted_part(runs: Sequence[LoadedRun], times: Sequence[Array], options: FitOptions) -> str:
    """Return the omissions of a fit in words: of the runs (with fitted times, s), the laws and the cycles."""
    said = []
    for run, time in zip(runs, times, strict=True):
        first, last = run.whole
        if max(time[0] - first, last - time[-1]) > MISSING_AT_ENDS * (last - first):
            name = f"{run.recording.source.name}: " if len(runs) > 1 else ""
            said.append(f"{name}{round(time[0], 2):g} to {round(time[-1], 2):g} s")
    said += _fitted_laws(options.competitors)
    if options.excluded:
        said.append(f"without cycle{'s' * (len(options.excluded) > 1)} {', '.join(map(str, options.excluded))}")
    return "; ".join(said)


def _fitted_laws(competitors: Competitors) -> list[str]:
    """Return the fitted laws in words, unless the six alone, and the conditions on them."""
    laws, names = ([law.name for law in laws] for laws in (competitors.six, competitors.formulas))
    said = []
    if laws and len(laws) < len(SIX):
        said.append(f"law{'s' * (len(laws) > 1)} {', '.join(laws)}")
    if names:
        said.append(f"{'with ' if laws else ''}law{'s' * (len(names) > 1)} {', '.join(names)}")
    if competitors.fix:
        said.append(", ".join(f"{name} = {value:g}" for name, value in competitors.fix.items()))
    if competitors.bounds:
        said.append(f"bounds of {', '.join(competitors.bounds)}")
    return said


def calibrated(rig: Rig, options: FitOptions) -> Rig:
    """Return a run's calibration with the options' values."""
    for name in ("mass", "stiffness"):
        stated = getattr(options, name)
        if stated is not None and not stated.value > 0:
            raise InputError(f"{name} is {stated.value}", f"--{name}", "give one above 0")
    if options.mass is not None:
        rig = replace(rig, mass=options.mass)
    if options.stiffness is not None:
        rig = replace(rig, mass=options.mass, stiffness=options.stiffness)
    if options.x0 is not None and (options.datum is not None or options.datum_sd is not None):
        other = "--datum" if options.datum is not None else "--datum-sd"
        raise InputError(f"--x0 and {other} together", "command line", "give --x0 alone, with +-: --datum is -x0")
    if options.x0 is not None:
        rig = rig.resting_at(_changed("--x0", None, options.x0, None))
    if options.datum_sd is not None and options.datum is None and rig.datum is None:
        raise InputError("--datum-sd without a datum", "--datum-sd", "give --x0 with +- instead")
    if options.datum is not None or options.datum_sd is not None:
        rig = replace(rig, datum=_changed("--datum", rig.datum, options.datum, options.datum_sd), x0=None)
    if options.damping is None and options.damping_sd is None:
        return rig
    damping = _changed("--damping", rig.damping, options.damping, options.damping_sd)
    if damping.value < 0:
        raise InputError(f"damping is {damping.value}", "--damping", "give 0 or more, in N s/m")
    if rig.mass is None and rig.stiffness is None:
        raise InputError("--damping in N s/m without a mass", "--damping", "give --mass or --stiffness too")
    return replace(rig, damping=damping)


def _changed(flag: str, known: Measured | None, typed: Measured | None, sd: float | None) -> Measured:
    """Return a calibration with value or error replaced; a new value without an error is exact."""
    if typed is not None and typed.sd and sd is not None:
        raise InputError(f"{flag} with +- and {flag}-sd together", "command line", "give the error once")
    value, typed_sd = (typed.value, typed.sd) if typed is not None else (0.0 if known is None else known.value, 0.0)
    sd = typed_sd if sd is None else sd
    if not math.isfinite(value):
        raise InputError(f"is {value}", flag, "give a number")
    if not 0 <= sd < math.inf:
        raise InputError(f"standard deviation is {sd}", f"{flag}-sd", "give a number of 0 or more")
    return Measured(float(value), float(sd))
