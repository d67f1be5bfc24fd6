"""The fitted stage: /entry/fit and /entry/fit_law1 ... fit_law_NAME, of one run in its file, of several in their own.

In a run file the raw data beside them stay untouched.  In the file of a joint fit (`daq.runfile.joint`) the cycles and
what differs between the runs stand once for each: cycles_run1 ..., parameters_run1 ...; runs has what each run shows.

::

    fit               NXprocess   @default=ranking; program, version, date, sequence_index
      parameters      NXparameters  verdict, adequacy, warnings, cpu_time; begin and end of what was fitted; part: in
                                    words, where it is not the whole run, all laws and all cycles;
                                    sha256_smooth: of the velocity in the smoothed stage beside it
      ranking         NXdata      one row a law of the six: score, weight, in_set, rms, cycles, orbit_distance; law_name
                                  beside it
      formulas        NXdata      the same of laws given as formulas; law_name, formula and asked beside it
      cycles          NXdata      one row a break-away: t, static_level, kinetic_scale
    fit_law1 ...      NXprocess   @default=friction_curve; of a law given as a formula fit_law_NAME, with _ for -
      parameters      NXparameters  law_name, formula; value, value_errors and units of each parameter; errors are
                                    NaN where no law describes the record
      friction_curve  NXdata      friction against relative velocity
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike

from daq.base.errors import InputError
from daq.runfile import joint, nexus, store
from fitting.drawing.curves import curve, speeds_of_all, unit
from fitting.estimation.derived import RUNS_OWN
from fitting.estimation.result import Parameter
from fitting.report.symbols import formula_of
from fitting.selection.result import LawResult, RankedLaws
from processing import stage as smoothed_stage


def save(ranking: RankedLaws, path: Path, record: str, smoothed: str, part: str = "") -> None:
    """Write the stage into the run file, replacing an earlier one.

    Parameters
    ----------
    ranking : RankedLaws
        The fit.
    path : Path
        The run file.
    record, smoothed : str
        The sha256 of the raw data and of the smoothed stage (`processing.stage.digest`) that the file held when it
        was read.
    part : str
        What was fitted, in words, where something was left out.

    Raises
    ------
    InputError
        For a file that is no run, or one that was recorded or smoothed anew meanwhile.
    """

    def write(entry: h5py.Group) -> None:
        raw = nexus.read_text(entry, "provenance/sha256_raw", path) if "provenance/sha256_raw" in entry else ""
        digests = raw, smoothed_stage.digest(entry)
        for now, before, done in zip(digests, (record, smoothed), ("recorded", "smoothed"), strict=True):
            if now != before:
                what = f"it was {done} anew while it was fitted; the fit was not stored"
                raise InputError(what, str(path), f"run: fit-friction {path.name}")
        for name in [name for name in entry if name.startswith("fit_law")]:
            del entry[name]
        _write(entry, ranking, part)
        if smoothed:
            nexus.field(entry["fit/parameters"], "sha256_smooth", smoothed)

    store.extend(path, "fit", write, default="fit")


def save_joint(
    ranking: RankedLaws, runs: Sequence[joint.FittedRun], path: Path, part: str = "", *, force: bool = False
) -> None:
    """Write the file of a joint fit; InputError where something else stands, without ``force``; ``part`` as `save`."""

    def write(entry: h5py.Group) -> None:
        _write(entry, ranking, part)
        about = entry["runs"]
        for name, place in (("begin", 0), ("end", -1)):
            nexus.field(
                about, name, np.array([side.motion.begin + side.motion.time[place] for side in ranking.runs]), "s"
            )
        nexus.field(about, "adequacy", [side.adequacy.said for side in ranking.runs])
        if ranking.rows:
            nexus.field(about, "cycles", np.array([side.best.cycles for side in ranking.runs], np.uint32), "")
            nexus.field(about, "rms", np.array([side.best.rms_m for side in ranking.runs]), "m")

    joint.write(path, runs, write, force=force)


def _write(entry: h5py.Group, ranking: RankedLaws, part: str) -> None:
    six = sorted((row for row in ranking.rows if isinstance(row.law, int)), key=_number)
    formulas = ranking.rivals
    shown = "ranking" if six else "formulas" if formulas else "parameters"
    fit = nexus.process(entry, "fit", "fit-friction", 2, shown)
    about = nexus.group(fit, "parameters", "NXparameters")
    nexus.field(about, "verdict", ranking.verdict)
    nexus.field(about, "adequacy", ranking.adequacy.said)
    if part:
        nexus.field(about, "part", part)
    nexus.field(about, "cpu_time", np.float64(ranking.cpu_s), "s")
    if not ranking.runs:
        for name, time in zip(("begin", "end"), ranking.motion.begin + ranking.motion.time[[0, -1]], strict=True):
            nexus.field(about, name, np.float64(time), "s")
    if ranking.warnings:
        nexus.field(about, "warnings", list(ranking.warnings))
    if not ranking.rows:
        return
    if six:
        laws: dict[str, tuple[ArrayLike, str]] = {"law": (np.array([row.law for row in six], np.uint8), "")}
        _ranked(fit, "ranking", laws, six)
    if formulas:
        places: dict[str, tuple[ArrayLike, str]] = {"row": (np.arange(1, len(formulas) + 1, dtype=np.uint8), "")}
        table = _ranked(fit, "formulas", places, formulas)
        nexus.field(table, "formula", [row.formula or "" for row in formulas])
        nexus.field(table, "asked", np.array([row.asked for row in formulas], np.uint8), "")
    for number, side in enumerate(ranking.sides, start=1):
        nexus.table(
            fit,
            f"cycles_run{number}" if ranking.runs else "cycles",
            {
                "t": (np.array([event.t for event in side.events]), "s"),
                "static_level": (np.array([event.break_away_level for event in side.events]), ""),
                "kinetic_scale": (np.array([event.kinetic_scale for event in side.events]), ""),
                "used": (np.array([event.flag in ("", "rough") for event in side.events], np.uint8), ""),
            },
            axis="t",
            signal="static_level",
            auxiliary=("kinetic_scale",),
            title="levels of each break-away over Fs",
        )
    for row in (*six, *formulas):
        _law(entry, row, ranking)


def _number(row: LawResult) -> int:
    return row.law if isinstance(row.law, int) else 0


def _ranked(
    fit: h5py.Group, name: str, axis: dict[str, tuple[ArrayLike, str]], rows: Sequence[LawResult]
) -> h5py.Group:
    """Write one table of the ranking; ``axis`` is its first column."""
    columns = {
        "score": (np.array([row.score for row in rows]), ""),
        "weight": (np.array([row.weight for row in rows]), ""),
        "in_set": (np.array([row.in_set for row in rows], np.uint8), ""),
        "rms": (np.array([row.rms_m for row in rows]), "m"),
        "cycles": (np.array([row.cycles for row in rows], np.uint32), ""),
        "orbit_distance": (np.array([row.orbit for row in rows]), ""),
    }
    title = "log error of each law above the best one's, penalised"
    table = nexus.table(fit, name, {**axis, **columns}, axis=next(iter(axis)), signal="score", title=title)
    nexus.field(table, "law_name", [row.name if row.formula is None else str(row.law) for row in rows])
    return table


def _law(entry: h5py.Group, row: LawResult, ranking: RankedLaws) -> None:
    name = f"fit_law{row.law}" if isinstance(row.law, int) else f"fit_law_{row.law.replace('-', '_')}"
    group = nexus.process(entry, name, "fit-friction", 2, "friction_curve")
    parameters = nexus.group(group, "parameters", "NXparameters")
    nexus.field(parameters, "law_name", row.name if row.formula is None else str(row.law))
    nexus.field(parameters, "formula", formula_of(row))
    parameters_of_law = ranking.sides[0].row(row.law).parameters
    of_runs = RUNS_OWN if ranking.runs else ()
    _parameters(parameters, {name: item for name, item in parameters_of_law.items() if name not in of_runs})
    for number, side in enumerate(ranking.runs, start=1):
        parameters_of_law = side.row(row.law).parameters
        its = nexus.group(group, f"parameters_run{number}", "NXparameters")
        _parameters(its, {name: item for name, item in parameters_of_law.items() if name in of_runs})
    w = speeds_of_all([side.motion for side in ranking.sides])
    nexus.table(
        group,
        "friction_curve",
        {"relative_velocity": (w, "m/s"), "friction": (curve(row.fit, ranking.motion, w), unit(ranking.motion))},
        axis="relative_velocity",
        signal="friction",
        title=row.title if row.formula is not None else f"law {row.law}: {row.name}",
    )


def _parameters(group: h5py.Group, parameters: Mapping[str, Parameter]) -> None:
    for name, item in parameters.items():
        key = name.replace("/", "_over_")
        nexus.field(group, key, np.float64(item.value), item.unit)
        nexus.field(group, f"{key}_errors", np.float64(item.stderr if item.trusted else np.nan), item.unit)
