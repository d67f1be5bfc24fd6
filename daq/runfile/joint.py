"""The file of a joint fit, `NAME1+N.fit.h5`: the fit of several runs together, and which runs they are.

It has no raw data.  ``/entry/runs`` names the runs; ``fit-friction`` adds the same groups as to the file of one run.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from daq.runfile import nexus, trust
from stickslip.errors import InputError
from stickslip.output import atomic, disk
from stickslip.version import VERSION

SUFFIX = ".fit.h5"
KEPT = "move it away, or --force to replace it"


@dataclass(frozen=True)
class FittedRun:
    """One of the runs of a fit: its file, the sha256 of its raw data, its title, and when it began (ISO 8601)."""

    file: Path
    digest: str
    title: str
    started: str


def beside(files: Sequence[Path], suffix: str = SUFFIX) -> Path:
    """Return the name of an output of several runs, beside the first: ``run1+2.fit.h5`` for three runs."""
    return files[0].with_name(f"{files[0].stem}+{len(files) - 1}{suffix}")


def refuse_foreign_file(path: Path, runs: Sequence[FittedRun], *, force: bool = False) -> None:
    """Raise InputError when ``path`` may not be written: not without ``force``, unless it is the fit of these runs.

    Which of the runs is named first does not matter.
    """
    atomic.refuse_existing(path, True, *(run.file for run in runs))
    if not path.exists() or force:
        return
    try:
        with opened(path) as entry:
            found = nexus.read_texts(entry, "runs/sha256_raw", path)
    except (InputError, *trust.DAMAGE) as error:
        raise InputError("exists and is no joint fit", str(path), KEPT) from error
    if sorted(found) != sorted(run.digest for run in runs):
        raise InputError("exists and is the joint fit of other runs", str(path), KEPT)


def write(path: Path, runs: Sequence[FittedRun], writer: Callable[[h5py.Group], None], *, force: bool = False) -> None:
    """Write the fit of several runs; an older one of the same runs is replaced.

    writer: Takes /entry, open for writing, and adds the group ``fit`` and those beside it.
    force: Replace any other file too, except the runs themselves.
    Raises InputError: as `refuse_foreign_file`.
    Raises RefusedError: the disk refuses; an older file still stands.
    """
    refuse_foreign_file(path, runs, force=force)
    with atomic.replacing(path, force=True) as temporary, disk.hdf5(temporary, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "entry", "creator": f"stickslip {VERSION}"})
        file.attrs.update({"file_name": path.name, "NeXus_version": "2024.02"})
        entry = nexus.group(file, "entry", "NXentry", default="fit")
        names = [Path(os.path.relpath(run.file, path.parent)).as_posix() for run in runs]
        nexus.field(entry, "title", f"joint fit of {', '.join(run.file.name for run in runs)}")
        nexus.field(entry, "start_time", min(run.started for run in runs))
        nexus.field(entry, "program_name", "fit-friction", version=VERSION)
        about = nexus.group(entry, "runs", "NXcollection", **{trust.JOINT: np.int64(trust.JOINT_SCHEMA)})
        nexus.field(about, "file", names)
        nexus.field(about, "sha256_raw", [run.digest for run in runs])
        nexus.field(about, "title", [run.title for run in runs])
        nexus.field(about, "start_time", [run.started for run in runs])
        writer(entry)


@contextmanager
def opened(path: Path) -> Iterator[h5py.Group]:
    """Open the file of a joint fit for reading, and give its /entry.

    Raises InputError: for a file that is none, of another schema, or not to be trusted.
    """
    wrong = InputError("is not the file of a joint fit", str(path), "give one that fit-friction wrote")
    try:
        file = trust.opened(path)
    except OSError as error:
        raise wrong from error
    with file:
        if not trust.is_joint(file):
            raise wrong
        yield nexus.read_group(file, "entry", path)


def recognised(path: Path) -> bool:
    """Return whether a file is that of a joint fit, of the schema that this version reads."""
    try:
        with trust.opened(path) as file:
            return trust.is_joint(file)
    except (OSError, InputError):
        return False
