r"""Lines of numbers, one per sample, as any sketch prints them; the user declares their columns.

``--columns t_us,up,down``: names in the order of the line, separated by commas; the line itself may use commas,
semicolons, tabs or spaces.  A sign, a decimal point in a time, and ``\r\n`` are understood; a line that begins with
``#`` is a comment, brackets around a line are ignored.  Exactly one time, and a net count, both counters, or a
measured number:

==================  ===================================================================================================
column              holds
==================  ===================================================================================================
t_us  t_ms  t_s     device time (also us, ms, s); micros() and millis() may roll over at 2^32
up  down            the two counters; ``up:16`` and ``down:16`` when they roll over at 2^16 (32 without)
count               net count, signed (also ticks); ``count:16`` when it rolls over at 2^16
x_m  x_mm           position in m, mm (also x_cm, x_um), with decimals and sign; ``x`` when its unit is not known
F_N  F_mN           force of a spring of known stiffness
seq                 number of the line; only its form counts: losses show in the time
a  b                levels of the channels, 0 or 1
illegal             illegal transitions counted so far
xor                 two hex digits: XOR of the bytes before the separator in front of them, the only checksum
``-``               anything; ignored
==================  ===================================================================================================

Labelled lines (``t=12,pos=34``, ``us: 12; count: 34``) need no columns: micros, millis, t and time are times, too; pos,
position, counts and encoder are counts; x, distance and laser are positions, and force is one; a unit may follow, as in
pos_mm.  Other labels are ignored.  The unit of t and time is that of the declared column, us without.

A sketch may state its columns itself, in a comment that it repeats: ``# columns seq,t_us,count,xor``.

A measured number is a count of its last decimal, so that everything after this module is the same as for counts:
``x_mm:2`` has two decimals.  Decimals that are not declared are those of the first lines.

The rate is the sketch's own: it is measured before the recording starts.  Nothing is sent to the board.
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Any

from daq.protocols import lines
from daq.protocols import session as sessions
from daq.protocols.columns import (
    LONGEST_LINE,
    Columns,
    ColumnVote,
    LineParser,
    explain_labels,
    parse_columns,
    with_decimals,
)
from daq.protocols.lines import LineReader, LineTally
from daq.protocols.request import RecordRequest
from daq.protocols.session import Identity, Plan, Port, Session
from daq.wire import frames
from stickslip.errors import DeviceError, InputError, check_known

if TYPE_CHECKING:
    from daq.wire.decode import Stream

BAUD = 115_200
DELIMITER = b"\n"
TICK_NS = 1000
MILLISECOND = 1000  # ticks
LISTEN_S = 1.0  # span of good lines, by their own times, before their rate is used
FEWEST_LINES = 20
SLOWEST = 0.05  # a clock slower than this share of the host's has another unit, most often by 1000
RATE_WITHIN = 0.1  # deviation from the requested rate, relative


def check(request: RecordRequest) -> None:
    """Refuse columns that cannot be parsed, and an unknown decoder."""
    parse_columns(request.columns)
    if request.decoder is not None:
        check_known(request.decoder, frames.DECODERS, "decoder", "--decoder")


def make_ident(form: Columns, decoder: str | None) -> frames.Ident:
    """Return the identification that follows from the declared columns."""
    return frames.Ident(
        decoder=decoder or "x4",
        capabilities=form.capabilities,
        counter_bits=form.bits,
        tick_ns=TICK_NS,
        name="text lines",
    )


def make_reader(form: Columns) -> LineReader:
    """Return a reader of lines that skips the first one: digits missing at its beginning could not be detected."""
    return LineReader(DELIMITER, LONGEST_LINE, LineParser(form).read, trusts_first=False)


def decode_pieces(
    reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any], most_bytes: float
) -> "Iterator[Stream]":
    declared = header["columns"]
    if declared is None:
        vote = ColumnVote()
        any(vote.feed(data) for _, data in reads)  # up to the line that decides
        declared = vote.columns
    form = parse_columns(declared)
    return lines.decode_pieces(
        reads,
        partial(make_reader, form),
        make_ident(form, header.get("decoder")),
        1e9 / (TICK_NS * float(header["rate_hz"])),
        net=form.net,
        most_bytes=most_bytes,
        resolution=MILLISECOND,
    )


class Text(Session):
    """A session with a sketch that prints lines; nothing is sent to it."""

    def __init__(self, port: Port, url: str, request: RecordRequest) -> None:
        super().__init__(port, url, request)
        self._form = parse_columns(request.columns)
        self._rate_hz = 0.0
        self._line_bytes = 0.0
        self._coarse = self._even = False

    def identify(self) -> Identity:
        """Read lines until their rate is known; and their columns, if they are labelled and none are declared.

        Raises DeviceError if nothing is received, or no line with the declared columns.
        """
        listener = make_reader(self._form)
        vote, received_bytes = ColumnVote(), b""
        times: list[int] = []
        bytes_heard, n_damaged, first_s = 0, 0, 0.0
        deadline = time.monotonic() + sessions.ANSWER_S
        while time.monotonic() < deadline:
            data = self.read()
            bytes_heard += len(data)
            received_bytes += data
            if self.request.columns is None:
                if vote.feed(data):
                    self.request = replace(self.request, columns=vote.columns)
                    self._form = parse_columns(vote.columns)
                    listener, data, times, n_damaged = make_reader(self._form), received_bytes, [], 0
            batch = listener.feed(data)
            if len(batch.rows) and not times:
                first_s = time.monotonic()
            times += batch.rows[:, 0].tolist()
            n_damaged += len(batch.others)
            steps = [later - earlier & 0xFFFFFFFF for earlier, later in pairwise(times)]
            advance = sum(sorted(steps)[: len(steps) * 9 // 10])  # robust against single lines
            if len(times) > FEWEST_LINES and advance >= LISTEN_S * 1e9 / TICK_NS:
                break
        if len(times) <= FEWEST_LINES:
            raise DeviceError(*self._explain_silence(bytes_heard, len(times), n_damaged, listener.example))
        if self.request.columns is not None and self._form.measured is not None:
            self._form = with_decimals(self.request.columns, received_bytes)
            self.request = replace(self.request, columns=self._form.declared)
        typical = median(steps)
        if not any(steps):
            raise DeviceError("the time in the lines does not change", self.url, "print micros() with each sample")
        if typical >= 1 << 31:
            problem = f"the time in the lines runs backwards, by {(1 << 32) - typical:.0f} us from line to line"
            raise DeviceError(
                problem, self.url, "check which of the --columns is the time, and print micros() with each sample"
            )
        took, advanced = time.monotonic() - first_s, sum(steps) * TICK_NS / 1e9
        if took > 0.5 * sessions.ANSWER_S and advanced < SLOWEST * took:
            problem = f"the time in the lines advances by {1e3 * advanced:.3g} ms in {took:.3g} s"
            raise DeviceError(problem, self.url, "state its unit in the column name, as in --columns t_ms,count")
        self._coarse = all(ticks % MILLISECOND == 0 for ticks in times)
        self._even = typical > 0 and all(step > 0 and step % typical == 0 for step in steps)  # a line may be missing
        shortest, longest = 0.5 * typical, 1.5 * typical
        if self._coarse and not self._even:  # its steps differ by a millisecond, so their mean is the interval
            shortest, longest = 0.0, max(longest, typical + 2 * MILLISECOND)
        usual = [step for step in steps if shortest <= step <= longest]
        if not any(usual):
            raise DeviceError("the time in most lines does not change", self.url, "print micros() with each sample")
        self._rate_hz = 1e9 / TICK_NS / (sum(usual) / len(usual))
        self._line_bytes = bytes_heard / max(1, len(times) + n_damaged)
        return self._identity()

    def _identity(self) -> Identity:
        return Identity(make_ident(self._form, self.request.decoder), measured=self._form.measured)

    def plan(self, identity: Identity) -> Plan:
        """Return the sketch's own rate; InputError if it is not the requested one."""
        rate_hz, requested = self._rate_hz, self.request.rate_hz
        if requested is not None:
            if abs(rate_hz / requested - 1) > RATE_WITHIN:
                what = f"the lines arrive at {rate_hz:.4g} Hz, not at {requested} Hz"
                do = f"omit --rate, set it to {round(rate_hz)}, or change the sketch"
                python = f"use rate_hz=None or rate_hz={round(rate_hz)}, or change the sketch"
                raise InputError(what, "--rate", do, python=python)
            rate_hz = float(requested) if abs(rate_hz / requested - 1) < 0.01 else rate_hz
        else:
            rate_hz = float(f"{rate_hz:.3g}") if abs(float(f"{rate_hz:.3g}") / rate_hz - 1) < 0.005 else rate_hz
        notes = []
        if self._coarse and self._even:
            what = "the times are evenly spaced whole milliseconds, which are exact if a timer triggers the samples"
            notes.append(f"{what}. If they come from millis(), their errors are up to 1 ms, so print micros() instead")
        elif self._coarse:
            notes.append("the times are whole milliseconds with errors up to 1 ms, so print micros() instead")
        if self._form.measured is not None and not self._form.measured[0]:
            example = self._form.declared.replace("x:", "x_mm:")
            notes.append(
                f"the positions have no unit, so they are recorded as counts of {self._form.measured[1]:g} of "
                f"the unit. State the unit with --columns {example}, or use --metres-per-count"
            )
        return Plan(rate_hz, 1, rate_hz * self._line_bytes, tuple(notes), comes_already=True)

    def prepare(self, plan: Plan) -> Identity:
        self._rate_hz = plan.rate_hz
        return self._identity()

    def start(self) -> None:
        """Discard the bytes received since then: the sketch prints continuously."""
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
        return LineTally(partial(make_reader, self._form), 1e9 / (TICK_NS * self._rate_hz))

    def _explain_silence(self, bytes_heard: int, good: int, bad: int, example: bytes) -> tuple[str, str, str]:
        if bytes_heard == 0:
            do = "check the port ('daq ports'), the cable, and that the sketch prints without waiting for a command"
            return f"no data arrived within {sessions.ANSWER_S:g} s", self.url, do
        if bad > good:
            if (labels := explain_labels(example)) is not None:
                return labels[0], self.url, labels[1]
            example_text = example.rstrip(b"\r")[:60].decode("ascii", "backslashreplace")
            if self.request.columns is None:
                form = "t_us,x_mm" if "." in example_text else "t_us,up,down"
                do = f"declare the columns, as in --columns {form}, or print labels, as in t=1,pos=2; check --baud"
                return f"the lines, such as {example_text!r}, have no labels, and no columns are declared", self.url, do
            problem = f"the lines, such as {example_text!r}, do not match the columns {self.request.columns}"
            return problem, self.url, "declare the actual columns by --columns, and check --baud"
        problem = f"only {good} lines arrived within {sessions.ANSWER_S:g} s"
        return problem, self.url, f"let the sketch print at least {FEWEST_LINES // 5 + 1} lines a second"


session = Text
