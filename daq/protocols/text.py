r"""Lines of numbers, one per sample, as any sketch prints them; the user declares their columns.

``--columns t_us,up,down``: names in the order of the line, separated by commas; the line itself may use commas,
semicolons, tabs or spaces.  A sign, a decimal point in a time, and ``\r\n`` are understood; a line that begins with
``#`` is a remark.  Exactly one time, and either a net count or both counters:

==================  ===================================================================================================
column              holds
==================  ===================================================================================================
t_us  t_ms  t_s     device time (also us, ms, s); micros() and millis() may roll over at 2^32
up  down            the two counters; ``up:16`` and ``down:16`` when they roll over at 2^16 (32 without)
count               net count, signed (also ticks); ``count:16`` when it rolls over at 2^16
a  b                levels of the channels, 0 or 1
illegal             illegal transitions counted so far
xor                 two hex digits: XOR of the bytes before the separator in front of them, the one checksum there is
``-``               anything: left out
==================  ===================================================================================================

The rate is the sketch's own: it is measured before the recording starts.  Nothing is sent to the board.
"""

import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from operator import xor
from statistics import median
from typing import TYPE_CHECKING, Any

from daq import wire
from daq.errors import DeviceError, InputError, nearest
from daq.protocols import session as sessions
from daq.protocols.lines import LineTally, Rows, to_stream
from daq.protocols.session import Identity, Line, Plan, Wish

if TYPE_CHECKING:
    from daq.ports import Port
    from daq.stream import Stream

BAUD = 115_200
TICK_NS = 1000
LISTEN_S = 1.0  # of good lines, by their own times, before the rate is believed
FEWEST_LINES = 20
RATE_WITHIN = 0.1  # of the wished rate
LONGEST_LINE = 256
_TIMES = {"t_us": 1, "us": 1, "t_ms": 1000, "ms": 1000, "t_s": 1_000_000, "s": 1_000_000}
_COUNTS = ("up", "down", "count", "ticks")
_NAMES = (*_TIMES, *_COUNTS, "a", "b", "illegal", "xor", "-")
_PATTERNS = {"a": "[01]", "b": "[01]", "illegal": r"\d{1,5}", "xor": r"\*?[0-9A-Fa-f]{2}", "-": r"[^,;\s]*"}
_SEPARATOR = r"[ \t]*[,;\t ][ \t]*"


@dataclass(frozen=True)
class Columns:
    """How to read a line: its pattern, and where each quantity stands in it (a group's number, or None)."""

    pattern: "re.Pattern[bytes]"
    time: int
    us_per_unit: int
    up: int
    down: int | None
    levels: tuple[int, int] | None
    illegal: int | None
    xor: int | None
    bits: int

    def read(self, line: bytes) -> "tuple[int, int, int, int, int] | None":
        """Return (ticks, up, down, status, illegal) of a line, or None when it does not hold."""
        found = self.pattern.fullmatch(line)
        if found is None:
            return None
        if self.xor is not None:
            before = line[: found.start(self.xor)].rstrip(b" \t*")[:-1].rstrip(b" \t")
            if reduce(xor, before, 0) != int(found[self.xor].lstrip(b"*"), 16):
                return None
        limit = 1 << self.bits
        up, down = int(found[self.up]), 0 if self.down is None else int(found[self.down])
        if not (-limit <= 2 * up < 2 * limit if self.down is None else up < limit and down < limit):
            return None
        ticks = _microseconds(found[self.time], self.us_per_unit)
        status = 0 if self.levels is None else int(found[self.levels[0]]) | int(found[self.levels[1]]) << 1
        illegal = 0 if self.illegal is None else int(found[self.illegal])
        return ticks & 0xFFFFFFFF, up & limit - 1, down, status, illegal & 0xFFFF


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


def check(wish: Wish) -> None:
    """Refuse columns that cannot be read, and a decoder that there is not."""
    columns(wish.columns)
    if wish.decoder is not None and wish.decoder not in wire.DECODERS:
        raise InputError(f"unknown decoder {wish.decoder!r}", "--decoder", nearest(wish.decoder, wire.DECODERS))


def session(port: "Port", url: str, wish: Wish) -> "Text":
    """Return a session on an open port."""
    return Text(port, url, wish)


def ident(form: Columns, decoder: str | None) -> wire.Ident:
    """Return what the declared columns say of the board."""
    has = wire.Capability
    told = has.LEVELS * (form.levels is not None) | has.ILLEGAL * (form.illegal is not None)
    return wire.Ident(
        firmware=(0, 0, 0),
        decoder=decoder or "x4",
        capabilities=has(told),
        counter_bits=form.bits,
        tick_ns=TICK_NS,
        block_size=1,
        max_rate_hz=1_000_000,
        max_edge_rate_hz=0,
        name="text lines",
    )


class Lines:
    """Cut a byte stream into lines and read them; never raises on garbage, back in step at the next line feed."""

    def __init__(self, form: Columns) -> None:
        self._form = form
        self._tail = b""
        self._first = True
        self._skipping = False
        self.bad = 0
        self.bad_bytes = 0
        self.example = b""  # a line that did not hold

    def feed(self, data: bytes) -> list[tuple[int, int, int, int, int]]:
        """Take bytes as they came and return what the lines they complete say."""
        *lines, self._tail = (self._tail + data).split(b"\n")
        found = []
        for line in lines:
            stripped = line.rstrip(b"\r")
            if self._skipping:
                self._skipping = False
                self.bad_bytes += len(line)
            elif stripped and not stripped.startswith(b"#"):
                row = self._form.read(stripped)
                # A first line may have lost its beginning, which digits do not show.
                if row is None:
                    self.example = self.example or stripped
                    self._refuse(len(line))
                elif not self._first:
                    found.append(row)
            self._first = False
        if len(self._tail) > LONGEST_LINE:
            if not self._skipping:
                self._refuse(0)
            self._first, self._skipping = False, True
            self.bad_bytes += len(self._tail)
            self._tail = b""
        return found

    def _refuse(self, length: int) -> None:
        self.bad += not self._first
        self.bad_bytes += length


class Tally(LineTally):
    """How far a stream of lines has come."""

    def __init__(self, form: Columns, rate_hz: float) -> None:
        super().__init__(1e9 / (TICK_NS * rate_hz))
        self._form = form
        self._lines = Lines(form)

    def feed(self, data: bytes) -> None:
        """Take bytes as they came."""
        for row in self._lines.feed(data):
            self.step(row[0])

    def begin_again(self, reached: int) -> None:
        """Begin anew, ``reached`` periods after the start."""
        super().begin_again(reached)
        self._lines = Lines(self._form)


def decode(reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Stream":
    """Decode the reads of one connection."""
    form = columns(header["columns"])
    lines = Lines(form)
    rows = Rows()
    for stamp, data in reads:
        bad = lines.bad
        for ticks, up, down, status, illegal in lines.feed(data):
            rows.stamp_ns.append(stamp)
            rows.ticks.append(ticks)
            rows.up.append(up)
            if form.down is not None:
                rows.down.append(down)
            rows.status.append(status)
            rows.illegal.append(illegal)
        rows.bad += [len(rows)] * (lines.bad - bad)
    rows.discarded_bytes = lines.bad_bytes
    return to_stream(rows, ident(form, header.get("decoder")), 1e9 / (TICK_NS * float(header["rate_hz"])))


class Text(Line):
    """A session with a sketch that prints lines; it is listened to, and nothing is said to it."""

    def __init__(self, port: "Port", url: str, wish: Wish) -> None:
        super().__init__(port, url, wish)
        self._form = columns(wish.columns)
        self._rate_hz = 0.0
        self._line_bytes = 0.0
        self._coarse = False

    def identify(self) -> Identity:
        """Listen until the lines tell their rate.

        Raises
        ------
        DeviceError
            Nothing comes, or nothing of the declared columns.
        """
        lines = Lines(self._form)
        times: list[int] = []
        heard = 0
        until = time.monotonic() + sessions.ANSWER_S
        while time.monotonic() < until:
            data = self.read()
            heard += len(data)
            times += [row[0] for row in lines.feed(data)]
            steps = [later - earlier & 0xFFFFFFFF for earlier, later in pairwise(times)]
            if len(times) > FEWEST_LINES and median(steps) * len(steps) >= LISTEN_S * 1e9 / TICK_NS:
                break
        if len(times) <= FEWEST_LINES:
            raise DeviceError(*self._silent(heard, lines, len(times)))
        typical = median(steps)
        if typical == 0:
            raise DeviceError("the time in the lines stands still", self.url, "print micros() with each sample")
        usual = [step for step in steps if 0.5 * typical <= step <= 1.5 * typical]
        self._rate_hz = 1e9 / TICK_NS / (sum(usual) / len(usual))
        self._line_bytes = heard / max(1, len(times) + lines.bad)
        self._coarse = all(ticks % 1000 == 0 for ticks in times)
        return Identity(ident(self._form, self.wish.decoder))

    def plan(self, identity: Identity) -> Plan:
        """Return the sketch's own rate.

        Raises
        ------
        InputError
            It is not the one asked for.
        """
        rate_hz, wished = self._rate_hz, self.wish.rate_hz
        if wished is not None:
            if abs(rate_hz / wished - 1) > RATE_WITHIN:
                what = f"the lines come at {rate_hz:.4g} Hz, not at {wished} Hz"
                raise InputError(what, "--rate", f"leave --rate out, or give {round(rate_hz)}, or change the sketch")
            rate_hz = float(wished) if abs(rate_hz / wished - 1) < 0.01 else rate_hz
        else:
            rate_hz = float(f"{rate_hz:.3g}") if abs(float(f"{rate_hz:.3g}") / rate_hz - 1) < 0.005 else rate_hz
        notes = []
        if self._coarse:
            notes.append("the times are whole milliseconds, each wrong by up to 1 ms: let the sketch print micros()")
        return Plan(rate_hz, 1, rate_hz * self._line_bytes, tuple(notes), comes_already=True)

    def prepare(self, plan: Plan) -> Identity:
        """Do nothing: the sketch is as it is."""
        self._rate_hz = plan.rate_hz
        return Identity(ident(self._form, self.wish.decoder))

    def start(self) -> None:
        """Throw away what has waited since: the sketch prints all the time."""
        waiting = self.port.in_waiting
        if waiting:
            self.port.read(waiting)

    def restart(self) -> None:
        """Do nothing: a sketch starts by itself."""

    def stop(self) -> None:
        """Do nothing: a sketch goes on."""

    def drain(self) -> bytes:
        """Return what is there: the line never runs dry."""
        waiting = self.port.in_waiting
        return self.port.read(waiting) if waiting else b""

    def tally(self) -> Tally:
        """Return a new tally."""
        return Tally(self._form, self._rate_hz)

    def _silent(self, heard: int, lines: Lines, good: int) -> tuple[str, str, str]:
        if heard == 0:
            do = "check the port ('daq ports'), the cable, and that the sketch prints by itself"
            return f"nothing came within {sessions.ANSWER_S:g} s", self.url, do
        if lines.bad > good:
            seen = lines.example[:60].decode("ascii", "backslashreplace")
            what = f"the lines are not of the columns {self.wish.columns}; one is {seen!r}"
            return what, self.url, "declare them by --columns as they are, and check --baud"
        what = f"only {good} lines came within {sessions.ANSWER_S:g} s"
        return what, self.url, f"let the sketch print at least {FEWEST_LINES // 5 + 1} lines a second"


def _microseconds(text: bytes, us_per_unit: int) -> int:
    """Return a time in whole us, rounded down; exact, as no float would be."""
    whole, _, fraction = text.partition(b".")
    digits = len(str(us_per_unit)) - 1
    return int(whole) * us_per_unit + int((fraction + b"000000")[:digits] or b"0")
