r"""US Digital's QSB, a quadrature-to-USB adapter: ASCII records at 230400 baud, 32-bit counts, a tick of 1/512 s.

Commands are a letter (R read, W write, S stream), a register of two hex digits and data; a line feed ends them.
Records are the letter in lower case, the register, eight hex digits of data, eight of time stamp, and ``!``::

    W155      w15 00000005 00000123 !      reply format: line feed and time stamp
    S0E       s0E 00000539 00000200 !      a count, again and again, until the stream is stopped
              QSB-S  0E!                   it has just been reset
              e...!                        an error

Registers: 03 x1, x2 or x4; 0B least change that is sent (0: every sample); 0C interval in 1/512 s; 0D time reset;
0E count; 14 identity; 15 reply format; 16 stop.  A stream also ends when its register is read.

Not used: counting modulo N, index and trigger inputs, x2.  There is no checksum: `daq.protocols.lines` describes
how damage is detected.  Written from descriptions and other programs; not tested on the device.
"""

import re
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from daq.protocols import lines
from daq.protocols import session as sessions
from daq.protocols.lines import LineReader, LineTally, NoSample, Row
from daq.protocols.request import RecordRequest
from daq.protocols.session import Identity, Plan, Port, Session
from daq.wire import frames
from daq.wire.splitter import Splitter
from stickslip.errors import DeviceError, InputError

if TYPE_CHECKING:
    from daq.wire.decode import Stream

BAUD = 230_400
DELIMITER = b"!"
TICK_HZ = 512
TICK_NS = 1_000_000_000 // TICK_HZ  # 1.953125 ms, exactly
RECORD_BYTES = 21
LONGEST_RECORD = 64  # bytes; a longer one without a "!" is damaged
MODES = {"x1": "1", "x4": "3"}
REPLY_S = 1.0  # for the acknowledgement of one setting; not measured on the device
_SAMPLE = re.compile(rb"s[0-9A-Fa-f]{18}")
_RECORD = re.compile(rb"[rwse][0-9A-Fa-f]{10}(?:[0-9A-Fa-f]{8})?")
_ERROR = re.compile(rb"e[0-9A-Fa-f]{0,18}")
_BANNER = re.compile(rb"QSB-[A-Z0-9]{1,8}$")
_SPACE = b" \r\n"


def check(request: RecordRequest) -> None:
    if request.rate_hz is not None and request.rate_hz > TICK_HZ:
        what = f"{request.rate_hz} Hz is too fast for a QSB, whose tick of 1/512 s allows at most {TICK_HZ} Hz"
        raise InputError(what, "--rate", f"use --rate {TICK_HZ} or less, or a board with stickslip firmware")
    if request.decoder is not None and request.decoder not in MODES:
        what = f"a QSB has no decoder {request.decoder!r}"
        raise InputError(what, "--decoder", f"use {' or '.join(MODES)}")
    if request.columns is not None:
        raise InputError(
            "the records of a QSB have fixed columns", "--columns", "omit it; it applies only to the protocol 'text'"
        )


def make_ident(decoder: str | None) -> frames.Ident:
    """Return the identification common to every QSB."""
    name = "US Digital QSB"
    return frames.Ident(decoder=decoder or "x4", counter_bits=32, tick_ns=TICK_NS, max_rate_hz=TICK_HZ, name=name)


def read_record(line: bytes) -> Row | NoSample:
    """Return the values in a record; spaces in it are ignored."""
    record = line.translate(None, _SPACE)
    if _SAMPLE.fullmatch(record):
        return int(record[11:], 16), int(record[3:11], 16)
    if _BANNER.fullmatch(record):
        return NoSample.START
    if _RECORD.fullmatch(record) or _ERROR.fullmatch(record):
        return NoSample.REMARK
    return NoSample.DAMAGED | NoSample.START if _BANNER.search(record) else NoSample.DAMAGED


def make_reader() -> LineReader:
    return LineReader(DELIMITER, LONGEST_RECORD, read_record, trusts_first=True)


def decode_pieces(
    reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any], most_bytes: float
) -> "Iterator[Stream]":
    ident, period_ticks = make_ident(header.get("decoder")), TICK_HZ / float(header["rate_hz"])
    return lines.decode_pieces(reads, make_reader, ident, period_ticks, net=True, most_bytes=most_bytes)


class Qsb(Session):
    def __init__(self, port: Port, url: str, request: RecordRequest) -> None:
        super().__init__(port, url, request)
        self._interval = 1
        self._settings: tuple[str, ...] = ()

    def identify(self) -> Identity:
        """Stop a running stream and request the identity.

        Raises DeviceError if there is no answer, or not that of a QSB.
        """
        self.send("", "W160", "R0E")
        bytes_heard = len(self.drain())
        until = time.monotonic() + sessions.ANSWER_S
        while time.monotonic() < until:
            self.send("R14")
            reply, count = self._await_reply(b"r14", sessions.ASK_AGAIN_S)
            bytes_heard += count
            if reply is not None:
                return Identity(make_ident(self.request.decoder))
        do = "check that it is a QSB, and --baud (230400 for a QSB)"
        raise self.explain_no_answer(bytes_heard, "it is a QSB", do)

    def plan(self, identity: Identity) -> Plan:
        """Return the rate 512/n Hz that is nearest to the requested one."""
        check(self.request)
        requested = self.request.rate_hz or TICK_HZ
        self._interval = max(1, round(TICK_HZ / requested))
        rate_hz = TICK_HZ / self._interval
        notes = []
        if rate_hz != requested:
            notes.append(f"a QSB samples at 512/n Hz: {rate_hz:.6g} Hz is the nearest to {requested} Hz")
        return Plan(rate_hz, 1, rate_hz * RECORD_BYTES, tuple(notes))

    def prepare(self, plan: Plan) -> Identity:
        """Set reply format, decoder, interval and time; DeviceError if it does not acknowledge a setting."""
        mode = MODES[self.request.decoder or "x4"]
        # Older devices may lack register 0B; they send every sample anyway.
        self._settings = ("W155", f"W03{mode}", "W0B0", f"W0C{self._interval:X}", "W0D1")
        for command in self._settings:
            self.send(command)
            reply, _ = self._await_reply(b"w" + command[1:3].lower().encode(), REPLY_S)
            if reply is None and not command.startswith("W0B"):
                raise DeviceError(f"the QSB does not acknowledge {command}", self.url, "plug it in again")
        return Identity(make_ident(self.request.decoder))

    def start(self) -> None:
        self.send("S0E")

    def restart(self) -> None:
        self.send(*self._settings, "S0E")

    def stop(self) -> None:
        self.send("W160", "R0E")

    def tally(self) -> LineTally:
        return LineTally(make_reader, self._interval, TICK_NS)

    def _await_reply(self, beginning: bytes, within_s: float) -> tuple[bytes | None, int]:
        """Return the record that answers a command, None for an error or no answer; and the number of bytes read."""
        splitter = Splitter(b"!", LONGEST_RECORD)
        until = time.monotonic() + within_s
        bytes_heard = 0
        while time.monotonic() < until:
            data = self.read()
            bytes_heard += len(data)
            for line in splitter.feed(data):
                record = line.translate(None, _SPACE)
                if _RECORD.fullmatch(record):
                    if record[:3].lower() == beginning:
                        return record, bytes_heard
                elif _ERROR.fullmatch(record):
                    return None, bytes_heard
        return None, bytes_heard


session = Qsb
