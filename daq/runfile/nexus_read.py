"""Reading a NeXus tree that may not hold what it should: every surprise is one line that names the field.

Paths are relative to /entry; ``where`` is the file, for the message.  Every function raises InputError.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.errors import InputError

EVERY = slice(None)  # rows
AGAIN = "the file was damaged or made by another program; record or import it again"


def same_length(found: int, n: int, name: str, where: Path) -> None:
    """Refuse a column of ``found`` values where ``n`` belong."""
    if found != n:
        raise InputError(f"/entry/{name} has {found} values where {n} belong", str(where), AGAIN)


def group(parent: h5py.Group, name: str, where: Path) -> h5py.Group:
    """Return the group ``name``."""
    item = parent.get(name)
    if not isinstance(item, h5py.Group):
        raise InputError(f"has no group /{name}", str(where), AGAIN)
    return item


def dataset(entry: h5py.Group, name: str, where: Path) -> h5py.Dataset:
    """Return the dataset ``name``."""
    item = entry.get(name)
    if not isinstance(item, h5py.Dataset):
        raise InputError(f"has no /entry/{name}", str(where), AGAIN)
    return item


def array(entry: h5py.Group, name: str, dtype: Any, where: Path, own: slice = EVERY) -> Any:
    """Return a column of numbers, or ``own`` rows of it, as ``dtype``; integers are never read out of floats."""
    item = dataset(entry, name, where)
    if item.ndim != 1 or item.dtype.kind not in "iuf" or not np.can_cast(item.dtype, dtype, "same_kind"):
        found = f"{item.ndim}-dimensional {item.dtype}"
        raise InputError(f"/entry/{name} is {found}, not one column of {np.dtype(dtype)}", str(where), AGAIN)
    return item[own].astype(dtype, copy=False)


def scalar(entry: h5py.Group, name: str, where: Path) -> float:
    """Return a single number."""
    item = dataset(entry, name, where)
    if item.shape != () or item.dtype.kind not in "iuf":
        raise InputError(f"/entry/{name} is no number", str(where), AGAIN)
    return float(item[()])


def string(entry: h5py.Group, name: str, where: Path) -> str:
    """Return a single text."""
    item = dataset(entry, name, where)
    if item.shape != () or h5py.check_string_dtype(item.dtype) is None:
        raise InputError(f"/entry/{name} is no text", str(where), AGAIN)
    return text(item[()])


def text(value: Any) -> str:
    """Return an HDF5 string, however h5py delivered it."""
    return value.decode() if isinstance(value, bytes) else str(value)
