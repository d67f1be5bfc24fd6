"""A table of numbers in a text file, as cameras, trackers and spreadsheets write it.

Detected: encoding (UTF-8, UTF-16 with a mark, else Windows-1252), line ends, comment lines (``#``, ``%``, ``//``), the
time stamps that a serial monitor puts before each line, and the layout (`daq.imports.layout`).  A line with any number
in it is data, unless it is part of a preamble: from there on every line must be, or is left out on request and counted.
A line that repeats the header begins another measurement.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from daq.imports import layout, source
from daq.imports.source import Parsed, Source
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError, in_python

DELIMITER_NAMES = {"\t": "tab", ";": "semicolon", ",": "comma", " ": "spaces", "|": "bar"}
COMMENTS = ("#", "%", "//", "=~=~")  # the last begins the log of a terminal program
HDF5 = b"\x89HDF\r\n\x1a\n"  # how such a file begins, a run file among them
# A column, what makes a number of its cells (None where it cannot), and what a cell should be.
ColumnReader = tuple[int, Callable[[str], float | None], str]
TOGETHER = 4096  # rows whose cells are converted together; half costs the same CPU time, double 50 % more
MOST_COMMENTS = 100  # lines above a table in which its names are looked for
LISTED = 5  # lines named in a message about many
# Characters.  A table of 4000 columns has lines of half of it; at twice, a file that is no table takes a second to be
# found out, since every delimiter and decimal sign is tried on each line.
LONGEST_LINE = 100_000
_STAMP = re.compile(r"\d{2}:\d{2}:\d{2}\.\d{3} -> ")  # of the serial monitor of Arduino, before each line


@dataclass(frozen=True)
class Skipped:
    """A line that cannot be read: its number in the file, from 1, and what is wrong with it."""

    line: int
    what: str


@dataclass(frozen=True)
class Table:
    """The cells of a table, not yet numbers."""

    path: Path
    names: tuple[str, ...]  # the header; empty without one
    rows: list[Sequence[str]]  # the cells of each line of data
    lines: list[int]  # line number of each row in the file, from 1
    width: int  # columns, as most lines have
    delimiter: str
    decimal: str
    header_line: int = 0  # 0 without a header
    kind: str = ""  # "LabVIEW", "MATLAB", "TDMS" or "workbook"; "" for a text file of any program
    recorded: str = ""  # when it was recorded, as the file says it
    comments: tuple[str, ...] = ()  # the comment lines above the data, the nearest first
    sha256: str = ""  # of the file
    modified_s: float = 0.0  # time of the file's last change, s since 1970
    clocks: tuple[int | None, ...] = ()  # of each column the one with its times, where the file says so
    starts: tuple[int, ...] = (0,)  # first row of each measurement
    left_out: str = ""  # names of columns of another length
    beside: tuple[int, ...] = ()  # lines with nothing but cells beside the table, which are not rows of it

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
        return source.shorten(self.names) + (f" (of another length: {self.left_out})" if self.left_out else "")

    def place(self, line: int, column: int | None = None) -> str:
        """Return where a line, or a cell of it, stands in the file, for messages."""
        where = f"{self.path}, line {line}" if line else str(self.path)
        return where if column is None else f"{where}, column {column + 1}"

    def number(self, cell: str) -> float | None:
        """Return a cell as a finite number, None when it is not one."""
        value = layout.number(cell, self.decimal)
        return None if value is None or value - value != 0 else value

    @classmethod
    def of_columns(cls, path: Path, parsed: Parsed, kind: str) -> "Table":
        """Return the table of the columns that have the usual length, with their waveforms' times before them."""
        length = source.usual_length(parsed.columns)
        columns = [column for column in parsed.columns if column.values.size == length]
        clocks = list(dict.fromkeys(column.clock for column in columns if column.clock is not None))
        names = ["Time (s)"] if len(clocks) == 1 else []
        for clock in clocks if len(clocks) > 1 else ():
            first = next(column.name for column in columns if column.clock == clock)
            names.append(f"Time of {first.split(' (')[0]} (s)")
        cells = [list(map(repr, (begin + step * np.arange(length)).tolist())) for begin, step in clocks]
        cells += [list(map(repr, column.values.tolist())) for column in columns]
        names += [column.name for column in columns]
        return cls(
            path,
            tuple(names),
            list(zip(*cells, strict=True)),
            list(range(1, length + 1)),
            len(names),
            "",
            ".",
            kind=kind,
            recorded=parsed.recorded,
            sha256=parsed.sha256,
            modified_s=parsed.modified_s,
            clocks=(
                *[None] * len(clocks),
                *(None if column.clock is None else clocks.index(column.clock) for column in columns),
            ),
            left_out=source.shorten(column.name for column in parsed.columns if column.values.size != length),
        )

    def segment(self, number: int | None) -> "Table":
        """Return one of the measurements, from 1, or all as one record (0); None: the only one.

        Raises InputError: there is no such measurement, or several and none was chosen.
        """
        count = len(self.starts)
        if number is None and count > 1:
            begins = source.shorten(f"line {self.lines[start]}" for start in self.starts)
            what = f"holds {count} measurements, which begin at {begins}"
            do = f"choose one with --segment 1 to --segment {count}; --segment 0 reads them as one record"
            raise InputError(what, str(self.path), do)
        if number is None or number == 0:
            return self
        if not 1 <= number <= count:
            what = f"--segment {number}: the file holds {count} measurement{'s' if count > 1 else ''}"
            raise InputError(what, str(self.path), f"choose 1 to {count}" if count > 1 else "leave it out")
        chosen = slice(*[*self.starts, len(self.rows)][number - 1 : number + 1])
        return replace(self, rows=self.rows[chosen], lines=self.lines[chosen], starts=(0,))

    def columns(
        self, readers: Sequence[ColumnReader], *, skip: bool, progress: Stages = silent
    ) -> "tuple[Array, Table, tuple[Skipped, ...]]":
        """Return columns as numbers.

        skip: Leave out the lines that cannot be read, instead of refusing them.
        progress: Called with the stage, the lines done, and all lines.
        Returns: The numbers; the table of the lines that they were read from; the lines left out.
        Raises InputError: for a line of another length or a cell that cannot be read, naming line and column, and how
            many there are.
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


def listed(lines: Sequence[int]) -> str:
    """Return the numbers of the first few lines: ``3, 4, 9 and 12 more``."""
    more = f" and {len(lines) - LISTED} more" if len(lines) > LISTED else ""
    return ", ".join(map(str, lines[:LISTED])) + more


def _bad_lines(bad: Sequence[Skipped]) -> str:
    return bad[0].what + (
        f"; {len(bad)} lines cannot be read: {listed([each.line for each in bad])}" if len(bad) > 1 else ""
    )


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
    """Read a table of numbers; ``preamble`` is how many lines at its top to pass over."""
    file = source.read(path)
    cells = of_lines(path, enumerate(text_of(file).split("\n"), start=1), preamble, progress)
    return replace(cells, sha256=file.sha256, modified_s=file.modified_s)


def of_lines(
    path: Path,
    numbered: Iterable[tuple[int, str]],
    preamble: int = 0,
    progress: Stages = silent,
    named: str | None = None,
) -> Table:
    """Return the table in numbered lines; ``named`` is the delimiter, where it is known.

    Raises InputError: there are no numbers, a line is longer than `LONGEST_LINE`, or the header names another number of
        columns than the lines have.
    """
    lines, comments, own = _kept(path, numbered, preamble, progress)
    named = own if named is None else named
    texts = [text for _, text in lines]
    if all(_STAMP.match(text) for text in texts):
        texts = [_STAMP.sub("", text, count=1) for text in texts]
    delimiter, decimal = layout.find_format(texts, named)
    rows, data = _split(texts, delimiter, decimal, progress)
    if data and delimiter != " " and all(len(row) > 1 and not row[-1].strip() for row in data):
        # Every line closes with a delimiter.
        texts = [
            text.rstrip()[:-1] if text.rstrip().endswith(delimiter.strip() or delimiter) else text for text in texts
        ]
        rows, data = _split(texts, delimiter, decimal, silent)
    if not data:
        raise InputError("holds no numbers", str(path), "give a CSV with a column of positions")
    width = Counter(map(len, data)).most_common(1)[0][0]
    source.check_size(len(data), width, str(path))
    start = layout.find_start(texts, delimiter, decimal, width)
    head = texts[:start]
    names = layout.name_columns(head, delimiter, width)
    if names is None:
        count = len(layout.header(head[-1], delimiter, width))
        raise InputError(
            f"the header names {count} columns, the lines below have {width}",
            f"{path}, line {lines[start - 1][0]}",
            "separate columns by semicolons if numbers have decimal commas",
        )
    header_line = lines[start - 1][0] if names else 0
    first_line = lines[start][0]
    above = tuple(text for line, text in reversed(comments) if line < first_line)
    kept, starts, beside = _measurements(rows, start, head, delimiter, width)
    return Table(
        path,
        names,
        [rows[index] for index in kept],
        [lines[index][0] for index in kept],
        width,
        delimiter,
        decimal,
        header_line,
        comments=above,
        starts=starts,
        beside=tuple(lines[index][0] for index in beside),
    )


def _split(
    texts: Sequence[str], delimiter: str, decimal: str, progress: Stages
) -> tuple[list[Sequence[str]], list[Sequence[str]]]:
    """Return the cells of each line, and those of the lines that hold a number."""
    rows: list[Sequence[str]] = []
    data: list[Sequence[str]] = []
    for begin in range(0, len(texts), TOGETHER):
        progress("splitting lines", begin, len(texts))
        some: list[Sequence[str]] = [layout.split(text, delimiter) for text in texts[begin : begin + TOGETHER]]
        rows += some
        if layout.plain_numbers([row[0] if row else "" for row in some], decimal) is None:
            some = [row for row in some if any(layout.number(cell, decimal) is not None for cell in row)]
        data += some
    return rows, data


def _measurements(
    rows: Sequence[Sequence[str]], start: int, head: Sequence[str], delimiter: str, width: int
) -> tuple[list[int], tuple[int, ...], list[int]]:
    """Return the rows of data, which of them begin a measurement, and rows of cells beside the table, such as notes.

    A measurement begins below each repeated header.
    """
    header = {tuple(layout.split(text, delimiter)) for text in head if text}
    kept: list[int] = []
    beside: list[int] = []
    starts = [0]
    for index in range(start, len(rows)):
        row = rows[index]
        if header and tuple(row) in header:
            if kept and starts[-1] != len(kept):
                starts.append(len(kept))
        elif len(row) <= width or any(cell.strip() for cell in row[:width]):
            kept.append(index)
        else:
            beside.append(index)
    if starts[-1] == len(kept) > 0:
        starts.pop()
    return kept, tuple(starts), beside


def text_of(file: Source) -> str:
    """Return the text of a file, its lines ended by line feeds; InputError where it is not text."""
    data, where = file.data, str(file.path)
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
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if (count := text.count("\n")) > source.MOST_LINES:
        what = f"has {count:,} lines; a table has at most {source.MOST_LINES:,}"
        raise InputError(what, where, source.PARTS)
    return text


def _kept(
    path: Path, lines: Iterable[tuple[int, str]], preamble: int, progress: Stages
) -> tuple[list[tuple[int, str]], list[tuple[int, str]], str | None]:
    """Return number and text of each line that may hold data, of comments, and the delimiter that the file names."""
    where = str(path)
    every = list(lines)
    numbered = [(line, text) for line, text in every if line > preamble]
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
        what = "holds no data" if any(text for _, text in every) else "is empty"
        raise InputError(what, where, "give a CSV with a column of positions")
    for line, content in kept:
        if len(content) > LONGEST_LINE:
            what = f"the line holds {len(content)} characters; a line of a table has at most {LONGEST_LINE}"
            do = "delete that line; if the table begins below it, give --preamble"
            raise InputError(what, f"{where}, line {line}", f"{do} {line}")
    return kept, comments[:MOST_COMMENTS], named
