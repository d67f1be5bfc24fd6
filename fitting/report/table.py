"""The ranking as a table for other programs: comma-separated, a row for each run and law, parameters as columns."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from daq.output import atomic

EVIDENCE = ("law", "name", "score", "weight", "in_set", "rms_m", "cycles", "orbit_distance", "cpu_s")


def refuse_foreign_file(path: Path, files: Sequence[Path]) -> None:
    """Raise InputError when the table cannot go to ``path``: a folder, a run, a file that is no table of ours."""
    atomic.refuse_existing(path, False, *files, own="file,law,name,", kind="ranking", flag="--csv")


def write(path: Path, documents: Sequence[tuple[Path, dict[str, Any]]]) -> None:
    """Write the rankings of runs.

    Parameters
    ----------
    path : Path
        Table to write; an older one is replaced.
    documents : sequence of (Path, dict)
        Run file and its JSON document; a run without a ranking has no rows.
    """
    rows = [(file, row) for file, document in documents for row in document.get("ranking", ())]
    names = dict.fromkeys(name for _, row in rows for name in row["parameters"])
    with atomic.replacing(path, force=True) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        columns = [f"{name}{part}" for name in names for part in ("", " stderr")]
        out.writerow(["file", *EVIDENCE, *columns])
        for run, row in rows:
            found = [row["parameters"].get(name, {}).get(part, "") for name in names for part in ("value", "stderr")]
            out.writerow([run, *(int(row[key]) if key == "in_set" else row[key] for key in EVIDENCE), *found])
