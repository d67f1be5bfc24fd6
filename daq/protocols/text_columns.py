"""What a line of text holds, as the user declared its columns: read one at a time, or many of one shape at once."""

import re
from dataclasses import dataclass
from functools import reduce
from operator import xor

import numpy as np
from numpy.typing import NDArray

from daq.errors import InputError, nearest
from daq.wire import cut

_TIMES = {"t_us": 1, "us": 1, "t_ms": 1000, "ms": 1000, "t_s": 1_000_000, "s": 1_000_000}
_COUNTS = ("up", "down", "count", "ticks")
_NAMES = (*_TIMES, *_COUNTS, "a", "b", "illegal", "xor", "-")
_PATTERNS = {"a": "[01]", "b": "[01]", "illegal": r"\d{1,5}", "xor": r"\*?[0-9A-Fa-f]{2}", "-": r"[^,;\s]*"}
_SEPARATOR = r"[ \t]*[,;\t ][ \t]*"
# What the patterns tell apart: every digit is as good as another, and so is every hex digit that is none.
KINDS = np.arange(256, dtype=np.uint8)
KINDS[list(b"0123456789")] = ord("0")
KINDS[list(b"ABCDEFabcdef")] = ord("A")
_HEX = np.zeros(256, dtype=np.uint8)
for _digits in (b"0123456789abcdef", b"0123456789ABCDEF"):
    _HEX[list(_digits)] = range(16)


@dataclass(frozen=True)
class Columns:
    """How to read a line: its pattern, and where each quantity stands in it (a group's number, or None)."""

    pattern: re.Pattern[bytes]
    time: int
    us_per_unit: int
    up: int
    down: int | None
    levels: tuple[int, int] | None
    illegal: int | None
    xor: int | None
    bits: int

    def read(self, line: bytes) -> tuple[int, int, int, int, int] | None:
        """Return (ticks, up, down, status, illegal) of a line, or None when it does not hold."""
        found = self.pattern.fullmatch(line)
        if found is None:
            return None
        if self.xor is not None and reduce(xor, self._guarded(found), 0) != int(found[self.xor].lstrip(b"*"), 16):
            return None
        limit = 1 << self.bits
        up, down = int(found[self.up]), 0 if self.down is None else int(found[self.down])
        if not (-limit <= 2 * up < 2 * limit if self.down is None else up < limit and down < limit):
            return None
        ticks = _microseconds(found[self.time], self.us_per_unit)
        status = 0 if self.levels is None else int(found[self.levels[0]]) | int(found[self.levels[1]]) << 1
        illegal = 0 if self.illegal is None else int(found[self.illegal])
        return ticks & 0xFFFFFFFF, up & limit - 1, down, status, illegal & 0xFFFF

    def _guarded(self, found: re.Match[bytes]) -> bytes:
        """Return the part of a line that its xor is of."""
        return found.string[: found.start(self.xor or 0)].rstrip(b" \t*")[:-1].rstrip(b" \t")

    def read_alike(self, rows: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], list[NDArray[np.int64]]] | None:
        """Do what `read` does with lines of one length and shape (`daq.wire.cut.alike`), (k, size), at once.

        Returns
        -------
        tuple or None
            Which lines hold, (k,), and their five columns, (k,) each; None when the first does not match.
        """
        found = self.pattern.fullmatch(rows[0].tobytes().rstrip(b"\r"))
        if found is None:
            return None
        columns = np.ascontiguousarray(rows.T)
        digits = columns - np.uint8(ord("0"))

        def whole(group: int) -> NDArray[np.int64]:
            begin, end = found.span(group)
            signed = found[group][:1] in (b"+", b"-")
            value = cut.number(digits[begin + signed : end])
            return -value if found[group][:1] == b"-" else value

        limit = 1 << self.bits
        up = whole(self.up)
        down = np.zeros_like(up) if self.down is None else whole(self.down)
        held = (-limit <= 2 * up) & (up < limit) if self.down is None else (up < limit) & (down < limit)
        if self.xor is not None:
            begin = found.start(self.xor) + (found[self.xor][:1] == b"*")
            said = cut.number(_HEX[columns[begin : found.end(self.xor)]], 16)
            held &= np.bitwise_xor.reduce(columns[: len(self._guarded(found))], axis=0) == said
        status = np.zeros_like(up)
        for bit, group in enumerate(self.levels or ()):
            level = whole(group)
            held &= level <= 1
            status |= level << bit
        illegal = np.zeros_like(up) if self.illegal is None else whole(self.illegal)
        begin, end = found.span(self.time)
        point = begin + len(found[self.time].partition(b".")[0])
        fine = len(str(self.us_per_unit)) - 1
        fraction = digits[point + 1 : end][:fine]
        ticks = cut.number(digits[begin:point]) * self.us_per_unit + cut.number(fraction) * 10 ** (fine - len(fraction))
        return held, [ticks & 0xFFFFFFFF, up & limit - 1, down, status, illegal & 0xFFFF]


def columns(declared: str | None) -> Columns:
    """Return how to read lines of the declared columns.

    Raises
    ------
    InputError
        None are declared, one is unknown or twice there, or time or counts are missing.
    """
    where = "--columns"
    if not declared:
        raise InputError("text lines need their columns declared", where, "give for example --columns t_us,up,down")
    names, widths = [], set()
    for part in declared.split(","):
        name, _, width = part.strip().partition(":")
        if name not in _NAMES:
            raise InputError(f"unknown column {name!r}", where, nearest(name, _NAMES))
        if name in names and name != "-":
            raise InputError(f"column {name!r} is there twice", where, "call what you do not need '-'")
        if width and (width not in ("16", "32") or name not in _COUNTS):
            raise InputError(f"{part.strip()!r} is no width of a counter", where, "write up:16 or up:32")
        names.append(name)
        if name in _COUNTS:
            widths.add(int(width or 32))
    times = [name for name in names if name in _TIMES]
    if len(times) != 1:
        what = "which column is the time?" if times else "there is no time column, and sample times matter"
        raise InputError(what, where, "declare one of t_us, t_ms, t_s; a sketch prints it by micros()")
    counts = sorted(name for name in names if name in _COUNTS)
    if counts not in (["down", "up"], ["count"], ["ticks"]):
        raise InputError("which columns are the counts?", where, "declare up and down, or count (or ticks)")
    if len(widths) > 1:
        raise InputError("up and down differ in width", where, "give both the same, as in up:16,down:16")
    if ("a" in names) != ("b" in names):
        raise InputError("one level of two", where, "declare a and b, or none of them")
    whole = r"[+-]?\d{1,10}" if len(counts) == 1 else r"\d{1,10}"
    decimal = r"\d{1,12}(?:\.\d{0,9})?"
    fields = [f"({decimal if n in _TIMES else whole if n in _COUNTS else _PATTERNS[n]})" for n in names]
    place = {name: number for number, name in enumerate(names, start=1)}
    return Columns(
        pattern=re.compile((r"[ \t]*" + _SEPARATOR.join(fields) + r"[ \t]*").encode()),
        time=place[times[0]],
        us_per_unit=_TIMES[times[0]],
        up=place["up"] if "up" in place else place[counts[0]],
        down=place.get("down"),
        levels=(place["a"], place["b"]) if "a" in place else None,
        illegal=place.get("illegal"),
        xor=place.get("xor"),
        bits=widths.pop(),
    )


def _microseconds(text: bytes, us_per_unit: int) -> int:
    """Return a time in whole us, rounded down; exact, as no float would be."""
    whole, _, fraction = text.partition(b".")
    digits = len(str(us_per_unit)) - 1
    return int(whole) * us_per_unit + int((fraction + b"000000")[:digits] or b"0")
