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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.imports import layout, source
from daq.imports.lines import TOGETHER, Lines, Rows
from daq.imports.source import Source
from stickslip.compute.arrays import Array, Mask
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError, in_python

DELIMITER_NAMES = {"\t": "tab", ";": "semicolon", ",": "comma", " ": "spaces", "|": "bar"}
COMMENTS = ("#", "%", "//", "=~=~")  # the last begins the log of a terminal program
HDF5 = b"\x89HDF\r\n\x1a\n"  # how such a file begins, a run file among them
# A column, what makes a number of its cells (None where it cannot), and what a cell should be.
ColumnReader = tuple[int, Callable[[str], float | None], str]
MOST_COMMENTS = 100  # lines above a table in which its names are looked for
LISTED = 5  # lines named in a message about many
LONGEST_LINE = 100_000  # characters; a table of 4000 columns has half of it
# Of the serial monitor of Arduino, before each line.
_STAMP, STAMP_BYTES = re.compile(r"[0-9]{2}:[0-9]{2}:[0-9]{2}\.[0-9]{3} -> "), 16


@dataclass(frozen=True)
class Table:
    """The cells of a table, not yet numbers."""

    path: Path
    names: tuple[str, ...]  # the header; empty without one
    rows: Sequence[Sequence[str]]  # the cells of each line of data
    lines: NDArray[np.int32]  # line number of each row in the file, from 1
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
        return source.shorten(self.names) + (
            f" (omitted because of their length: {self.left_out})" if self.left_out else ""
        )

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
            what = f"has {count} measurements, which begin at {begins}"
            do = f"choose one with --segment 1 to --segment {count}; --segment 0 joins them"
            raise InputError(what, str(self.path), do)
        if number is None or number == 0:
            return self
        if not 1 <= number <= count:
            what = f"--segment {number}: the file has {count} measurement{'s' if count > 1 else ''}"
            raise InputError(what, str(self.path), f"choose 1 to {count}" if count > 1 else "omit it")
        chosen = slice(*[*self.starts, len(self.lines)][number - 1 : number + 1])
        return replace(self.take(chosen), starts=(0,))

    def columns(
        self, readers: Sequence[ColumnReader], *, skip: bool, progress: Stages = silent
    ) -> "tuple[Array, Table, tuple[int, ...]]":
        """Return columns as numbers, their lines (a table without cells), and lines left out, which ``skip`` allows."""
        values = np.empty((len(readers), len(self.rows)))
        filled = 0
        good = np.ones(len(self.rows), np.bool_)
        bad: list[int] = []
        problem: tuple[str, int | None] = "", None  # of the first bad line, and its column
        for begin in range(0, len(self.rows), TOGETHER):
            progress("reading numbers", begin, len(self.rows))
            rows = list(self.rows[begin : begin + TOGETHER])
            plain = self._plain(rows, readers)
            if plain is not None:
                values[:, filled : filled + len(rows)] = plain
                filled += len(rows)
                continue
            for index, row in enumerate(rows, start=begin):
                cells, what, column = self._read_row(row, readers)
                if what:
                    problem = problem if bad else (what, column)
                    bad.append(int(self.lines[index]))
                    good[index] = False
                else:
                    values[:, filled] = cells
                    filled += 1
        if bad and not skip:
            do, python = _advise(self, bad, good)
            what, column = problem
            several = f"; {len(bad)} lines cannot be read: {list_lines(bad)}"
            raise InputError(what + several * (len(bad) > 1), self.locate(bad[0], column), do, python=python)
        return values[:, :filled], replace(self, rows=(), lines=self.lines[good]), tuple(bad)

    def take(self, which: slice) -> "Table":
        """Return the table of some of its lines."""
        return replace(self, rows=self.rows[which], lines=self.lines[which])

    def _read_row(self, row: Sequence[str], readers: Sequence[ColumnReader]) -> tuple[list[float], str, int | None]:
        """Return the numbers in a row, why it cannot be read ("" where it can), and the column that cannot."""
        if len(row) != self.width:
            columns = "1 column" if len(row) == 1 else f"{len(row)} columns"
            return [], f"has {columns}, but the others have {self.width}", None
        cells: list[float] = []
        for column, reader, kind in readers:
            value = reader(row[column])
            if value is None:
                cell = row[column].strip()
                what = f"contains {source.cut(cell)!r}, not {kind}" if cell else "is empty"
                return [], f"{self.label(column)} {what}", column
            cells.append(value)
        return cells, "", None

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


def _advise(cells: Table, bad: Sequence[int], good: Mask) -> tuple[str, str]:
    """Return what to do, for a terminal and in Python."""
    what = "those lines" if len(bad) > 1 else "that line"
    do = f"correct or delete {what}, or skip such lines with {{}}; times need not be evenly spaced"
    if good.any() and len(bad) == int(good.argmax()) and not cells.names:
        do += f"; if the table begins below, give --preamble {bad[-1]}"
    return do.format("--skip-bad"), in_python(do.format("skip_bad=True"))


def parse_lines(path: Path, lines: Lines, preamble: int, progress: Stages, delimiter_known: str | None = None) -> Table:
    """Return the table in some lines; ``delimiter_known`` is the delimiter, where it is known."""
    texts, comments, stated = _select_lines(path, lines, preamble, progress)
    delimiter_known = stated if delimiter_known is None else delimiter_known
    if all(_STAMP.match(text) for _, piece in texts.pieces() for text in piece):
        texts = texts.cut(texts.begin + STAMP_BYTES, texts.end)
    delimiter, decimal = layout.find_format(texts, delimiter_known)
    survey = _survey(texts, delimiter, decimal, progress)
    if survey.rows and delimiter != " " and survey.closed:
        texts = texts.cut(texts.begin, texts.begin + _measure_unclosed(texts, delimiter))
        survey = _survey(texts, delimiter, decimal, silent)
    if not survey.rows:
        raise InputError("has no numbers", str(path), "use a CSV file with a column of positions")
    width = survey.widths.most_common(1)[0][0]
    source.check_size(survey.rows, width, str(path))
    start = layout.find_start(texts, delimiter, decimal, width)
    head = texts[:start]
    names = layout.name_columns(head, delimiter, width)
    if names is None:
        count = len(layout.split_header(head[-1], delimiter, width))
        raise InputError(
            f"the header names {count} columns, but the lines below have {width}",
            f"{path}, line {texts.number[start - 1]}",
            "separate columns by semicolons if numbers have decimal commas",
        )
    header_line = int(texts.number[start - 1]) if names else 0
    above = tuple(text for line, text in reversed(comments) if line < texts.number[start])
    below = texts.take(slice(start, None))
    kept, starts, beside = _find_measurements(below, head, delimiter, width)
    rows = below.take(kept)
    return Table(
        path,
        names,
        Rows(rows, delimiter),
        rows.number,
        width,
        delimiter,
        decimal,
        header_line,
        comments=above,
        starts=starts,
        beside=tuple(below.number[beside].tolist()),
    )


class _Survey(NamedTuple):
    """The lines that hold a number: how many, how many have so many cells, and whether a delimiter closes each."""

    rows: int
    widths: Counter[int]
    closed: bool


def _survey(texts: Lines, delimiter: str, decimal: str, progress: Stages) -> _Survey:
    widths: Counter[int] = Counter()
    closed = True
    for first, piece in texts.pieces():
        progress("splitting lines", first, len(texts))
        chunk = [layout.split_cells(text, delimiter) for text in piece]
        if layout.read_plain_numbers([row[0] if row else "" for row in chunk], decimal) is None:
            chunk = [row for row in chunk if any(layout.read_number(cell, decimal) is not None for cell in row)]
        widths.update(map(len, chunk))
        closed = closed and all(len(row) > 1 and not row[-1].strip() for row in chunk)
    return _Survey(widths.total(), widths, closed)


def _measure_unclosed(texts: Lines, delimiter: str) -> NDArray[np.int32]:
    """Return the bytes of each line without the delimiter that closes it."""
    sizes = []
    for _, piece in texts.pieces():
        for text in piece:
            closed = text.rstrip()
            sizes.append(len((closed[:-1] if closed.endswith(delimiter.strip() or delimiter) else text).encode()))
    return np.array(sizes, np.int32)


def _find_measurements(
    texts: Lines, head: Sequence[str], delimiter: str, width: int
) -> tuple[Mask, tuple[int, ...], list[int]]:
    """Return which lines are data, which of these start a measurement, and lines outside the table, such as notes."""
    header = {tuple(layout.split_cells(text, delimiter)) for text in head if text}
    kept = np.ones(len(texts), np.bool_)
    beside: list[int] = []
    starts, count = [0], 0
    for index, row in enumerate(Rows(texts, delimiter)):
        if header and tuple(row) in header:
            if count and starts[-1] != count:
                starts.append(count)
            kept[index] = False
        elif len(row) <= width or any(cell.strip() for cell in row[:width]):
            count += 1
        else:
            beside.append(index)
            kept[index] = False
    if starts[-1] == count > 0:
        starts.pop()
    return kept, tuple(starts), beside


def decode_text(file: Source) -> str:
    """Return the text of a file, its lines ended by line feeds."""
    data, where = file.data, str(file.path)
    if data.startswith(HDF5):
        do = "a run file needs no import, so use process smooth or fit-friction; export other files as CSV"
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
        what = f"has {count:,} lines, but a table may have at most {source.MOST_LINES:,}"
        raise InputError(what, where, source.PARTS)
    return text


def _select_lines(
    path: Path, lines: Lines, preamble: int, progress: Stages
) -> tuple[Lines, list[tuple[int, str]], str | None]:
    """Return the lines that may hold data, comments with their line numbers, and the delimiter that the file names."""
    where = str(path)
    numbered = lines.take(slice(int(np.searchsorted(lines.number, preamble, "right")), None))
    keep = np.zeros(len(numbered), np.bool_)
    comments: list[tuple[int, str]] = []
    for first, piece in numbered.pieces():
        progress("reading lines", first, len(numbered))
        for index, content in enumerate(piece, start=first):
            if content.lstrip().startswith(COMMENTS):
                comments.append((int(numbered.number[index]), content))
            elif content.strip(" \t;,|"):
                keep[index] = True
        del comments[MOST_COMMENTS:]
    kept, delimiter = numbered.take(keep), None
    if len(kept) and kept[0].lower().startswith("sep=") and len(kept[0]) == 5:
        delimiter = kept[0][4]  # written by spreadsheets
        kept = kept.take(slice(1, None))
    if not len(kept):
        what = "has no data" if (lines.end > lines.begin).any() else "is empty"
        raise InputError(what, where, "use a CSV file with a column of positions")
    for index in np.flatnonzero(kept.end - kept.begin > LONGEST_LINE).tolist():
        if (length := len(kept[index])) > LONGEST_LINE:
            what = f"the line has {length} characters, but a line of a table may have at most {LONGEST_LINE}"
            do = "delete that line; if the table begins below it, use --preamble"
            raise InputError(what, f"{where}, line {kept.number[index]}", f"{do} {kept.number[index]}")
    return kept, comments, delimiter
