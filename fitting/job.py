"""One job of `fit-friction`: runs are read, calibrated, smoothed, fitted as one contact, and stored."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.runfile import store as runfile
from daq.runfile.nexus import EVERY
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig, find_replaced
from fitting.judge.adequacy import ADEQUATE
from fitting.options import Options
from fitting.ranking import rank
from fitting.report import page, stage
from fitting.result import Ranking
from processing import stage as smoothed_stage
from processing.record.kinematics import Kinematics
from processing.record.motion import Finding
from processing.smoothing import smooth
from processing.statistics import from_kinematics, pooled
from stickslip.errors import EXIT_DONE, EXIT_NO_LAW, EXIT_UNDECIDED, DataError
from stickslip.units import Measured, with_error

# Share of a run that may be missing at either end of the whole: samples left out there as spikes are fewer.
MISSING_AT_ENDS = 0.01


@dataclass(frozen=True, eq=False)
class LoadedRun:
    """A run with its calibration, smoothed if its file has that stage."""

    recording: Recording
    kinematics: Kinematics | None
    rig: Rig
    stage: str  # digest of the smoothing in its file
    whole: tuple[float, float]  # times of its first and last sample, s


def exit_code(document: Mapping[str, Any]) -> int:
    """Return the exit code by the number of requested laws in the set; other laws do not count."""
    if document["adequacy"]["verdict"] not in (ADEQUATE, None):  # None: goodness of fit could not be judged
        return EXIT_NO_LAW
    rivals = document.get("rivals", ())
    unasked = {row["law"] for row in document.get("ranking", ()) if not row.get("asked", True)}
    if not document["set"] and unasked.issuperset(rivals):
        return EXIT_NO_LAW
    return EXIT_DONE if len(document["set"]) + len(rivals) == 1 else EXIT_UNDECIDED


def load_run(path: Path, options: Options, rig: Rig | None = None) -> LoadedRun:
    samples = runfile.select_between(path, options.begin, options.end)
    with runfile.open_run(path) as file:
        beside = smoothed_stage.digest(file["entry"])  # before the rest: what replaces it later is another one
    kinematics = smoothed_stage.load(path) if samples == EVERY else None  # of a part, the smoothing is its own
    recording = runfile.load(path, samples) if kinematics is None else kinematics.recording
    time = runfile.read_times(path)
    known = options.calibrate(recording.rig if rig is None else rig)
    return LoadedRun(recording, kinematics, known, beside, (float(time[0]), float(time[-1])))


def fit_runs(runs: Sequence[LoadedRun], options: Options, progress: Callable[[float], None] | None = None) -> Ranking:
    """Smooth the runs and rank the laws; a DataError has the statistics and findings."""
    # Sticks are looked for at the record's own speed: a wrong stated one would hide them.
    motions = [_with_replaced(_smoothed(run), run.rig, options) for run in runs]
    try:
        ranking = rank(motions, [run.rig for run in runs], options, progress)
    except DataError as error:
        together = pooled([from_kinematics(motion) for motion in motions])
        findings = error.data.get("findings", []) + [vars(finding) for motion in motions for finding in motion.findings]
        document = {"statistics": together.as_json(), "findings": findings}
        error.add_result(document, together.sentences(motions[0].unit))
        raise
    part = "; ".join([*_parts(runs, ranking), *options.laws_fitted])
    return replace(_with_replaced_mass(ranking, options), part=part, stages=tuple(run.stage for run in runs))


def save(ranking: Ranking, report: Path | None, text: str, *, force: bool = False) -> None:
    """Write the results into the run file (of several runs a new one), and the page; the run must be unchanged."""
    stage.save(ranking, force=force)
    if report is not None:
        page.write(ranking, report, text, force=force)


def _smoothed(run: LoadedRun) -> Kinematics:
    """Return the run smoothed well enough to start from: plain differences are not."""
    if run.kinematics is None:
        return smooth(run.recording)
    if run.kinematics.method == "fd":
        return smooth(run.kinematics.recording, times=run.kinematics.times)
    return run.kinematics


def _with_replaced(motion: Kinematics, rig: Rig, options: Options) -> Kinematics:
    """Add a finding for each replaced value of the run's calibration."""
    speed = options.belt_speed
    if speed is not None and not isinstance(speed, str):
        rig = replace(rig, belt_speed=speed if isinstance(speed, Measured) else Measured(speed))
    rows = tuple(Finding("replaced", *row) for row in find_replaced(motion.recording.rig, rig))
    return replace(motion, findings=(*rows, *motion.findings)) if rows else motion


def _with_replaced_mass(ranking: Ranking, options: Options) -> Ranking:
    """Add a finding where the mass implied by a stated stiffness is not the stored one."""
    ratio = ranking.rows[0].parameters.get("k/m") if ranking.rows else None
    if options.stiffness is None or ratio is None or not ratio.value > 0:
        return ranking
    stated = with_error(options.stiffness)
    mass = stated.value / ratio.value
    implied = Rig(mass=Measured(mass, mass * math.hypot(stated.sd / stated.value, ratio.stderr / ratio.value)))
    stored = [Rig(mass=record.recording.rig.mass) for record in ranking.records]
    rows = {row for rig in stored for row in find_replaced(rig, implied)}
    findings = tuple(Finding("replaced", *row) for row in sorted(rows))
    warnings = (*(finding.text for finding in findings), *ranking.warnings)
    return replace(ranking, findings=(*findings, *ranking.findings), warnings=warnings) if findings else ranking


def _parts(runs: Sequence[LoadedRun], ranking: Ranking) -> list[str]:
    """Return the fitted span of each run that was not fitted as a whole, in words."""
    said = []
    for run, record in zip(runs, ranking.records, strict=True):
        (first, last), time = run.whole, record.time
        if max(time[0] - first, last - time[-1]) > MISSING_AT_ENDS * (last - first):
            name = f"{run.recording.source.name}: " if len(runs) > 1 else ""
            said.append(f"{name}{round(time[0], 2):g} to {round(time[-1], 2):g} s")
    return said
