"""A table of numbers in a text file, as cameras, trackers and spreadsheets write it.

Found, not asked for: encoding (UTF-8, UTF-16 with a mark, else Windows-1252), line ends, comment lines (``#``, ``%``,
``//``), and the layout (`daq.imports.layout`).  A line with any number in it is data, unless it is part of a preamble:
from there on every line must be, or is left out on request and counted.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from daq.imports import layout
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError, in_python

DELIMITER_NAMES = {"\t": "tab", ";": "semicolon", ",": "comma", " ": "spaces", "|": "bar"}
COMMENTS = ("#", "%", "//")
HDF5 = b"\x89HDF\r\n\x1a\n"  # how such a file begins, a run file among them
# A column, what makes a number of its cells (None where it cannot), and what a cell should be.
ColumnReader = tuple[int, Callable[[str], float | None], str]
TOGETHER = 4096  # rows whose cells are converted together; half costs the same CPU time, double 50 % more
MOST_COMMENTS = 100  # lines above a table in which its names are looked for
LISTED = 5  # lines named in a message about many
# Characters.  A table of 4000 columns has lines of half of it; at twice, a file that is no table takes a second to be
# found out, since every delimiter and decimal sign is tried on each line.
LONGEST_LINE = 100_000


@dataclass(frozen=True)
class Skipped:
    """A line that cannot be read: its number in the file, from 1, and what is wrong with it."""

    line: int
    what: str


@dataclass(frozen=True)
class Table:
    """The cells of a table, not yet numbers.

    Attributes
    ----------
    path : Path
        The file.
    names : tuple of str
        The header; empty without one.
    rows : list of sequence of str
        The cells of each line of data.
    lines : list of int
        Line number of each row in the file, from 1.
    width : int
        Number of columns, that of most lines.
    delimiter, decimal : str
        As found.
    header_line : int
        Line number of the header; 0 without one.
    kind : str
        What the file is, "LabVIEW", "MATLAB", "TDMS" or "workbook"; "" for a text file of any program.
    recorded : str
        When it was recorded, as the file says it; "" where it does not.
    comments : tuple of str
        The comment lines above the data, the nearest first.
    """

    path: Path
    names: tuple[str, ...]
    rows: list[Sequence[str]]
    lines: list[int]
    width: int
    delimiter: str
    decimal: str
    header_line: int = 0
    kind: str = ""
    recorded: str = ""
    comments: tuple[str, ...] = ()

    @property
    def delimiter_name(self) -> str:
        """The delimiter in words; "none" for a single column, the kind of a file that is no text."""
        return self.kind or (DELIMITER_NAMES[self.delimiter] if self.width > 1 else "none")

    def label(self, column: int) -> str:
        """Return the name of a column in messages."""
        return f"column {short(self.names[column])}" if self.names else f"column {column + 1}"

    @property
    def listed(self) -> str:
        """The names of the columns, for messages; empty without a header."""
        return ", ".join(short(name)[1:-1] for name in self.names)

    def place(self, line: int, column: int | None = None) -> str:
        """Return where a line, or a cell of it, stands in the file, for messages."""
        where = f"{self.path}, line {line}" if line else str(self.path)
        return where if column is None else f"{where}, column {column + 1}"

    def number(self, cell: str) -> float | None:
        """Return a cell as a finite number, None when it is not one."""
        value = layout.number(cell, self.decimal)
        return None if value is None or value - value != 0 else value

    def columns(
        self, readers: Sequence[ColumnReader], *, skip: bool, progress: Stages = silent
    ) -> "tuple[Array, Table, tuple[Skipped, ...]]":
        """Return columns as numbers.

        Parameters
        ----------
        readers : sequence of ColumnReader
        skip : bool
            Leave out the lines that cannot be read, instead of refusing them.
        progress : callable
            Called with the stage, the lines done, and all lines.

        Returns
        -------
        array of shape (columns, n), Table, tuple of Skipped
            The numbers; the table of the lines that they were read from; the lines left out.

        Raises
        ------
        InputError
            For a line of another length or a cell that cannot be read, naming line and column, and how many there are.
        """
        values: list[Array] = []
        kept: list[int] = []
        bad: list[Skipped] = []
        first: int | None = None
        for begin in range(0, len(self.rows), TOGETHER):
            progress("reading numbers", begin, len(self.rows))
            rows = self.rows[begin : begin + TOGETHER]
            plain = self._plain(rows, readers)
            if plain is not None:
                values.append(plain)
                kept += range(begin, begin + len(rows))
                continue
            found: list[list[float]] = []
            for index, row in enumerate(rows, start=begin):
                cells: list[float] = []
                for column, reader, kind in readers if len(row) == self.width else ():
                    value = reader(row[column])
                    if value is None:
                        cell = row[column].strip()
                        what = f"holds {short(cell)}, not {kind}" if cell else "is empty"
                        bad.append(Skipped(self.lines[index], f"{self.label(column)} {what}"))
                        first = column if len(bad) == 1 else first
                        break
                    cells.append(value)
                else:
                    if len(row) == self.width:
                        found.append(cells)
                        kept.append(index)
                    else:
                        columns = "1 column" if len(row) == 1 else f"{len(row)} columns"
                        what = f"has {columns} where the others have {self.width}"
                        bad.append(Skipped(self.lines[index], what))
            values.append(np.array(found, np.float64).reshape(-1, len(readers)).T)
        if bad and not skip:
            do, python = _advice(self, bad, kept)
            raise InputError(_bad_lines(bad), self.place(bad[0].line, first), do, python=python)
        good = self
        if bad:
            good = replace(self, rows=[self.rows[index] for index in kept], lines=[self.lines[index] for index in kept])
        return np.concatenate([np.empty((len(readers), 0)), *values], axis=1), good, tuple(bad)

    def _plain(self, rows: list[Sequence[str]], readers: Sequence[ColumnReader]) -> Array | None:
        """Return the columns of some rows as numbers, (columns, rows); None unless each cell is a plain number."""
        if {*map(len, rows)} != {self.width} or any(reader != self.number for _, reader, _ in readers):
            return None
        columns = [layout.plain_numbers([row[column] for row in rows], self.decimal) for column, _, _ in readers]
        if any(numbers is None for numbers in columns):
            return None
        values = np.array(columns, np.float64)
        return values if np.isfinite(values).all() else None


def listed(bad: Sequence[Skipped]) -> str:
    """Return the numbers of the first few lines: ``3, 4, 9 and 12 more``."""
    more = f" and {len(bad) - LISTED} more" if len(bad) > LISTED else ""
    return ", ".join(str(one.line) for one in bad[:LISTED]) + more


def _bad_lines(bad: Sequence[Skipped]) -> str:
    return bad[0].what + (f"; {len(bad)} lines cannot be read: {listed(bad)}" if len(bad) > 1 else "")


def _advice(cells: Table, bad: Sequence[Skipped], kept: Sequence[int]) -> tuple[str, str]:
    """Return what to do, for a terminal and in Python."""
    what = "those lines" if len(bad) > 1 else "that line"
    do = f"correct or delete {what}, or leave such lines out with {{}}: times need not be even"
    if kept and len(bad) == kept[0] and not cells.names:
        do += f"; if the table begins below, give --preamble {bad[-1].line}"
    return do.format("--skip-bad"), in_python(do.format("skip_bad=True"))


def short(cell: str) -> str:
    """Return a cell in quotes, its end left out where it is long."""
    return repr(cell if len(cell) <= 40 else cell[:37] + "...")


def read(path: Path, preamble: int = 0, progress: Stages = silent) -> Table:
    """Read a table of numbers.

    Parameters
    ----------
    path : Path
        The file.
    preamble : int
        How many lines at its top to pass over.
    progress : callable
        Called with the stage, the lines done, and all lines.

    Raises
    ------
    InputError
        When the file is missing, not text or empty, has a line longer than `LONGEST_LINE`, or a header that names
        another number of columns than the lines have.
    """
    return of_lines(path, text_of(path).split("\n"), preamble, progress)


def of_lines(path: Path, lines_of_file: Sequence[str], preamble: int = 0, progress: Stages = silent) -> Table:
    """Return the table in the lines of a file; arguments and errors as of `read`."""
    lines, comments, named = _kept(path, lines_of_file, preamble, progress)
    texts = [text for _, text in lines]
    delimiter, decimal = layout.find_format(texts, named)
    rows: list[Sequence[str]] = []
    data = []
    for begin in range(0, len(texts), TOGETHER):
        progress("splitting lines", begin, len(texts))
        rows += [layout.split(text, delimiter) for text in texts[begin : begin + TOGETHER]]
        some = rows[begin : begin + TOGETHER]
        if layout.plain_numbers([row[0] if row else "" for row in some], decimal) is None:
            some = [row for row in some if any(layout.number(cell, decimal) is not None for cell in row)]
        data += some
    if data and all(len(row) > 1 and not row[-1].strip() for row in data):
        # Every line closes with a delimiter.
        rows = [row[:-1] if len(row) > 1 and not row[-1].strip() else row for row in rows]
        data = [row[:-1] for row in data]
    if not data:
        raise InputError("holds no numbers", str(path), "give a CSV with a column of positions")
    width = Counter(map(len, data)).most_common(1)[0][0]
    start = layout.find_start(texts, delimiter, decimal, width)
    head = [text for _, text in lines[:start]]
    names = layout.name_columns(head, delimiter, width)
    if names is None:
        count = len(layout.header(head[-1], delimiter, width))
        raise InputError(
            f"the header names {count} columns, the lines below have {width}",
            f"{path}, line {lines[start - 1][0]}",
            "separate columns by semicolons if numbers have decimal commas",
        )
    header_line = lines[start - 1][0] if names else 0
    numbers = [line for line, _ in lines[start:]]
    above = tuple(text for line, text in reversed(comments) if line < numbers[0])
    return Table(path, names, rows[start:], numbers, width, delimiter, decimal, header_line, comments=above)


def text_of(path: Path) -> str:
    """Return the text of a file, its lines ended by line feeds.

    Raises
    ------
    InputError
        The file is missing, or no text.
    """
    where = str(path)
    if not path.exists():
        raise InputError("no such file", where, "check the path")
    if path.is_dir():
        raise InputError("is a folder", where, "give the CSV file in it")
    data = path.read_bytes()
    if data.startswith(HDF5):
        do = "a run file needs no import: process smooth reads it; of another file export a CSV"
        raise InputError("is an HDF5 file, not a table", where, do)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", "replace")
    else:
        if b"\0" in data[:4096]:
            raise InputError("is not a text file", where, "export it as CSV")
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _kept(
    path: Path, lines: Sequence[str], preamble: int, progress: Stages
) -> tuple[list[tuple[int, str]], list[tuple[int, str]], str | None]:
    """Return number and text of each line that may hold data, of comments, and the delimiter that the file names."""
    where = str(path)
    numbered = list(enumerate(lines, start=1))[preamble:]
    kept: list[tuple[int, str]] = []
    comments: list[tuple[int, str]] = []
    for begin in range(0, len(numbered), TOGETHER):
        progress("reading lines", begin, len(numbered))
        some = [(line, content) for line, content in numbered[begin : begin + TOGETHER] if content.strip(" \t;,|")]
        comment = [content.lstrip().startswith(COMMENTS) for _, content in some]
        kept += [each for each, is_comment in zip(some, comment, strict=True) if not is_comment]
        if len(comments) < MOST_COMMENTS:
            comments += [each for each, is_comment in zip(some, comment, strict=True) if is_comment]
    named = None
    if kept and kept[0][1].lower().startswith("sep=") and len(kept[0][1]) == 5:
        named = kept.pop(0)[1][4]  # written by spreadsheets
    if not kept:
        what = "holds no data" if any(lines) else "is empty"
        raise InputError(what, where, "give a CSV with a column of positions")
    for line, content in kept:
        if len(content) > LONGEST_LINE:
            what = f"the line holds {len(content)} characters; a line of a table has at most {LONGEST_LINE}"
            do = "delete that line; if the table begins below it, give --preamble"
            raise InputError(what, f"{where}, line {line}", f"{do} {line}")
    return kept, comments[:MOST_COMMENTS], named
