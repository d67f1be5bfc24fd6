"""A MATLAB file as a table: its vectors of one length are the columns, under their own names.

Vectors are taken as they are, row or column; a matrix of as many rows gives a column each, NAME_1, NAME_2 ...  The
length that most vectors share is the table's.  Not read: files saved with -v7.3, which are HDF5 of MATLAB's own kind.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from daq.errors import InputError
from daq.imports.table import Table


def read(path: Path) -> Table:
    """Read a MATLAB file of version 4 to 7.

    Raises
    ------
    InputError
        When the file is missing, not MATLAB's, saved with -v7.3, or holds no vector of real numbers.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    where = str(path)
    if not path.is_file():
        raise InputError("no such file", where, "check the path")
    try:
        found = loadmat(path)
    except NotImplementedError as error:
        raise InputError("was saved with -v7.3", where, "save it again in MATLAB: save('FILE.mat', '-v7')") from error
    except (MatReadError, ValueError, TypeError, OSError, IndexError, KeyError) as error:
        what = f"is not a MATLAB file ({str(error).splitlines()[0] if str(error) else type(error).__name__})"
        raise InputError(what, where, "save it again in MATLAB: save('FILE.mat', '-v7')") from error
    columns: dict[str, list[str]] = {}
    for name, value in found.items():
        if name.startswith("__") or not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
            continue
        if value.ndim != 2 or value.size < 2:
            continue
        matrix = value.reshape(-1, 1) if 1 in value.shape else value
        for k, own in enumerate(matrix.T, start=1):
            label = name if matrix.shape[1] == 1 else f"{name}_{k}"
            columns[label] = list(map(repr, own.astype(np.float64).tolist()))
    if not columns:
        raise InputError("holds no vector of real numbers", where, "give a file with times and positions in it")
    length = Counter(map(len, columns.values())).most_common(1)[0][0]
    names = tuple(name for name, cells in columns.items() if len(cells) == length)
    rows: list[Sequence[str]] = list(zip(*(columns[name] for name in names), strict=True))
    return Table(path, names, rows, list(range(1, length + 1)), len(names), "\t", ".")
