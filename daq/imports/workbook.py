"""A sheet of an Excel workbook (.xlsx) as a table, its header and units found as in a text file.

A child process reads the file, with openpyxl of the extra ``formats``.  Formulas count by the values that the
spreadsheet has stored beside them; of a date with a time the time of day is taken, as of text (--clock).
"""

import json
from dataclasses import replace
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any

from daq.imports import layout, table
from daq.imports.extra import needed
from daq.imports.table import Table
from daq.runfile.isolation import BrokenOffError, isolated
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError

SAVE = "save it again as .xlsx, or export the sheet as CSV"
# CPU time of the child and its memory beyond that of Python: 100,000 rows of four columns take 5 s and 150 MB.
SECONDS, MEMORY = 120.0, 1 << 30
FEWEST_ROWS = 2  # with two numbers or more, of a sheet with a table


def read(path: Path, sheet: str | None, preamble: int = 0, progress: Stages = silent) -> Table:
    """Read a sheet of a workbook.

    Parameters
    ----------
    path : Path
        The file.
    sheet : str or None
        Name of the sheet; None: the only one with a table.
    preamble, progress
        As of `daq.imports.table.read`.

    Raises
    ------
    InputError
        The file is missing, damaged or no workbook, openpyxl is not installed, there is no such sheet, or several
        sheets hold a table.
    """
    where = str(path)
    if not path.is_file():
        raise InputError("no such file", where, "check the path")
    needed("openpyxl", path)
    try:
        sheets: dict[str, list[str]] = json.loads(isolated(_sheets, path, SECONDS, MEMORY))
    except BrokenOffError as error:
        raise InputError(f"cannot be read: it {error}", where, SAVE) from error
    tables = [name for name, lines in sheets.items() if sum(map(_is_row, lines)) >= FEWEST_ROWS]
    if sheet is None:
        if len(tables) != 1:
            what = f"which sheet is the table? {', '.join(map(repr, tables))}" if tables else "no sheet holds a table"
            raise InputError(what, where, "give --sheet=NAME" if tables else "give a sheet with times and positions")
        sheet = tables[0]
    elif sheet not in sheets:
        raise InputError(f"no sheet {sheet!r}", where, f"the sheets are: {', '.join(map(repr, sheets))}")
    found = table.of_lines(path, ["sep=\t", *sheets[sheet]], preamble + 1 if preamble else 0, progress)
    lines = [line - 1 for line in found.lines]
    return replace(found, lines=lines, header_line=max(found.header_line - 1, 0), kind="workbook")


def _is_row(line: str) -> bool:
    return sum(layout.number(cell, ".") is not None for cell in line.split("\t")) >= 2


def _sheets(path: Path) -> bytes:
    """Return the sheets of a workbook by name, each as lines of cells separated by tabs."""
    import warnings

    from openpyxl import load_workbook

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about extensions that hold no cells
            book = load_workbook(path, read_only=True, data_only=True)
            sheets = {
                sheet.title: ["\t".join(map(_cell, row)) for row in sheet.iter_rows(values_only=True)]
                for sheet in book.worksheets
            }
    except MemoryError:
        raise
    except Exception as error:  # whatever the library stumbles over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a workbook ({reason})", str(path), SAVE) from error
    return json.dumps(sheets).encode()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value)
    if isinstance(value, datetime):
        return value.time().isoformat()
    if isinstance(value, time):
        return value.isoformat()
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    if isinstance(value, int | float):
        return repr(value)
    return " ".join(str(value).split())
