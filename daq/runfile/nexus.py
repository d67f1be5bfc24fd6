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
    group_made = parent.create_group(name)
    group_made.attrs["NX_class"] = nx_class
    for key, value in attributes.items():
        group_made.attrs[key] = storable(value) if isinstance(value, str) else value
    return group_made


def field(parent: h5py.Group, name: str, data: Any, units: str | None = None, **attributes: Any) -> h5py.Dataset:
    """Write one field, arrays chunked and compressed; a float without ``units`` ("": dimensionless) is a ValueError."""
    if isinstance(data, str):
        dataset = parent.create_dataset(name, data=storable(data), dtype=h5py.string_dtype())
    elif isinstance(data, list | tuple) and data and isinstance(data[0], str):
        dataset = parent.create_dataset(name, data=[storable(text) for text in data], dtype=h5py.string_dtype())
    elif isinstance(data, Column):
        dataset = column(parent, name, len(data), data.dtype.str, units)
        for first in range(0, len(data), BLOCK):
            dataset[first : first + BLOCK] = data[first : first + BLOCK]
    else:
        values = np.asarray(data)
        if values.dtype.kind == "f" and units is None:
            raise ValueError(f"float field {name!r} has no units; give units, '' if it is dimensionless")
        filters = {}
        if values.ndim and values.size:
            filters = {"chunks": (min(values.shape[0], CHUNK), *values.shape[1:]), **FILTERS}
        # An array of an HDF5 enum carries its names in the dtype's metadata, which h5py reads here.
        dataset = parent.create_dataset(name, data=values, dtype=values.dtype, track_times=False, **filters)
    if units is not None:
        dataset.attrs["units"] = units
    for key, value in attributes.items():
        dataset.attrs[key] = storable(value) if isinstance(value, str) else value
    return dataset


def column(
    parent: h5py.Group, name: str, n: int, dtype: str, units: str | None, *, growing: bool = False, **attributes: Any
) -> h5py.Dataset:
    """Make a column of ``n`` numbers yet to be written, stored as `field` stores one; a growing one starts empty."""
    shape, maximum = ((0,), (None,)) if growing else ((n,), None)
    dataset = parent.create_dataset(
        name, shape, dtype, maxshape=maximum, chunks=(min(n, CHUNK),), track_times=False, **FILTERS
    )
    dataset.attrs.update(attributes if units is None else {"units": units, **attributes})
    return dataset


def attach_scale(parent: h5py.Group, axis: str) -> None:
    """Make ``axis`` the dimension scale of every other one-dimensional field of its length in ``parent``."""
    coordinate = parent[axis]
    coordinate.make_scale(axis)
    for key, item in parent.items():
        if key != axis and isinstance(item, h5py.Dataset) and item.shape == coordinate.shape:
            item.dims[0].attach_scale(coordinate)


def add_link(parent: h5py.Group, name: str, target: h5py.Dataset) -> None:
    """Give ``target`` a second name: a hard link, no copy."""
    parent[name] = target


def check_length(length: int, n: int, name: str, where: Path) -> None:
    if length != n:
        raise InputError(f"/entry/{name} has {length} values instead of {n}", str(where), AGAIN)


def read_group(parent: h5py.Group, name: str, where: Path) -> h5py.Group:
    item = parent.get(name)
    if not isinstance(item, h5py.Group):
        raise InputError(f"has no group /{name}", str(where), AGAIN)
    return item


def read_dataset(entry: h5py.Group, name: str, where: Path) -> h5py.Dataset:
    item = entry.get(name)
    if not isinstance(item, h5py.Dataset):
        raise InputError(f"has no /entry/{name}", str(where), AGAIN)
    return item


def read_array(entry: h5py.Group, name: str, dtype: Any, where: Path, selected: slice = EVERY) -> Any:
    """Return a column of numbers, or ``selected`` rows, as ``dtype``; integers are never read out of floats."""
    item = read_dataset(entry, name, where)
    if item.ndim != 1 or item.dtype.kind not in "iuf" or not np.can_cast(item.dtype, dtype, "same_kind"):
        form = f"{item.ndim}-dimensional {item.dtype}"
        raise InputError(f"/entry/{name} is {form} instead of one column of {np.dtype(dtype)}", str(where), AGAIN)
    return item[selected].astype(dtype, copy=False)


def read_number(entry: h5py.Group, name: str, where: Path) -> float:
    item = read_dataset(entry, name, where)
    if item.shape != () or item.dtype.kind not in "iuf":
        raise InputError(f"/entry/{name} is not a number", str(where), AGAIN)
    return float(item[()])


def read_text(entry: h5py.Group, name: str, where: Path) -> str:
    item = read_dataset(entry, name, where)
    if item.shape != () or h5py.check_string_dtype(item.dtype) is None:
        raise InputError(f"/entry/{name} is not text", str(where), AGAIN)
    return decode_text(item[()])


def read_text_or_whole(parent: h5py.Group, name: str, where: Path) -> str | int:
    item = read_dataset(parent, name, where)
    if item.shape == () and item.dtype.kind in "iu":
        return int(item[()])
    return read_text(parent, name, where)


def read_texts(entry: h5py.Group, name: str, where: Path) -> tuple[str, ...]:
    item = read_dataset(entry, name, where)
    if item.ndim != 1 or h5py.check_string_dtype(item.dtype) is None:
        raise InputError(f"/entry/{name} is not a column of text", str(where), AGAIN)
    return tuple(decode_text(value) for value in item[()])


def decode_text(value: Any) -> str:
    """Return an HDF5 string, in whichever type h5py returned it."""
    return value.decode() if isinstance(value, bytes) else str(value)
