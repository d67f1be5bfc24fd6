"""Columns of text lines: how the values of a line become a sample; see `daq.protocols.text` for their names.

A line holds values in the order of the columns, or labelled values (``t=12,pos=34``).  Labels are mapped to columns
once; one pattern, which contains these labels, then reads all lines that have them.
"""

import re
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import lru_cache, reduce
from operator import xor

from daq.protocols.lines import NoSample, Row
from daq.wire import frames
from daq.wire.splitter import Splitter
from stickslip.errors import InputError, check_known

TIMES = {"t_us": 1, "us": 1, "t_ms": 1000, "ms": 1000, "t_s": 1_000_000, "s": 1_000_000}
_COUNTS = ("up", "down", "count", "ticks")
# Measured numbers with decimals: the quantity and the unit in SI.  Their counts are multiples of the last decimal.
LENGTH, FORCE = "length", "force"
MEASURED = {
    "x": ("", 1.0),  # a length in an unknown unit
    "x_m": (LENGTH, 1.0),
    "x_cm": (LENGTH, 1e-2),
    "x_mm": (LENGTH, 1e-3),
    "x_um": (LENGTH, 1e-6),
    "F_N": (FORCE, 1.0),
    "F_mN": (FORCE, 1e-3),
}
MOST_DECIMALS = 9
# How many times the first readings a travel may be and still fit the counters.
ROOM = 100
# Decimals until the first lines show them, if they are not declared: a nanometre, or a micronewton.
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
UNREAD = ("seq", "-")  # without a group: only their form is checked
_OPEN, _CLOSE = r"(?>[(\[][ \t]*+)?+", r"(?>[)\]][ \t]*+)?+"  # around a line that Python prints: (1000, 21.04)
_SEPARATOR = r"(?:[,;]|[ \t]+[,;]?)[ \t]*"

_TIME_OF_LABEL = {"t": None, "time": None, "micros": "us", "millis": "ms", **{name: name for name in TIMES}}
_COUNT_LABELS = ("pos", "position", "count", "counts", "ticks", "encoder")
_LENGTH_LABELS = ("x", "distance", "dist", "laser", "displacement")
_FORCE_LABELS = ("f", "force", "load")
# A label with a unit, such as pos_mm, and its column.
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
    """The columns of a line, and how to read them."""

    # of a whole line; its last group is empty and replaces every column that is not declared
    pattern: re.Pattern[bytes]
    names: tuple[str, ...]  # columns in the order of the line; empty if none are declared
    labels: tuple[str, ...]  # labels of the columns in the line; empty if the line has values only
    counts: tuple[int, ...]  # groups of the time's whole part and fraction, up (or the net count) and down
    checks: tuple[int, ...]  # groups of a, b, illegal and xor; empty if none of them is declared
    us_per_unit: int  # unit of the time, us
    net: bool  # whether there is only one count, signed
    bits: int  # width of the counters
    # of a measured number that replaces the count, in units of its last decimal; None for counts
    decimals: int | None
    capabilities: frames.Capability  # of the columns in addition to counts

    @property
    def measured(self) -> tuple[str, float] | None:
        """The measured quantity, `LENGTH`, `FORCE` or "" (unknown unit), and a count of it in SI; None for counts."""
        if self.decimals is None:
            return None
        quantity, size = next(MEASURED[name] for name in self.names if name in MEASURED)
        return quantity, size * 10.0**-self.decimals

    @property
    def declared(self) -> str:
        wide = f":{self.bits}" if self.bits != 32 else ""
        tails = dict.fromkeys(_COUNTS, wide) | dict.fromkeys(MEASURED, f":{self.decimals}")
        return ",".join(name + tails.get(name, "") for name in self.names)

    def read_row(self, match: re.Match[bytes]) -> Row | NoSample:
        """Return the values in a line that matches the pattern, or `NoSample.DAMAGED` if one is out of range."""
        whole, fraction, up_text, down_text = match.group(*self.counts)
        ticks = int(whole) * self.us_per_unit
        if fraction:  # digits beyond the microsecond are cut off
            ticks += int(fraction.ljust(6, b"0")[:6]) * self.us_per_unit // 1_000_000
        limit = 1 << self.bits
        down = int(down_text or 0)
        up = int(up_text) if self.decimals is None else round(float(up_text) * 10**self.decimals)
        most = limit if self.decimals is not None else 2 * limit  # a count may be sent without its sign
        if not (-limit <= 2 * up < most if self.net else up < limit and down < limit):
            return NoSample.DAMAGED
        if not self.checks:
            return ticks & 0xFFFFFFFF, up & limit - 1, down
        a, b, illegal, check = match.group(*self.checks)
        if check and reduce(xor, self._take_guarded(match), 0) != int(check, 16):
            return NoSample.DAMAGED
        levels = int(a or 0) | int(b or 0) << 1
        return ticks & 0xFFFFFFFF, up & limit - 1, down, levels, int(illegal or 0) & 0xFFFF

    def _take_guarded(self, match: re.Match[bytes]) -> bytes:
        """Return the part of a line that its xor covers: everything before the separator in front of it."""
        before = match.string[: match.start(self.checks[-1])].removesuffix(b"*").rstrip(b" \t")
        if self.labels:
            before = before[:-1].rstrip(b" \t")[: -len("xor")].rstrip(b" \t")
        return (before[:-1] if before.endswith((b",", b";")) else before).rstrip(b" \t")

    def match_labels(self, line: bytes) -> "Columns | None":
        """Return the columns with the labels of this line; None unless they name each column once."""
        labels = [label for label, _ in _find_labels(line)]
        columns_of = {}
        for name in self.names or ("t_us", "count"):
            if name in UNREAD:
                continue
            matching = [label for label in labels if _KINDS.get(label.lower()) == _KINDS[name]]
            if not matching and name in MEASURED:
                matching = [label for label in labels if _KINDS.get(label.lower()) == "position"]
            if len(matching) > 1 and self.names:
                matching = [
                    label for label in matching if label.lower() == name or _OF_LABEL.get(label.lower()) == name
                ]
            if len(matching) != 1:
                return None
            columns_of[matching[0]] = _TIME_OF_LABEL.get(matching[0].lower()) or name
            if _OF_LABEL.get(matching[0].lower(), name) != name:
                return None  # of another unit than the declared one
        used = tuple(label for label in labels if label in columns_of)
        return (
            _make_columns(tuple(columns_of[label] for label in used), self.bits, used, self.decimals) if used else None
        )


class LineParser:
    """Parse the lines of one stream; after two lines in a row with the same labels, other labels are damage."""

    def __init__(self, form: Columns) -> None:
        self._declared = self._form = form
        self._last: Columns | None = None

    def read(self, line: bytes) -> Row | NoSample:
        match = self._form.pattern.fullmatch(line)
        if match is not None:
            return self._form.read_row(match)
        if line.startswith(b"#") or not line.rstrip(b"\r"):
            return NoSample.REMARK
        form = self._declared.match_labels(line) if self._form is self._declared else self._declared
        match = form.pattern.fullmatch(line) if form is not None else None
        if form is None or match is None:
            return NoSample.DAMAGED
        if form == self._last:
            self._form = form
        self._last = form
        return form.read_row(match)


def parse_columns(declared: str | None) -> Columns:
    """Return the declared columns; None: labelled lines with a time and a net count.

    Raises InputError if a column is unknown or declared twice, or time or counts are missing.
    """
    where = "--columns"
    if declared is None:
        return replace(parse_columns("t_us,count"), pattern=re.compile(rb"(?!)"), names=())
    names, widths, decimals = [], set(), None
    for part in declared.split(","):
        name, _, width = part.strip().partition(":")
        check_known(name, list(VALUES), "column", where)
        if name in names and name not in UNREAD:
            raise InputError(f"column {name!r} occurs twice", where, "name columns that are not needed '-'")
        if name in MEASURED:
            if width and (not width.isdecimal() or int(width) > MOST_DECIMALS):
                do = f"write {name}:2 for two decimals; at most {MOST_DECIMALS} are possible"
                raise InputError(f"{part.strip()!r} is not a valid number of decimals", where, do)
            decimals = int(width) if width else _DECIMALS[name]
        elif width and (width not in ("16", "32") or name not in _COUNTS):
            raise InputError(f"{part.strip()!r} is not a valid counter width", where, "write up:16 or up:32")
        names.append(name)
        if name in _COUNTS:
            widths.add(int(width or 32))
    times = [name for name in names if name in TIMES]
    if len(times) != 1:
        problem = "which column is the time?" if times else "a column of times is required"
        raise InputError(problem, where, "declare one of t_us, t_ms, t_s; a sketch obtains the time with micros()")
    counts = sorted(name for name in names if name in (*_COUNTS, *MEASURED))
    if counts not in (["down", "up"], ["count"], ["ticks"], *([name] for name in MEASURED)):
        do = "declare up and down, or count (or ticks), or a position or force with its unit, such as x_mm or F_N"
        raise InputError("which columns are the counts?", where, do)
    if len(widths) > 1:
        raise InputError("up and down have different widths", where, "use the same width for both, as in up:16,down:16")
    if ("a" in names) != ("b" in names):
        raise InputError("only one of the two logic levels is declared", where, "declare both a and b, or neither")
    return _make_columns(tuple(names), widths.pop() if widths else 32, (), decimals)


@lru_cache(_MOST_FORMS)
def _make_columns(names: tuple[str, ...], bits: int, labels: tuple[str, ...], decimals: int | None) -> Columns:
    groups = {"": 1}  # of each column; the time has a second one, for its fraction
    for name in names:
        if name not in UNREAD:
            groups[name] = groups[""]
            groups[""] += 2 if name in TIMES else 1
    fields = [VALUES[name] for name in names]
    separator, ending = _SEPARATOR, ""
    if labels:
        other = rf"(?!(?i:{'|'.join(labels)}){_IS}){_NAME}{_IS}{_VALUE}"
        fields = [f"{label}{_IS}{field}" for label, field in zip(labels, fields, strict=True)]
        fields[0] = f"(?>{other}{_SEPARATOR})*+{fields[0]}"
        separator, ending = f"{_SEPARATOR}(?>{other}{_SEPARATOR})*+", f"(?>{_SEPARATOR}{other})*+"
    time = next(name for name in names if name in TIMES)
    counts = [name for name in (*_COUNTS, *MEASURED) if name in names]
    up, down = (*counts, "")[:2]
    checks = ("a", "b", "illegal", "xor")
    Capability = frames.Capability
    return Columns(
        pattern=re.compile(rf"[ \t]*{_OPEN}{separator.join(fields)}{ending}[ \t]*{_CLOSE}\r*()".encode()),
        names=names,
        labels=labels,
        counts=(groups[time], groups[time] + 1, groups[up], groups[down]),
        checks=tuple(groups.get(name, groups[""]) for name in checks) if groups.keys() & checks else (),
        us_per_unit=TIMES[time],
        net=len(counts) == 1,
        bits=bits,
        decimals=decimals,
        capabilities=Capability(Capability.LEVELS * ("a" in names) | Capability.ILLEGAL * ("illegal" in names)),
    )


def _find_labels(line: bytes) -> list[tuple[str, str]]:
    return [(label.decode("latin-1"), value.decode("latin-1")) for label, value in _LABELLED.findall(line)]


def find_labelled_columns(line: bytes) -> str | None:
    """Return the columns of a labelled line, as they are declared; None unless there are one time and one position.

    Levels, ``illegal`` and ``xor`` are columns if their values are valid; otherwise they are ignored like other labels.
    """
    pairs = [(label.lower(), value) for label, value in _find_labels(line)]
    kinds = [_KINDS.get(label) for label, _ in pairs]
    single = {kind: pair for kind, pair in zip(kinds, pairs, strict=True) if kind and kinds.count(kind) == 1}
    has_both = {"up", "down"} <= single.keys()
    position = next((single[kind] for kind in ("position", LENGTH, FORCE) if kind in kinds and kind in single), None)
    if position is not None and position[0] == "x":
        position = None  # an acceleration, perhaps: this one must be declared
    if "time" not in single or kinds.count("position") > 1 or has_both == (position is not None):
        return None
    names = [_TIME_OF_LABEL[single["time"][0]] or "t_us"]
    names += ["up", "down"] if position is None else [_choose_position_column(*position)]
    for name in ("a", "b", "illegal", "xor"):
        if name in single and re.fullmatch(VALUES[name], single[name][1]):
            names.append(name)
    if ("a" in names) != ("b" in names):
        names = [name for name in names if name not in ("a", "b")]
    return ",".join(names)


def _choose_position_column(label: str, value: str) -> str:
    """Return the column of a labelled position: with the label's unit, with unknown unit, or a count."""
    if label in _OF_LABEL:
        return _OF_LABEL[label]
    return "count" if re.fullmatch(VALUES["count"], value) and label in _COUNT_LABELS else "x"


class ColumnVote:
    """Find the columns of lines if none are declared.

    They are those in a comment (``# columns t_us,count``), otherwise those of most of the first labelled lines.
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
        """Return whether the lines up to these bytes are enough."""
        for line in self._splitter.feed(data):
            self._stated = self._stated or _read_stated_columns(line)
            if self._stated is None and len(self._found) < ENOUGH_LINES and (labelled := find_labelled_columns(line)):
                self._found.append(labelled)
        return self._stated is not None or len(self._found) == ENOUGH_LINES


def _read_stated_columns(line: bytes) -> str | None:
    """Return the columns in a ``# columns`` comment; None for another line."""
    comment = _STATED.fullmatch(line)
    if comment is None:
        return None
    try:
        return parse_columns(comment[1].decode()).declared
    except InputError:
        return None


def with_decimals(declared: str, data: bytes) -> Columns:
    """Return the columns; those of a measured number without declared decimals get the decimals that ``data`` shows.

    They are fewer if so many would leave no room: a number may become `ROOM` times the largest one.
    """
    columns = parse_columns(declared)
    stated = (part.partition(":") for part in declared.split(","))
    if columns.decimals is None or any(name.strip() in MEASURED and tail for name, _, tail in stated):
        return columns
    decimals, largest = 0, 0
    for line in data.split(b"\n")[1:-1]:
        line_form = columns if columns.pattern.fullmatch(line) else columns.match_labels(line)
        match = None if line_form is None else line_form.pattern.fullmatch(line)
        if line_form is not None and match is not None:
            number = Decimal(match[line_form.counts[2]].decode())
            decimals, largest = max(decimals, -int(number.as_tuple().exponent)), max(largest, abs(int(number)))
    while decimals > MOST_DECIMALS or (decimals and ROOM * (largest + 1) * 10**decimals > 1 << (columns.bits - 1)):
        decimals -= 1
    return replace(parse_columns(declared), decimals=decimals)


def explain_labels(line: bytes) -> tuple[str, str] | None:
    """Return the problem with a line's labels, and what is expected; None without labels, or if they are a sample."""
    labels = [label for label, _ in _find_labels(line)]
    if not labels or find_labelled_columns(line) is not None:
        return None
    kinds = [_KINDS.get(label.lower()) for label in labels]
    text = f"the lines have the labels {', '.join(labels)}"[:200]
    if "time" in kinds and "position" not in kinds and kinds.count(LENGTH) == 1:
        return f"{text}, but the position has no unit", "state it with --columns t_us,x_mm, or x_m, x_cm, x_um"
    positions, times = f"{', '.join(_COUNT_LABELS)}, or up and down", ", ".join(_TIME_OF_LABEL)
    if not ("position" in kinds or {"up", "down"} <= set(kinds)):
        return f"{text}, but none of them is a position", f"label the position as one of {positions}"
    if "time" not in kinds:
        return f"{text}, but none of them is a time", f"label the time as one of {times}"
    duplicate = "time" if kinds.count("time") > 1 else "position"
    return f"{text}, but more than one of them is a {duplicate}", "choose one with --columns, for example t_us,count"
