"""Arrays put aside while a long record is worked on: in memory while they are few, then in a file without a name.

The file is in the folder of the output, and the system removes it with the process: nothing is left behind.
"""

import tempfile
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import IO, Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from stickslip.output import disk

# Bytes kept in memory: a minute at 5 kHz.  Half writes a minute's record twice, double adds as much to the peak.
MEMORY_BYTES = 24 << 20
BLOCK = 1 << 16  # rows read back at once

T = TypeVar("T")


@dataclass(frozen=True)
class Aside:
    """An array that was put aside: itself, or its place in the file; stored in the narrowest type that holds it."""

    dtype: np.dtype[Any]
    stored: np.dtype[Any]
    shape: tuple[int, ...]
    values: NDArray[Any] | None
    at: int


class Spill:
    """Puts arrays aside; what does not fit into memory goes into a file in the folder of ``output``."""

    def __init__(self, output: Path | None = None) -> None:
        self._output = output
        self._left = MEMORY_BYTES
        self._file: IO[bytes] | None = None
        self._end = 0

    def __del__(self) -> None:
        if self._file is not None:
            self._file.close()

    def put(self, values: NDArray[Any]) -> Aside:
        stored = np.ascontiguousarray(values, _find_narrowest(values))
        if stored.nbytes <= self._left:
            self._left -= stored.nbytes
            # A view would keep the whole array that it is a part of.
            kept = stored.copy() if stored.base is not None or stored is values else stored
            return Aside(values.dtype, stored.dtype, values.shape, kept, 0)
        with disk.writing(self._output or Path(tempfile.gettempdir())):
            if self._file is None:
                folder = None if self._output is None else self._output.absolute().parent
                self._file = tempfile.TemporaryFile(dir=folder, prefix=".stickslip.")
            self._file.seek(self._end)
            self._file.write(stored.reshape(-1).view(np.uint8).data)
        offset, self._end = self._end, self._end + stored.nbytes
        return Aside(values.dtype, stored.dtype, values.shape, None, offset)

    def get(self, aside: Aside, first: int = 0, last: int | None = None) -> NDArray[Any]:
        """Return some rows of an array that was put aside, by default all."""
        last = aside.shape[0] if last is None else last
        if aside.values is not None:
            return aside.values[first:last].astype(aside.dtype, copy=False)
        if self._file is None:
            raise ValueError("the array was put aside elsewhere")
        row = aside.stored.itemsize * int(np.prod(aside.shape[1:], dtype=np.int64))
        self._file.seek(aside.at + first * row)
        values = np.empty((last - first, *aside.shape[1:]), aside.stored)
        bytes_read = self._file.readinto(values.reshape(-1).view(np.uint8).data)  # type: ignore[attr-defined]
        if bytes_read != values.nbytes:
            raise OSError(f"{values.nbytes} bytes were put aside, {bytes_read} came back")
        return values.astype(aside.dtype, copy=False)


def _find_narrowest(values: NDArray[Any]) -> np.dtype[Any]:
    """Return the type to store an array in: of int64, the narrowest one that holds its values."""
    if values.dtype != np.int64 or values.size == 0:
        return values.dtype
    least, most = int(values.min()), int(values.max())
    for kind in (np.uint8, np.uint16, np.uint32, np.int32):
        if np.iinfo(kind).min <= least and most <= np.iinfo(kind).max:
            return np.dtype(kind)
    return values.dtype


class Column:
    """A column of numbers, appended piece by piece and read back as slices; to numpy, an array."""

    ndim = 1

    def __init__(self, spill: Spill) -> None:
        self._spill = spill
        self._pieces: list[Aside] = []
        self._ends: list[int] = []

    def append(self, values: NDArray[Any]) -> None:
        """Append numbers, all of one type; an empty array changes nothing."""
        if len(values) or not self._pieces:
            self._pieces.append(self._spill.put(values))
            self._ends.append(len(self) + len(values))

    @property
    def dtype(self) -> np.dtype[Any]:
        return self._pieces[0].dtype

    @property
    def size(self) -> int:
        return len(self)

    @property
    def shape(self) -> tuple[int]:
        return (len(self),)

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, where: slice) -> NDArray[Any]:
        first, last, _ = where.indices(len(self))
        parts = []
        k = bisect_right(self._ends, first)
        while first < last:
            begin = self._ends[k] - self._pieces[k].shape[0]
            until = min(last, self._ends[k])
            parts.append(self._spill.get(self._pieces[k], first - begin, until - begin))
            first, k = until, k + 1
        return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0, self.dtype), *parts])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return self[:].astype(dtype or self.dtype, copy=False)

    def whole(self) -> NDArray[Any]:
        """Return an array where the numbers are in memory; else this, which reads them on use."""
        if all(piece.values is not None for piece in self._pieces):
            return self[:]
        return cast(NDArray[Any], self)


class Shelf(Generic[T]):
    """Values of a dataclass, in order; their arrays are put aside, those of ``labels`` are empty."""

    def __init__(self, spill: Spill) -> None:
        self.labels: list[T] = []
        self._spill = spill
        self._arrays: list[dict[str, Aside]] = []

    def append(self, value: T) -> None:
        fields = dict(vars(value))
        arrays = {name: item for name, item in fields.items() if isinstance(item, np.ndarray)}
        self._arrays.append({name: self._spill.put(item) for name, item in arrays.items()})
        empty = {name: item[:0].copy() for name, item in arrays.items()}
        self.labels.append(cast(T, replace(cast(Any, value), **empty)))

    def __len__(self) -> int:
        return len(self.labels)

    def __getitem__(self, number: int) -> T:
        arrays = {name: self._spill.get(aside) for name, aside in self._arrays[number].items()}
        return cast(T, replace(cast(Any, self.labels[number]), **arrays))

    def __iter__(self) -> Iterator[T]:
        return (self[number] for number in range(len(self)))


def read_columns(data: T) -> T:
    """Return a dataclass, and those in it, with arrays in place of its columns."""
    read = {name: value[:] for name, value in vars(data).items() if isinstance(value, Column)}
    parts = {name: value for name, value in vars(data).items() if is_dataclass(value)}
    read |= {name: read_columns(cast(Any, part)) for name, part in parts.items()}
    return cast(T, replace(cast(Any, data), **read))


def blocks(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Yield an array or a column in blocks of `BLOCK` rows."""
    for first in range(0, len(values), BLOCK):
        yield values[first : first + BLOCK]
