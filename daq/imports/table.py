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
from daq.imports.source import Source
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError, in_python

DELIMITER_NAMES = {"\t": "tab", ";": "semicolon", ",": "comma", " ": "spaces", "|": "bar"}
COMMENTS = ("#", "%", "//", "=~=~")  # the last begins the log of a terminal program
HDF5 = b"\x89HDF\r\n\x1a\n"  # how such a file begins, a run file among them
# A column, what makes a number of its cells (None where it cannot), and what a cell should be.
ColumnReader = tuple[int, Callable[[str], float | None], str]
TOGETHER = 4096  # rows whose cells are converted together
MOST_COMMENTS = 100  # lines above a table in which its names are looked for
LISTED = 5  # lines named in a message about many
LONGEST_LINE = 100_000  # characters; a table of 4000 columns has half of it
_STAMP = re.compile(r"\d{2}:\d{2}:\d{2}\.\d{3} -> ")  # of the serial monitor of Arduino, before each line


@dataclass(frozen=True)
class Skipped:
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
        """The delimiter in words; "none" for a single column, the kind of a file that is not text."""
        return self.kind or (DELIMITER_NAMES[self.delimiter] if self.width > 1 else "none")

    def label(self, column: int) -> str:
        """Return the name of a column in messages."""
        return f"column {source.cut(self.names[column])!r}" if self.names else f"column {column + 1}"

    @property
    def listed(self) -> str:
        """The names of the columns, for messages; empty without a header."""
        return source.shorten(self.names) + (f" (of another length: {self.left_out})" if self.left_out else "")

    def locate(self, line: int, column: int | None = None) -> str:
        """Return the position of a line, or of a cell of it, in the file, for messages."""
        where = f"{self.path}, line {line}" if line else str(self.path)
        return where if column is None else f"{where}, column {column + 1}"

    def number(self, cell: str) -> float | None:
        """Return a cell as a finite number, None when it is not one."""
        value = layout.read_number(cell, self.decimal)
        return None if value is None or value - value != 0 else value

    def segment(self, number: int | None) -> "Table":
        """Return the measurement of a number from 1, or all as one record (0); None: the only one."""
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
        """Return columns as numbers, the table of their lines, and the lines left out, which ``skip`` allows."""
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
            numbers: list[list[float]] = []
            for index, row in enumerate(rows, start=begin):
                cells: list[float] = []
                for column, reader, kind in readers if len(row) == self.width else ():
                    value = reader(row[column])
                    if value is None:
                        cell = row[column].strip()
                        what = f"holds {source.cut(cell)!r}, not {kind}" if cell else "is empty"
                        bad.append(Skipped(self.lines[index], f"{self.label(column)} {what}"))
                        first = column if len(bad) == 1 else first
                        break
                    cells.append(value)
                else:
                    if len(row) == self.width:
                        numbers.append(cells)
                        kept.append(index)
                    else:
                        columns = "1 column" if len(row) == 1 else f"{len(row)} columns"
                        what = f"has {columns} where the others have {self.width}"
                        bad.append(Skipped(self.lines[index], what))
            values.append(np.array(numbers, np.float64).reshape(-1, len(readers)).T)
        if bad and not skip:
            do, python = _advise(self, bad, kept)
            several = f"; {len(bad)} lines cannot be read: {list_lines(skipped.line for skipped in bad)}"
            raise InputError(bad[0].what + several * (len(bad) > 1), self.locate(bad[0].line, first), do, python=python)
        good = self
        if bad:
            good = replace(self, rows=[self.rows[index] for index in kept], lines=[self.lines[index] for index in kept])
        return np.concatenate([np.empty((len(readers), 0)), *values], axis=1), good, tuple(bad)

    def _plain(self, rows: list[Sequence[str]], readers: Sequence[ColumnReader]) -> Array | None:
        """Return the columns of some rows as numbers, (columns, rows); None unless each cell is a plain number."""
        if {*map(len, rows)} != {self.width} or any(reader != self.number for _, reader, _ in readers):
            return None
        columns = [layout.read_plain_numbers([row[column] for row in rows], self.decimal) for column, _, _ in readers]
        if any(numbers is None for numbers in columns):
            return None
        values = np.array(columns, np.float64)
        return values if np.isfinite(values).all() else None


def list_lines(lines: Iterable[int]) -> str:
    return source.shorten(map(str, lines), LISTED)


def _advise(cells: Table, bad: Sequence[Skipped], kept: Sequence[int]) -> tuple[str, str]:
    """Return what to do, for a terminal and in Python."""
    what = "those lines" if len(bad) > 1 else "that line"
    do = f"correct or delete {what}, or leave such lines out with {{}}: times need not be even"
    if kept and len(bad) == kept[0] and not cells.names:
        do += f"; if the table begins below, give --preamble {bad[-1].line}"
    return do.format("--skip-bad"), in_python(do.format("skip_bad=True"))


def parse_lines(
    path: Path, numbered: Iterable[tuple[int, str]], preamble: int, progress: Stages, delimiter_known: str | None = None
) -> Table:
    """Return the table in numbered lines; ``delimiter_known`` is the delimiter, where it is known."""
    lines, comments, stated = _select_lines(path, numbered, preamble, progress)
    delimiter_known = stated if delimiter_known is None else delimiter_known
    texts = [text for _, text in lines]
    if all(_STAMP.match(text) for text in texts):
        texts = [_STAMP.sub("", text, count=1) for text in texts]
    delimiter, decimal = layout.find_format(texts, delimiter_known)
    rows, data = _split_lines(texts, delimiter, decimal, progress)
    if data and delimiter != " " and all(len(row) > 1 and not row[-1].strip() for row in data):
        # Every line closes with a delimiter.
        texts = [
            text.rstrip()[:-1] if text.rstrip().endswith(delimiter.strip() or delimiter) else text for text in texts
        ]
        rows, data = _split_lines(texts, delimiter, decimal, silent)
    if not data:
        raise InputError("holds no numbers", str(path), "give a CSV with a column of positions")
    width = Counter(map(len, data)).most_common(1)[0][0]
    source.check_size(len(data), width, str(path))
    start = layout.find_start(texts, delimiter, decimal, width)
    head = texts[:start]
    names = layout.name_columns(head, delimiter, width)
    if names is None:
        count = len(layout.split_header(head[-1], delimiter, width))
        raise InputError(
            f"the header names {count} columns, the lines below have {width}",
            f"{path}, line {lines[start - 1][0]}",
            "separate columns by semicolons if numbers have decimal commas",
        )
    header_line = lines[start - 1][0] if names else 0
    first_line = lines[start][0]
    above = tuple(text for line, text in reversed(comments) if line < first_line)
    kept, starts, outside = _find_measurements(rows, start, head, delimiter, width)
    beside = tuple(lines[index][0] for index in outside)
    rows, numbers = [rows[index] for index in kept], [lines[index][0] for index in kept]
    return Table(
        path, names, rows, numbers, width, delimiter, decimal, header_line, comments=above, starts=starts, beside=beside
    )


def _split_lines(
    texts: Sequence[str], delimiter: str, decimal: str, progress: Stages
) -> tuple[list[Sequence[str]], list[Sequence[str]]]:
    """Return the cells of each line, and those of the lines that hold a number."""
    rows: list[Sequence[str]] = []
    data: list[Sequence[str]] = []
    for begin in range(0, len(texts), TOGETHER):
        progress("splitting lines", begin, len(texts))
        chunk: list[Sequence[str]] = [layout.split_cells(text, delimiter) for text in texts[begin : begin + TOGETHER]]
        rows += chunk
        if layout.read_plain_numbers([row[0] if row else "" for row in chunk], decimal) is None:
            chunk = [row for row in chunk if any(layout.read_number(cell, decimal) is not None for cell in row)]
        data += chunk
    return rows, data


def _find_measurements(
    rows: Sequence[Sequence[str]], start: int, head: Sequence[str], delimiter: str, width: int
) -> tuple[list[int], tuple[int, ...], list[int]]:
    """Return the rows of data, which of them start a measurement, and rows outside the table, such as notes."""
    header = {tuple(layout.split_cells(text, delimiter)) for text in head if text}
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


def decode_text(file: Source) -> str:
    """Return the text of a file, its lines ended by line feeds."""
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


def _select_lines(
    path: Path, lines: Iterable[tuple[int, str]], preamble: int, progress: Stages
) -> tuple[list[tuple[int, str]], list[tuple[int, str]], str | None]:
    """Return number and text of each line that may hold data, of comments, and the delimiter that the file names."""
    where = str(path)
    all_lines = list(lines)
    numbered = [(line, text) for line, text in all_lines if line > preamble]
    kept: list[tuple[int, str]] = []
    comments: list[tuple[int, str]] = []
    for begin in range(0, len(numbered), TOGETHER):
        progress("reading lines", begin, len(numbered))
        chunk = [(line, content) for line, content in numbered[begin : begin + TOGETHER] if content.strip(" \t;,|")]
        comment = [content.lstrip().startswith(COMMENTS) for _, content in chunk]
        kept += [each for each, is_comment in zip(chunk, comment, strict=True) if not is_comment]
        if len(comments) < MOST_COMMENTS:
            comments += [each for each, is_comment in zip(chunk, comment, strict=True) if is_comment]
    delimiter = None
    if kept and kept[0][1].lower().startswith("sep=") and len(kept[0][1]) == 5:
        delimiter = kept.pop(0)[1][4]  # written by spreadsheets
    if not kept:
        what = "holds no data" if any(text for _, text in all_lines) else "is empty"
        raise InputError(what, where, "give a CSV with a column of positions")
    for line, content in kept:
        if len(content) > LONGEST_LINE:
            what = f"the line holds {len(content)} characters; a line of a table has at most {LONGEST_LINE}"
            do = "delete that line; if the table begins below it, give --preamble"
            raise InputError(what, f"{where}, line {line}", f"{do} {line}")
    return kept, comments[:MOST_COMMENTS], delimiter
