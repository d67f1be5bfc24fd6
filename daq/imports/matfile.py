"""A MATLAB file as a table: its vectors of one length are the columns, under their own names.

Vectors are taken as they are, row or column; a matrix of as many rows gives a column each, NAME_1, NAME_2 ...  The
length that most vectors share is the table's.  Of a structure each field is such a vector or matrix, NAME.FIELD.  Not
read: tables and other objects of MATLAB, and structures inside structures.

A child process reads the file: of the library that does, damaged files crash the process.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from daq.imports.table import HDF5, Table
from daq.runfile.isolation import BrokenOffError, isolated
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

SAVE = "save it again in MATLAB: save('FILE.mat', '-v7')"
# CPU time of the child and, beyond that of Python itself, its memory: 4 million numbers take 0.2 s and 70 MB.
SECONDS, MEMORY = 8.0, 1 << 29
MATLAB_HEADER = 512  # bytes before the HDF5 of a file of version 7.3
MOST_NUMBERS = 4_000_000  # an hour at 500 frames/s; each takes 90 bytes in a table


def read(path: Path) -> Table:
    """Read a MATLAB file of version 4 to 7.3.

    Raises
    ------
    InputError
        When the file is missing, not MATLAB's, damaged, or holds no vector of real numbers, or more than
        `MOST_NUMBERS`.
    """
    where = str(path)
    if not path.is_file():
        raise InputError("no such file", where, "check the path")
    try:
        sent = isolated(_vectors, path, SECONDS, MEMORY)
    except BrokenOffError as error:
        raise InputError(f"is damaged: it {error}", where, SAVE) from error
    columns = dict(received(sent))
    if not columns:
        raise InputError("holds no vector of real numbers", where, "give a file with times and positions in it")
    length = Counter(map(len, columns.values())).most_common(1)[0][0]
    names = tuple(name for name, cells in columns.items() if len(cells) == length)
    rows: list[Sequence[str]] = list(zip(*(columns[name] for name in names), strict=True))
    return Table(path, names, rows, list(range(1, length + 1)), len(names), "", ".", kind="MATLAB")


def _vectors(path: Path) -> bytes:
    """Return the vectors of a file: a line of their names and shapes, then their numbers."""
    with path.open("rb") as file:
        as_hdf5 = file.read(MATLAB_HEADER + 8).find(HDF5) in (0, MATLAB_HEADER)
    variables = dict(_of_hdf5(path) if as_hdf5 else _of_version_5(path))
    matrices: dict[str, Array] = {}
    for name, value in variables.items():
        matrix = value.reshape(-1, 1) if 1 in value.shape else value
        matrices[name] = np.ascontiguousarray(matrix.T, "<f8")
    numbers = sum(matrix.size for matrix in matrices.values())
    if numbers > MOST_NUMBERS:
        what = f"holds {numbers} numbers; at most {MOST_NUMBERS} are read"
        raise InputError(what, str(path), "save the times and positions alone, or a part of them")
    return packed(matrices)


def _of_version_5(path: Path) -> Iterator[tuple[str, Array]]:
    """Yield the matrices of real numbers in a file of version 4 to 7; of a structure, its fields as NAME.FIELD."""
    from scipy.io import loadmat

    try:
        variables = loadmat(path)
    except MemoryError:
        raise
    except Exception as error:  # whatever the library stumbles over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a MATLAB file ({reason})", str(path), SAVE) from error
    for name, value in variables.items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        parts = {name: value}
        if value.dtype.names and value.size == 1:
            parts = {f"{name}.{field}": value[field].flat[0] for field in value.dtype.names}
        for own, part in parts.items():
            if isinstance(part, np.ndarray) and part.dtype.kind in "iuf" and part.ndim == 2 and part.size >= 2:
                yield own, part


def _of_hdf5(path: Path) -> Iterator[tuple[str, Array]]:
    """Yield the same of a file of version 7.3, which is HDF5, its matrices transposed."""
    import h5py

    try:
        with h5py.File(path) as file:
            for name, item in file.items():
                inside = item.items() if isinstance(item, h5py.Group) and not name.startswith("#") else ()
                parts = {f"{name}.{field}": part for field, part in inside} or {name: item}
                for own, part in parts.items():
                    if not isinstance(part, h5py.Dataset) or part.dtype.kind not in "iuf":
                        continue
                    text = part.attrs.get("MATLAB_class") == b"char" or "MATLAB_empty" in part.attrs
                    if not text and part.ndim == 2 and part.size >= 2:
                        yield own, part[()].T
    except MemoryError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a MATLAB file ({reason})", str(path), SAVE) from error


def packed(matrices: Mapping[str, Array]) -> bytes:
    """Return matrices, each of as many rows as it has columns of the table: a line of names and shapes, the numbers."""
    head = json.dumps([(name, matrix.shape) for name, matrix in matrices.items()])
    return b"".join([head.encode(), b"\n", *(matrix.tobytes() for matrix in matrices.values())])


def received(sent: bytes) -> Iterator[tuple[str, list[str]]]:
    """Yield name and cells of each column of what was `packed`."""
    head, _, content = sent.partition(b"\n")
    at = 0
    for name, shape in json.loads(head):
        size = math.prod(shape)
        for k, own in enumerate(np.frombuffer(content, "<f8", size, at).reshape(shape), start=1):
            yield name if shape[0] == 1 else f"{name}_{k}", list(map(repr, own.tolist()))
        at += 8 * size
