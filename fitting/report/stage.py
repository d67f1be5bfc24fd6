"""The fitted stage: /entry/fit and /entry/fit_law1 ... fit_law_NAME, of one run in its file, of several in their own.

In a run file the raw data stay unchanged.  In the file of a joint fit (`daq.runfile.joint`) the cycles and what differs
between the runs appear once for each: cycles_run1 ..., parameters_run1 ...; runs has the results of each.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter, methodcaller
from pathlib import Path

import h5py

from daq.runfile import joint, nexus, store, tree
from daq.runfile.tree import Field, Group
from fitting.drawing.curves import curve, speeds_of_all, unit
from fitting.estimation.derived import RUNS_OWN
from fitting.estimation.result import Parameter
from fitting.report.symbols import formula
from fitting.selection.result import LawResult, RankedLaws
from processing import stage as smoothed_stage
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

FRICTION = "N or N/kg"  # unit of a friction: N where mass or stiffness is known


@dataclass(frozen=True)
class _Stage:
    """The contents of a stage: ranking, fitted part in words, sha256 of the smoothed stage."""

    ranking: RankedLaws
    part: str
    smoothed: str

    @cached_property
    def six(self) -> tuple[LawResult, ...]:
        return tuple(sorted((row for row in self.ranking.rows if isinstance(row.law, int)), key=_number))

    @property
    def span(self) -> tuple[float, float] | None:
        return None if self.ranking.runs else _span(self.ranking)


@dataclass(frozen=True)
class _Law:
    """The contents of a law: its row, and the speeds of its friction curve."""

    row: LawResult
    ranking: RankedLaws
    relative_velocity: Array

    @property
    def shared(self) -> dict[str, Parameter]:
        """The parameters that all runs share; all for a single run."""
        return self._of(self.ranking.sides[0], lambda name: not self.ranking.runs or name not in RUNS_OWN)

    def own(self, number: int) -> dict[str, Parameter]:
        return self._of(self.ranking.runs[number], lambda name: name in RUNS_OWN)

    @property
    def friction(self) -> Array:
        return curve(self.row.fit, self.ranking.motion, self.relative_velocity)

    def _of(self, side: RankedLaws, wanted: Callable[[str], bool]) -> dict[str, Parameter]:
        parameters = side.row(self.row.law).parameters
        return {name.replace("/", "_over_"): item for name, item in parameters.items() if wanted(name)}


def _number(row: LawResult) -> int:
    return row.law if isinstance(row.law, int) else 0


def _span(side: RankedLaws) -> tuple[float, float]:
    """Return start and end of the fitted part, s."""
    begin, end = side.motion.begin + side.motion.time[[0, -1]]
    return float(begin), float(end)


def _shown_name(row: LawResult) -> str:
    return row.name if row.formula is None else str(row.law)


def _table(path: str, of: str, *columns: Field) -> tree.Tree:
    """Return the rows of a table of laws; ``columns`` begin with the axis."""
    title = "log error of each law above the best one's, penalised"
    return (
        tree.table(path, columns[0].name, "score", title, optional=True),
        columns[0],
        Field(f"{path}/score", "f8[l]", "", "log error above the best law's, penalised", value=_evidence(of, "score")),
        Field(f"{path}/weight", "f8[l]", "", "weight of evidence", value=_evidence(of, "weight")),
        Field(f"{path}/in_set", "u1[l]", "", "1 in the confidence set", f"{of}.in_set"),
        Field(f"{path}/rms", "f8[l]", "m", "of the residuals", f"{of}.rms_m"),
        Field(f"{path}/cycles", "u4[l]", "", "cycles fitted", f"{of}.cycles"),
        Field(f"{path}/orbit_distance", "f8[l]", "", "to the measured orbit, of its size", f"{of}.orbit"),
        *columns[1:],
    )


def _names(of: str) -> Callable[[_Stage], list[str] | None]:
    return lambda stage: [_shown_name(row) for row in attrgetter(of)(stage)] or None


def _evidence(of: str, name: str) -> Callable[[_Stage], list[float] | None]:
    """Return how a column of the evidence is read; NaN where no law describes the record."""

    def column(stage: _Stage) -> list[float] | None:
        items = [getattr(row, name) for row in attrgetter(of)(stage)]
        return [math.nan if item is None else item for item in items] or None

    return column


def _cycles(path: str) -> tree.Tree:
    title = "levels of each break-away over Fs"
    return (
        tree.table(path, "t", "static_level", title, auxiliary=("kinetic_scale",), optional=True),
        Field(f"{path}/t", "f8[c]", "s", "of the break-away", "events.t"),
        Field(f"{path}/static_level", "f8[c]", "", "friction at the break-away over Fs", "events.break_away_level"),
        Field(f"{path}/kinetic_scale", "f8[c]", "", "friction in the slip over the law's", "events.kinetic_scale"),
        Field(f"{path}/used", "u1[c]", "", "1 where the cycle was fitted", value=_used),
    )


def _used(side: RankedLaws) -> list[bool] | None:
    return [event.flag in ("", "rough") for event in side.events] or None


def _law(path: str, title: str, runs: int = 0) -> tree.Tree:
    """Return the rows of one law; ``runs`` is the number of runs fitted together."""
    return (
        *tree.process(path, "fit-friction", 2, "friction_curve"),
        Group(f"{path}/parameters", "NXparameters"),
        Field(f"{path}/parameters/law_name", "text", "", "of the law", value=lambda law: _shown_name(law.row)),
        Field(f"{path}/parameters/formula", "text", "", "of the law", value=lambda law: formula(law.row.fit.law)),
        Field(f"{path}/parameters/*", "parameters", "", PARAMETERS, "shared"),
        *(
            row
            for number in range(runs)
            for row in (
                Group(f"{path}/parameters_run{number + 1}", "NXparameters"),
                Field(
                    f"{path}/parameters_run{number + 1}/*",
                    "parameters",
                    "",
                    PARAMETERS,
                    value=methodcaller("own", number),
                ),
            )
        ),
        tree.table(f"{path}/friction_curve", "relative_velocity", "friction", title),
        Field(f"{path}/friction_curve/relative_velocity", "f8[w]", "m/s", "mass minus belt", "relative_velocity"),
        Field(f"{path}/friction_curve/friction", "f8[w]", FRICTION, "on the mass", "friction"),
    )


def _unfitted(stage: _Stage) -> list[str] | None:
    return [f"law {row.law}: {row.reason}" for row in stage.ranking.unfitted] or None


PARAMETERS = "each parameter in its unit, with `NAME_errors`, NaN where no law describes the record"
ABOUT: tree.Tree = (
    Group("fit/parameters", "NXparameters"),
    Field("fit/parameters/verdict", "text", "", "in words", "ranking.verdict"),
    Field("fit/parameters/adequacy", "text", "", "whether a law describes the record", "ranking.adequacy.said"),
    Field("fit/parameters/part", "text", "", "what was fitted, where not all was", "part", optional=True),
    Field("fit/parameters/cpu_time", "f8", "s", "spent", "ranking.cpu_s"),
    Field("fit/parameters/begin", "f8", "s", "of what was fitted", value=lambda stage: stage.span and stage.span[0]),
    Field("fit/parameters/end", "f8", "s", "of what was fitted", value=lambda stage: stage.span and stage.span[1]),
    Field("fit/parameters/warnings", "text[i]", "", "in words", "ranking.warnings", optional=True),
    Field("fit/parameters/not_fitted", "text[u]", "", "laws without a fit, and why", value=_unfitted, optional=True),
    Field("fit/parameters/sha256_smooth", "text", "", "of the smoothed velocity", "smoothed", optional=True),
)
RANKING = _table(
    "fit/ranking",
    "six",
    Field("fit/ranking/law", "u1[l]", "", "number of the law", "six.law"),
    Field("fit/ranking/law_name", "text[l]", "", "of the law", value=_names("six")),
)
FORMULAS = _table(
    "fit/formulas",
    "ranking.rivals",
    Field(
        "fit/formulas/row", "u1[l]", "", "from 1", value=lambda stage: range(1, len(stage.ranking.rivals) + 1) or None
    ),
    Field("fit/formulas/law_name", "text[l]", "", "of the law", value=_names("ranking.rivals")),
    Field("fit/formulas/formula", "text[l]", "", "of the law", "ranking.rivals.formula"),
    Field("fit/formulas/asked", "u1[l]", "", "1 where it was asked for", "ranking.rivals.asked"),
)
RUNS: tree.Tree = (  # of a joint fit, beside what `daq.runfile.joint` writes
    Field("runs/begin", "f8[r]", "s", "of what was fitted", value=lambda fit: [_span(side)[0] for side in fit.runs]),
    Field("runs/end", "f8[r]", "s", "of what was fitted", value=lambda fit: [_span(side)[1] for side in fit.runs]),
    Field("runs/adequacy", "text[r]", "", "verdict on this run", value=lambda fit: [s.adequacy.said for s in fit.runs]),
    Field(
        "runs/cycles",
        "u4[r]",
        "",
        "cycles fitted",
        value=lambda fit: [s.best.cycles for s in fit.runs] if fit.rows else None,
    ),
    Field(
        "runs/rms",
        "f8[r]",
        "m",
        "of the residuals",
        value=lambda fit: [s.best.rms_m for s in fit.runs] if fit.rows else None,
    ),
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


def save(ranking: RankedLaws, path: Path, record: str, smoothed: str, part: str = "") -> None:
    """Write the stage into the run file, replacing an earlier one; ``part`` names what was fitted, if not all.

    Raises InputError where the file is not a run, or its raw data or smoothed stage no longer have the sha256
    ``record`` and ``smoothed``.
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
        _write(entry, ranking, part, smoothed)

    store.extend(path, "fit", write, default="fit")


def save_joint(
    ranking: RankedLaws, runs: Sequence[joint.FittedRun], path: Path, part: str = "", *, force: bool = False
) -> None:
    """Write the file of a joint fit; another file there is an InputError without ``force``; ``part`` as in `save`."""

    def write(entry: h5py.Group) -> None:
        _write(entry, ranking, part)
        tree.write(entry, RUNS, ranking)

    joint.write(path, runs, write, force=force)


def _write(entry: h5py.Group, ranking: RankedLaws, part: str, smoothed: str = "") -> None:
    stage = _Stage(ranking, part, smoothed)
    shown = "ranking" if stage.six else "formulas" if ranking.rivals else "parameters"
    # The two tables of laws are of different lengths.
    tree.write(entry, (*tree.process("fit", "fit-friction", 2, shown), *ABOUT, *RANKING), stage)
    tree.write(entry, FORMULAS, stage)
    if not ranking.rows:
        return
    for number, side in enumerate(ranking.sides, start=1):
        tree.write(entry, _cycles(f"fit/cycles_run{number}" if ranking.runs else "fit/cycles"), side)
    speeds = speeds_of_all([side.motion for side in ranking.sides])
    for row in (*stage.six, *ranking.rivals):
        name = f"fit_law{row.law}" if isinstance(row.law, int) else f"fit_law_{row.law.replace('-', '_')}"
        title = row.title if row.formula is not None else f"law {row.law}: {row.name}"
        law = _Law(row, ranking, speeds)
        tree.write(entry, _law(name, title, len(ranking.runs)), law, {FRICTION: unit(ranking.motion)})
