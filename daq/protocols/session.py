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

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol

from daq.protocols.request import RecordRequest
from daq.wire import frames

if TYPE_CHECKING:
    from daq.wire.decode import Stream

ANSWER_S = 5.0  # an Arduino resets when its port is opened and boots for up to 2 s
ASK_AGAIN_S = 0.5  # between two requests for identification; a board that boots answers each of those it received
# A line without a byte for so long is idle.  USB chips deliver in batches of at most 16 ms: half would still cover one,
# double only makes each drain 50 ms longer.
QUIET_S = 0.05
DRAIN_S = 2.0  # a board that streams all the time is drained no longer than this
# Bytes of a journal that are decoded at once when a run file is made.  Half saves 10 MB and costs 5 % more CPU time in
# the finaliser; double needs 15 MB more.
PIECE_BYTES = 1 << 19
MOST_AT_ONCE = 4096  # bytes of a read from a port that does not report how many are waiting


class Port(Protocol):
    """An open port: the part of pyserial's interface that all of its handlers have."""

    @property
    def in_waiting(self) -> int:
        """Bytes that a read would return at once."""

    def read(self, size: int = 1, /) -> bytes:
        """Return up to ``size`` bytes, as many as come before the time-out."""

    def write(self, data: bytes, /) -> int | None:
        """Send."""

    def close(self) -> None:
        """Close the port."""

    def __enter__(self) -> "Port": ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...


@dataclass(frozen=True)
class Identity:
    """Identification sent by the board, or implied by its protocol; and the calibration, if the board has one."""

    ident: frames.Ident  # the identification
    config: str | None = None  # the calibration, TOML
    # (str, float) where positions are measured numbers: what they are, "length", "force" or "" of a unit that nobody
    # stated, and a count in SI
    measured: tuple[str, float] | None = None


@dataclass(frozen=True)
class Plan:
    """How a recording will go."""

    rate_hz: float  # the rate that the board will sample at
    block: int  # samples per frame
    bytes_per_s: float  # load on the line
    notes: tuple[str, ...] = ()  # remarks for the user, such as a rate that differs slightly from the requested one
    comes_already: bool = False  # the load was measured on the line, so the line carries it


class Tally(ABC):
    """How far a stream has come, in sample periods from its start: lost samples count, gaps of a lost port too.

    reached: Sample periods.
    received: Samples among them that came, and all periods while the port was lost.
    illegal: Illegal transitions as the board counts them; None where it does not.
    resets: Restarts of the board seen after the first sample.
    notice: The board's message when it stopped on its own.
    """

    def __init__(self) -> None:
        self.reached = self.received = 0
        self.illegal: int | None = None
        self.resets = 0
        self.notice = ""

    @abstractmethod
    def feed(self, data: bytes, at_s: float | None = None) -> None:
        """Take bytes as they came, and the host's monotonic clock when they had; None: it is not known."""

    def begin_again(self, reached: int) -> None:
        """Start again with a stream that starts ``reached`` periods after the first one."""
        lost = self.reached - self.received
        self.reached = max(self.reached, reached)
        self.received = self.reached - lost

    def words(self, elapsed_s: float) -> str:
        """Return the rate at which samples come, and those lost and illegal, in words."""
        rate = self.received / elapsed_s if elapsed_s > 0 else 0.0
        illegal = "" if self.illegal is None else f", {self.illegal} illegal"
        return f"{rate:.4g} Hz, {max(self.reached - self.received, 0)} lost{illegal}"


class Session(ABC):
    """One board on one port: the interface of every protocol, and the reading that they share.

    received: Bytes received before the start, from the last identification on, with the host's monotonic time stamp in
        ns. They are the first in the journal.

    Notes
    -----
    The port may raise SerialException or OSError at any time: the session's owner handles both.
    """

    def __init__(self, port: Port, url: str, request: RecordRequest) -> None:
        self.port = port
        self.url = url
        self.request = request
        self.received: list[tuple[int, bytes]] = []

    @abstractmethod
    def identify(self) -> Identity:
        """Identify the board; DeviceError when there is no answer, or none in this protocol."""

    @abstractmethod
    def plan(self, identity: Identity) -> Plan:
        """Return how the recording will go; InputError when it cannot."""

    @abstractmethod
    def prepare(self, plan: Plan) -> Identity:
        """Set the board up; DeviceError when it refuses."""

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
    def tally(self) -> Tally:
        """Return a new tally of what this session will read."""

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
        """Close the port; a port that is already gone raises nothing."""
        try:
            self.port.close()
        except OSError:
            return

    def drain(self) -> bytes:
        """Read until the line is idle, and return the bytes."""
        parts = []
        until = time.monotonic() + DRAIN_S
        quiet = time.monotonic() + QUIET_S
        while True:
            now = time.monotonic()  # before looking: whatever came during a pause of the computer is read first
            waiting = self.port.in_waiting
            if waiting:
                parts.append(self.port.read(waiting))
                quiet = time.monotonic() + QUIET_S
            elif now >= quiet:
                break
            else:
                time.sleep(QUIET_S / 10)
            if now >= until:
                break
        return b"".join(parts)

    def send(self, *commands: str) -> None:
        """Send command lines."""
        self.port.write("".join(f"{command}\n" for command in commands).encode())


class Backend(Protocol):
    """Functions that a protocol's module provides."""

    BAUD: int
    DELIMITER: bytes  # what ends a frame or a line of the board

    def check(self, request: RecordRequest) -> None:
        """Raise InputError for a request that this protocol can never carry out; nothing has been touched then."""

    def session(self, port: Port, url: str, request: RecordRequest) -> Session:
        """Return a session on an open port: the protocol's own class of sessions."""

    def decode(self, reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Stream":
        """Decode the reads of one connection out of a journal with this header."""

    def pieces(self, reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Iterator[Stream]":
        """Decode them piece by piece, at least one; ``reads`` gives the same whenever it is asked."""
