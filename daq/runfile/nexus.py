"""NeXus on h5py: groups with a class, fields with units, true HDF5 dimension scales; typed reads.

Rules of the validators: free columns belong in NXdata or NXcollection; every float has ``units`` ("" when it is
dimensionless); ``NAME_errors`` draws error bars everywhere; no compression plugin, so that files open anywhere.
No object stores its creation time, so equal data give equal bytes.

The ``read_`` functions assume nothing about a file: anything unexpected is an InputError naming the field.  Their paths
are relative to /entry; ``where`` is the file, for the message.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.runfile.spill import BLOCK, Column
from stickslip.errors import InputError
from stickslip.text import storable

CHUNK = 16384
# With shuffle, higher levels of gzip cost time and gain little.
FILTERS: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
EVERY = slice(None)  # rows
AGAIN = "the file was damaged or made by another program; record or import it again"


def group(parent: h5py.Group, name: str, nx_class: str, **attributes: Any) -> h5py.Group:
    """Make the group ``name`` of NeXus class ``nx_class`` in ``parent``, with further attributes."""
    made = parent.create_group(name)
    made.attrs["NX_class"] = nx_class
    for key, value in attributes.items():
        made.attrs[key] = storable(value) if isinstance(value, str) else value
    return made


def field(parent: h5py.Group, name: str, data: Any, units: str | None = None, **attributes: Any) -> h5py.Dataset:
    """Write one field.

    parent: Where it goes.
    name: Its name.
    data: What HDF5 cannot hold of a text is escaped (`stickslip.text.storable`). Arrays are stored in their own type,
        chunked by 16384, with gzip, shuffle and a checksum per chunk.
    units: Stored as ``@units``; a float without units is refused; "" means dimensionless.
    **attributes: Further attributes.
    Raises ValueError: for a float field without units.
    """
    if isinstance(data, str):
        made = parent.create_dataset(name, data=storable(data), dtype=h5py.string_dtype())
    elif isinstance(data, list | tuple) and data and isinstance(data[0], str):
        made = parent.create_dataset(name, data=[storable(text) for text in data], dtype=h5py.string_dtype())
    elif isinstance(data, Column):
        made = column(parent, name, len(data), data.dtype.str, units)
        for first in range(0, len(data), BLOCK):
            made[first : first + BLOCK] = data[first : first + BLOCK]
    else:
        values = np.asarray(data)
        if values.dtype.kind == "f" and units is None:
            raise ValueError(f"float field {name!r} has no units; give units, '' when it is dimensionless")
        filters = {}
        if values.ndim and values.size:
            filters = {"chunks": (min(values.shape[0], CHUNK), *values.shape[1:]), **FILTERS}
        # An array of an HDF5 enum carries its names in the dtype's metadata, which h5py reads here.
        made = parent.create_dataset(name, data=values, dtype=values.dtype, track_times=False, **filters)
    if units is not None:
        made.attrs["units"] = units
    for key, value in attributes.items():
        made.attrs[key] = storable(value) if isinstance(value, str) else value
    return made


def column(
    parent: h5py.Group, name: str, n: int, dtype: str, units: str | None, *, growing: bool = False, **attributes: Any
) -> h5py.Dataset:
    """Make a column of ``n`` numbers yet to be written, stored as `field` stores one; a growing one begins empty."""
    shape, most = ((0,), (None,)) if growing else ((n,), None)
    made = parent.create_dataset(
        name, shape, dtype, maxshape=most, chunks=(min(n, CHUNK),), track_times=False, **FILTERS
    )
    made.attrs.update(attributes if units is None else {"units": units, **attributes})
    return made


def scale(parent: h5py.Group, axis: str) -> None:
    """Make ``axis`` the dimension scale of every other one-dimensional field of its length in ``parent``."""
    coordinate = parent[axis]
    coordinate.make_scale(axis)
    for key, item in parent.items():
        if key != axis and isinstance(item, h5py.Dataset) and item.shape == coordinate.shape:
            item.dims[0].attach_scale(coordinate)


def link(parent: h5py.Group, name: str, target: h5py.Dataset) -> None:
    """Give ``target`` a second name: a hard link, no copy."""
    parent[name] = target


def check_length(length: int, n: int, name: str, where: Path) -> None:
    """Refuse a column of ``length`` values where ``n`` belong."""
    if length != n:
        raise InputError(f"/entry/{name} has {length} values where {n} belong", str(where), AGAIN)


def read_group(parent: h5py.Group, name: str, where: Path) -> h5py.Group:
    """Return the group ``name``."""
    item = parent.get(name)
    if not isinstance(item, h5py.Group):
        raise InputError(f"has no group /{name}", str(where), AGAIN)
    return item


def read_dataset(entry: h5py.Group, name: str, where: Path) -> h5py.Dataset:
    """Return the dataset ``name``."""
    item = entry.get(name)
    if not isinstance(item, h5py.Dataset):
        raise InputError(f"has no /entry/{name}", str(where), AGAIN)
    return item


def read_array(entry: h5py.Group, name: str, dtype: Any, where: Path, own: slice = EVERY) -> Any:
    """Return a column of numbers, or ``own`` rows of it, as ``dtype``; integers are never read out of floats."""
    item = read_dataset(entry, name, where)
    if item.ndim != 1 or item.dtype.kind not in "iuf" or not np.can_cast(item.dtype, dtype, "same_kind"):
        form = f"{item.ndim}-dimensional {item.dtype}"
        raise InputError(f"/entry/{name} is {form}, not one column of {np.dtype(dtype)}", str(where), AGAIN)
    return item[own].astype(dtype, copy=False)


def read_number(entry: h5py.Group, name: str, where: Path) -> float:
    """Return a single number."""
    item = read_dataset(entry, name, where)
    if item.shape != () or item.dtype.kind not in "iuf":
        raise InputError(f"/entry/{name} is not a number", str(where), AGAIN)
    return float(item[()])


def read_text(entry: h5py.Group, name: str, where: Path) -> str:
    """Return a single text."""
    item = read_dataset(entry, name, where)
    if item.shape != () or h5py.check_string_dtype(item.dtype) is None:
        raise InputError(f"/entry/{name} is not text", str(where), AGAIN)
    return text(item[()])


def read_text_or_whole(parent: h5py.Group, name: str, where: Path) -> str | int:
    """Return a single text or whole number."""
    item = read_dataset(parent, name, where)
    if item.shape == () and item.dtype.kind in "iu":
        return int(item[()])
    return read_text(parent, name, where)


def read_texts(entry: h5py.Group, name: str, where: Path) -> tuple[str, ...]:
    """Return a column of texts."""
    item = read_dataset(entry, name, where)
    if item.ndim != 1 or h5py.check_string_dtype(item.dtype) is None:
        raise InputError(f"/entry/{name} is not a column of text", str(where), AGAIN)
    return tuple(text(value) for value in item[()])


def text(value: Any) -> str:
    """Return an HDF5 string, however h5py delivered it."""
    return value.decode() if isinstance(value, bytes) else str(value)
