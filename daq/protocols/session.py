"""A session with a board: the interface of every protocol, and the reading that they share.

States of a session, and the calls that change them::

    silent     opened; the board may be anything: booting, still streaming for a program that crashed
      identify()  find out which board it is
    idle
      plan()      choose the rate, and compute its load on the line; nothing is sent
      prepare()   set the board up; its answer is the receipt
    ready
      start()
    streaming  read() belongs to the recorder now; restart() starts a board again that has reset
      stop()
    idle       the rest of the stream may still come
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol

from daq.protocols.request import RecordRequest
from daq.wire import frames
from stickslip.errors import DeviceError

if TYPE_CHECKING:
    from daq.wire.decode import Stream

ANSWER_S = 5.0  # an Arduino resets when its port is opened and boots for up to 2 s
ASK_AGAIN_S = 0.5  # between two requests for identification; a booting board answers each that it received
# A line without a byte for so long is idle: USB chips deliver in batches of at most 16 ms.
QUIET_S = 0.05
DRAIN_S = 2.0  # a board that streams continuously is drained no longer than this
# Bytes of a journal that are decoded at once when a run file is made: twice as many take 15 MB more.
PIECE_BYTES = 1 << 19
MOST_AT_ONCE = 4096  # bytes of a read from a port that does not report how many are waiting


class Port(Protocol):
    """An open port: the part of pyserial's interface that all of its handlers have."""

    @property
    def in_waiting(self) -> int:
        """Bytes that a read would return immediately."""

    def read(self, size: int = 1, /) -> bytes:
        """Return up to ``size`` bytes, as many as arrive before the time-out."""

    def write(self, data: bytes, /) -> int | None: ...

    def close(self) -> None: ...

    def __enter__(self) -> "Port": ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...


@dataclass(frozen=True)
class Identity:
    """Identification sent by the board, or implied by its protocol; and the calibration, if the board has one."""

    ident: frames.Ident
    config: str | None = None  # the calibration, TOML
    # if positions are measured numbers: the quantity, "length", "force" or "" (unknown unit), and a count in SI
    measured: tuple[str, float] | None = None


@dataclass(frozen=True)
class Plan:
    """The settings of a recording."""

    rate_hz: float  # the rate that the board will sample at
    block: int  # samples per frame
    bytes_per_s: float  # load on the line
    notes: tuple[str, ...] = ()  # remarks for the user, such as a rate that differs slightly from the requested one
    comes_already: bool = False  # whether the load was measured on the line, so that the line can carry it


class Tally(ABC):
    """How far a stream has advanced, in sample periods from its start, lost samples and gaps of a lost port included.

    reached: Sample periods.
    received: Samples among them that arrived, and all periods while the port was lost.
    illegal: Illegal transitions as the board counts them; None if it does not.
    resets: Restarts of the board after the first sample.
    notice: The board's message when it stopped by itself.
    """

    def __init__(self) -> None:
        self.reached = self.received = 0
        self.illegal: int | None = None
        self.resets = 0
        self.notice = ""

    @abstractmethod
    def feed(self, data: bytes, at_s: float | None = None) -> None:
        """Count the samples in bytes; ``at_s`` is the host's monotonic clock when they arrived, None if unknown."""

    def begin_again(self, reached: int) -> None:
        """Continue with a stream that starts ``reached`` periods after the first one."""
        lost = self.reached - self.received
        self.reached = max(self.reached, reached)
        self.received = self.reached - lost

    def describe(self, elapsed_s: float) -> str:
        """Return the rate at which samples arrive, and those lost and illegal, as text."""
        rate = self.received / elapsed_s if elapsed_s > 0 else 0.0
        illegal = "" if self.illegal is None else f", {self.illegal} illegal"
        return f"{rate:.4g} Hz, {max(self.reached - self.received, 0)} lost{illegal}"


class Session(ABC):
    """One board on one port: the interface of every protocol, and the reading that they share.

    received: Bytes received before the start, from the last identification on, with the host's monotonic time stamp in
        ns. They are the first in the journal.

    The port may raise SerialException or OSError at any time: the session's owner handles both.
    """

    def __init__(self, port: Port, url: str, request: RecordRequest) -> None:
        self.port = port
        self.url = url
        self.request = request
        self.received: list[tuple[int, bytes]] = []

    @abstractmethod
    def identify(self) -> Identity:
        """Identify the board; DeviceError if there is no answer, or none in this protocol."""

    @abstractmethod
    def plan(self, identity: Identity) -> Plan:
        """Return the settings of the recording; InputError if it is impossible."""

    @abstractmethod
    def prepare(self, plan: Plan) -> Identity:
        """Set the board up; DeviceError if it refuses."""

    @abstractmethod
    def start(self) -> None:
        """Start the samples."""

    @abstractmethod
    def restart(self) -> None:
        """Configure and start a board that has just reset, without waiting for answers."""

    @abstractmethod
    def stop(self) -> None:
        """Stop the samples; the rest of the stream may still come."""

    @abstractmethod
    def tally(self) -> Tally: ...

    def read(self) -> bytes:
        """Wait for bytes, for the port's time-out at most, and return all that are there."""
        waiting = self.port.in_waiting
        data: bytes = self.port.read(waiting or 1)
        if data and not waiting:
            waiting = self.port.in_waiting
            data += self.port.read(waiting)
        while waiting == 1 and len(data) < MOST_AT_ONCE:  # a socket returns 1 for "some"
            waiting = self.port.in_waiting
            data += self.port.read(waiting)
        return data

    def close(self) -> None:
        """Close the port; no error if it is gone."""
        try:
            self.port.close()
        except OSError:
            return

    def drain(self) -> bytes:
        """Read until the line is idle, and return the bytes."""
        received = []
        deadline = time.monotonic() + DRAIN_S
        idle_at = time.monotonic() + QUIET_S
        while True:
            now = time.monotonic()  # first, so that bytes from a pause of the computer are read
            waiting = self.port.in_waiting
            if waiting:
                received.append(self.port.read(waiting))
                idle_at = time.monotonic() + QUIET_S
            elif now >= idle_at:
                break
            else:
                time.sleep(QUIET_S / 10)
            if now >= deadline:
                break
        return b"".join(received)

    def explain_no_answer(self, bytes_heard: int, condition: str, do: str) -> DeviceError:
        """Return the error of a device that did not identify itself; ``do`` is for one that sent other bytes."""
        if bytes_heard:
            what = f"the device did not identify itself within {ANSWER_S:g} s, but sent {bytes_heard} other bytes"
            return DeviceError(what, self.url, do)
        do = f"check the port ('daq ports'), the cable, and that {condition}"
        return DeviceError(f"the device did not reply within {ANSWER_S:g} s", self.url, do)

    def send(self, *commands: str) -> None:
        """Send command lines."""
        self.port.write("".join(f"{command}\n" for command in commands).encode())


class Backend(Protocol):
    """The functions that a protocol's module provides."""

    BAUD: int
    DELIMITER: bytes  # what ends a frame or a line of the board

    def check(self, request: RecordRequest) -> None:
        """Raise InputError for a request that this protocol can never carry out; the port is not open yet."""

    def session(self, port: Port, url: str, request: RecordRequest) -> Session:
        """Return a session on an open port: the protocol's own class of sessions."""

    def decode_pieces(
        self, reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any], most_bytes: float
    ) -> "Iterator[Stream]":
        """Decode the reads of one connection out of a journal with this header, in pieces of about so many bytes.

        There is at least one piece; ``reads`` is iterated over repeatedly and must yield the same.
        """


def decode_whole(backend: Backend, reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Stream":
    """Decode the reads of one connection in one piece."""
    return next(backend.decode_pieces(reads, header, math.inf))
