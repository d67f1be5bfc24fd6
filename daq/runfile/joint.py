"""The file of a joint fit, `NAME1+N.fit.h5`: the fit of several runs together, and which runs they are.

It has no raw data.  ``/entry/runs`` names the runs; ``fit-friction`` adds the same groups as to the file of one run.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from daq.runfile import nexus, trust
from daq.runfile.recording import Recording
from stickslip.errors import InputError
from stickslip.output import atomic, disk
from stickslip.version import VERSION

SUFFIX = ".fit.h5"
KEPT = "move it, or use --force to replace it"


def name_output(files: Sequence[Path], suffix: str = SUFFIX) -> Path:
    """Return the name of an output of several runs, next to the first: ``run1+2.fit.h5`` for three runs."""
    return files[0].with_name(f"{files[0].stem}+{len(files) - 1}{suffix}")


def refuse_foreign_file(path: Path, runs: Sequence[Recording], *, force: bool = False) -> None:
    """Raise InputError for a file that exists, unless with ``force`` or if it is the fit of these runs in any order."""
    atomic.refuse_existing(path, True, *(run.source for run in runs))
    if not path.exists() or force:
        return
    try:
        with open_joint_fit(path) as entry:
            digests = nexus.read_texts(entry, "runs/sha256_raw", path)
    except (InputError, *trust.DAMAGE) as error:
        raise InputError("exists and is not the file of a joint fit", str(path), KEPT) from error
    if sorted(digests) != sorted(run.digest for run in runs):
        raise InputError("exists and contains the joint fit of other runs", str(path), KEPT)


def write(path: Path, runs: Sequence[Recording], writer: Callable[[h5py.Group], None], *, force: bool = False) -> None:
    """Write the fit of several runs in place of an older one; ``writer`` takes /entry and adds the group ``fit``."""
    refuse_foreign_file(path, runs, force=force)
    with atomic.replacing(path, force=True) as temporary, disk.open_hdf5(temporary, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "entry", "creator": f"stickslip {VERSION}"})
        file.attrs.update({"file_name": path.name, "NeXus_version": "2024.02"})
        entry = nexus.group(file, "entry", "NXentry", default="fit")
        names = [Path(os.path.relpath(run.source, path.parent)).as_posix() for run in runs]
        nexus.field(entry, "title", f"joint fit of {', '.join(run.source.name for run in runs)}")
        nexus.field(entry, "start_time", min(run.started for run in runs))
        nexus.field(entry, "program_name", "fit-friction", version=VERSION)
        group = nexus.group(entry, "runs", "NXcollection", **{trust.JOINT: np.int64(trust.JOINT_SCHEMA)})
        nexus.field(group, "file", names)
        nexus.field(group, "sha256_raw", [run.digest for run in runs])
        nexus.field(group, "title", [run.title for run in runs])
        nexus.field(group, "start_time", [run.started for run in runs])
        writer(entry)


@contextmanager
def open_joint_fit(path: Path) -> Iterator[h5py.Group]:
    """Open the file of a joint fit for reading, and yield its /entry."""
    wrong = InputError("is not the file of a joint fit", str(path), "use a file that fit-friction wrote")
    try:
        file = trust.open_trusted(path)
    except OSError as error:
        raise wrong from error
    with file:
        if not trust.is_joint(file):
            raise wrong
        yield nexus.read_group(file, "entry", path)


def is_joint_fit(path: Path) -> bool:
    """Return whether a file is that of a joint fit, of the schema that this version reads."""
    try:
        with trust.open_trusted(path) as file:
            return trust.is_joint(file)
    except (OSError, InputError):
        return False
