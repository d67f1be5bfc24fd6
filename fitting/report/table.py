"""Tables for other programs, comma-separated: the ranking, a row for each run and law; the measured friction curve."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fitting.curve.result import MeasuredCurve
from fitting.drawing import curves
from fitting.selection.result import Ranking
from stickslip.errors import InputError
from stickslip.output import atomic

EVIDENCE = ("law", "name", "score", "weight", "in_set", "rms_m", "cycles", "orbit_distance", "cpu_s")


HEAD = "file,law,name,"


def refuse_foreign_file(path: Path, files: Sequence[Path], *, force: bool = False) -> None:
    """Raise InputError where ``path`` is a folder, a run or, without ``force``, not a ranking of only these files."""
    atomic.refuse_existing(path, force, *files, mark=HEAD, kind="ranking", flag="--csv")
    if path.exists() and not force:
        with path.open(newline="", encoding="utf-8", errors="surrogateescape") as file:
            others = {Path(row["file"]).name for row in csv.DictReader(file)} - {run.name for run in files}
        if others:
            what = f"exists and is the ranking of another run, {min(others)}"
            raise InputError(what, str(path), "give another name (--csv), or --force to replace it")


def write_curve(path: Path, ranking: Ranking, curve: MeasuredCurve) -> None:
    """Write friction against relative speed: the measured curve, its band, the best law and each formula."""
    unit, laws = ranking.adequacy.unit, [row for row in ranking.rows if row is ranking.best or row in ranking.rivals]
    drawn = [np.abs(curves.curve(row.fit, ranking.motion, -curve.speed)) for row in laws]
    columns = (curve.speed, curve.friction, curve.lo, curve.hi, *drawn)
    with atomic.replacing(path, force=True) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        names = ("friction", "lo", "hi", *(row.label for row in laws))
        out.writerow(["speed (m/s)", *(f"{name} ({unit})" for name in names)])
        out.writerows(zip(*(column.tolist() for column in columns), strict=True))


def write(path: Path, rankings: Sequence[tuple[Path, Sequence[dict[str, Any]]]]) -> None:
    """Write the rankings of runs (file and rows of the JSON document), in place of an older table."""
    rows = [(file, row) for file, ranking in rankings for row in ranking]
    names = dict.fromkeys(name for _, row in rows for name in row["parameters"])
    with (
        atomic.replacing(path, force=True) as temporary,
        temporary.open("w", newline="", encoding="utf-8", errors="surrogateescape") as file,  # the bytes of a path
    ):
        out = csv.writer(file)
        columns = [f"{name}{part}" for name in names for part in ("", " stderr")]
        more = [key for key in ("formula", "asked", "reason") if any(key in row for _, row in rows)]
        out.writerow(["file", *EVIDENCE, *more, *columns])
        for run, row in rows:
            values = [row["parameters"].get(name, {}).get(part, "") for name in names for part in ("value", "stderr")]
            beside = [int(row.get(key, True)) if key == "asked" else row.get(key, "") for key in more]
            out.writerow([run, *(int(row[key]) if key == "in_set" else row[key] for key in EVIDENCE), *beside, *values])
