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
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
    where = str(path)
    lines = text.split("\n")
    separators = (re.match(r"Separator[\t,](\w+)", line) for line in lines[:MOST_TAGS])
    separator = next((_SEPARATORS.get(match[1], "\t") for match in separators if match), "\t")
    end = next((number for number, line in enumerate(lines) if _has_tag(line, _END, separator)), None)
    if end is None:
        raise InputError("its header does not end", where, "export it again, or delete the lines above the table")
    header = _parse_tags(lines[:end], separator)
    segments = [segment for segment in _split_segments(lines, end + 1, separator, where) if segment.rows]
    if not segments or {*segments[0].names} <= {_COLUMNS}:
        raise InputError("has no numbers", where, "give a measurement with a channel of positions")
    first = segments[0]
    decimal = header.get("Decimal_Separator", [""])[0] or _find_decimal(
        first.rows[0]
    )  # before version 2 nobody says it
    for segment in segments:
        _check_segment(segment, first, where)
    kind = header.get("X_Columns", ["One"])[0]
    names, clocks, *_ = _lay_out(first, kind, decimal, where)
    rows: list[Sequence[str]] = []
    numbers: list[int] = []
    starts: list[int] = []
    origin = _read_stamp(first.tags)
    last = -math.inf
    for segment in segments:
        _, _, timed_rows, measurement_starts = _lay_out(segment, kind, decimal, where)
        times = [layout.read_number(row[0], decimal) for row in timed_rows]
        begin = next((time for time in times if time is not None), None)
        shift = 0.0
        if begin is not None and begin <= last:
            stamp = _read_stamp(segment.tags)
            if stamp is not None and origin is not None:
                shift = DAY_S * (stamp[0] - origin[0]) + (stamp[1] - origin[1])
            if begin + shift <= last:
                shift = math.nan  # nobody knows when
        step = _compute_mean_step(times)
        is_separate = begin is None or not begin + shift - last <= LONGEST_BREAK * step
        starts += [len(rows) + row for row in measurement_starts if row or is_separate]
        if shift > 0:
            for row in timed_rows:
                for column in range(clocks.count(None)):
                    value = layout.read_number(row[column], decimal)
                    row[column] = row[column] if value is None else repr(value + shift).replace(".", decimal)
        finite_times = [time for time in times if time is not None]
        last = finite_times[-1] + (shift if shift > 0 else 0.0) if finite_times else last
        rows += timed_rows
        numbers += segment.lines
    recorded = " ".join(header.get(tag, [""])[0].strip() for tag in ("Date", "Time")).strip()
    header_line = first.lines[0] - 1
    lines_of_rows, width = np.array(numbers, np.int32), len(names)
    cells = Table(path, tuple(names), rows, lines_of_rows, width, separator, decimal, header_line, "LabVIEW", recorded)
    return replace(cells, clocks=tuple(clocks), starts=tuple(starts) or (0,))


def _compute_mean_step(times: Sequence[float | None]) -> float:
    """Return the mean step of times; infinite for fewer than two."""
    finite_times = [time for time in times if time is not None]
    return (finite_times[-1] - finite_times[0]) / (len(finite_times) - 1) if len(finite_times) > 1 else math.inf


def _check_segment(segment: _Segment, first: _Segment, where: str) -> None:
    place = f"{where}, line {segment.lines[0]}"
    source.check_size(len(segment.rows), len(segment.names), where)
    if segment.names != first.names:
        others, names = source.shorten(segment.names), source.shorten(first.names)
        what = f"a segment has the channels {others}, but the first segment has {names}"
        raise InputError(what, place, "export segments with equal channels")
    for dimension in segment.tags.get("X_Dimension", []):
        if dimension not in ("", "Time"):
            what = f"X_Dimension is {dimension[:40]!r}, so the X values are not times"
            raise InputError(what, place, "export the signal against time")


def _has_tag(line: str, tag: str, separator: str) -> bool:
    return line.split(separator, 1)[0].strip() == tag


def _parse_tags(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    tags = {}
    for line in lines:
        tag, *values = line.split(separator)
        if values and tag.strip():
            tags[tag.strip()] = [value.strip() for value in values]
    return tags


def _split_segments(lines: Sequence[str], first: int, separator: str, where: str) -> list[_Segment]:
    cells_kept = 0
    segments: list[_Segment] = []
    header: list[str] = []
    special = named = False
    for number, line in enumerate(lines[first:], start=first + 1):
        if _has_tag(line, _SPECIAL, separator):
            special = True
        elif _has_tag(line, _SPECIAL_END, separator):
            special = False
        elif special or not line.strip():
            continue
        elif _has_tag(line, "Channels", separator):  # the header of a segment begins
            header, named = [line], False
        elif _has_tag(line, _END, separator):
            named = False
        elif _has_tag(line, _COLUMNS, separator) and not named:
            names = [name.strip() for name in line.rstrip(separator).split(separator)]
            names = names[:-1] if names[-1] == "Comment" else names
            source.check_size(1, len(names), where)
            segments.append(_Segment(_parse_tags(header, separator), names, [], []))
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


def _find_decimal(cells: Sequence[str]) -> str:
    commas = any(layout.read_number(cell, ".") is None and layout.read_number(cell, ",") is not None for cell in cells)
    return "," if commas else "."


class _Layout(NamedTuple):
    """A segment as a table: the columns of times, then the channels."""

    names: list[str]  # of the columns, with their units
    clocks: list[int | None]  # of each channel the column with its times, of a column of times None
    rows: list[list[str]]
    starts: list[int]  # rows at which measurements begin


def _lay_out(segment: _Segment, kind: str, decimal: str, where: str) -> _Layout:
    channels = [column for column, name in enumerate(segment.names) if name != _COLUMNS]
    tags = [column - 1 for column in channels]  # number of each channel among the tags of the header
    size = len(segment.rows)  # of a measurement
    if kind == "No":
        tags = list(range(len(channels)))
        waveforms = [_read_waveform(segment, number, decimal, where) for number in tags]
        distinct = list(dict.fromkeys(waveforms))
        clocks = [distinct.index(waveform) for waveform in waveforms]
        samples = _read_tag(segment.tags, "Samples", 0, decimal) or 0.0
        size = int(samples) if 0 < samples < size else size
        times = [
            [repr(begin + row % size * step).replace(".", decimal) for begin, step in distinct]
            for row in range(len(segment.rows))
        ]
    else:
        # X values stand in the first column, or in one before each channel; of equal ones the first is kept.
        kept: list[int] = []
        clocks = []
        for column in channels:
            before = max(other for other in range(column) if segment.names[other] == _COLUMNS) if kind == "Multi" else 0
            equal = (index for index, other in enumerate(kept) if _have_equal_times(segment, before, other))
            clocks.append(next(equal, len(kept)))
            kept += [before] if clocks[-1] == len(kept) else []
        times = [[row[column] for column in kept] for row in segment.rows]
    count = max(clocks, default=-1) + 1
    names = ["Time (s)"] if count == 1 else [f"Time {number + 1} (s)" for number in range(count)]
    units = segment.tags.get("Y_Unit_Label", [])
    for column, tag in zip(channels, tags, strict=True):
        unit = units[tag] if tag < len(units) else ""
        names.append(f"{segment.names[column]} ({unit})" if unit else segment.names[column])
    rows = [[*own, *(row[column] for column in channels)] for own, row in zip(times, segment.rows, strict=True)]
    return _Layout(names, [*[None] * count, *clocks], rows, list(range(0, len(rows), size)))


def _have_equal_times(segment: _Segment, column: int, other: int) -> bool:
    """Return whether two columns hold the same times; the last ones of a shorter channel are missing."""
    pairs = ((row[column].strip(), row[other].strip()) for row in segment.rows)
    return column == other or all(first == second or not first or not second for first, second in pairs)


def _read_waveform(segment: _Segment, number: int, decimal: str, where: str) -> tuple[float, float]:
    """Return X0 and Delta_X of a channel."""
    begin, step = (_read_tag(segment.tags, tag, number, decimal) for tag in ("X0", "Delta_X"))
    if begin is None or not step:
        what = "has neither a column of X values nor X0 and Delta_X"
        raise InputError(what, f"{where}, line {segment.lines[0]}", "export it with X_Columns One")
    return begin, step


def _read_tag(tags: dict[str, list[str]], tag: str, number: int, decimal: str) -> float | None:
    """Return a channel's number under a tag; the first channel's where there is only one."""
    values = tags.get(tag, [""])
    return layout.read_number(values[min(number, len(values) - 1)], decimal)


def _read_stamp(tags: dict[str, list[str]]) -> tuple[int, float] | None:
    """Return the day and the second of it in which a segment began; None where its header does not contain it."""
    try:
        day = datetime.strptime(tags["Date"][0], "%Y/%m/%d")
    except (KeyError, ValueError):
        return None
    clock = layout.read_clock(tags.get("Time", [""])[0])
    return None if clock is None else (day.toordinal(), clock)
