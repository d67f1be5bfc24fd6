"""A MATLAB file as a table: its vectors of one length are the columns, under their own names.

Vectors are taken as they are, row or column; a matrix of as many rows gives a column each, NAME_1, NAME_2 ...  The
length that most vectors share is the table's.  Not read: files saved with -v7.3, which are HDF5 of MATLAB's own kind.

A child process reads the file: of the library that does, damaged files crash the process.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from daq.base.compute.arrays import Array
from daq.base.compute.isolation import BrokenOffError, isolated
from daq.base.errors import InputError
from daq.imports.table import Table

SAVE = "save it again in MATLAB: save('FILE.mat', '-v7')"
# CPU time of the child and, beyond that of Python itself, its memory: 4 million numbers take 0.2 s and 70 MB.
SECONDS, MEMORY = 8.0, 1 << 29
MOST_NUMBERS = 4_000_000  # an hour at 500 frames/s; each takes 90 bytes in a table


def read(path: Path) -> Table:
    """Read a MATLAB file of version 4 to 7.

    Raises
    ------
    InputError
        When the file is missing, not MATLAB's, saved with -v7.3, damaged, or holds no vector of real numbers, or more
        than `MOST_NUMBERS`.
    """
    where = str(path)
    if not path.is_file():
        raise InputError("no such file", where, "check the path")
    try:
        sent = isolated(_vectors, path, SECONDS, MEMORY)
    except BrokenOffError as error:
        raise InputError(f"is damaged: it {error}", where, SAVE) from error
    columns = dict(_received(sent))
    if not columns:
        raise InputError("holds no vector of real numbers", where, "give a file with times and positions in it")
    length = Counter(map(len, columns.values())).most_common(1)[0][0]
    names = tuple(name for name, cells in columns.items() if len(cells) == length)
    rows: list[Sequence[str]] = list(zip(*(columns[name] for name in names), strict=True))
    return Table(path, names, rows, list(range(1, length + 1)), len(names), "", ".")


def _vectors(path: Path) -> bytes:
    """Return the vectors of a file: a line of their names and shapes, then their numbers."""
    from scipy.io import loadmat

    where = str(path)
    try:
        found = loadmat(path)
    except NotImplementedError as error:
        raise InputError("was saved with -v7.3", where, SAVE) from error
    except MemoryError:
        raise
    except Exception as error:  # whatever the library stumbles over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a MATLAB file ({reason})", where, SAVE) from error
    matrices: dict[str, Array] = {}
    for name, value in found.items():
        if name.startswith("__") or not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
            continue
        if value.ndim == 2 and value.size >= 2:
            matrix = value.reshape(-1, 1) if 1 in value.shape else value
            matrices[name] = np.ascontiguousarray(matrix.T, "<f8")
    numbers = sum(matrix.size for matrix in matrices.values())
    if numbers > MOST_NUMBERS:
        what = f"holds {numbers} numbers; at most {MOST_NUMBERS} are read"
        raise InputError(what, where, "save the times and positions alone, or a part of them")
    head = json.dumps([(name, matrix.shape) for name, matrix in matrices.items()])
    return b"".join([head.encode(), b"\n", *(matrix.tobytes() for matrix in matrices.values())])


def _received(sent: bytes) -> Iterator[tuple[str, list[str]]]:
    """Yield name and cells of each column."""
    head, _, content = sent.partition(b"\n")
    at = 0
    for name, shape in json.loads(head):
        size = math.prod(shape)
        for k, own in enumerate(np.frombuffer(content, "<f8", size, at).reshape(shape), start=1):
            yield name if shape[0] == 1 else f"{name}_{k}", list(map(repr, own.tolist()))
        at += 8 * size
