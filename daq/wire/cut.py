"""A finished byte stream cut at its delimiter, and its lines of one length laid side by side.

What a protocol says of one line it can say of a thousand of the same length with a few numpy calls, column by column.
So a decoder of a whole journal takes the lines by length, judges the regular ones together, and only what is left one
at a time.  Where a read ended plays no part but for the stamp: the same bytes give the same lines however they came.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LINES_AT_ONCE = 32_768  # their columns stay in the processor's cache
FEWEST_ALIKE = 8  # fewer lines of one shape are not worth a walk along their columns
MOST_SHAPES = 100  # among lines of one length


@dataclass(frozen=True)
class Cut:
    """The m lines of a byte stream.

    Attributes
    ----------
    data : bytes
        All of it.
    start, stop : (m,) int64
        Where each line begins and ends, its delimiter not included.
    stamp_ns : (m,) int64
        Stamp of the read that brought each line's delimiter.
    rest : int
        Bytes after the last delimiter.
    read_end, read_ns : (r,) int64
        Where each read ended, and its stamp.
    """

    data: bytes
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    rest: int
    read_end: NDArray[np.int64]
    read_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)

    @property
    def length(self) -> NDArray[np.int64]:
        """Bytes of each line, (m,)."""
        return self.stop - self.start

    def line(self, k: int) -> bytes:
        """Return line k."""
        return self.data[self.start[k] : self.stop[k]]

    def by_length(self, shortest: int, longest: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint8]]]:
        """Yield numbers (k,) and bytes (k, length) of lines of one length, some thousands at a time.

        Parameters
        ----------
        shortest, longest : int
            Lengths to yield, both included.
        """
        for first in range(0, len(self), LINES_AT_ONCE):
            length = self.length[first : first + LINES_AT_ONCE]
            for size in np.flatnonzero(np.bincount(length[length <= longest], minlength=1)).tolist():
                if size >= max(shortest, 1):
                    here = first + np.flatnonzero(length == size)
                    yield here, self.rows(here, size)

    def rows(self, lines: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
        """Return lines that are all ``size`` bytes long (1 or more) as one array, (k, size)."""
        # Every place of the stream as the start of a row: taking rows copies whole lines and no single bytes.
        places = np.ndarray((len(self.data) - size + 1,), dtype=f"V{size}", buffer=self.data, strides=(1,))
        return places[self.start[lines]].view(np.uint8).reshape(len(lines), size)


def cut(reads: Iterable[tuple[int, bytes]], delimiter: bytes) -> Cut:
    """Cut the reads of one connection into lines.

    Parameters
    ----------
    reads : iterable of (int, bytes)
        Host's monotonic stamp in ns at the end of each read, and the bytes it gave.
    delimiter : bytes
        One byte; it ends a line.
    """
    taken = list(reads)
    data = b"".join(part for _, part in taken)
    read_end = np.cumsum([len(part) for _, part in taken], dtype=np.int64)
    read_ns = np.array([stamp for stamp, _ in taken], dtype=np.int64)
    stop = np.flatnonzero(np.frombuffer(data, dtype=np.uint8) == delimiter[0])
    start = np.concatenate((np.zeros(1, dtype=np.int64), stop + 1))
    rest = len(data) - int(start[-1])
    stamp_ns = read_ns[np.searchsorted(read_end, stop, side="right")]
    return Cut(data, start[:-1], stop, stamp_ns, rest, read_end, read_ns)


def alike(rows: NDArray[np.uint8], kinds: NDArray[np.uint8]) -> Iterator[NDArray[np.int64]]:
    """Yield the numbers of rows whose bytes are of the same kinds, place by place; rare shapes are left out.

    Parameters
    ----------
    rows : (k, size) uint8
        Lines of one length.
    kinds : (256,) uint8
        The kind of each byte: what a pattern cannot tell apart has one kind.
    """
    shape = kinds[rows].view(f"V{rows.shape[1]}").ravel()
    left = np.arange(len(rows))
    for _ in range(MOST_SHAPES):
        if len(left) < FEWEST_ALIKE:
            return
        same = shape[left] == shape[left[0]]
        if np.count_nonzero(same) >= FEWEST_ALIKE:
            yield left[same]
        left = left[~same]


def number(columns: NDArray[np.uint8], base: int = 10) -> NDArray[np.int64]:
    """Return the numbers whose digits' values stand in columns, (digits, k), the highest first."""
    value = np.zeros(columns.shape[1], dtype=np.int64)
    for column in columns:
        value *= base
        value += column
    return value
