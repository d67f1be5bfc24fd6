"""The runs and joint fits in a folder, a row each, read without loading their samples."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from daq.runfile import joint, nexus, schema, store, tree, trust
from daq.runfile.run_data import OF_FILE, count_lost
from stickslip.errors import InputError

# Its lock is not tried: for a moment that would hold the lock of a recording that just begins.
UNFINISHED = "a journal: still recording, or interrupted (daq recover)"
WANTED = ("title", "started", "rate_hz", "operator", "sample_name", "note", "tags", "provenance")
LISTED = [row for row in schema.TREE if isinstance(row, tree.Group) or row.of in WANTED]
VERDICT, PART = "fit/parameters/verdict", "fit/parameters/part"


@dataclass(frozen=True)
class RunRow:
    """One run, or the joint fit of several; None where the file does not contain it."""

    file: Path  # the run file, the journal of a recording that has not ended, or the file of a joint fit
    # Title, time of the first sample (ISO 8601 with zone; of a joint fit, of its first run), who recorded, what was
    # measured, remarks
    title: str | None = None
    date: str | None = None
    duration: float | None = None  # s
    rate: float | None = None  # Nominal, Hz
    lost: int | None = None  # samples that the sequence numbers skip; None for an import
    sticks: int | None = None  # none before ``process smooth``
    verdict: str | None = None  # none before ``fit-friction``
    part: str | None = None  # what was fitted, where it was not the whole run, all laws and all cycles
    operator: str | None = None
    sample: str | None = None
    note: str | None = None
    tags: dict[str, str] = field(default_factory=dict)  # named values
    runs: int | None = None  # how many were fitted jointly; None for a run
    of_file: bool = False  # the date is that of the file that was imported: nobody stated when it was recorded
    problem: str | None = None  # why nothing else is known: not a run, damaged, not finished


def list_runs(folders: Sequence[Path]) -> list[RunRow]:
    """Return the runs and unfinished recordings in folders, oldest first; a joint fit after its first run."""
    rows = []
    for folder in folders:
        try:
            files = sorted(item for item in folder.iterdir() if item.name.endswith((".h5", ".h5.part")))
        except OSError as error:
            what = "is a file" if folder.is_file() else f"cannot be listed: {error.strerror}"
            raise InputError(what, str(folder), "use a folder that contains runs") from error
        rows += [RunRow(file, problem=UNFINISHED) if file.suffix == ".part" else _read_run(file) for file in files]
    return sorted(rows, key=lambda row: (row.date is None, row.date or "", row.runs or 0, str(row.file)))


def _read_run(file: Path) -> RunRow:
    try:
        with trust.damage(file):
            if file.name.endswith(joint.SUFFIX) and joint.is_joint_fit(file):
                with joint.open_joint_fit(file) as entry:
                    return _make_joint_row(entry, file)
            with store.open_run(file) as run_file:
                return _make_row(nexus.read_group(run_file, "entry", file), file)
    except InputError as error:
        return RunRow(file, problem=error.what)


def _make_joint_row(entry: h5py.Group, file: Path) -> RunRow:
    return RunRow(
        file=file,
        title=nexus.read_text(entry, "title", file),
        date=nexus.read_text(entry, "start_time", file),
        verdict=nexus.read_text(entry, VERDICT, file),
        part=nexus.read_text(entry, PART, file) if PART in entry else None,
        runs=len(nexus.read_texts(entry, "runs/sha256_raw", file)),
    )


def _make_row(entry: h5py.Group, file: Path) -> RunRow:
    values = tree.read(entry, LISTED, file)
    time = nexus.read_dataset(entry, f"{schema.ENCODER_LOG}/time", file)
    lost = None
    if "raw" in entry:
        sample = nexus.read_array(entry, "raw/sample", np.uint32, file)
        lost = count_lost(sample, nexus.read_array(entry, "raw/segment", np.uint32, file))
    sticks = "smooth/statistics/sticks"
    return RunRow(
        file=file,
        title=values["title"],
        date=values["started"],
        duration=float(time[-1] - time[0]) + 1 / values["rate_hz"],
        rate=values["rate_hz"],
        lost=lost,
        sticks=int(nexus.read_number(entry, sticks, file)) if sticks in entry else None,
        verdict=nexus.read_text(entry, VERDICT, file) if VERDICT in entry else None,
        part=nexus.read_text(entry, PART, file) if PART in entry else None,
        operator=values.get("operator"),
        sample=values.get("sample_name"),
        note=values.get("note"),
        tags=values.get("tags", {}),
        of_file=values.get("provenance", {}).get("start_time_from") == OF_FILE,
    )
