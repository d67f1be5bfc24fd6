"""A run into a new file: built beside its place, synced to disk, and put there whole."""

import os
from dataclasses import replace
from pathlib import Path

from daq.runfile import schema, trust
from daq.runfile.run_data import RunData
from stickslip.output import atomic, disk


def write(path: str | os.PathLike[str], run: RunData, *, force: bool = False) -> None:
    """Write a run into a new file: build it next to ``path``, sync it to disk, move it into place."""
    target = Path(path)
    atomic.refuse_existing(target, force)
    schema.check(run)
    run = replace(run, digest=schema.compute_digest(run))
    with atomic.replacing(target, force) as temporary, disk.open_hdf5(temporary, "w") as file:
        schema.write(file, run, target.name)
    trust.trust_own(target)
