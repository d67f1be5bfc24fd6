"""Which column of a table is the time, which the position, and in what units: by flag, by name, by elimination."""

import re
from dataclasses import replace

from daq.imports import layout, source
from daq.imports.layout import POSITION_NAMES, TIME_NAMES
from daq.imports.table import Table, short
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
EXAMPLE_UNITS = {"time": "ms", "force": "mN, or weight for a force divided by the weight"}
_IN_WORD = re.compile(r"[/,]|\bin\b")  # what stands between a name and its unit
_BRACKETS = (("(", ")"), ("[", "]"))


def named(cells: Table) -> Table:
    """Return a table without a header with the names that a comment above it has, as numpy and trackers write them.

    A comment is one of names where it has as many as there are columns, and one of them is known or has a unit.
    """
    for comment in () if cells.names else cells.comments:
        text = comment.strip().lstrip("#%/").strip()
        names = tuple(name.strip() for name in layout.header(text, cells.delimiter, cells.width))
        known = any(_bare(name) in TIME_NAMES + FRAME_NAMES + POSITION_NAMES or _dimension(name) for name in names)
        if len(names) == cells.width and known and all(cells.number(name) is None for name in names):
            return replace(cells, names=names)
    return cells


def find(
    cells: Table,
    time: str | None,
    position: str | None,
    rate_known: bool,
    flag: str = "--position",
    belt: int | None = None,
) -> tuple[int | None, int, bool]:
    """Find the columns of times and positions: as they are called, by name, by unit, by elimination.

    cells: The table.
    time, position: What the user called them: a name, or a number from 1.
    rate_known: Whether times can be made from a frame rate.
    flag: The flag that ``position`` came from.
    belt: The column of the belt, which is neither.
    Returns: Column of times or None, column of positions, and whether the times are frame numbers.
    Raises InputError: when a column is missing or there is more than one choice, listing the columns.
    """
    t_column = None if time is None else called(cells, time, "--time")
    x_column = None if position is None else called(cells, position, flag)
    clocks = {clock for clock in cells.clocks if clock is not None}
    free = [i for i in range(cells.width) if i not in (t_column, x_column, belt) and i not in clocks]
    frames = False
    if cells.names:
        plain = [_bare(name) for name in cells.names]
        if t_column is None and not clocks:
            t_column = next((i for i in free if plain[i] in TIME_NAMES), None)
            if t_column is None:
                t_column = next((i for i in free if plain[i] in FRAME_NAMES), None)
            t_column = _only(cells, free, "time", x_column) if t_column is None else t_column
        elif t_column is None and len(clocks) == 1:
            t_column = next(iter(clocks))
        if x_column is None:
            places = [i for i in free if plain[i] in POSITION_NAMES and i != t_column]
            if len(places) > 1 and plain[places[0]] == plain[places[1]]:
                raise _ambiguous(cells, "the position", places, "--position")
            x_column = places[0] if places else None
            x_column = _only(cells, free, "length", t_column) if x_column is None else x_column
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
        forces = [i for i in free if _dimension(cells.names[i]) == "force"] if cells.names else []
        what = f"which column is the position? the columns are: {listed}"
        if not forces:
            raise InputError(what, str(cells.path), "give --position")
        flags, keywords = _spring(cells, forces[0])
        do = "give {}, or for the force of a pulling spring {}"
        raise InputError(
            what, str(cells.path), do.format("--position", flags), python=do.format("position=NAME", keywords)
        )
    free = [i for i in free if i != x_column]
    t_column = check_clock(cells, x_column, t_column)
    if t_column is None and len(free) == 1 and not rate_known:
        t_column = free[0]
    if t_column is None and len(free) > 1 and not rate_known:
        raise InputError(f"which column is the time? the columns are: {listed}", str(cells.path), "give --time")
    if t_column == x_column:
        raise InputError("time and position are the same column", str(cells.path), f"the columns are: {listed}")
    return t_column, x_column, frames


def called(cells: Table, name: str, flag: str) -> int:
    """Return the column of a name, or of a number from 1; InputError where there is none."""
    wanted = name.strip()
    for same in (str, str.lower, _bare):
        places = [i for i, column in enumerate(cells.names) if same(column) == same(wanted)]
        if len(places) > 1:
            raise _ambiguous(cells, repr(wanted), places, flag)
        if places:
            return places[0]
    if wanted.isdecimal() and 1 <= int(wanted) <= cells.width:
        return int(wanted) - 1
    known = f"the columns are numbered 1 to {cells.width}"
    if cells.names:
        near = nearest(wanted, cells.names)
        known = (near + " " if near.startswith("did") else "") + f"the columns are: {cells.listed}"
    raise InputError(f"{flag}: no column {name!r}", str(cells.path), known)


def _ambiguous(cells: Table, which: str, places: list[int], flag: str) -> InputError:
    choice = source.shorten(f"{cells.names[i]!r} (column {i + 1})" for i in places)
    return InputError(f"which column is {which}: {choice}?", str(cells.path), f"give {flag}=NUMBER")


def check_clock(cells: Table, column: int, times: int | None) -> int | None:
    """Return the column of a channel's times: the file's own clock of that channel, where it states one.

    Raises InputError: ``times`` are those of another channel.
    """
    own = cells.clocks[column] if cells.clocks else None
    if own is None or times is None or times == own:
        return times if own is None else own
    is_clock = times in cells.clocks
    if is_clock and any(row[times].strip() != row[own].strip() for row in cells.rows):
        what = f"{cells.label(times)} holds the times of another channel, not of {cells.label(column)}"
        raise InputError(what, str(cells.path), f"leave --time out: {cells.label(own)} holds its times")
    return times


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
            match = _IN_WORD.search(name, begin)
            mark = None if match is None or match.end() == len(name) else match.span()
        if mark is not None and mark[0] < at:
            at, unit = mark[0], name[mark[1] :]
    base = name[:at].rstrip()
    return (base, unit.strip()) if base and at < len(name) else (name, None)


def _mark_at_end(text: str) -> tuple[int, int] | None:
    """Return where a separator of name and unit stands that ends a text, None where none does."""
    for length in (1, 2):
        match = _IN_WORD.fullmatch(text, max(0, len(text) - length))
        if match is not None:
            return match.span()
    return None


def _stated_unit(name: str) -> str | None:
    """Return the unit that follows a name, or a name that is itself one, as ``ms``."""
    _, stated = split_unit(name)
    if stated is not None:
        return stated
    if any(units.known(name.strip(), dimension) for dimension in ("time", "length")) and _bare(name) not in TIME_NAMES:
        return name.strip()
    head, _, tail = name.rpartition("_")
    return tail if head and any(units.known(tail, dimension) for dimension in DIMENSIONS) else None


def is_length(name: str) -> bool:
    """Return whether a column states a unit of length."""
    return _dimension(name) == "length"


def _only(cells: Table, free: list[int], dimension: str, but: int | None) -> int | None:
    """Return the one free column with a unit of a dimension; None where there are none or several."""
    alike = [i for i in free if i != but and _dimension(cells.names[i]) == dimension]
    return alike[0] if len(alike) == 1 else None


def _dimension(name: str) -> str:
    """Return the dimension of a column by its unit; "" where it states none that is known."""
    stated = _stated_unit(name)
    return next((each for each in DIMENSIONS if stated is not None and units.known(stated, each)), "")


def _spring(cells: Table, column: int, *others: tuple[str, str]) -> tuple[str, str]:
    """Return what reads a column as the force of a pulling spring: as flags, and as keywords in Python."""
    name = split_unit(cells.names[column])[0]
    given = (("spring-force", name), ("stiffness", "168 N/m"), *others)
    flags = " ".join(f"--{flag} {value if value.isalnum() else repr(value)}" for flag, value in given)
    return flags, ", ".join(f"{flag.replace('-', '_')}={value!r}" for flag, value in given)


def check_length(cells: Table, column: int) -> None:
    """Raise InputError for a column that is no length by its unit or name, unless a flag states its unit.

    A force suggests `daq import --spring-force`; a friction coefficient is asked about; counts need their pitch.
    """
    if not cells.names:
        return
    name = cells.names[column]
    stated, dimension, plain = _stated_unit(name), _dimension(name), _bare(name)
    where, other = cells.place(cells.header_line, column), "choose the position by --position"
    do = "{} {}; else " + other + ", or state its unit by --x-unit"
    if dimension == "force" or (stated is None and plain in FORCE_NAMES):
        is_of = f"is in {stated}: a force" if stated else "is a force by its name"
        how = "for the force of a pulling spring give"
        flags, keywords = _spring(cells, column, *([] if stated else [("force-unit", "N")]))
        what = f"{cells.label(column)} {is_of}, no position"
        raise InputError(what, where, do.format(how, flags), python=in_python(do.format(how, keywords)))
    if dimension in ("speed", "time"):
        raise InputError(f"{cells.label(column)} is in {stated}: a {dimension}, no position", where, other)
    if (stated or "").lower() in RATIO_UNITS or (stated is None and plain in RATIO_NAMES):
        is_of = f"is dimensionless ({stated})" if stated else "is a friction coefficient by its name"
        how = "if it is the force of the pulling spring over the slider's weight give"
        flags, keywords = _spring(cells, column, ("force-unit", "weight"), ("mass", "1 kg"))
        what = f"{cells.label(column)} {is_of}, no position"
        raise InputError(what, where, do.format(how, flags), python=in_python(do.format(how, keywords)))
    if (stated or plain).lower() in COUNT_UNITS:
        do = "give --metres-per-count '7.67 um', or --counts-per-rev=16384 and --circumference '125.66 mm'"
        raise InputError(f"{cells.label(column)} holds counts", where, do)


def belt_unit(cells: Table, column: int, flag_value: str | None) -> tuple[str, float, str]:
    """Return what a column of the belt holds, "length" or "speed", the size of its unit in SI, and its name.

    Raises InputError: its unit is neither stated nor given, or is one of neither dimension.
    """
    stated = flag_value or (_stated_unit(cells.names[column]) if cells.names else None)
    for dimension in ("length", "speed"):
        if stated is not None and (units.known(stated, dimension) or flag_value is not None):
            try:
                return dimension, units.unit_size(stated, dimension, "--belt-unit"), stated
            except InputError:
                continue
    what = f"{cells.label(column)} states no unit" if stated is None else f"{stated!r} is a unit of neither"
    do = "give --belt-unit=mm for a position of the belt, --belt-unit=mm/s for its speed"
    raise InputError(
        f"{what}: is it the position or the speed of the belt?", cells.place(cells.header_line, column), do
    )


def unit(
    cells: Table, column: int, flag_value: str | None, dimension: str, flag: str, warnings: list[str]
) -> tuple[float, str]:
    """Return the size of a column's unit in SI and its name: the flag's, else the header's, else SI.

    Raises InputError: when the header's unit is unknown and the flag was not given.
    """
    stated = _stated_unit(cells.names[column]) if cells.names else None
    if dimension == "length" and flag_value is None:
        check_length(cells, column)
    if flag_value is not None:
        size = units.unit_size(flag_value, dimension, flag)
        if stated and units.known(stated, dimension) and units.unit_size(stated, dimension, flag) != size:
            warnings.append(f"{cells.label(column)} is read in {flag_value} ({flag}), not in {stated}")
        return size, flag_value
    if stated is None:
        return 1.0, units.si_unit(dimension)
    base = split_unit(cells.names[column])[0].strip()
    if base != stated and units.known(base, dimension):
        what = f"column {base!r} has the name of a unit, and its unit is stated as {stated}"
        raise InputError(what, cells.place(cells.header_line, column), f"give {flag}, for example {flag} {base}")
    if not units.known(stated, dimension):
        example = f"'0.25 mm' for {stated} of that size" if dimension == "length" else EXAMPLE_UNITS[dimension]
        what = f"{cells.label(column)} is in {short(stated)}, which is not a known unit of {dimension}"
        do = f"give {flag}, for example {flag} {example}"
        raise InputError(what, cells.place(cells.header_line, column), do)
    return units.unit_size(stated, dimension, flag), stated


def is_stated(cells: Table, column: int, flag_value: str | None) -> bool:
    """Return whether the unit of a column was given by a flag or stands in the header."""
    return flag_value is not None or bool(cells.names and _stated_unit(cells.names[column]))
