"""A sheet of an Excel workbook (.xlsx) as a table, its header and units found as in a text file.

A child process reads the file, with openpyxl of the extra ``formats``.  Formulas count by the values that the
spreadsheet has stored beside them.  What a sheet says of its own size is not believed.  A date or a time is read from
its serial number, to the microsecond: the library rounds it to milliseconds.
"""

import io
import json
import zipfile
from dataclasses import replace
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any

from daq.imports import layout, source, table
from daq.imports.formats.columns import parse_isolated, refuse_unreadable, require
from daq.imports.lines import number_lines
from daq.imports.table import Table
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError

SAVE = "save it again as .xlsx, or export the sheet as CSV"
# CPU time of the child and its memory beyond that of Python: 100,000 rows of four columns take 5 s and 150 MB.
SECONDS, MEMORY = 120.0, 1 << 30
FEWEST_ROWS = 2  # with two numbers or more, of a sheet with a table
DAY_US = 86_400_000_000


def read(path: Path, sheet: str | None, preamble: int = 0, progress: Stages = silent) -> Table:
    """Read a sheet of a workbook; without ``sheet`` the only one with a table."""
    where = str(path)
    require("openpyxl", path)
    answer = json.loads(parse_isolated(_parse, path, SECONDS, MEMORY, "workbook", SAVE))
    sheets: dict[str, list[tuple[int, str]]] = answer["sheets"]
    tables = [name for name, lines in sheets.items() if sum(_is_row(line) for _, line in lines) >= FEWEST_ROWS]
    if sheet is None:
        if len(tables) != 1:
            what = (
                f"which sheet is the table? {source.shorten(map(repr, tables))}"
                if tables
                else "no sheet contains a table"
            )
            raise InputError(
                what, where, "choose one with --sheet=NAME" if tables else "choose a sheet with times and positions"
            )
        sheet = tables[0]
    elif sheet not in sheets:
        raise InputError(f"no sheet {sheet!r}", where, f"the sheets are: {source.shorten(map(repr, sheets))}")
    lines = number_lines("\n".join(text for _, text in sheets[sheet]), [number for number, _ in sheets[sheet]])
    cells = table.parse_lines(path, lines, preamble, progress, delimiter_known="\t")
    return replace(cells, kind="workbook", sha256=answer["sha256"], modified_s=answer["modified_s"])


def _is_row(line: str) -> bool:
    return (
        sum(
            layout.read_number(cell, ".") is not None or layout.read_clock(cell) is not None
            for cell in line.split("\t")
        )
        >= 2
    )


def _parse(path: Path) -> bytes:
    """Return the sheets of a workbook by name, each as numbered lines of cells separated by tabs."""
    import warnings

    from openpyxl import load_workbook

    file = source.read(path, "choose a workbook in it")
    with refuse_unreadable("workbook", path, SAVE), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about extensions that hold no cells
        unpacked = sum(entry.file_size for entry in zipfile.ZipFile(io.BytesIO(file.data)).infolist())
        source.check_bytes(unpacked, str(path))
        book = load_workbook(io.BytesIO(file.data), read_only=True, data_only=True)
        state = vars(book)
        dates, durations = state["_date_formats"], state["_timedelta_formats"]
        state["_date_formats"] = frozenset()  # so that serial numbers come as they are
        sheets = {sheet.title: _read_lines(sheet, dates, durations, book.epoch, path) for sheet in book.worksheets}
    return json.dumps({"sha256": file.sha256, "modified_s": file.modified_s, "sheets": sheets}).encode()


def _read_lines(sheet: Any, dates: set[int], durations: set[int], epoch: datetime, path: Path) -> list[tuple[int, str]]:
    """Return number and text of each row that is not empty."""
    sheet.reset_dimensions()
    lines: list[tuple[int, str]] = []
    cells = 0
    for number, row in enumerate(sheet.iter_rows(), start=1):
        texts = [_format_cell(cell, dates, durations, epoch) for cell in row]
        while texts and not texts[-1]:
            texts.pop()
        if texts:
            cells += len(row)
            source.check_size(cells, 1, f"{path}, sheet {sheet.title!r}")
            lines.append((number, "\t".join(texts)))
    return lines


def _format_cell(cell: Any, dates: set[int], durations: set[int], epoch: datetime) -> str:
    value = cell.value
    if value is None:
        return ""
    style = getattr(cell, "_style_id", None)
    if style in dates and isinstance(value, int | float):
        return _format_time(float(value), epoch, is_duration=style in durations)
    if isinstance(value, datetime | time):  # a cell that holds a date as text
        return value.isoformat(" ") if isinstance(value, datetime) else value.isoformat()
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    if isinstance(value, bool):
        return str(value)
    return repr(value) if isinstance(value, int | float) else " ".join(str(value).split())


def _format_time(days: float, epoch: datetime, *, is_duration: bool) -> str:
    """Return a serial number as a duration in s, a time of day, or a date with one."""
    microseconds = round(days * DAY_US)
    if is_duration:
        return repr(microseconds / 1e6)
    moment = epoch + timedelta(microseconds=microseconds)
    text = moment.isoformat(" ", "microseconds")
    return text if days >= 1 else text.split(" ")[1]
