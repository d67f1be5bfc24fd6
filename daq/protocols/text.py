r"""Lines of numbers, one per sample, as any sketch prints them; the user declares their columns.

``--columns t_us,up,down``: names in the order of the line, separated by commas; the line itself may use commas,
semicolons, tabs or spaces.  A sign, a decimal point in a time, and ``\r\n`` are understood; a line that begins with
``#`` is a comment.  Exactly one time, and either a net count or both counters:

==================  ===================================================================================================
column              holds
==================  ===================================================================================================
t_us  t_ms  t_s     device time (also us, ms, s); micros() and millis() may roll over at 2^32
up  down            the two counters; ``up:16`` and ``down:16`` when they roll over at 2^16 (32 without)
count               net count, signed (also ticks); ``count:16`` when it rolls over at 2^16
a  b                levels of the channels, 0 or 1
illegal             illegal transitions counted so far
xor                 two hex digits: XOR of the bytes before the separator in front of them, the only checksum
``-``               anything; ignored
==================  ===================================================================================================

The rate is the sketch's own: it is measured before the recording starts.  Nothing is sent to the board.
"""

import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial, reduce
from itertools import pairwise
from operator import xor
from statistics import median
from typing import TYPE_CHECKING, Any

from daq.errors import DeviceError, InputError, check_known
from daq.protocols import lines
from daq.protocols import session as sessions
from daq.protocols.lines import LineReader, LineTally, Other, Row
from daq.protocols.request import RecordRequest
from daq.protocols.session import Identity, Plan, Port, Session
from daq.wire import frames

if TYPE_CHECKING:
    from daq.wire.decode import Stream

BAUD = 115_200
TICK_NS = 1000
MILLISECOND = 1000  # ticks
LISTEN_S = 1.0  # of good lines, by their own times, before the rate is believed
FEWEST_LINES = 20
RATE_WITHIN = 0.1  # of the requested rate
LONGEST_LINE = 256


_TIMES = {"t_us": 1, "us": 1, "t_ms": 1000, "ms": 1000, "t_s": 1_000_000, "s": 1_000_000}
_COUNTS = ("up", "down", "count", "ticks")
_PATTERNS = {
    **dict.fromkeys(_TIMES, r"(\d{1,12}+)(?:\.(\d{0,9}+))?+"),
    **dict.fromkeys(("up", "down"), r"(\d{1,10}+)"),
    **dict.fromkeys(("count", "ticks"), r"([+-]?+\d{1,10}+)"),
    **dict.fromkeys(("a", "b"), "([01])"),
    "illegal": r"(\d{1,5}+)",
    "xor": r"\*?+([0-9A-Fa-f]{2})",
    "-": r"[^,;\s]*",
}
_SEPARATOR = r"(?:[,;]|[ \t]+[,;]?)[ \t]*"


def check(request: RecordRequest) -> None:
    """Refuse columns that cannot be read, and an unknown decoder."""
    columns(request.columns)
    if request.decoder is not None:
        check_known(request.decoder, frames.DECODERS, "decoder", "--decoder")


@dataclass(frozen=True)
class Columns:
    """How to read a line of the declared columns.

    Attributes
    ----------
    pattern : re.Pattern
        Of a whole line; its last group is empty and takes the place of every column that is not declared.
    counts : tuple of int
        Groups that hold the time's whole part and fraction, up (or the net count) and down.
    checks : tuple of int
        Groups that hold a, b, illegal and xor; empty when none of them is declared.
    us_per_unit : int
        Unit of the time, us.
    net : bool
        There is only one count, signed.
    bits : int
        Width of the counters.
    capabilities : Capability
        What the columns hold in addition to counts.
    """

    pattern: re.Pattern[bytes]
    counts: tuple[int, ...]
    checks: tuple[int, ...]
    us_per_unit: int
    net: bool
    bits: int
    capabilities: frames.Capability

    def read(self, line: bytes) -> Row | Other:
        """Return the values in a line."""
        found = self.pattern.fullmatch(line)
        if found is None:
            return Other.REMARK if line.startswith(b"#") or not line.rstrip(b"\r") else Other.DAMAGED
        whole, fraction, up_text, down_text = found.group(*self.counts)
        ticks = int(whole) * self.us_per_unit
        if fraction:  # digits beyond the microsecond are cut off
            ticks += int(fraction.ljust(6, b"0")[:6]) * self.us_per_unit // 1_000_000
        limit = 1 << self.bits
        up, down = int(up_text), int(down_text or 0)
        if not (-limit <= 2 * up < 2 * limit if self.net else up < limit and down < limit):
            return Other.DAMAGED
        if not self.checks:
            return ticks & 0xFFFFFFFF, up & limit - 1, down
        a, b, illegal, check = found.group(*self.checks)
        if check and reduce(xor, self._guarded(found), 0) != int(check, 16):
            return Other.DAMAGED
        levels = int(a or 0) | int(b or 0) << 1
        return ticks & 0xFFFFFFFF, up & limit - 1, down, levels, int(illegal or 0) & 0xFFFF

    def _guarded(self, found: re.Match[bytes]) -> bytes:
        """Return the part of a line that its xor covers: everything before the separator in front of it."""
        before = found.string[: found.start(self.checks[-1])].removesuffix(b"*").rstrip(b" \t")
        return (before[:-1] if before.endswith((b",", b";")) else before).rstrip(b" \t")


def columns(declared: str | None) -> Columns:
    """Return how to read lines of the declared columns.

    Raises
    ------
    InputError
        None are declared, one is unknown or declared twice, or time or counts are missing.
    """
    where = "--columns"
    if not declared:
        raise InputError("text lines need their columns declared", where, "give for example --columns t_us,up,down")
    names, widths = [], set()
    for part in declared.split(","):
        name, _, width = part.strip().partition(":")
        check_known(name, list(_PATTERNS), "column", where)
        if name in names and name != "-":
            raise InputError(f"column {name!r} occurs twice", where, "call what you do not need '-'")
        if width and (width not in ("16", "32") or name not in _COUNTS):
            raise InputError(f"{part.strip()!r} is not a width of a counter", where, "write up:16 or up:32")
        names.append(name)
        if name in _COUNTS:
            widths.add(int(width or 32))
    times = [name for name in names if name in _TIMES]
    if len(times) != 1:
        what = "which column is the time?" if times else "there is no time column, which is required"
        raise InputError(what, where, "declare one of t_us, t_ms, t_s; a sketch prints it by micros()")
    counts = sorted(name for name in names if name in _COUNTS)
    if counts not in (["down", "up"], ["count"], ["ticks"]):
        raise InputError("which columns are the counts?", where, "declare up and down, or count (or ticks)")
    if len(widths) > 1:
        raise InputError("up and down differ in width", where, "give both the same, as in up:16,down:16")
    if ("a" in names) != ("b" in names):
        raise InputError("one level of two", where, "declare both a and b, or neither")
    group = {"": 1}  # of each column; of the time, a second one behind it holds the fraction
    for name in names:
        if name != "-":
            group[name] = group[""]
            group[""] += 2 if name in _TIMES else 1
    fields = _SEPARATOR.join(_PATTERNS[name] for name in names)
    up, down = ("up", "down") if len(counts) == 2 else (counts[0], "")
    checks = ("a", "b", "illegal", "xor")
    has = frames.Capability
    return Columns(
        pattern=re.compile(rf"[ \t]*{fields}[ \t]*\r*()".encode()),
        counts=(group[times[0]], group[times[0]] + 1, group[up], group[down]),
        checks=tuple(group.get(name, group[""]) for name in checks) if group.keys() & checks else (),
        us_per_unit=_TIMES[times[0]],
        net=len(counts) == 1,
        bits=widths.pop(),
        capabilities=has(has.LEVELS * ("a" in names) | has.ILLEGAL * ("illegal" in names)),
    )


def ident(form: Columns, decoder: str | None) -> frames.Ident:
    """Return the identification that follows from the declared columns."""
    return frames.Ident(
        firmware=(0, 0, 0),
        decoder=decoder or "x4",
        capabilities=form.capabilities,
        counter_bits=form.bits,
        tick_ns=TICK_NS,
        block_size=1,
        max_rate_hz=1_000_000,
        max_edge_rate_hz=0,
        name="text lines",
    )


def reader(form: Columns) -> LineReader:
    """Return a reader of lines.  The first line is not used: digits missing at its beginning could not be detected."""
    return LineReader(b"\n", LONGEST_LINE, form.read, trusts_first=False)


def decode(reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Stream":
    """Decode the reads of one connection."""
    form = columns(header["columns"])
    period_ticks = 1e9 / (TICK_NS * float(header["rate_hz"]))
    return lines.decode(
        reads,
        reader(form),
        ident(form, header.get("decoder")),
        period_ticks,
        net=form.net,
        resolution=MILLISECOND,
    )


class Text(Session):
    """A session with a sketch that prints lines; nothing is sent to it."""

    def __init__(self, port: Port, url: str, request: RecordRequest) -> None:
        super().__init__(port, url, request)
        self._form = columns(request.columns)
        self._rate_hz = 0.0
        self._line_bytes = 0.0
        self._coarse = self._even = False

    def identify(self) -> Identity:
        """Read lines until their rate is known.

        Raises
        ------
        DeviceError
            Nothing is received, or no line with the declared columns.
        """
        listener = reader(self._form)
        times: list[int] = []
        heard = bad = 0
        until = time.monotonic() + sessions.ANSWER_S
        while time.monotonic() < until:
            data = self.read()
            heard += len(data)
            rows, others = listener.feed(data)
            times += [row[0] for row in rows]
            bad += len(others)
            steps = [later - earlier & 0xFFFFFFFF for earlier, later in pairwise(times)]
            if len(times) > FEWEST_LINES and median(steps) * len(steps) >= LISTEN_S * 1e9 / TICK_NS:
                break
        if len(times) <= FEWEST_LINES:
            raise DeviceError(*self._silent(heard, len(times), bad, listener.example))
        typical = median(steps)
        if typical == 0:
            raise DeviceError("the time in the lines does not change", self.url, "print micros() with each sample")
        if typical >= 1 << 31:
            what = f"the time in the lines runs backwards, by {(1 << 32) - typical:.0f} us from line to line"
            raise DeviceError(what, self.url, "check which of --columns is the time; print micros() with each sample")
        usual = [step for step in steps if 0.5 * typical <= step <= 1.5 * typical]
        self._rate_hz = 1e9 / TICK_NS / (sum(usual) / len(usual))
        self._line_bytes = heard / max(1, len(times) + bad)
        self._coarse = all(ticks % MILLISECOND == 0 for ticks in times)
        self._even = all(step > 0 and step % typical == 0 for step in steps)  # a line may be missing
        return Identity(ident(self._form, self.request.decoder))

    def plan(self, identity: Identity) -> Plan:
        """Return the sketch's own rate.

        Raises
        ------
        InputError
            It is not the requested one.
        """
        rate_hz, requested = self._rate_hz, self.request.rate_hz
        if requested is not None:
            if abs(rate_hz / requested - 1) > RATE_WITHIN:
                what = f"the lines arrive at {rate_hz:.4g} Hz, not at {requested} Hz"
                raise InputError(what, "--rate", f"leave --rate out, or give {round(rate_hz)}, or change the sketch")
            rate_hz = float(requested) if abs(rate_hz / requested - 1) < 0.01 else rate_hz
        else:
            rate_hz = float(f"{rate_hz:.3g}") if abs(float(f"{rate_hz:.3g}") / rate_hz - 1) < 0.005 else rate_hz
        notes = []
        if self._coarse and self._even:
            what = "the times are whole milliseconds, evenly spaced: exact if a timer takes the samples"
            notes.append(
                f"{what}; if they come from millis(), their errors are up to 1 ms: let the sketch print micros()"
            )
        elif self._coarse:
            notes.append("the times are whole milliseconds, with errors up to 1 ms: let the sketch print micros()")
        return Plan(rate_hz, 1, rate_hz * self._line_bytes, tuple(notes), comes_already=True)

    def prepare(self, plan: Plan) -> Identity:
        """Do nothing: a sketch takes no settings."""
        self._rate_hz = plan.rate_hz
        return Identity(ident(self._form, self.request.decoder))

    def start(self) -> None:
        """Discard the bytes received since then: the sketch prints all the time."""
        waiting = self.port.in_waiting
        if waiting:
            self.port.read(waiting)

    def restart(self) -> None:
        """Do nothing: a sketch starts on its own."""

    def stop(self) -> None:
        """Do nothing: a sketch continues to print."""

    def drain(self) -> bytes:
        """Return the bytes that are waiting: the line is never idle."""
        waiting = self.port.in_waiting
        return self.port.read(waiting) if waiting else b""

    def tally(self) -> LineTally:
        """Return a new tally."""
        return LineTally(partial(reader, self._form), 1e9 / (TICK_NS * self._rate_hz))

    def _silent(self, heard: int, good: int, bad: int, example: bytes) -> tuple[str, str, str]:
        if heard == 0:
            do = "check the port ('daq ports'), the cable, and that the sketch prints without a command"
            return f"nothing came within {sessions.ANSWER_S:g} s", self.url, do
        if bad > good:
            seen = example.rstrip(b"\r")[:60].decode("ascii", "backslashreplace")
            what = f"the lines are not of the columns {self.request.columns}; one is {seen!r}"
            return what, self.url, "declare the actual columns by --columns, and check --baud"
        what = f"only {good} lines came within {sessions.ANSWER_S:g} s"
        return what, self.url, f"let the sketch print at least {FEWEST_LINES // 5 + 1} lines a second"


session = Text
