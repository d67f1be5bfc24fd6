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

import time
from collections.abc import Iterable, Mapping
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.errors import DeviceError, InputError, nearest
from daq.protocols import session as sessions
from daq.protocols.lines import LineTally, Rows, to_stream
from daq.protocols.session import Identity, Line, Plan, Port, Wish
from daq.protocols.text_columns import KINDS, Columns, columns
from daq.wire import cut, frames

if TYPE_CHECKING:
    from daq.wire.decode import Stream

BAUD = 115_200
TICK_NS = 1000
LISTEN_S = 1.0  # of good lines, by their own times, before the rate is believed
FEWEST_LINES = 20
RATE_WITHIN = 0.1  # of the wished rate
LONGEST_LINE = 256


def check(wish: Wish) -> None:
    """Refuse columns that cannot be read, and a decoder that there is not."""
    columns(wish.columns)
    if wish.decoder is not None and wish.decoder not in frames.DECODERS:
        raise InputError(f"unknown decoder {wish.decoder!r}", "--decoder", nearest(wish.decoder, frames.DECODERS))


def session(port: Port, url: str, wish: Wish) -> "Text":
    """Return a session on an open port."""
    return Text(port, url, wish)


def ident(form: Columns, decoder: str | None) -> frames.Ident:
    """Return what the declared columns say of the board."""
    has = frames.Capability
    told = has.LEVELS * (form.levels is not None) | has.ILLEGAL * (form.illegal is not None)
    return frames.Ident(
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
        self.example = b""  # a line that did not hold

    def feed(self, data: bytes) -> list[tuple[int, int, int, int, int]]:
        """Take bytes as they came and return what the lines they complete say."""
        *lines, self._tail = (self._tail + data).split(b"\n")
        found = []
        for line in lines:
            stripped = line.rstrip(b"\r")
            if self._skipping:
                self._skipping = False
            elif stripped and not stripped.startswith(b"#"):
                row = self._form.read(stripped)
                # A first line may have lost its beginning, which digits do not show.
                if row is None:
                    self.example = self.example or stripped
                    self.bad += not self._first
                elif not self._first:
                    found.append(row)
            self._first = False
        if len(self._tail) > LONGEST_LINE:
            self.bad += not self._skipping and not self._first
            self._first, self._skipping = False, True
            self._tail = b""
        return found

    def last(self, data: bytes) -> tuple[int | None, int]:
        """Look ahead: return the time of the last line that ``data`` completes, and how many; nothing is taken.

        The time is None when that line does not hold.
        """
        if self._first or self._skipping:
            return None, 0
        whole = self._tail + data
        end = whole.rfind(b"\n")
        begin = whole.rfind(b"\n", 0, max(end, 0)) + 1
        row = self._form.read(whole[begin : max(end, 0)].rstrip(b"\r"))
        return None if row is None else row[0], whole.count(b"\n")

    def skip(self, data: bytes) -> None:
        """Take bytes without reading the lines that they complete."""
        self._tail = (self._tail + data).rpartition(b"\n")[2]


class Tally(LineTally):
    """How far a stream of lines has come."""

    def __init__(self, form: Columns, rate_hz: float) -> None:
        super().__init__(1e9 / (TICK_NS * rate_hz))
        self._form = form
        self._lines = Lines(form)

    def feed(self, data: bytes) -> None:
        """Take bytes as they came."""
        ticks, count = self._lines.last(data)
        if ticks is not None and self.stride(ticks, count):
            self._lines.skip(data)
            return
        for row in self._lines.feed(data):
            self.step(row[0])

    def begin_again(self, reached: int) -> None:
        """Begin anew, ``reached`` periods after the start."""
        super().begin_again(reached)
        self._lines = Lines(self._form)


def decode(reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Stream":
    """Decode the reads of one connection."""
    form = columns(header["columns"])
    rows = Rows.of(cut.cut(reads, b"\n"), net=form.down is None)
    lines = rows.lines
    told = rows.ticks, rows.up, rows.down, rows.status, rows.illegal
    singly = lines.length > 0
    for where, together in lines.by_length(3, LONGEST_LINE):
        for same in cut.alike(together, KINDS):
            found = form.read_alike(together[same])
            if found is not None:
                line, held = where[same], found[0]
                rows.good[line], rows.bad[line], singly[line] = held, ~held, False
                for column, values in zip(told, found[1], strict=True):
                    column[line] = values
    for k in np.flatnonzero(singly).tolist():
        stripped = lines.line(k).rstrip(b"\r")
        if stripped and not stripped.startswith(b"#"):
            row = form.read(stripped)
            rows.good[k], rows.bad[k] = row is not None, row is None
            for column, value in zip(told, row or (0,) * 5, strict=True):
                column[k] = value
    rows.good[:1] = False  # a first line may have lost its beginning, which digits do not show
    rows.close(LONGEST_LINE)
    return to_stream(rows, ident(form, header.get("decoder")), 1e9 / (TICK_NS * float(header["rate_hz"])))


class Text(Line):
    """A session with a sketch that prints lines; it is listened to, and nothing is said to it."""

    def __init__(self, port: Port, url: str, wish: Wish) -> None:
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
        if typical >= 1 << 31:
            what = f"the time in the lines runs backwards, by {(1 << 32) - typical:.0f} us from line to line"
            raise DeviceError(what, self.url, "check which of --columns is the time; print micros() with each sample")
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
