"""Which column of a table is the time, which the position, and in what units: by flag, by name, by elimination."""

import re

from daq.base import units
from daq.base.errors import InputError, nearest
from daq.imports.table import Table, short

TIME_NAMES = ("t", "time", "times", "timestamp", "seconds", "zeit", "temps", "tiempo", "tempo")
FRAME_NAMES = ("frame", "frames", "frame number", "frame no", "frameno", "image", "slice", "bild")
POSITION_NAMES = ("x", "position", "pos", "displacement", "distance", "weg", "ort", "auslenkung")
DIMENSIONS = ("time", "length", "force")  # of columns
EXAMPLE_UNITS = {"time": "ms", "force": "mN, or weight for a force divided by the weight"}
_IN_WORD = re.compile(r"[/,]|\bin\b")  # what stands between a name and its unit
_BRACKETS = (("(", ")"), ("[", "]"))


def find(
    cells: Table, time: str | None, position: str | None, rate_known: bool, flag: str = "--position"
) -> tuple[int | None, int, bool]:
    """Find the columns of times and positions.

    Parameters
    ----------
    cells : Table
        The table.
    time, position : str or None
        What the user called them: a name, or a number from 1.
    rate_known : bool
        Whether times can be made from a frame rate.
    flag : str
        The flag that ``position`` came from.

    Returns
    -------
    tuple
        Column of times or None, column of positions, and whether the times are frame numbers.

    Raises
    ------
    InputError
        When a column is missing or there is more than one choice, listing the columns.
    """
    t_column = None if time is None else _named(cells, time, "--time")
    x_column = None if position is None else _named(cells, position, flag)
    free = [i for i in range(cells.width) if i not in (t_column, x_column)]
    frames = False
    if cells.names:
        plain = [_bare(name) for name in cells.names]
        if t_column is None:
            t_column = next((i for i in free if plain[i] in TIME_NAMES), None)
            if t_column is None:
                t_column = next((i for i in free if plain[i] in FRAME_NAMES), None)
        if x_column is None:
            called = [i for i in free if plain[i] in POSITION_NAMES and i != t_column]
            if len(called) > 1 and plain[called[0]] == plain[called[1]]:
                both = " and ".join(f"{short(cells.names[i])} (column {i + 1})" for i in called[:2])
                raise InputError(f"which column is the position: {both}?", str(cells.path), "give --position NUMBER")
            x_column = called[0] if called else None
        frames = t_column is not None and plain[t_column] in FRAME_NAMES
    free = [i for i in free if i not in (t_column, x_column)]
    listed = cells.listed or f"1 to {cells.width}"
    if x_column is None and cells.width == 1:
        x_column, t_column = 0, None
    elif cells.width == 2 and t_column is None and x_column is None:
        t_column, x_column = 0, 1
    elif x_column is None and len(free) == 1:
        x_column = free[0]
    if x_column is None:
        raise InputError(f"which column is the position? the columns are: {listed}", str(cells.path), "give --position")
    if t_column is None and cells.width == 2 and not rate_known:
        t_column = 1 - x_column
    if t_column is None and cells.width > 2 and not rate_known:
        raise InputError(f"which column is the time? the columns are: {listed}", str(cells.path), "give --time")
    if t_column == x_column:
        raise InputError("time and position are the same column", str(cells.path), f"the columns are: {listed}")
    return t_column, x_column, frames


def _named(cells: Table, name: str, flag: str) -> int:
    wanted = name.strip()
    for same in (str, str.lower, _bare):
        for i, found in enumerate(cells.names):
            if same(found) == same(wanted):
                return i
    if wanted.isdecimal() and 1 <= int(wanted) <= cells.width:
        return int(wanted) - 1
    known = f"the columns are numbered 1 to {cells.width}"
    if cells.names:
        near = nearest(wanted, cells.names)
        known = (near + " " if near.startswith("did") else "") + f"the columns are: {cells.listed}"
    raise InputError(f"{flag}: no column {name!r}", str(cells.path), known)


def _bare(name: str) -> str:
    """Return a column's name without its unit, in lower case: ``x (cm)`` and ``x_cm`` are ``x``."""
    base, _ = split_unit(name)
    head, _, tail = base.rpartition("_")
    if head and any(units.known(tail, dimension) for dimension in DIMENSIONS):
        base = head
    return base.strip().lower().rstrip("#").strip()


def split_unit(name: str) -> tuple[str, str | None]:
    """Return a column's name without the unit after it, and the unit; the whole name and None where none follows.

    A unit follows as in ``x (cm)``, ``x [cm]``, ``x/cm``, ``x, cm`` or ``x in cm``; of several readings the longest
    unit is taken.  The name is looked through a fixed number of times, however long it is.
    """
    at, unit = len(name), ""
    for opening, closing in _BRACKETS:
        begin = name.rfind(opening)
        inside = name[begin + 1 : -1]
        if begin >= 0 and name.endswith(closing) and closing not in inside:
            at, unit = begin, inside
    last = name.split()[-1:]
    if last and name.endswith(last[0]):
        begin = len(name) - len(last[0])
        before = name[:begin].rstrip()
        mark = _mark_at_end(before)
        if mark is None:
            found = _IN_WORD.search(name, begin)
            mark = None if found is None or found.end() == len(name) else found.span()
        if mark is not None and mark[0] < at:
            at, unit = mark[0], name[mark[1] :]
    base = name[:at].rstrip()
    return (base, unit.strip()) if base and at < len(name) else (name, None)


def _mark_at_end(text: str) -> tuple[int, int] | None:
    """Return where a separator of name and unit stands that ends a text, None where none does."""
    for length in (1, 2):
        found = _IN_WORD.fullmatch(text, max(0, len(text) - length))
        if found is not None:
            return found.span()
    return None


def _stated_unit(name: str) -> str | None:
    _, stated = split_unit(name)
    if stated is not None:
        return stated
    head, _, tail = name.rpartition("_")
    return tail if head and any(units.known(tail, dimension) for dimension in DIMENSIONS) else None


def unit(
    cells: Table, column: int, flag_value: str | None, dimension: str, flag: str, warnings: list[str]
) -> tuple[float, str]:
    """Return the size of a column's unit in SI and its name: the flag's, else the header's, else SI.

    Raises
    ------
    InputError
        When the header's unit is unknown and the flag was not given.
    """
    stated = _stated_unit(cells.names[column]) if cells.names else None
    if flag_value is not None:
        size = units.unit_size(flag_value, dimension, flag)
        if stated and units.known(stated, dimension) and units.unit_size(stated, dimension, flag) != size:
            warnings.append(f"{cells.label(column)} is read in {flag_value} ({flag}), not in {stated}")
        return size, flag_value
    if stated is None:
        return 1.0, units.si_unit(dimension)
    if not units.known(stated, dimension):
        example = "'0.25 mm' for a pixel of that size" if dimension == "length" else EXAMPLE_UNITS[dimension]
        what = f"{cells.label(column)} is in {short(stated)}, which is not a known unit of {dimension}"
        do = f"give {flag}, for example {flag} {example}"
        raise InputError(what, cells.place(cells.header_line, column), do)
    return units.unit_size(stated, dimension, flag), stated


def is_stated(cells: Table, column: int, flag_value: str | None) -> bool:
    """Return whether the unit of a column was given by a flag or stands in the header."""
    return flag_value is not None or bool(cells.names and _stated_unit(cells.names[column]))
