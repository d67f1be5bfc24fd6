"""The fitted stage, and tables for other programs: the ranking and the measured friction curve.

The stage is /entry/fit and /entry/fit_law1 ... fit_law_NAME, added to the file of a run.  Several runs have a file of
their joint fit (`daq.runfile.joint`): cycles_run1 ..., parameters_run1 ..., and the results of each run in runs.
"""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter, methodcaller
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.runfile import joint, nexus, store, tree
from daq.runfile.tree import Field, Group
from fitting.judge import friction
from fitting.judge.curve import MeasuredCurve
from fitting.judge.friction import friction_at, speeds_of_all, unit
from fitting.judge.parameters import RUN_PARAMETERS, Parameter
from fitting.report.symbols import formula
from fitting.result import LawResult, Ranking
from processing import stage
from stickslip.compute.arrays import Array
from stickslip.errors import InputError
from stickslip.output import atomic

FRICTION = "N or N/kg"  # unit of a friction: N where mass or stiffness is known


@dataclass(frozen=True)
class _Law:
    """The contents of a law's group."""

    row: LawResult
    ranking: Ranking
    relative_velocity: Array

    @property
    def shared(self) -> dict[str, Parameter]:
        """The parameters that all runs share."""
        return self._of(self.ranking.sides[0], lambda name: not self.ranking.runs or name not in RUN_PARAMETERS)

    def own(self, number: int) -> dict[str, Parameter]:
        return self._of(self.ranking.runs[number], lambda name: name in RUN_PARAMETERS)

    @property
    def friction(self) -> Array:
        return friction_at(self.row.fit, self.ranking.motion, self.relative_velocity)

    def _of(self, side: Ranking, wanted: Callable[[str], bool]) -> dict[str, Parameter]:
        parameters = side.row(self.row.law).parameters
        return {_field_name(name): item for name, item in parameters.items() if wanted(name)}


def _field_name(name: str) -> str:
    """Return a parameter's name as NeXus allows it: "(Fs - b)/m" is Fs_minus_b_over_m."""
    for sign, word in {"/": "_over_", "*": "_times_", " - ": "_minus_", " + ": "_plus_"}.items():
        name = name.replace(sign, word)
    return name.translate(dict.fromkeys(map(ord, "() ")))


def _end(place: int) -> Callable[[Ranking], float | None]:
    """Return the reader of the first (0) or last (-1) fitted time, s, of a single run."""
    return lambda side: None if side.runs else float(side.motion.begin + side.motion.time[place])


def _shown_name(row: LawResult) -> str:
    return row.name if row.formula is None else str(row.law)


def _table(path: str, *columns: Field) -> tree.Tree:
    """Return the rows of a table of laws; ``columns`` begin with the axis."""
    title = "log error of each law above the best one's, penalised"
    return (
        tree.table(path, columns[0].name, "score", title, optional=True),
        columns[0],
        Field(f"{path}/score", "f8[l]", "", "log error above the best law's, penalised", value=_evidence("score")),
        Field(f"{path}/weight", "f8[l]", "", "weight of evidence", value=_evidence("weight")),
        Field(f"{path}/in_set", "u1[l]", "", "1 if in the confidence set", "rows.in_set"),
        Field(f"{path}/rms", "f8[l]", "m", "of the residuals", "rows.rms_m"),
        Field(f"{path}/cycles", "u4[l]", "", "cycles fitted", "rows.cycles"),
        Field(f"{path}/orbit_distance", "f8[l]", "", "to the measured orbit, relative to its size", "rows.orbit"),
        *columns[1:],
    )


def _names(ranking: Ranking) -> list[str] | None:
    return [_shown_name(row) for row in ranking.rows] or None


def _evidence(name: str) -> Callable[[Ranking], list[float] | None]:
    """Return the reader of a column of the evidence; NaN where no law describes the record."""
    return lambda ranking: [math.nan if (item := getattr(row, name)) is None else item for row in ranking.rows] or None


def _cycles(path: str) -> tree.Tree:
    title = "levels of each break-away relative to Fs"
    return (
        tree.table(path, "t", "static_level", title, auxiliary=("kinetic_scale",), optional=True),
        Field(f"{path}/t", "f8[c]", "s", "of the break-away", "events.t"),
        Field(f"{path}/static_level", "f8[c]", "", "friction at break-away relative to Fs", "events.break_away_level"),
        Field(
            f"{path}/kinetic_scale",
            "f8[c]",
            "",
            "friction in the slip relative to that of the law",
            "events.kinetic_scale",
        ),
        Field(f"{path}/used", "u1[c]", "", "1 if the cycle was fitted", value=_used),
    )


def _used(side: Ranking) -> list[bool] | None:
    return [event.flag in ("", "rough") for event in side.events] or None


def _law(path: str, title: str, runs: int = 0) -> tree.Tree:
    """Return the rows of one law; ``runs`` is the number of runs fitted jointly, 0 for one."""
    own: list[tree.Row] = []
    for number in range(runs):
        group = f"{path}/parameters_run{number + 1}"
        of_run = Field(f"{group}/*", "parameters", "", PARAMETERS, value=methodcaller("own", number))
        own += [Group(group, "NXparameters"), of_run]
    return (
        *tree.process(path, "fit-friction", 2, "friction_curve"),
        Group(f"{path}/parameters", "NXparameters"),
        Field(f"{path}/parameters/law_name", "text", "", "of the law", value=lambda law: _shown_name(law.row)),
        Field(f"{path}/parameters/formula", "text", "", "of the law", value=lambda law: formula(law.row.fit.law)),
        Field(f"{path}/parameters/*", "parameters", "", PARAMETERS, "shared"),
        *own,
        tree.table(f"{path}/friction_curve", "relative_velocity", "friction", title),
        Field(f"{path}/friction_curve/relative_velocity", "f8[w]", "m/s", "mass minus belt", "relative_velocity"),
        Field(f"{path}/friction_curve/friction", "f8[w]", FRICTION, "on the mass", "friction"),
    )


def _unfitted(ranking: Ranking) -> list[str] | None:
    return [f"law {row.law}: {row.reason}" for row in ranking.unfitted] or None


def _smoothed(ranking: Ranking) -> str:
    return "" if ranking.runs else ranking.stages[0]


def _of_runs(ranking: Ranking, name: str) -> list[Any] | None:
    return [getattr(side.best, name) for side in ranking.runs] if ranking.rows else None


PARAMETERS = "each parameter in its unit, with `NAME_errors`, NaN where no law describes the record"
ABOUT: tree.Tree = (
    Group("fit/parameters", "NXparameters"),
    Field("fit/parameters/verdict", "text", "", "in words", "verdict"),
    Field("fit/parameters/adequacy", "text", "", "whether a law describes the record", "adequacy.said"),
    Field("fit/parameters/part", "text", "", "fitted part, unless the whole run was fitted", "part", optional=True),
    Field("fit/parameters/cpu_time", "f8", "s", "spent", "cpu_s"),
    Field("fit/parameters/begin", "f8", "s", "of the fitted part", value=_end(0)),
    Field("fit/parameters/end", "f8", "s", "of the fitted part", value=_end(-1)),
    Field("fit/parameters/warnings", "text[i]", "", "in words", "warnings", optional=True),
    Field("fit/parameters/not_fitted", "text[u]", "", "laws without a fit, and why", value=_unfitted, optional=True),
    Field("fit/parameters/sha256_smooth", "text", "", "of the smoothed velocity", value=_smoothed, optional=True),
)
RANKING = _table(  # of the six, by number
    "fit/ranking",
    Field("fit/ranking/law", "u1[l]", "", "number of the law", "rows.law"),
    Field("fit/ranking/law_name", "text[l]", "", "of the law", value=_names),
)
FORMULAS = _table(
    "fit/formulas",
    Field("fit/formulas/row", "u1[l]", "", "from 1", value=lambda ranking: range(1, len(ranking.rows) + 1) or None),
    Field("fit/formulas/law_name", "text[l]", "", "of the law", value=_names),
    Field("fit/formulas/formula", "text[l]", "", "of the law", "rows.formula"),
    Field("fit/formulas/asked", "u1[l]", "", "1 if it was requested", "rows.asked"),
)
RUNS: tree.Tree = (  # of a joint fit, beside what `daq.runfile.joint` writes
    Field("runs/begin", "f8[r]", "s", "of the fitted part", value=lambda fit: list(map(_end(0), fit.runs))),
    Field("runs/end", "f8[r]", "s", "of the fitted part", value=lambda fit: list(map(_end(-1), fit.runs))),
    Field("runs/adequacy", "text[r]", "", "verdict on this run", value=lambda fit: [s.adequacy.said for s in fit.runs]),
    Field("runs/cycles", "u4[r]", "", "cycles fitted", value=lambda fit: _of_runs(fit, "cycles")),
    Field("runs/rms", "f8[r]", "m", "of the residuals", value=lambda fit: _of_runs(fit, "rms_m")),
)
# As in the file of one run with law 1 and a formula; `_write` names the groups of each law and run.
TREE: tree.Tree = (
    *tree.process("fit", "fit-friction", 2, "ranking"),
    *ABOUT,
    *RANKING,
    *FORMULAS,
    *_cycles("fit/cycles"),
    *_law("fit_law1", ""),
)


def save(ranking: Ranking, *, force: bool = False) -> None:
    """Write the stage, unless the raw data or the smoothed stage of the run have changed since they were fitted."""
    recordings = [record.recording for record in ranking.records]
    path = recordings[0].source

    def write(entry: h5py.Group) -> None:
        raw = nexus.read_text(entry, "provenance/sha256_raw", path) if "provenance/sha256_raw" in entry else ""
        digests = (raw, recordings[0].digest), (stage.digest(entry), ranking.stages[0])
        for (now, before), done in zip(digests, ("recorded", "smoothed"), strict=True):
            if now != before:
                what = f"the run was {done} again during the fit, so the fit was not stored"
                raise InputError(what, str(path), f"run: fit-friction {path.name}")
        for name in [name for name in entry if name.startswith("fit_law")]:
            del entry[name]
        _write(entry, ranking)

    def write_joint(entry: h5py.Group) -> None:
        _write(entry, ranking)
        tree.write(entry, RUNS, ranking)

    if ranking.runs:
        joint.write(joint.name_output([one.source for one in recordings]), recordings, write_joint, force=force)
    else:
        store.extend(path, "fit", write, default="fit")


def _write(entry: h5py.Group, ranking: Ranking) -> None:
    six = tuple(sorted((row for row in ranking.rows if isinstance(row.law, int)), key=attrgetter("law")))
    shown = "ranking" if six else "formulas" if ranking.rivals else "parameters"
    tree.write(entry, (*tree.process("fit", "fit-friction", 2, shown), *ABOUT), ranking)
    tree.write(entry, RANKING, replace(ranking, rows=six))
    tree.write(entry, FORMULAS, replace(ranking, rows=ranking.rivals))
    if not ranking.rows:
        return
    for number, side in enumerate(ranking.sides, start=1):
        tree.write(entry, _cycles(f"fit/cycles_run{number}" if ranking.runs else "fit/cycles"), side)
    speeds = speeds_of_all([side.motion for side in ranking.sides])
    for row in (*six, *ranking.rivals):
        name = f"fit_law{row.law}" if isinstance(row.law, int) else f"fit_law_{row.law.replace('-', '_')}"
        title = row.title if row.formula is not None else f"law {row.law}: {row.name}"
        law = _Law(row, ranking, speeds)
        tree.write(entry, _law(name, title, len(ranking.runs)), law, {FRICTION: unit(ranking.motion)})


HEAD = "file,law,name,"
EVIDENCE = ("law", "name", "score", "weight", "in_set", "rms_m", "cycles", "orbit_distance", "cpu_s")


def refuse_foreign_file(path: Path, files: Sequence[Path], *, force: bool = False) -> None:
    """Raise InputError if ``path`` is a folder, a run or, without ``force``, not a ranking of only these files."""
    atomic.refuse_existing(path, force, *files, mark=HEAD, kind="ranking", flag="--csv")
    if path.exists() and not force:
        with path.open(newline="", encoding="utf-8", errors="surrogateescape") as file:
            others = {Path(row["file"]).name for row in csv.DictReader(file)} - {run.name for run in files}
        if others:
            what = f"exists and contains the ranking of another run, {min(others)}"
            raise InputError(what, str(path), "choose another name (--csv), or --force to replace it")


def write_curve(path: Path, ranking: Ranking, curve: MeasuredCurve) -> None:
    unit, laws = ranking.adequacy.unit, [row for row in ranking.rows if row is ranking.best or row in ranking.rivals]
    drawn = [np.abs(friction.friction_at(row.fit, ranking.motion, -curve.speed)) for row in laws]
    columns = (curve.speed, curve.friction, curve.lo, curve.hi, *drawn)
    with atomic.replacing(path, force=True) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        names = ("friction", "lo", "hi", *(row.label for row in laws))
        out.writerow(["speed (m/s)", *(f"{name} ({unit})" for name in names)])
        out.writerows(zip(*(column.tolist() for column in columns), strict=True))


def write(path: Path, rankings: Sequence[tuple[Path, Sequence[dict[str, Any]]]]) -> None:
    """Write the rankings of runs, each its file and the rows of the JSON document."""
    rows = [(file, row) for file, ranking in rankings for row in ranking]
    names = dict.fromkeys(name for _, row in rows for name in row["parameters"])
    with (
        atomic.replacing(path, force=True) as temporary,
        temporary.open("w", newline="", encoding="utf-8", errors="surrogateescape") as file,  # the bytes of a path
    ):
        out = csv.writer(file)
        parts = ("value", "stderr", "lo", "hi")
        columns = [name if part == "value" else f"{name} {part}" for name in names for part in parts]
        more = [key for key in ("formula", "asked", "reason") if any(key in row for _, row in rows)]
        out.writerow(["file", *EVIDENCE, *more, *columns])
        for run, row in rows:
            values = [row["parameters"].get(name, {}).get(part, "") for name in names for part in parts]
            beside = [int(row.get(key, True)) if key == "asked" else row.get(key, "") for key in more]
            out.writerow([run, *(int(row[key]) if key == "in_set" else row[key] for key in EVIDENCE), *beside, *values])
