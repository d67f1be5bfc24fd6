"""Columns of text lines: how the values of a line become a sample; see `daq.protocols.text` for their names.

A line holds values in the order of the columns, or labelled values (``t=12,pos=34``).  Labels are mapped to columns
once; one pattern, which contains these labels, then reads all lines that have them.
"""

import re
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import lru_cache, reduce
from operator import xor

from daq.protocols.lines import Other, Row
from daq.wire import frames
from daq.wire.splitter import Splitter
from stickslip.errors import InputError, check_known

TIMES = {"t_us": 1, "us": 1, "t_ms": 1000, "ms": 1000, "t_s": 1_000_000, "s": 1_000_000}
_COUNTS = ("up", "down", "count", "ticks")
# Measured numbers with decimals: of what they are a unit, and its size in SI.  They count their last decimal.
LENGTH, FORCE = "length", "force"
MEASURED = {
    "x": ("", 1.0),  # a length in a unit that nobody stated
    "x_m": (LENGTH, 1.0),
    "x_cm": (LENGTH, 1e-2),
    "x_mm": (LENGTH, 1e-3),
    "x_um": (LENGTH, 1e-6),
    "F_N": (FORCE, 1.0),
    "F_mN": (FORCE, 1e-3),
}
MOST_DECIMALS = 9
# A travel of a hundred times the first readings still fits.  With 10 a mass that begins beside zero may run out of the
# range; with 1000 a digit less is kept of numbers that a computer prints in full.
ROOM = 100
# Resolution of numbers whose decimals nobody stated, while the first lines show them: a nanometre, or a micronewton.
_DECIMALS = {"x": 6, "x_m": 9, "x_cm": 7, "x_mm": 6, "x_um": 3, "F_N": 6, "F_mN": 3}
VALUES = {
    **dict.fromkeys(TIMES, r"(\d{1,12}+)(?>\.(\d{0,9}+))?+"),
    **dict.fromkeys(("up", "down"), r"(\d{1,10}+)"),
    **dict.fromkeys(("count", "ticks"), r"([+-]?+\d{1,10}+)"),
    **dict.fromkeys(MEASURED, r"([+-]?+(?:\d{1,9}+(?>\.\d{0,17}+)?+|\.\d{1,17}+)(?>[eE][+-]?+\d{1,2}+)?+)"),
    **dict.fromkeys(("a", "b"), "([01])"),
    "illegal": r"(\d{1,5}+)",
    "xor": r"\*?+([0-9A-Fa-f]{2})",
    "seq": r"\d{1,10}+",
    "-": r"[^,;\s]*",
}
UNREAD = ("seq", "-")  # without a group: only their form counts
_OPEN, _CLOSE = r"(?>[(\[][ \t]*+)?+", r"(?>[)\]][ \t]*+)?+"  # about a line that Python prints: (1000, 21.04)
_SEPARATOR = r"(?:[,;]|[ \t]+[,;]?)[ \t]*"

_TIME_OF_LABEL = {"t": None, "time": None, "micros": "us", "millis": "ms", **{name: name for name in TIMES}}
_COUNT_LABELS = ("pos", "position", "count", "counts", "ticks", "encoder")
_LENGTH_LABELS = ("x", "distance", "dist", "laser", "displacement")
_FORCE_LABELS = ("f", "force", "load")
# A label with a unit, such as pos_mm, and the column that it is.
_OF_LABEL = {
    f"{label}_{unit}".lower(): name
    for name in MEASURED
    for what, _, unit in [name.partition("_")]
    if unit
    for label in ((*_COUNT_LABELS, *_LENGTH_LABELS) if what == "x" else _FORCE_LABELS)
}
_KINDS = {
    **{name: name for name in VALUES},
    **dict.fromkeys(_TIME_OF_LABEL, "time"),
    **dict.fromkeys(_COUNT_LABELS, "position"),
    **dict.fromkeys(_LENGTH_LABELS, LENGTH),
    **dict.fromkeys(_FORCE_LABELS, FORCE),
    **{label: MEASURED[name][0] for label, name in _OF_LABEL.items()},
    **{name: of or LENGTH for name, (of, _) in MEASURED.items()},
}
_NAME, _IS, _VALUE = r"[A-Za-z_][\w.()\[\]/%-]*+", r"[ \t]*+[=:][ \t]*+", r"[^,;:=\s]++"
_LABELLED = re.compile(rf"(?:\A|[,;\s])[ \t]*+({_NAME}){_IS}(?>({_VALUE}))?+".encode())
_STATED = re.compile(rb"#[ \t]*+columns[ \t:=]++([\w:,-]++)[ \t\r]*+")
_MOST_FORMS = 64  # kept compiled; only damaged lines make more of them
ENOUGH_LINES = 20  # labelled lines that define the columns when none are declared
LONGEST_LINE = 256


@dataclass(frozen=True)
class Columns:
    """How to read a line of the declared columns."""

    # of a whole line; its last group is empty and takes the place of every column that is not declared
    pattern: re.Pattern[bytes]
    names: tuple[str, ...]  # columns in the order of the line; empty when none are declared
    labels: tuple[str, ...]  # labels of the columns in the line; empty when the line holds values only
    counters: tuple[str, str]  # columns of the counters: up (or the net count) and down; "" for none
    counts: tuple[int, ...]  # groups that hold the time's whole part and fraction, up (or the net count) and down
    checks: tuple[int, ...]  # groups that hold a, b, illegal and xor; empty when none of them is declared
    us_per_unit: int  # unit of the time, us
    net: bool  # there is only one count, signed
    bits: int  # width of the counters
    # of a measured number in place of a count: the count is that of its last decimal.  None for counts.
    decimals: int | None
    capabilities: frames.Capability  # what the columns hold in addition to counts

    @property
    def measured(self) -> tuple[str, float] | None:
        """What the position is measured as, `LENGTH`, `FORCE` or "", and a count of it in SI; None for counts."""
        if self.decimals is None:
            return None
        of, size = MEASURED[self.counters[0]]
        return of, size * 10.0**-self.decimals

    @property
    def declared(self) -> str:
        """The columns as they are declared, with widths and decimals."""
        wide = f":{self.bits}" if self.bits != 32 else ""
        tails = dict.fromkeys(_COUNTS, wide) | dict.fromkeys(MEASURED, f":{self.decimals}")
        return ",".join(name + tails.get(name, "") for name in self.names)

    def row(self, match: re.Match[bytes]) -> Row | Other:
        """Return the values in a line that matches the pattern."""
        whole, fraction, up_text, down_text = match.group(*self.counts)
        ticks = int(whole) * self.us_per_unit
        if fraction:  # digits beyond the microsecond are cut off
            ticks += int(fraction.ljust(6, b"0")[:6]) * self.us_per_unit // 1_000_000
        limit = 1 << self.bits
        down = int(down_text or 0)
        up = int(up_text) if self.decimals is None else round(float(up_text) * 10**self.decimals)
        most = limit if self.decimals is not None else 2 * limit  # a count may be sent without its sign
        if not (-limit <= 2 * up < most if self.net else up < limit and down < limit):
            return Other.DAMAGED
        if not self.checks:
            return ticks & 0xFFFFFFFF, up & limit - 1, down
        a, b, illegal, check = match.group(*self.checks)
        if check and reduce(xor, self.guarded(match), 0) != int(check, 16):
            return Other.DAMAGED
        levels = int(a or 0) | int(b or 0) << 1
        return ticks & 0xFFFFFFFF, up & limit - 1, down, levels, int(illegal or 0) & 0xFFFF

    def guarded(self, match: re.Match[bytes]) -> bytes:
        """Return the part of a line that its xor covers: everything before the separator in front of it."""
        before = match.string[: match.start(self.checks[-1])].removesuffix(b"*").rstrip(b" \t")
        if self.labels:
            before = before[:-1].rstrip(b" \t")[: -len("xor")].rstrip(b" \t")
        return (before[:-1] if before.endswith((b",", b";")) else before).rstrip(b" \t")

    def labelled(self, line: bytes) -> "Columns | None":
        """Return how to read lines with the labels of this one; None unless they name each column once."""
        labels = [label for label, _ in _pairs(line)]
        columns_of = {}
        for name in self.names or ("t_us", "count"):
            if name in UNREAD:
                continue
            same = [label for label in labels if _KINDS.get(label.lower()) == _KINDS[name]]
            if not same and name in MEASURED:
                same = [label for label in labels if _KINDS.get(label.lower()) == "position"]
            if len(same) > 1 and self.names:
                same = [label for label in same if label.lower() == name or _OF_LABEL.get(label.lower()) == name]
            if len(same) != 1:
                return None
            columns_of[same[0]] = _TIME_OF_LABEL.get(same[0].lower()) or name
            if _OF_LABEL.get(same[0].lower(), name) != name:
                return None  # of another unit than the declared one
        used = tuple(label for label in labels if label in columns_of)
        return _form(tuple(columns_of[label] for label in used), self.bits, used, self.decimals) if used else None


def columns(declared: str | None) -> Columns:
    """Return how to read lines of the declared columns; None: labelled lines with a time and a net count.

    Raises InputError: A column is unknown or declared twice, or time or counts are missing.
    """
    where = "--columns"
    if declared is None:
        return replace(columns("t_us,count"), pattern=re.compile(rb"(?!)"), names=())
    names, widths, decimals = [], set(), None
    for part in declared.split(","):
        name, _, width = part.strip().partition(":")
        check_known(name, list(VALUES), "column", where)
        if name in names and name not in UNREAD:
            raise InputError(f"column {name!r} occurs twice", where, "call what you do not need '-'")
        if name in MEASURED:
            if width and (not width.isdecimal() or int(width) > MOST_DECIMALS):
                do = f"write {name}:2 for two, at most {MOST_DECIMALS}"
                raise InputError(f"{part.strip()!r} is no number of decimals", where, do)
            decimals = int(width) if width else _DECIMALS[name]
        elif width and (width not in ("16", "32") or name not in _COUNTS):
            raise InputError(f"{part.strip()!r} is not a width of a counter", where, "write up:16 or up:32")
        names.append(name)
        if name in _COUNTS:
            widths.add(int(width or 32))
    times = [name for name in names if name in TIMES]
    if len(times) != 1:
        what = "which column is the time?" if times else "there is no time column, which is required"
        raise InputError(what, where, "declare one of t_us, t_ms, t_s; a sketch prints it by micros()")
    counts = sorted(name for name in names if name in (*_COUNTS, *MEASURED))
    if counts not in (["down", "up"], ["count"], ["ticks"], *([name] for name in MEASURED)):
        do = "declare up and down, or count (or ticks), or a position or force with its unit, such as x_mm or F_N"
        raise InputError("which columns are the counts?", where, do)
    if len(widths) > 1:
        raise InputError("up and down differ in width", where, "give both the same, as in up:16,down:16")
    if ("a" in names) != ("b" in names):
        raise InputError("one level of two", where, "declare both a and b, or neither")
    return _form(tuple(names), widths.pop() if widths else 32, (), decimals)


@lru_cache(_MOST_FORMS)
def _form(names: tuple[str, ...], bits: int, labels: tuple[str, ...], decimals: int | None) -> Columns:
    """Return how to read lines of these columns, which have these labels unless there are none."""
    group = {"": 1}  # of each column; of the time, a second one behind it holds the fraction
    for name in names:
        if name not in UNREAD:
            group[name] = group[""]
            group[""] += 2 if name in TIMES else 1
    fields = [VALUES[name] for name in names]
    separator, end = _SEPARATOR, ""
    if labels:
        other = rf"(?!(?i:{'|'.join(labels)}){_IS}){_NAME}{_IS}{_VALUE}"
        fields = [f"{label}{_IS}{field}" for label, field in zip(labels, fields, strict=True)]
        fields[0] = f"(?>{other}{_SEPARATOR})*+{fields[0]}"
        separator, end = f"{_SEPARATOR}(?>{other}{_SEPARATOR})*+", f"(?>{_SEPARATOR}{other})*+"
    time = next(name for name in names if name in TIMES)
    counts = [name for name in (*_COUNTS, *MEASURED) if name in names]
    up, down = (*counts, "")[:2]
    checks = ("a", "b", "illegal", "xor")
    has = frames.Capability
    return Columns(
        pattern=re.compile(rf"[ \t]*{_OPEN}{separator.join(fields)}{end}[ \t]*{_CLOSE}\r*()".encode()),
        names=names,
        labels=labels,
        counters=(up, down),
        counts=(group[time], group[time] + 1, group[up], group[down]),
        checks=tuple(group.get(name, group[""]) for name in checks) if group.keys() & checks else (),
        us_per_unit=TIMES[time],
        net=len(counts) == 1,
        bits=bits,
        decimals=decimals,
        capabilities=has(has.LEVELS * ("a" in names) | has.ILLEGAL * ("illegal" in names)),
    )


def _pairs(line: bytes) -> list[tuple[str, str]]:
    """Return the labels in a line and their values."""
    return [(label.decode("latin-1"), value.decode("latin-1")) for label, value in _LABELLED.findall(line)]


def labelled_columns(line: bytes) -> str | None:
    """Return the columns of a labelled line, as they are declared; None unless there are one time and one position.

    Levels, ``illegal`` and ``xor`` are columns where their values can be such; else they are ignored as other labels.
    """
    pairs = [(label.lower(), value) for label, value in _pairs(line)]
    kinds = [_KINDS.get(label) for label, _ in pairs]
    single = {kind: pair for kind, pair in zip(kinds, pairs, strict=True) if kind and kinds.count(kind) == 1}
    both = {"up", "down"} <= single.keys()
    position = next((single[kind] for kind in ("position", LENGTH, FORCE) if kind in kinds and kind in single), None)
    if position is not None and position[0] == "x":
        position = None  # an acceleration, perhaps: this one must be declared
    if "time" not in single or kinds.count("position") > 1 or both == (position is not None):
        return None
    names = [_TIME_OF_LABEL[single["time"][0]] or "t_us"]
    names += ["up", "down"] if position is None else [_measured_as(*position)]
    for name in ("a", "b", "illegal", "xor"):
        if name in single and re.fullmatch(VALUES[name], single[name][1]):
            names.append(name)
    if ("a" in names) != ("b" in names):
        names = [name for name in names if name not in ("a", "b")]
    return ",".join(names)


def _measured_as(label: str, value: str) -> str:
    """Return the column that a position under a label is: one with a unit, of none, or a count."""
    if label in _OF_LABEL:
        return _OF_LABEL[label]
    return "count" if re.fullmatch(VALUES["count"], value) and label in _COUNT_LABELS else "x"


class ColumnVote:
    """Find the columns of lines when none are declared.

    They are those that a comment states (``# columns t_us,count``), else those of labelled lines that most of the first
    lines have.
    """

    def __init__(self) -> None:
        self._splitter = Splitter(b"\n", LONGEST_LINE)
        self._found: list[str] = []
        self._stated: str | None = None

    @property
    def columns(self) -> str | None:
        """The columns, as they are declared; None if no line has a time and a position."""
        return self._stated or max(self._found, key=self._found.count, default=None)

    def feed(self, data: bytes) -> bool:
        """Take bytes as they came; return whether they are enough."""
        for line in self._splitter.feed(data):
            self._stated = self._stated or _stated_columns(line)
            if self._stated is None and len(self._found) < ENOUGH_LINES and (found := labelled_columns(line)):
                self._found.append(found)
        return self._stated is not None or len(self._found) == ENOUGH_LINES


def _stated_columns(line: bytes) -> str | None:
    """Return the columns that a comment states, None of another line."""
    found = _STATED.fullmatch(line)
    if found is None:
        return None
    try:
        return columns(found[1].decode()).declared
    except InputError:
        return None


def with_decimals(declared: str, data: bytes) -> Columns:
    """Return the columns, a measured number with the decimals that lines of ``data`` show where none are declared.

    They are fewer where so many of them would leave no room: a number may become `ROOM` times the largest one.
    """
    form = columns(declared)
    stated = (part.partition(":") for part in declared.split(","))
    if form.decimals is None or any(name.strip() in MEASURED and tail for name, _, tail in stated):
        return form
    decimals, largest = 0, 0
    for line in data.split(b"\n")[1:-1]:
        own = form if form.pattern.fullmatch(line) else form.labelled(line)
        found = None if own is None else own.pattern.fullmatch(line)
        if own is not None and found is not None:
            number = Decimal(found[own.counts[2]].decode())
            decimals, largest = max(decimals, -int(number.as_tuple().exponent)), max(largest, abs(int(number)))
    while decimals > MOST_DECIMALS or (decimals and ROOM * (largest + 1) * 10**decimals > 1 << (form.bits - 1)):
        decimals -= 1
    return replace(columns(declared), decimals=decimals)


def lacking(line: bytes) -> tuple[str, str] | None:
    """Return what the labels of a line lack, and what is expected; None without labels, or if they name a sample."""
    labels = [label for label, _ in _pairs(line)]
    if not labels or labelled_columns(line) is not None:
        return None
    kinds = [_KINDS.get(label.lower()) for label in labels]
    seen = f"the lines have the labels {', '.join(labels)}"[:200]
    if "time" in kinds and "position" not in kinds and kinds.count(LENGTH) == 1:
        return f"{seen}: the unit of the position is not stated", "give it by --columns t_us,x_mm, or x_m, x_cm, x_um"
    positions, times = f"{', '.join(_COUNT_LABELS)}, or up and down", ", ".join(_TIME_OF_LABEL)
    if not ("position" in kinds or {"up", "down"} <= set(kinds)):
        return f"{seen}: none is a position", f"label the position as one of {positions}"
    if "time" not in kinds:
        return f"{seen}: none is a time", f"label the time as one of {times}"
    which = "time" if kinds.count("time") > 1 else "position"
    return f"{seen}: more than one is a {which}", "say by --columns which one to use, for example t_us,count"
