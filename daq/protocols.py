"""Sessions with a board: identify, set the rate, start, stop; each protocol is one class with the same few methods.

`PROTOCOLS` names them; a journal's header says which one its bytes are in.  There is one so far, our own frames
(`daq.wire`), which boards with our firmware and the simulated rig both speak.

States of a session, and what moves it on::

    silent     opened; the board may be anything: booting, still streaming for somebody who crashed
      identify()  stop it, let the line run dry, ask until it answers
    idle
      prepare()   rate and block size; its second identification is the receipt
    ready
      start()
    streaming  read() belongs to the recorder now
      stop()
    idle       the rest of the stream may still come
"""

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from daq import wire
from daq.errors import DeviceError

if TYPE_CHECKING:
    from daq.ports import Port

ANSWER_S = 5.0  # an Arduino resets when its port is opened and boots for up to 2 s
ASK_AGAIN_S = 0.5
QUIET_S = 0.05  # a line this long without a byte has run dry
DRAIN_S = 2.0


@dataclass(frozen=True)
class Identity:
    """What a board said about itself: its identification, and the rig's calibration when it holds one."""

    ident: wire.Ident
    config: str | None


class Frames:
    """A session in our own binary protocol.

    Parameters
    ----------
    decoder : str, optional
        The decoder to select on a board that runs another one; its counters then start again.

    Attributes
    ----------
    received : list of (int, bytes)
        What came from the last identification on, with the host's monotonic stamp in ns: it opens the journal.

    Notes
    -----
    `port.read` and `port.write` may raise SerialException or OSError at any time: the port's owner handles both.
    """

    name = "frames"

    def __init__(self, port: "Port", url: str, decoder: str | None = None) -> None:
        self.port = port
        self.url = url
        self.decoder = decoder
        self.received: list[tuple[int, bytes]] = []

    def identify(self) -> Identity:
        """Stop whatever runs and ask the board who it is.

        Raises
        ------
        DeviceError
            No answer, or none in our protocol; or the board does not have the decoder.
        """
        self._send("", "X")  # the empty line ends a half-sent command of somebody who crashed
        strange = self.drain()
        identity = self._ask(strange)
        if self.decoder in (None, identity.ident.decoder):
            return identity
        self._send(f"M {self.decoder}")
        return self._ask(b"")

    def prepare(self, rate_hz: int, block: int) -> Identity:
        """Set the sample rate and the samples per frame.

        Raises
        ------
        DeviceError
            The board refuses; its own words are in the message.
        """
        self._send(f"R {rate_hz}", f"B {block}")
        identity = self._ask(b"")
        if identity.ident.block_size != block:
            what = f"the board keeps {identity.ident.block_size} samples per frame where {block} were asked for"
            raise DeviceError(what, self.url, "update its firmware")
        return identity

    def start(self) -> None:
        """Start the samples: sequence number 0."""
        self._send("S")

    def restart(self, rate_hz: int, block: int) -> None:
        """Set a board that has just reset back to work, without waiting for answers."""
        decoder = [] if self.decoder is None else [f"M {self.decoder}"]
        self._send(*decoder, f"R {rate_hz}", f"B {block}", "S")

    def stop(self) -> None:
        """Stop the samples; the partial block still comes."""
        self._send("X")

    def read(self) -> bytes:
        """Wait for bytes, for the port's time-out at most, and return all that are there."""
        data: bytes = self.port.read(1)
        return data + self.port.read(self.port.in_waiting) if data else data

    def close(self) -> None:
        """Let go of the port; one that is gone already is no error."""
        try:
            self.port.close()
        except OSError:
            return

    def drain(self) -> bytes:
        """Read until the line has run dry, and return what came."""
        parts = []
        until = time.monotonic() + DRAIN_S
        quiet = time.monotonic() + QUIET_S
        while time.monotonic() < min(until, quiet):
            waiting = self.port.in_waiting
            if waiting:
                parts.append(self.port.read(waiting))
                quiet = time.monotonic() + QUIET_S
            else:
                time.sleep(QUIET_S / 10)
        return b"".join(parts)

    def _send(self, *commands: str) -> None:
        self.port.write("".join(f"{command}\n" for command in commands).encode())

    def _ask(self, strange: bytes) -> Identity:
        """Send `I` until an identification comes, and its CONFIG when it announces one."""
        reader = wire.FrameReader()
        until = time.monotonic() + ANSWER_S
        ask = 0.0
        ident: wire.Ident | None = None
        heard = len(strange)
        while time.monotonic() < until:
            if ident is None and time.monotonic() >= ask:
                self._send("I")
                ask = time.monotonic() + ASK_AGAIN_S
            data = self.read()
            if not data:
                continue
            heard += len(data)
            self.received.append((time.monotonic_ns(), data))
            for frame in reader.feed(data):
                if isinstance(frame, wire.Notice):
                    raise DeviceError(f"the board refuses: {frame.text}", self.url, "ask for what it can do")
                if isinstance(frame, wire.Ident):
                    ident = frame
                    self._begin_with(ident)
                if isinstance(frame, wire.Config) and ident is not None:
                    return self._settled(ident, frame.toml)
            if ident is not None and wire.Capability.CONFIG not in ident.capabilities:
                return self._settled(ident, None)
        if ident is not None:
            raise DeviceError("the board announces a CONFIG and does not send it", self.url, "reset it and try again")
        if heard:
            what = f"no identification within {ANSWER_S:g} s, but {heard} bytes of something else"
            raise DeviceError(what, self.url, "check the baud rate, and that the board runs our firmware")
        do = "check the port ('daq ports'), the cable, and that the board runs our firmware"
        raise DeviceError(f"no answer within {ANSWER_S:g} s", self.url, do)

    def _begin_with(self, ident: wire.Ident) -> None:
        """Drop what came before an identification: the noise of a board that had to find our baud rate."""
        came = b"".join(data for _, data in self.received)
        start = came.rfind(wire.encode_ident(ident))
        if start > 0:
            self.received[:] = [(self.received[-1][0], came[start:])]

    def _settled(self, ident: wire.Ident, config: str | None) -> Identity:
        # A slow board may answer each `I` that was sent while it booted: let those answers come before the samples.
        rest = self.drain()
        if rest:
            self.received.append((time.monotonic_ns(), rest))
        return Identity(ident, config)


PROTOCOLS = {Frames.name: Frames}
