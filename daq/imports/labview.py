"""A LabVIEW measurement (.lvm) as a table: channels are its columns, with the units of the header.

A file header, then segments, each with a header of its own (``Multi_Headings``) or only the first.  The X values stand
in a column (``X_Columns`` One), in one before each channel (Multi), or follow from ``X0`` and ``Delta_X`` of each
channel (No).  Segments whose X begins anew are placed by the date and time of their headers, and belong together where
they follow each other within `LONGEST_BREAK` steps; else each is a measurement, as is each part of ``Samples`` lines
below one header without X values.  Source: National Instruments, Specification for the LabVIEW Measurement File,
versions 0.92 to 2.0.

Special blocks are skipped.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from daq.imports import layout, source
from daq.imports.table import Table
from stickslip.errors import InputError

BEGINS = "LabVIEW Measurement"
_END, _SPECIAL, _SPECIAL_END = "***End_of_Header***", "***Start_Special***", "***End_Special***"
DAY_S = 86400.0
MOST_TAGS = 30  # lines of the header in which the separator is looked for; there are a dozen
# Steps between two segments of one measurement.  Blocks of one acquisition follow each other after one step, and the
# stamps of their headers are rounded to ms; a trigger comes later.
LONGEST_BREAK = 10.0
_COLUMNS = "X_Value"  # how the line of names begins
_SEPARATORS = {"Tab": "\t", "Comma": ","}


@dataclass(frozen=True)
class _Segment:
    tags: dict[str, list[str]]  # its header
    names: list[str]  # of its columns
    rows: list[list[str]]
    lines: list[int]  # numbers of its lines in the file


def read(path: Path, text: str) -> Table:
    """Read a LabVIEW measurement from its text.

    Raises InputError: there is no segment of numbers, X is not a time, or segments have other channels or times that
        cannot be placed.
    """
    where = str(path)
    lines = text.split("\n")
    stated = (re.match(r"Separator[\t,](\w+)", line) for line in lines[:MOST_TAGS])
    separator = next((_SEPARATORS.get(found[1], "\t") for found in stated if found), "\t")
    end = next((number for number, line in enumerate(lines) if _is(line, _END, separator)), None)
    if end is None:
        raise InputError("its header does not end", where, "export it again, or delete what stands above the table")
    header = _tags(lines[:end], separator)
    segments = [segment for segment in _segments(lines, end + 1, separator, where) if segment.rows]
    if not segments:
        raise InputError("holds no numbers", where, "give a measurement with a channel of positions")
    first = segments[0]
    decimal = header.get("Decimal_Separator", [""])[0] or _decimal(first.rows[0])  # before version 2 nobody says it
    for segment in segments:
        _check_segment(segment, first, where)
    kind = header.get("X_Columns", ["One"])[0]
    names, clocks = _columns(first, kind, decimal, where)
    rows: list[Sequence[str]] = []
    numbers: list[int] = []
    starts: list[int] = []
    origin = _stamp(first.tags)
    last = -math.inf
    for segment in segments:
        timed, begins = _with_times(segment, kind, decimal, where)
        times = [layout.number(row[0], decimal) for row in timed]
        begin = next((time for time in times if time is not None), None)
        shift = 0.0
        if begin is not None and begin <= last:
            stamp = _stamp(segment.tags)
            if stamp is not None and origin is not None:
                shift = DAY_S * (stamp[0] - origin[0]) + (stamp[1] - origin[1])
            if begin + shift <= last:
                shift = math.nan  # nobody knows when
        step = _usual_step(times)
        new = begin is None or not begin + shift - last <= LONGEST_BREAK * step
        starts += [len(rows) + row for row in begins if row or new]
        if shift > 0:
            for row in timed:
                for column in range(clocks.count(None)):
                    value = layout.number(row[column], decimal)
                    row[column] = row[column] if value is None else repr(value + shift).replace(".", decimal)
        known = [time for time in times if time is not None]
        last = known[-1] + (shift if shift > 0 else 0.0) if known else last
        rows += timed
        numbers += segment.lines
    recorded = " ".join(header.get(tag, [""])[0].strip() for tag in ("Date", "Time")).strip()
    return Table(
        path,
        tuple(names),
        rows,
        numbers,
        len(names),
        separator,
        decimal,
        first.lines[0] - 1,
        "LabVIEW",
        recorded,
        clocks=tuple(clocks),
        starts=tuple(starts) or (0,),
    )


def _usual_step(times: Sequence[float | None]) -> float:
    """Return the mean step of times; infinite for fewer than two."""
    known = [time for time in times if time is not None]
    return (known[-1] - known[0]) / (len(known) - 1) if len(known) > 1 else math.inf


def _check_segment(segment: _Segment, first: _Segment, where: str) -> None:
    place = f"{where}, line {segment.lines[0]}"
    source.check_size(len(segment.rows), len(segment.names), where)
    if segment.names != first.names:
        others, names = source.shorten(segment.names), source.shorten(first.names)
        what = f"a segment has the channels {others}, the first one {names}"
        raise InputError(what, place, "export segments with equal channels")
    for dimension in segment.tags.get("X_Dimension", []):
        if dimension not in ("", "Time"):
            what = f"X_Dimension is {dimension[:40]!r}: the X values are not times"
            raise InputError(what, place, "export the signal against time")


def _is(line: str, tag: str, separator: str) -> bool:
    return line.split(separator, 1)[0].strip() == tag


def _tags(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    tags = {}
    for line in lines:
        tag, *values = line.split(separator)
        if values and tag.strip():
            tags[tag.strip()] = [value.strip() for value in values]
    return tags


def _segments(lines: Sequence[str], at: int, separator: str, where: str) -> list[_Segment]:
    cells_kept = 0
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
            source.check_size(1, len(names), where)
            segments.append(_Segment(_tags(header, separator), names, [], []))
            named = True
        elif named:
            width = len(segments[-1].names)
            cells_kept += width
            source.check_size(cells_kept, 1, where)
            cells = [*line.split(separator), *[""] * width]  # a line of a shorter channel, or without a comment
            segments[-1].rows.append(cells[:width])
            segments[-1].lines.append(number)
        else:
            header.append(line)
    return segments


def _decimal(cells: Sequence[str]) -> str:
    commas = any(layout.number(cell, ".") is None and layout.number(cell, ",") is not None for cell in cells)
    return "," if commas else "."


def _columns(segment: _Segment, kind: str, decimal: str, where: str) -> tuple[list[str], list[int | None]]:
    """Return the names of the columns with their units, and of each channel the column with its times.

    The times come first: one column where they are the same, else one for each channel.
    """
    units = segment.tags.get("Y_Unit_Label", [])
    channels = [(place, name) for place, name in enumerate(segment.names) if name != _COLUMNS]
    count = len({clock for clock, _ in _clocks(segment, kind, decimal, where)})
    names = ["Time (s)"] if count == 1 else [f"Time {number + 1} (s)" for number in range(count)]
    clocks: list[int | None] = [None] * count
    for (_, name), (clock, place) in zip(channels, _clocks(segment, kind, decimal, where), strict=True):
        unit = units[place] if place < len(units) else ""
        names.append(f"{name} ({unit})" if unit else name)
        clocks.append(clock)
    return names, clocks


def _clocks(segment: _Segment, kind: str, decimal: str, where: str) -> list[tuple[int, int]]:
    """Return of each channel the number of its clock, and its number among the channels' tags."""
    channels = [place for place, name in enumerate(segment.names) if name != _COLUMNS]
    if kind == "No":
        waveforms = _waveforms(segment, len(channels), decimal, where)
        distinct = list(dict.fromkeys(waveforms))
        return [(distinct.index(waveform), number) for number, waveform in enumerate(waveforms)]
    if kind != "Multi":
        return [(0, place - 1) for place in channels]
    times: list[int] = []
    clocks = []
    for place in channels:
        column = _times_before(segment, place)
        clock = next((index for index, other in enumerate(times) if _agree(segment, column, other)), len(times))
        times += [column] if clock == len(times) else []
        clocks.append((clock, place - 1))
    return clocks


def _times_before(segment: _Segment, channel: int) -> int:
    """Return the column of X values before a channel."""
    return max(place for place, name in enumerate(segment.names[:channel]) if name == _COLUMNS)


def _agree(segment: _Segment, column: int, other: int) -> bool:
    """Return whether two columns hold the same times; of a shorter channel the last are missing."""
    pairs = ((row[column].strip(), row[other].strip()) for row in segment.rows)
    return column == other or all(one == two or not one or not two for one, two in pairs)


def _waveforms(segment: _Segment, channels: int, decimal: str, where: str) -> list[tuple[float, float]]:
    """Return X0 and Delta_X of each channel."""
    found = []
    for number in range(channels):
        begin, step = (_tag(segment.tags, tag, number, decimal) for tag in ("X0", "Delta_X"))
        if begin is None or not step:
            what = "has neither a column of X values nor X0 and Delta_X"
            raise InputError(what, f"{where}, line {segment.lines[0]}", "export it with X_Columns One")
        found.append((begin, step))
    return found


def _with_times(segment: _Segment, kind: str, decimal: str, where: str) -> tuple[list[list[str]], list[int]]:
    """Return the rows of a segment, with the columns of times before the channels, and where measurements begin."""
    channels = [place for place, name in enumerate(segment.names) if name != _COLUMNS]
    if kind == "No":
        distinct = list(dict.fromkeys(_waveforms(segment, len(channels), decimal, where)))
        samples = _tag(segment.tags, "Samples", 0, decimal) or 0.0
        size = int(samples) if 0 < samples < len(segment.rows) else len(segment.rows)
        rows = [
            [*(repr(begin + row % size * step).replace(".", decimal) for begin, step in distinct), *cells[1:]]
            for row, cells in enumerate(segment.rows)
        ]
        return rows, list(range(0, len(rows), size))
    if kind != "Multi":
        return segment.rows, [0]
    clocks = _clocks(segment, kind, decimal, where)
    first = {clock: place for (clock, _), place in reversed(list(zip(clocks, channels, strict=True)))}
    times = [_times_before(segment, first[clock]) for clock in sorted(first)]
    return [[row[place] for place in (*times, *channels)] for row in segment.rows], [0]


def _tag(tags: dict[str, list[str]], tag: str, number: int, decimal: str) -> float | None:
    """Return a channel's number under a tag; the first channel's where there is only one."""
    values = tags.get(tag, [""])
    return layout.number(values[min(number, len(values) - 1)], decimal)


def _stamp(tags: dict[str, list[str]]) -> tuple[int, float] | None:
    """Return the day and the second of it in which a segment began; None where its header does not say it."""
    try:
        day = datetime.strptime(tags["Date"][0], "%Y/%m/%d")
    except (KeyError, ValueError):
        return None
    clock = layout.clock(tags.get("Time", [""])[0])
    return None if clock is None else (day.toordinal(), clock)
