"""The layout of a table in a text file: delimiter, decimal sign, preamble, header, and where the data begin.

The delimiter and the decimal sign are the pair under which most cells are numbers and most lines are equally long, and
under which the header is as long as the lines; of equals the first in `CANDIDATES`.  They are found from the second
half of the file, where no header disturbs.

A preamble, such as the settings that a servo drive writes above its table, may hold numbers.  It is recognised when a
line of names stands between it and lines that all look like data, or when its lines hold words and another number of
cells than the table.
"""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from datetime import date

from stickslip import units

TIME_NAMES = ("t", "time", "times", "timestamp", "seconds", "zeit", "temps", "tiempo", "tempo")
POSITION_NAMES = ("x", "position", "pos", "displacement", "distance", "weg", "ort", "auslenkung")
# Delimiter and decimal sign; " " is any run of blanks.
CANDIDATES = tuple((d, s) for d in "\t;, |" for s in ".," if (d, s) != (",", ","))
FORMAT_LINES = 400  # lines from which delimiter and decimal sign are found; of a longer file, evenly spaced
LOGGED = ("time", "length", "speed", "force", "rate")  # dimensions in a line of units; no mass: t is a time's name
YEAR_DIGITS, MONTHS = 4, 12
LONGEST_NUMBER = 1000  # characters; the time that `float` takes for one grows with their square
ALIKE = 3  # lines that must look like data below a header for what stands above it to be a preamble

# Text from outside: each repeat takes all it can and gives none back, so that the work grows with the length alone.
_NUMBER = re.compile(r"[+-]?+(?:(?:\d++\.?+\d*+|\.\d++)(?>[eE][+-]?+\d++)?+|nan|inf(?>inity)?+)", re.IGNORECASE)
_PLAIN = r"[ \t]*+[+-]?+(?:[0-9]++\.?+[0-9]*+|\.[0-9]++)(?>[eE][+-]?+[0-9]++)?+[ \t]*+"
_PLAIN_NUMBERS = re.compile(rf"{_PLAIN}(?>\n{_PLAIN})*+")
_DATE = re.compile(r"(\d++)([-/.])(\d++)[-/.](\d++)")
_CLOCK = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?>[.,]\d*+)?+)")
_TIMECODE = re.compile(r"\d{1,2}(?::[0-5]\d){2}:\d{2,3}")
_DATE_END = re.compile("[T ]")
_WIDE_GAP = re.compile(r"(?<!\s)\s{2,}+|\t")
_GAP = re.compile(r"(?<!\s)\s++(?![(\[])")


def read_number(cell: str, decimal: str) -> float | None:
    """Return a cell as a number, which may be nan or inf; None when it is not a number."""
    if len(cell) > LONGEST_NUMBER:
        return None
    text = cell.strip().replace("\N{MINUS SIGN}", "-")
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    return float(text) if _NUMBER.fullmatch(text) else None


def read_plain_numbers(cells: Sequence[str], decimal: str) -> list[float] | None:
    """Return cells as `read_number` does, in a third of the CPU time; None unless all are plain numbers."""
    text = "\n".join(cells)
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    if max(map(len, cells), default=0) > LONGEST_NUMBER or not _PLAIN_NUMBERS.fullmatch(text):
        return None
    return list(map(float, text.split("\n")))


def strip_date(cell: str) -> str:
    return _DATE_END.split(cell.strip())[-1]


def read_day(cell: str) -> int | None:
    """Return the date before a time of day in days: of 25.03.2026 the day comes first, of 03/25/2026 the month."""
    parts = _DATE.match(cell.strip()) if len(cell) <= LONGEST_NUMBER else None
    if parts is None:
        return None
    first, mark, middle, last = parts.groups()
    year, number, month = (first, last, middle) if len(first) == YEAR_DIGITS else (last, first, middle)
    if len(year) != YEAR_DIGITS or max(len(number), len(month)) > 2:
        return None
    if year == last and (int(month) > MONTHS or (mark != "." and int(number) <= MONTHS)):
        number, month = month, number
    try:
        return date(int(year), int(month), int(number)).toordinal()
    except ValueError:
        return None


def read_clock(cell: str) -> float | None:
    """Return a time of day such as 12:00:00.000 in seconds since midnight; `read_day` reads a date before it."""
    parts = _CLOCK.fullmatch(strip_date(cell)) if len(cell) <= LONGEST_NUMBER else None
    if parts is None:
        return None
    hours, minutes, seconds = parts.groups()
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds.replace(",", "."))


def is_timecode(cell: str) -> bool:
    """Return whether a cell is a video's time code such as 0:00:01:12, whose last part may be frames or hundredths."""
    return len(cell) <= LONGEST_NUMBER and _TIMECODE.fullmatch(cell.strip()) is not None


def split_cells(text: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return text.split()
    if '"' not in text and " " not in text and 0 < len(text) <= csv.field_size_limit():
        return text.split(delimiter)  # what the reader of csv returns then
    try:
        return next(csv.reader([text.strip(" ")], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return [text]  # a cell too long to be one


def split_header(text: str, delimiter: str, width: int) -> list[str]:
    """Return the cells of a header; between spaces, ``x (cm)`` is one name; a closing delimiter adds no column."""
    if delimiter == " " and len(text.split()) != width:
        wide = _WIDE_GAP.split(text.strip())
        return wide if len(wide) == width else _GAP.split(text.strip())
    cells = split_cells(text, delimiter)
    return cells[:-1] if len(cells) == width + 1 and not cells[-1].strip() else cells


def find_format(texts: Sequence[str], stated: str | None) -> tuple[str, str]:
    """Return the delimiter and the decimal sign; ``stated`` is the delimiter that the file itself names."""
    half = range(len(texts) // 2, len(texts))
    sample = [texts[index] for index in half[:: max(1, len(half) // FORMAT_LINES)]]
    best, best_score = CANDIDATES[0], 0.0
    for delimiter, decimal in CANDIDATES:
        if stated is not None and delimiter != stated:
            continue
        rows = [split_cells(text, delimiter) for text in sample]
        width, most_common_count = Counter(map(len, rows)).most_common(1)[0]
        cells = [cell for row in rows for cell in row]
        numbers = sum(read_number(cell, decimal) is not None for cell in cells)
        score = most_common_count / len(rows) * numbers / max(len(cells), 1)
        if score <= best_score:
            continue  # what follows only lowers it
        if width == 1:
            score *= 0.9  # "1,5" alone is two columns, unless there is a header of one name
        start = find_start(texts, delimiter, decimal, width)
        if 0 < start < len(texts):
            names = split_header(texts[start - 1], delimiter, width)
            # A name that contains another delimiter is more than one name.
            if len(names) != width or (width == 1 and any(mark in names[0] for mark in "\t;,|")):
                score *= 0.5
        if score > best_score:
            best, best_score = (delimiter, decimal), score
    return best


def find_start(texts: Sequence[str], delimiter: str, decimal: str, width: int) -> int:
    """Return the index of the first line of data in a table of ``width`` columns; the number of lines without any."""

    def mark_data(index: int) -> tuple[bool, ...]:
        return tuple(
            read_number(cell, decimal) is not None or read_clock(cell) is not None or is_timecode(cell)
            for cell in split_cells(texts[index], delimiter)
        )

    first = next((index for index in range(len(texts)) if any(mark_data(index))), len(texts))
    if first == len(texts):
        return first
    patterns = Counter(mark_data(index) for index in range(len(texts) // 2, len(texts))[:FORMAT_LINES])
    pattern = patterns.most_common(1)[0][0]
    if mark_data(first) == pattern:
        return first
    # Words of another width at the top are a preamble, numbers of another width are a damaged line.
    while first < len(texts) and len(mark_data(first)) != width and not all(mark_data(first)):
        first += 1
    alike = 0
    for index in range(first, len(texts)):
        alike = alike + 1 if mark_data(index) == pattern else 0
        if alike == max(1, min(ALIKE, len(texts) - first - 1)):
            start = index - alike + 1
            above = split_header(texts[start - 1], delimiter, width) if start else []
            has_names = len(above) == width and start and not any(mark_data(start - 1))
            return start if has_names else first
    return first


def name_columns(head: Sequence[str], delimiter: str, width: int) -> tuple[str, ...] | None:
    """Join the names above the data with a line of units; empty below free text, None for another number of columns."""
    if not head:
        return ()
    cells = tuple(cell.strip() for cell in split_header(head[-1], delimiter, width))
    if len(cells) != width:
        return () if len(cells) == 1 and width > 1 else None
    above = tuple(cell.strip() for cell in split_header(head[-2], delimiter, width)) if len(head) > 1 else ()
    bare = [cell.strip("()[] ") for cell in cells]
    if len(above) == width and all(above) and _are_units(bare, above):
        return tuple(f"{name} ({unit})" if unit else name for name, unit in zip(above, bare, strict=True))
    return cells


def _are_units(cells: Sequence[str], above: Sequence[str]) -> bool:
    """Return whether a line holds the units of the names above it: two known ones, or one below a known name."""
    unit_count = sum(any(units.is_unit(cell, dimension) for dimension in LOGGED) for cell in cells)
    names_known = any(name.lower() in TIME_NAMES + POSITION_NAMES for name in above)
    return unit_count > 1 or (unit_count == 1 and names_known)
