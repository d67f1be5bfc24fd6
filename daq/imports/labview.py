"""A LabVIEW measurement (.lvm) as a table: channels are its columns, with the units of the header.

A file header, then segments, each with a header of its own (``Multi_Headings``) or only the first.  The X values stand
in a column (``X_Columns`` One), in one before each channel (Multi), or follow from ``X0`` and ``Delta_X`` (No).
Segments whose X begins anew are placed by the date and time of their headers.  ``Samples`` is not believed: lines
count.  Source: National Instruments, Specification for the LabVIEW Measurement File, versions 0.92 to 2.0.

Not read: special blocks (they are passed over), and X values of different times in one line.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from daq.imports import layout
from daq.imports.table import Table, short
from stickslip.errors import InputError

BEGINS = "LabVIEW Measurement"
_END, _SPECIAL, _SPECIAL_END = "***End_of_Header***", "***Start_Special***", "***End_Special***"
DAY_S = 86400.0
MOST_TAGS = 30  # lines of the header in which the separator is looked for; there are a dozen
_COLUMNS = "X_Value"  # how the line of names begins
_SEPARATORS = {"Tab": "\t", "Comma": ","}


@dataclass(frozen=True)
class _Segment:
    """A segment: its header by tags, names of columns, cells of its lines and their numbers in the file."""

    tags: dict[str, list[str]]
    names: list[str]
    rows: list[list[str]]
    lines: list[int]


def read(path: Path, text: str) -> Table:
    """Read a LabVIEW measurement.

    Parameters
    ----------
    path : Path
        The file, for messages.
    text : str
        What it holds.

    Raises
    ------
    InputError
        For a file without a segment of numbers, segments with other channels, or whose times cannot be placed.
    """
    where = str(path)
    lines = text.split("\n")
    stated = (re.match(r"Separator[\t,](\w+)", line) for line in lines[:MOST_TAGS])
    separator = next((_SEPARATORS.get(found[1], "\t") for found in stated if found), "\t")
    end = next((number for number, line in enumerate(lines) if _is(line, _END, separator)), None)
    if end is None:
        raise InputError("its header does not end", where, "export it again, or delete what stands above the table")
    header = _tags(lines[:end], separator)
    segments = [segment for segment in _segments(lines, end + 1, separator) if segment.rows]
    if not segments:
        raise InputError("holds no numbers", where, "give a measurement with a channel of positions")
    first = segments[0]
    decimal = header.get("Decimal_Separator", [""])[0] or _decimal(first.rows[0])  # before version 2 nobody says it
    for other in segments[1:]:
        if other.names != first.names:
            what = f"a segment has the channels {', '.join(other.names)}, the first one {', '.join(first.names)}"
            raise InputError(what, f"{where}, line {other.lines[0]}", "export segments with equal channels")
    kind = header.get("X_Columns", ["One"])[0]
    names, numbers = _columns(first), list[int]()
    rows: list[Sequence[str]] = []
    begun: tuple[int, float] | None = None
    last = float("-inf")
    for segment in segments:
        own = _with_times(segment, kind, decimal, where)
        if not segment.rows or not own:
            continue
        start = _stamp(segment.tags)
        begun = start if begun is None else begun
        time = layout.number(own[0][0], decimal)
        shift = 0.0
        if time is not None and time <= last:
            if start is not None and begun is not None:
                shift = DAY_S * (start[0] - begun[0]) + (start[1] - begun[1])
            if time + shift <= last:
                what = f"the times of a segment begin again with {own[0][0].strip()}, and its header does not say when"
                raise InputError(
                    what, f"{where}, line {segment.lines[0]}", "export the segments into files of their own"
                )
        for row in own:
            value = layout.number(row[0], decimal)
            if value is not None and shift:
                row[0] = repr(value + shift).replace(".", decimal)
            last = last if value is None else value + shift
        rows += own
        numbers += segment.lines
    recorded = " ".join(header.get(tag, [""])[0].strip() for tag in ("Date", "Time")).strip()
    width = len(names)
    return Table(path, tuple(names), rows, numbers, width, separator, decimal, first.lines[0] - 1, "LabVIEW", recorded)


def _is(line: str, tag: str, separator: str) -> bool:
    return line.split(separator, 1)[0].strip() == tag


def _tags(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    tags = {}
    for line in lines:
        tag, *values = line.split(separator)
        if values and tag.strip():
            tags[tag.strip()] = [value.strip() for value in values]
    return tags


def _segments(lines: Sequence[str], at: int, separator: str) -> list[_Segment]:
    """Return the segments in the lines from one on."""
    segments: list[_Segment] = []
    header: list[str] = []
    special = named = False
    for number, line in enumerate(lines[at:], start=at + 1):
        if _is(line, _SPECIAL, separator):
            special = True
        elif _is(line, _SPECIAL_END, separator):
            special = False
        elif special or not line.strip():
            continue
        elif _is(line, "Channels", separator):  # the header of a segment begins
            header, named = [line], False
        elif _is(line, _END, separator):
            named = False
        elif _is(line, _COLUMNS, separator) and not named:
            names = [name.strip() for name in line.rstrip(separator).split(separator)]
            names = names[:-1] if names[-1] == "Comment" else names
            segments.append(_Segment(_tags(header, separator), names, [], []))
            named = True
        elif named:
            width = len(segments[-1].names)
            cells = [*line.split(separator), *[""] * width]  # a line of a shorter channel, or without a comment
            segments[-1].rows.append(cells[:width])
            segments[-1].lines.append(number)
        else:
            header.append(line)
    return segments


def _decimal(cells: Sequence[str]) -> str:
    commas = any(layout.number(cell, ".") is None and layout.number(cell, ",") is not None for cell in cells)
    return "," if commas else "."


def _columns(segment: _Segment) -> list[str]:
    """Return the names of the columns with their units: the times first."""
    tags = segment.tags
    dimension = tags.get("X_Dimension", ["Time"])[0] or "Time"
    x_name = "Time (s)" if dimension == "Time" else dimension
    units = tags.get("Y_Unit_Label", [])
    names = []
    for k, name in enumerate(segment.names):
        if name == _COLUMNS:
            names += [x_name] if k == 0 else []
            continue
        unit = units[k - 1] if k <= len(units) else ""
        names.append(f"{name} ({unit})" if unit else name)
    return names


def _with_times(segment: _Segment, kind: str, decimal: str, where: str) -> list[list[str]]:
    """Return the rows of a segment, each with one time before its channels."""
    if kind == "No":
        begin, step = (_first(segment.tags, tag, decimal) for tag in ("X0", "Delta_X"))
        if begin is None or not step:
            what = "has neither a column of X values nor X0 and Delta_X"
            raise InputError(what, f"{where}, line {segment.lines[0]}", "export it with X_Columns One")
        return [[repr(begin + k * step).replace(".", decimal), *row[1:]] for k, row in enumerate(segment.rows)]
    others = [k for k, name in enumerate(segment.names) if name == _COLUMNS and k]
    if not others:
        return segment.rows
    for row, line in zip(segment.rows, segment.lines, strict=True):
        times = {row[k].strip() for k in (0, *others) if row[k].strip()}
        if len(times) > 1:
            what = f"the channels have different times, {' and '.join(map(short, sorted(times)[:2]))}"
            raise InputError(what, f"{where}, line {line}", "export it with X_Columns One")
    return [[cell for k, cell in enumerate(row) if k not in others] for row in segment.rows]


def _first(tags: dict[str, list[str]], tag: str, decimal: str) -> float | None:
    return layout.number(tags.get(tag, [""])[0], decimal)


def _stamp(tags: dict[str, list[str]]) -> tuple[int, float] | None:
    """Return the day and the second of it in which a segment began; None where its header does not say it."""
    try:
        day = datetime.strptime(tags["Date"][0], "%Y/%m/%d")
    except (KeyError, ValueError):
        return None
    clock = layout.clock(tags.get("Time", [""])[0])
    return None if clock is None else (day.toordinal(), clock)
