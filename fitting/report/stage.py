"""The fitted stage of a run file: /entry/fit and /entry/fit_law1 ... fit_law6, beside the untouched raw data.

::

    fit               NXprocess   @default=ranking; program, version, date, sequence_index
      parameters      NXparameters  verdict, adequacy, warnings, cpu_time; begin and end of what was fitted
      ranking         NXdata      one row a law: score, weight, in_set, rms, cycles, orbit_distance; law_name beside it
      cycles          NXdata      one row a break-away: t, static_level, kinetic_scale
    fit_law1 ...      NXprocess   @default=friction_curve
      parameters      NXparameters  law_name, formula; value, value_errors and units of each parameter; errors are
                                    NaN where no law describes the record
      friction_curve  NXdata      friction against relative velocity
"""

from pathlib import Path

import h5py
import numpy as np

from daq.runfile import nexus, store
from fitting.drawing.curves import curve, speeds, unit
from fitting.report.symbols import formula
from fitting.selection.result import LawResult, Ranking


def save(ranking: Ranking, path: Path) -> None:
    """Write the stage into the run file, replacing an earlier one.

    Raises
    ------
    InputError
        For a file that is no run.
    """
    names = ["fit", *(f"fit_law{law}" for law in range(1, 7))]
    store.extend(path, names, lambda entry: _write(entry, ranking), default="fit")


def _write(entry: h5py.Group, ranking: Ranking) -> None:
    fit = nexus.process(entry, "fit", "fit-friction", 2, "ranking" if ranking.rows else "parameters")
    about = nexus.group(fit, "parameters", "NXparameters")
    nexus.field(about, "verdict", ranking.verdict)
    nexus.field(about, "adequacy", ranking.adequacy.verdict)
    nexus.field(about, "cpu_time", np.float64(ranking.cpu_s), "s")
    for name, time in zip(("begin", "end"), ranking.motion.time[[0, -1]], strict=True):
        nexus.field(about, name, np.float64(time), "s")
    if ranking.warnings:
        nexus.field(about, "warnings", list(ranking.warnings))
    if not ranking.rows:
        return
    rows = sorted(ranking.rows, key=lambda row: row.law)
    table = nexus.table(
        fit,
        "ranking",
        {
            "law": (np.array([row.law for row in rows], np.uint8), ""),
            "score": (np.array([row.score for row in rows]), ""),
            "weight": (np.array([row.weight for row in rows]), ""),
            "in_set": (np.array([row.in_set for row in rows], np.uint8), ""),
            "rms": (np.array([row.rms_m for row in rows]), "m"),
            "cycles": (np.array([row.cycles for row in rows], np.uint32), ""),
            "orbit_distance": (np.array([row.orbit for row in rows]), ""),
        },
        axis="law",
        signal="score",
        title="log error of each law above the best one's, penalised",
    )
    nexus.field(table, "law_name", [row.name for row in rows])
    nexus.table(
        fit,
        "cycles",
        {
            "t": (np.array([event.t for event in ranking.events]), "s"),
            "static_level": (np.array([event.break_away_level for event in ranking.events]), ""),
            "kinetic_scale": (np.array([event.kinetic_scale for event in ranking.events]), ""),
            "used": (np.array([event.flag in ("", "rough") for event in ranking.events], np.uint8), ""),
        },
        axis="t",
        signal="static_level",
        auxiliary=("kinetic_scale",),
        title="levels of each break-away over Fs",
    )
    for row in rows:
        _law(entry, row, ranking)


def _law(entry: h5py.Group, row: LawResult, ranking: Ranking) -> None:
    group = nexus.process(entry, f"fit_law{row.law}", "fit-friction", 2, "friction_curve")
    parameters = nexus.group(group, "parameters", "NXparameters")
    nexus.field(parameters, "law_name", row.name)
    nexus.field(parameters, "formula", formula(row.law))
    for name, item in row.parameters.items():
        key = name.replace("/", "_over_")
        nexus.field(parameters, key, np.float64(item.value), item.unit)
        nexus.field(parameters, f"{key}_errors", np.float64(item.stderr if item.trusted else np.nan), item.unit)
    w = speeds(ranking.motion)
    nexus.table(
        group,
        "friction_curve",
        {"relative_velocity": (w, "m/s"), "friction": (curve(row.fit, ranking.motion, w), unit(ranking.motion))},
        axis="relative_velocity",
        signal="friction",
        title=f"law {row.law}: {row.name}",
    )
