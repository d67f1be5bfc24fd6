"""A MATLAB file as a table: its vectors of one length are the columns, under their own names.

Vectors are taken as they are, row or column; a matrix of as many rows gives a column each, NAME_1, NAME_2 ...  The
length that most vectors share is the table's.  Of a structure each field is such a vector or matrix, NAME.FIELD.  Not
read: tables and other objects of MATLAB, structures inside structures, and anything that lies in another file.

A child process reads the file: of the library that does, damaged files crash the process.
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np

from daq.imports import source
from daq.imports.formats.columns import Column, build_table, pack_columns, parse_isolated
from daq.imports.source import Source
from daq.imports.table import HDF5, Table
from daq.runfile.trust import refuse_external_link, refuse_stored_elsewhere
from stickslip.compute.arrays import Array

SAVE = "save it again in MATLAB: save('FILE.mat', '-v7')"
# CPU time of the child and, beyond that of Python itself, its memory: 4 million numbers take 0.2 s and 70 MB.
SECONDS, MEMORY = 8.0, 1 << 29
MATLAB_HEADER = 512  # bytes before the HDF5 of a file of version 7.3


def read(path: Path) -> Table:
    message = parse_isolated(_parse, path, SECONDS, MEMORY, "MATLAB file", SAVE)
    return build_table(path, message, "MATLAB", "vector of real numbers")


def _parse(path: Path) -> bytes:
    return pack_columns(_read_columns, path, "MATLAB file", SAVE)


def _read_columns(file: Source) -> tuple[str, list[Column]]:
    as_hdf5 = file.data[: MATLAB_HEADER + 8].find(HDF5) in (0, MATLAB_HEADER)
    columns: list[Column] = []
    for name, matrix in _read_hdf5(file) if as_hdf5 else _read_version_5(file):
        vectors = [matrix.ravel()] if 1 in matrix.shape else list(matrix.T)
        names = [name] if len(vectors) == 1 else [f"{name}_{number}" for number in range(1, len(vectors) + 1)]
        columns += [Column(each, values) for each, values in zip(names, vectors, strict=True)]
    return "", columns


def _read_version_5(file: Source) -> Iterator[tuple[str, Array]]:
    """Yield the matrices of real numbers in a file of version 4 to 7."""
    from scipy.io import loadmat

    for name, value in loadmat(cast(Any, io.BytesIO(file.data))).items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        parts = {name: value}
        if value.dtype.names and value.size == 1:
            parts = {f"{name}.{field}": value[field].flat[0] for field in value.dtype.names}
        for label, part in parts.items():
            if isinstance(part, np.ndarray) and part.dtype.kind in "iuf" and part.ndim == 2 and part.size >= 2:
                _check_matrix(label, part.shape, file.path)
                yield label, part


def _read_hdf5(file: Source) -> Iterator[tuple[str, Array]]:
    """Yield the matrices of a file of version 7.3, which is HDF5, its matrices transposed."""
    import h5py

    with h5py.File(io.BytesIO(file.data)) as content:
        for name, item in _yield_objects(content, file.path):
            group = isinstance(item, h5py.Group) and not name.startswith("#")
            for label, part in _yield_fields(name, item, file.path) if group else [(name, item)]:
                if not isinstance(part, h5py.Dataset) or part.dtype.kind not in "iuf":
                    continue
                text = part.attrs.get("MATLAB_class") == b"char" or "MATLAB_empty" in part.attrs
                if not text and part.ndim == 2 and part.size >= 2:
                    refuse_stored_elsewhere(part.id, label, file.path)
                    _check_matrix(label, part.shape[::-1], file.path)
                    yield label, part[()].T


def _yield_fields(name: str, group: Any, path: Path) -> Iterator[tuple[str, Any]]:
    return ((f"{name}.{field}", part) for field, part in _yield_objects(group, path))


def _yield_objects(group: Any, path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the objects of a group, none of which may lie in another file."""
    for name in group:
        refuse_external_link(group, name, path)
        yield name, group[name]


def _check_matrix(name: str, shape: tuple[int, ...], path: Path) -> None:
    """Reject a matrix that is too large before it is read."""
    columns = 1 if 1 in shape else shape[1]
    source.check_size(max(shape) if columns == 1 else shape[0], columns, f"{path}, {name[:40]}")
