"""Which column of a table is the time, which the position, and in what units: by flag, by name, by elimination."""

import re
from dataclasses import replace

from daq.imports import layout, source
from daq.imports.layout import POSITION_NAMES, TIME_NAMES
from daq.imports.table import Table
from stickslip import units
from stickslip.errors import InputError, in_python, nearest

FRAME_NAMES = ("frame", "frames", "frame number", "frame no", "frameno", "image", "slice", "bild")
FORCE_NAMES = (
    *("f", "force", "fx", "fy", "ft", "friction force", "tangential force", "lateral force", "load", "load cell"),
    *("kraft", "reibkraft"),
)
# What is no length though it has no unit: a friction coefficient.
RATIO_NAMES = (
    *("cof", "mu", "\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}", "friction", "friction coefficient"),
    *("coefficient of friction", "reibwert", "reibzahl", "reibungszahl"),
)
RATIO_UNITS = ("-", "1", "%", "dimensionless", "none", "unitless")
COUNT_UNITS = ("count", "counts", "cts", "tick", "ticks", "pulse", "pulses", "inc", "increments", "steps")
DIMENSIONS = ("time", "length", "force", "speed")  # dimensions that a column can have
EXAMPLE_UNITS = {"time": "ms", "force": "mN, or 'weight' for a force divided by the weight"}
# Between a name and its unit; and at the end of what precedes a unit.
_IN_WORD, _IN_WORD_AT_END = re.compile(r"[/,]|\bin\b"), re.compile(r"(?:[/,]|\bin)$")
_BRACKETS = (("(", ")"), ("[", "]"))


def name_from_comment(cells: Table) -> Table:
    """Name the columns of a table without a header by a comment above it, as numpy and trackers write them."""
    for comment in () if cells.names else cells.comments:
        text = comment.strip().lstrip("#%/").strip()
        names = tuple(name.strip() for name in layout.split_header(text, cells.delimiter, cells.width))
        is_header = any(
            _strip_unit(name) in TIME_NAMES + FRAME_NAMES + POSITION_NAMES or find_dimension(name) for name in names
        )
        if len(names) == cells.width and is_header and all(cells.number(name) is None for name in names):
            return replace(cells, names=names)
    return cells


def find_columns(
    cells: Table, time: str | None, position: str | None, rate_known: bool, flag: str, belt: int | None
) -> tuple[int | None, int, bool]:
    """Find the column of times (None: a frame rate), that of positions, and whether the times are frame numbers."""
    t_column = None if time is None else find_by_name(cells, time, "--time")
    x_column = None if position is None else find_by_name(cells, position, flag)
    clocks = {clock for clock in cells.clocks if clock is not None}
    free = [i for i in range(cells.width) if i not in (t_column, x_column, belt) and i not in clocks]
    frames = False
    if cells.names:
        plain = [_strip_unit(name) for name in cells.names]
        if t_column is None and not clocks:
            t_column = next((i for names in (TIME_NAMES, FRAME_NAMES) for i in free if plain[i] in names), None)
            t_column = _find_only(cells, free, "time", x_column) if t_column is None else t_column
        elif t_column is None and len(clocks) == 1:
            t_column = next(iter(clocks))
        if x_column is None:
            matches = [i for i in free if plain[i] in POSITION_NAMES and i != t_column]
            if len(matches) > 1 and plain[matches[0]] == plain[matches[1]]:
                raise _ambiguity_error(cells, "the position", matches, "--position")
            x_column = matches[0] if matches else None
            x_column = _find_only(cells, free, "length", t_column) if x_column is None else x_column
        frames = t_column is not None and plain[t_column] in FRAME_NAMES
    free = [i for i in free if i not in (t_column, x_column)]
    listed = cells.listed or f"1 to {cells.width}"
    if x_column is None and cells.width == 1:
        x_column, t_column = 0, None
    elif len(free) == 2 and t_column is None and x_column is None:
        t_column, x_column = free
    elif x_column is None and len(free) == 1:
        x_column = free[0]
    if x_column is None:
        force_columns = [i for i in free if find_dimension(cells.names[i]) == "force"] if cells.names else []
        what = f"which column is the position? the columns are: {listed}"
        if not force_columns:
            raise InputError(what, str(cells.path), "choose one with --position")
        flags, keywords = _suggest_spring_flags(cells, force_columns[0])
        do = "use {}, or {} for the force of a pulling spring"
        raise InputError(
            what, str(cells.path), do.format("--position", flags), python=do.format("position=NAME", keywords)
        )
    free = [i for i in free if i != x_column]
    t_column = check_clock(cells, x_column, t_column)
    if t_column is None and len(free) == 1 and not rate_known:
        t_column = free[0]
    if t_column is None and len(free) > 1 and not rate_known:
        raise InputError(
            f"which column is the time? the columns are: {listed}", str(cells.path), "choose one with --time"
        )
    if t_column == x_column:
        raise InputError("time and position are the same column", str(cells.path), f"the columns are: {listed}")
    return t_column, x_column, frames


def find_by_name(cells: Table, name: str, flag: str) -> int:
    """Return the column of a name, or of a number from 1."""
    wanted = name.strip()
    for normalise in (str, str.lower, _strip_unit):
        matches = [i for i, column in enumerate(cells.names) if normalise(column) == normalise(wanted)]
        if len(matches) > 1:
            raise _ambiguity_error(cells, repr(wanted), matches, flag)
        if matches:
            return matches[0]
    if wanted.isdecimal() and 1 <= int(wanted) <= cells.width:
        return int(wanted) - 1
    hint = f"the columns are numbered from 1 to {cells.width}"
    if cells.names:
        near = nearest(wanted, cells.names)
        hint = (near + " " if near.startswith("did") else "") + f"the columns are: {cells.listed}"
    raise InputError(f"{flag}: no column {name!r}", str(cells.path), hint)


def _ambiguity_error(cells: Table, which: str, places: list[int], flag: str) -> InputError:
    choice = source.shorten(f"{cells.names[i]!r} (column {i + 1})" for i in places)
    return InputError(f"which column is {which}: {choice}?", str(cells.path), f"choose one with {flag}=NUMBER")


def check_clock(cells: Table, column: int, time: int | None) -> int | None:
    """Return the column of a channel's times: the file's own clock of that channel, where it states one."""
    clock = cells.clocks[column] if cells.clocks else None
    if clock is None or time is None or time == clock:
        return time if clock is None else clock
    is_clock = time in cells.clocks
    if is_clock and any(row[time].strip() != row[clock].strip() for row in cells.rows):
        what = f"{cells.label(time)} contains the times of another channel than {cells.label(column)}"
        raise InputError(what, str(cells.path), f"omit --time: {cells.label(clock)} has its times")
    return time


def _strip_unit(name: str) -> str:
    """Return a column's name without its unit, in lower case: ``x (cm)`` and ``x_cm`` are ``x``."""
    base, _ = split_unit(name)
    head, _, tail = base.rpartition("_")
    if head and any(units.is_unit(tail, dimension) for dimension in DIMENSIONS):
        base = head
    return base.strip().lower().rstrip("#").strip()


def split_unit(name: str) -> tuple[str, str | None]:
    """Split ``x (cm)``, ``x [cm]``, ``x/cm``, ``x, cm`` or ``x in cm`` into name and unit, the longest if ambiguous."""
    end, unit = len(name), ""
    for opening, closing in _BRACKETS:
        begin = name.rfind(opening)
        inside = name[begin + 1 : -1]
        if begin >= 0 and name.endswith(closing) and closing not in inside:
            end, unit = begin, inside
    last = name.split()[-1:]
    if last and name.endswith(last[0]):
        begin = len(name) - len(last[0])
        before = name[:begin].rstrip()
        mark = _IN_WORD_AT_END.search(before, max(0, len(before) - 2)) or _IN_WORD.search(name, begin)
        if mark is not None and mark.end() < len(name) and mark.start() < end:
            end, unit = mark.start(), name[mark.end() :]
    base = name[:end].rstrip()
    return (base, unit.strip()) if base and end < len(name) else (name, None)


def _read_stated_unit(name: str) -> str | None:
    """Return the unit that follows a name, or a name that is itself one, as ``ms``."""
    _, stated = split_unit(name)
    if stated is not None:
        return stated
    if (
        any(units.is_unit(name.strip(), dimension) for dimension in ("time", "length"))
        and _strip_unit(name) not in TIME_NAMES
    ):
        return name.strip()
    head, _, tail = name.rpartition("_")
    return tail if head and any(units.is_unit(tail, dimension) for dimension in DIMENSIONS) else None


def _find_only(cells: Table, free: list[int], dimension: str, but: int | None) -> int | None:
    """Return the only free column with a unit of a dimension; None where there are none or several."""
    alike = [i for i in free if i != but and find_dimension(cells.names[i]) == dimension]
    return alike[0] if len(alike) == 1 else None


def find_dimension(name: str) -> str:
    """Return the dimension of a column by its unit; "" where it states none that is known."""
    stated = _read_stated_unit(name)
    return next((each for each in DIMENSIONS if stated is not None and units.is_unit(stated, each)), "")


def _suggest_spring_flags(cells: Table, column: int, *others: tuple[str, str]) -> tuple[str, str]:
    """Return what reads a column as the force of a pulling spring: as flags, and as keywords in Python."""
    name = split_unit(cells.names[column])[0]
    given = (("spring-force", name), ("stiffness", "168 N/m"), *others)
    flags = " ".join(f"--{flag} {value if value.isalnum() else repr(value)}" for flag, value in given)
    return flags, ", ".join(f"{flag.replace('-', '_')}={value!r}" for flag, value in given)


def check_length(cells: Table, column: int) -> None:
    """Raise InputError for a column that is not a length by its unit or name, unless a flag states its unit."""
    if not cells.names:
        return
    name = cells.names[column]
    stated, dimension, plain = _read_stated_unit(name), find_dimension(name), _strip_unit(name)
    where, other = cells.locate(cells.header_line, column), "choose the column of positions with --position"
    do = "{} {}; else " + other + ", or state its unit with --x-unit"
    others: list[tuple[str, str]] = []
    if dimension == "force" or (stated is None and plain in FORCE_NAMES):
        kind = f"in {stated}: a force" if stated else "a force by its name"
        how = "for the force of a pulling spring, use"
        others = [] if stated else [("force-unit", "N")]
    elif dimension in ("speed", "time"):
        raise InputError(
            f"{cells.label(column)} is in {stated}, so it is a {dimension} and not a position", where, other
        )
    elif (stated or "").lower() in RATIO_UNITS or (stated is None and plain in RATIO_NAMES):
        kind = f"dimensionless ({stated})" if stated else "a friction coefficient by its name"
        how = "if it is the force of a pulling spring divided by the weight of the slider, use"
        others = [("force-unit", "weight"), ("mass", "1 kg")]
    elif (stated or plain).lower() in COUNT_UNITS:
        do = "use --metres-per-count '7.67 um', or --counts-per-rev=16384 and --circumference '125.66 mm'"
        raise InputError(f"{cells.label(column)} contains counts", where, do)
    else:
        return
    flags, keywords = _suggest_spring_flags(cells, column, *others)
    what, do_in_python = f"{cells.label(column)} is {kind}, not a position", in_python(do.format(how, keywords))
    raise InputError(what, where, do.format(how, flags), python=do_in_python)


def read_belt_unit(cells: Table, column: int, flag_value: str | None) -> tuple[str, float, str]:
    """Return the dimension of a belt column, "length" or "speed", the size of its unit in SI, and its name."""
    stated = flag_value or (_read_stated_unit(cells.names[column]) if cells.names else None)
    for dimension in ("length", "speed"):
        if stated is not None and (units.is_unit(stated, dimension) or flag_value is not None):
            try:
                return dimension, units.unit_size(stated, dimension, "--belt-unit"), stated
            except InputError:
                continue
    what = f"{cells.label(column)} has no unit" if stated is None else f"{stated!r} is not a unit of length or speed"
    do = "use --belt-unit=mm for a position, or --belt-unit=mm/s for a speed"
    raise InputError(
        f"{what}: is it the position or the speed of the belt?", cells.locate(cells.header_line, column), do
    )


def read_unit(
    cells: Table, column: int, flag_value: str | None, dimension: str, flag: str, warnings: list[str]
) -> tuple[float, str]:
    """Return the size of a column's unit in SI and its name: the flag's, else the header's, else SI."""
    stated = _read_stated_unit(cells.names[column]) if cells.names else None
    if dimension == "length" and flag_value is None:
        check_length(cells, column)
    if flag_value is not None:
        size = units.unit_size(flag_value, dimension, flag)
        if stated and units.is_unit(stated, dimension) and units.unit_size(stated, dimension, flag) != size:
            warnings.append(
                f"{cells.label(column)} is read in {flag_value} ({flag}), although the table states {stated}"
            )
        return size, flag_value
    if stated is None:
        return 1.0, units.si_unit(dimension)
    base = split_unit(cells.names[column])[0].strip()
    if base != stated and units.is_unit(base, dimension):
        what = f"column {base!r} is named like a unit, but its unit is stated as {stated}"
        raise InputError(what, cells.locate(cells.header_line, column), f"use {flag}, for example {flag} {base}")
    if not units.is_unit(stated, dimension):
        example = f"'0.25 mm' for {stated} of that size" if dimension == "length" else EXAMPLE_UNITS[dimension]
        what = f"{cells.label(column)} is in {source.cut(stated)!r}, which is not a known unit of {dimension}"
        do = f"use {flag}, for example {flag} {example}"
        raise InputError(what, cells.locate(cells.header_line, column), do)
    return units.unit_size(stated, dimension, flag), stated


def is_stated(cells: Table, column: int, flag_value: str | None) -> bool:
    """Return whether the unit of a column was given by a flag or is in the header."""
    return flag_value is not None or bool(cells.names and _read_stated_unit(cells.names[column]))
