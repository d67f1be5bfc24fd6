"""The lines of a long text and their cells, cut out of it when they are used: 12 bytes a line beside the text."""

from collections.abc import Iterator, Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from daq.imports import layout
from stickslip.compute.arrays import Mask

TOGETHER = 4096  # lines that are cut out together
PIECE = 1 << 22  # bytes in which line feeds are looked for at once


class Lines(Sequence[str]):
    """Some lines of a text in UTF-8.

    begin, end, number: (n,) bytes before each line and before its end, and its number in the file.
    """

    def __init__(
        self, data: bytes, begin: NDArray[np.int32], end: NDArray[np.int32], number: NDArray[np.int32]
    ) -> None:
        self._data, self.begin, self.end, self.number = data, begin, end, number

    def __len__(self) -> int:
        return len(self.begin)

    @overload
    def __getitem__(self, which: int) -> str: ...
    @overload
    def __getitem__(self, which: slice) -> list[str]: ...
    def __getitem__(self, which: int | slice) -> str | list[str]:
        if isinstance(which, int):
            return self._data[self.begin[which] : self.end[which]].decode()
        begin, end = self.begin[which], self.end[which]
        if len(begin) and np.array_equal(begin[1:], end[:-1] + 1):
            return self._data[begin[0] : end[-1]].decode().split("\n")
        return [self._data[first:last].decode() for first, last in zip(begin.tolist(), end.tolist(), strict=True)]

    def pieces(self) -> Iterator[tuple[int, list[str]]]:
        """Yield some lines at a time, each time with how many came before."""
        return ((first, self[first : first + TOGETHER]) for first in range(0, len(self), TOGETHER))

    def take(self, which: Mask | slice) -> "Lines":
        if not isinstance(which, slice):
            first, count = int(which.argmax()), np.count_nonzero(which)
            which = slice(first, first + count) if which[first : first + count].all() else which  # without copies
        return Lines(self._data, self.begin[which], self.end[which], self.number[which])

    def cut(self, begin: NDArray[np.int32], end: NDArray[np.int32]) -> "Lines":
        """Return the lines with other bounds."""
        return Lines(self._data, begin, end, self.number)


def number_lines(text: str, numbers: Sequence[int] | None = None) -> Lines:
    """Return the lines of a text, numbered from 1 or by ``numbers``."""
    data = text.encode(errors="replace")
    octets, ends = np.frombuffer(data, np.uint8), [np.array([len(data)], np.int32)]
    for first in range(0, len(data), PIECE):
        ends.insert(-1, (first + np.flatnonzero(octets[first : first + PIECE] == ord("\n"))).astype(np.int32))
    end = np.concatenate(ends)
    begin = np.concatenate((np.zeros(1, np.int32), end[:-1] + 1), dtype=np.int32)
    every = np.arange(1, len(end) + 1, dtype=np.int32)
    return Lines(data, begin, end, every if numbers is None else np.array(numbers, np.int32))


class Rows(Sequence[Sequence[str]]):
    """The cells of lines; a slice is of the same kind."""

    def __init__(self, lines: Lines, delimiter: str) -> None:
        self._lines, self._delimiter = lines, delimiter

    def __len__(self) -> int:
        return len(self._lines)

    @overload
    def __getitem__(self, which: int) -> list[str]: ...
    @overload
    def __getitem__(self, which: slice) -> "Rows": ...
    def __getitem__(self, which: int | slice) -> "list[str] | Rows":
        if isinstance(which, slice):
            return self.take(which)
        return layout.split_cells(self._lines[which], self._delimiter)

    def __iter__(self) -> Iterator[list[str]]:
        return (layout.split_cells(text, self._delimiter) for _, piece in self._lines.pieces() for text in piece)

    def take(self, which: Mask | slice) -> "Rows":
        return Rows(self._lines.take(which), self._delimiter)
