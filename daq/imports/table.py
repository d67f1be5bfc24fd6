"""A table of numbers in a text file, as cameras, trackers and spreadsheets write it.

Found, not asked for: encoding (UTF-8, UTF-16 with a mark, else Windows-1252), line ends, the delimiter (tab,
semicolon, comma, spaces, bar), the decimal sign, comment lines (``#``, ``%``, ``//``), lines of words above the
table, whose last is the header.  A line with any number in it is data: from there on every line must be.

The delimiter and the decimal sign are the pair under which most cells are numbers and most lines are equally long,
and under which the header is as long as the lines; of equals the first in `CANDIDATES`.  They are found from the
second half of the file, where no header disturbs.
"""

import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from daq.errors import InputError

# Delimiter and decimal sign; " " is any run of blanks.
CANDIDATES = tuple((d, s) for d in "\t;, |" for s in ".," if (d, s) != (",", ","))
DELIMITER_NAMES = {"\t": "tab", ";": "semicolon", ",": "comma", " ": "spaces", "|": "bar"}
COMMENTS = ("#", "%", "//")
FORMAT_LINES = 400  # lines from which delimiter and decimal sign are found; of a longer file, evenly spaced

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)", re.IGNORECASE)


@dataclass(frozen=True)
class Table:
    """The cells of a table, not yet numbers.

    Attributes
    ----------
    path : Path
        The file.
    names : tuple of str
        The header; empty without one.
    rows : list of list of str
        The cells of each line of data.
    lines : list of int
        Line number of each row in the file, from 1.
    delimiter, decimal : str
        As found.
    """

    path: Path
    names: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    delimiter: str
    decimal: str

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.rows[0])

    @property
    def delimiter_name(self) -> str:
        """The delimiter in words; "none" for a single column."""
        return DELIMITER_NAMES[self.delimiter] if self.width > 1 else "none"

    def label(self, column: int) -> str:
        """Return the name of a column in messages."""
        return f"column {self.names[column]!r}" if self.names else f"column {column + 1}"

    def numbers(self, column: int) -> list[float]:
        """Return a column as numbers.

        Raises
        ------
        InputError
            For the first cell that is not a finite number, naming line, column and value.
        """
        out = []
        for line, row in zip(self.lines, self.rows, strict=True):
            value = number(row[column], self.decimal)
            if value is None or value - value != 0:
                cell = row[column].strip()
                what = f"{self.label(column)} " + (f"holds {cell!r}, not a number" if cell else "is empty")
                do = "correct or delete that line: times need not be even"
                raise InputError(what, f"{self.path}, line {line}", do)
            out.append(value)
        return out


def number(cell: str, decimal: str) -> float | None:
    """Return a cell as a number (which may be nan or inf), or None when it is not a number."""
    text = cell.strip().replace("\N{MINUS SIGN}", "-")
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    return float(text) if _NUMBER.fullmatch(text) else None


def read(path: Path) -> Table:
    """Read a table of numbers.

    Raises
    ------
    InputError
        When the file is missing, not text, empty, or its lines differ in length, naming the line.
    """
    lines = _lines(path)
    named = None
    if lines and lines[0][1].lower().startswith("sep=") and len(lines[0][1]) == 5:
        named = lines.pop(0)[1][4]  # written by spreadsheets
    texts = [text for _, text in lines]
    delimiter, decimal = _format(texts, named)
    start = _first_data(texts, delimiter, decimal)
    if start == len(lines):
        raise InputError("holds no numbers", str(path), "give a CSV with a column of positions")
    head, body = lines[:start], lines[start:]
    rows = [split(text, delimiter) for _, text in body]
    numbers = [line for line, _ in body]
    if all(len(row) > 1 and not row[-1].strip() for row in rows):
        rows = [row[:-1] for row in rows]  # every line closes with a delimiter
    width = Counter(map(len, rows)).most_common(1)[0][0]
    names: tuple[str, ...] = ()
    if head:
        cells = tuple(cell.strip() for cell in header(head[-1][1], delimiter, width))
        if len(cells) == width:
            names = cells
        elif len(cells) > 1 or width == 1:
            raise InputError(
                f"the header names {len(cells)} columns, the lines below have {width}",
                f"{path}, line {head[-1][0]}",
                "separate columns by semicolons if numbers have decimal commas",
            )
    for line, row in zip(numbers, rows, strict=True):
        if len(row) != width:
            raise InputError(
                f"has {len(row)} columns where the others have {width}",
                f"{path}, line {line}",
                "correct that line; put # before lines that hold no data",
            )
    return Table(path, names, rows, numbers, delimiter, decimal)


def split(text: str, delimiter: str) -> list[str]:
    """Return the cells of a line."""
    if delimiter == " ":
        return text.split()
    return next(csv.reader([text.strip(" ")], delimiter=delimiter, skipinitialspace=True), [])


def header(text: str, delimiter: str, width: int) -> list[str]:
    """Return the cells of a header; between spaces, ``x (cm)`` is one name; a closing delimiter adds no column."""
    if delimiter == " " and len(text.split()) != width:
        wide = re.split(r"\s{2,}|\t", text.strip())
        return wide if len(wide) == width else re.split(r"\s+(?![(\[])", text.strip())
    cells = split(text, delimiter)
    return cells[:-1] if len(cells) == width + 1 and not cells[-1].strip() else cells


def _lines(path: Path) -> list[tuple[int, str]]:
    where = str(path)
    if not path.exists():
        raise InputError("no such file", where, "check the path")
    if path.is_dir():
        raise InputError("is a folder", where, "give the CSV file in it")
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", "replace")
    else:
        if b"\0" in data[:4096]:
            raise InputError("is not a text file", where, "export it as CSV")
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", "replace")
    numbered = enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1)
    kept = [(line, content) for line, content in numbered if content.strip(" \t;,|")]
    kept = [(line, content) for line, content in kept if not content.lstrip().startswith(COMMENTS)]
    if not kept:
        raise InputError("is empty" if not data else "holds no data", where, "give a CSV with a column of positions")
    return kept


def _first_data(texts: list[str], delimiter: str, decimal: str) -> int:
    for index, text in enumerate(texts):
        if any(number(cell, decimal) is not None for cell in split(text, delimiter)):
            return index
    return len(texts)


def _format(texts: list[str], named: str | None) -> tuple[str, str]:
    half = texts[len(texts) // 2 :]
    sample = half[:: max(1, len(half) // FORMAT_LINES)]
    best, best_score = CANDIDATES[0], 0.0
    for delimiter, decimal in CANDIDATES:
        if named is not None and delimiter != named:
            continue
        rows = [split(text, delimiter) for text in sample]
        width, same = Counter(map(len, rows)).most_common(1)[0]
        cells = [cell for row in rows for cell in row]
        numbers = sum(number(cell, decimal) is not None for cell in cells)
        score = same / len(rows) * numbers / len(cells)
        if width == 1:
            score *= 0.9  # "1,5" alone is two columns, unless there is a header of one name
        start = _first_data(texts, delimiter, decimal)
        if 0 < start < len(texts):
            names = header(texts[start - 1], delimiter, width)
            # A name that contains another delimiter is more than one name.
            if len(names) != width or (width == 1 and any(mark in names[0] for mark in "\t;,|")):
                score *= 0.5
        if score > best_score:
            best, best_score = (delimiter, decimal), score
    return best
