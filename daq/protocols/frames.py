"""Binary frames (`daq.wire.frames`): boards with the project's firmware and the simulated rig, with the same bytes."""

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from daq.protocols import link_budget
from daq.protocols import session as sessions
from daq.protocols.request import RecordRequest
from daq.protocols.session import Identity, Plan, Port, Session, Tally
from daq.wire import frames
from daq.wire.counters import fits, is_late, signed
from stickslip.errors import DeviceError, InputError, check_known
from stickslip.text import printable, storable

if TYPE_CHECKING:
    from daq.wire.decode import Stream

BAUD = 115_200
DELIMITER = frames.DELIMITER
RATE_HZ = 1000


def check(request: RecordRequest) -> None:
    """Refuse columns, which frames declare themselves, and an unknown decoder."""
    if request.columns is not None:
        raise InputError("frames declare their columns themselves", "--columns", "leave it out: it is for text")
    if request.decoder is not None:
        check_known(request.decoder, frames.DECODERS, "decoder", "--decoder")


def decode(reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Stream":
    """Decode the reads of one connection."""
    from daq.wire import decode

    return decode.decode(reads, header.get("decoder"))


def pieces(reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any]) -> "Iterator[Stream]":
    """Decode them piece by piece."""
    from daq.wire import decode

    return decode.pieces(reads, sessions.PIECE_BYTES, header.get("decoder"))


class Frames(Session):
    """A session in the protocol of the project's firmware."""

    def __init__(self, port: Port, url: str, request: RecordRequest) -> None:
        super().__init__(port, url, request)
        self._settings: tuple[str, ...] = ()
        self._ticks_per_sample = 1.0
        self._tick_ns = 1000
        self._counts_illegal = False

    def identify(self) -> Identity:
        """Stop a running stream and ask for the identification.

        Raises DeviceError: no answer, or none in this protocol; or the board does not have the decoder.
        """
        self.send("", "X")  # the empty line ends an incomplete command of a program that crashed
        strange = self.drain()
        identity = self._ask(strange)
        if self.request.decoder in (None, identity.ident.decoder):
            return identity
        self.send(f"M {self.request.decoder}")  # its counters start again
        return self._ask(b"")

    def plan(self, identity: Identity) -> Plan:
        """Return the requested rate (1000 Hz) in frames as long as the rate allows."""
        rate_hz = float(self.request.rate_hz or RATE_HZ)
        block = link_budget.block_size(identity.ident, rate_hz)
        return Plan(rate_hz, block, link_budget.bytes_per_s(identity.ident, rate_hz, block))

    def prepare(self, plan: Plan) -> Identity:
        """Set rate and samples per frame; the next identification confirms them.

        Raises DeviceError: the board refuses; the message contains its reason.
        """
        self._settings = f"R {round(plan.rate_hz)}", f"B {plan.block}"
        self.send(*self._settings)
        identity = self._ask(b"")
        if identity.ident.block_size != plan.block:
            what = f"the board keeps {identity.ident.block_size} samples per frame where {plan.block} were requested"
            raise DeviceError(what, self.url, "update its firmware")
        if self.request.decoder not in (None, identity.ident.decoder):
            what = f"the board decodes as {identity.ident.decoder} where {self.request.decoder} was requested"
            raise DeviceError(what, self.url, "update its firmware, or leave --decoder out")
        self._tick_ns = identity.ident.tick_ns
        self._ticks_per_sample = 1e9 / (plan.rate_hz * self._tick_ns)
        self._counts_illegal = frames.Capability.ILLEGAL in identity.ident.capabilities
        return identity

    def start(self) -> None:
        """Start the samples: sequence number 0."""
        self.send("S")

    def restart(self) -> None:
        """Configure and start a board that has just reset, without waiting for answers.

        Its identification, asked for once more, says what the samples behind it are sent as.
        """
        decoder = [] if self.request.decoder is None else [f"M {self.request.decoder}"]
        self.send(*decoder, *self._settings, "I", "S")

    def stop(self) -> None:
        """Stop the samples; the board still sends the incomplete block."""
        self.send("X")

    def tally(self) -> "FrameTally":
        """Return a new tally."""
        return FrameTally(self._ticks_per_sample, counts_illegal=self._counts_illegal, tick_ns=self._tick_ns)

    def _ask(self, strange: bytes) -> Identity:
        """Send `I` until an identification comes, and its CONFIG when it announces one."""
        reader = frames.FrameReader()
        until = time.monotonic() + sessions.ANSWER_S
        ask = 0.0
        ident: frames.Ident | None = None
        heard = len(strange)
        while time.monotonic() < until:
            if ident is None and time.monotonic() >= ask:
                self.send("I")
                ask = time.monotonic() + sessions.ASK_AGAIN_S
            data = self.read()
            if not data:
                continue
            heard += len(data)
            self.received.append((time.monotonic_ns(), data))
            for frame in reader.feed(data):
                if isinstance(frame, frames.Notice):
                    raise DeviceError(f"the board refuses: {frame.text}", self.url, "ask for what it can do")
                if isinstance(frame, frames.Ident):
                    if frame.implausible:
                        what = f"the board's identification cannot be true: {frame.implausible}"
                        do = "correct its firmware (docs/reference/wire.md), or check the cable"
                        raise DeviceError(what, self.url, do)
                    ident = frame
                    self._begin_with(ident)
                if isinstance(frame, frames.Config) and ident is not None:
                    return self._settled(ident, frame.toml)
            if ident is not None and frames.Capability.CONFIG not in ident.capabilities:
                return self._settled(ident, None)
        if ident is not None:
            raise DeviceError("the board announces a CONFIG and does not send it", self.url, "reset it and try again")
        if heard:
            what = f"no identification within {sessions.ANSWER_S:g} s, but {heard} bytes of something else"
            do = "check the baud rate, and that the board runs stickslip firmware; others need --protocol qsb or text"
            raise DeviceError(what, self.url, do)
        do = "check the port ('daq ports'), the cable, and that the board runs stickslip firmware"
        raise DeviceError(f"no reply within {sessions.ANSWER_S:g} s", self.url, do)

    def _begin_with(self, ident: frames.Ident) -> None:
        """Drop what came before an identification: the noise of a board that had to find our baud rate."""
        came = b"".join(data for _, data in self.received)
        start = came.rfind(frames.encode_ident(ident))
        if start > 0:
            self.received[:] = [(self.received[-1][0], came[start:])]

    def _settled(self, ident: frames.Ident, config: str | None) -> Identity:
        # A slow board may answer each `I` that was sent while it booted: let those answers come before the samples.
        rest = self.drain()
        if rest:
            self.received.append((time.monotonic_ns(), rest))
        named = replace(ident, name=printable(ident.name))
        return Identity(named, None if config is None else storable(config))


session = Frames


class FrameTally(Tally):
    """How far a stream of frames has come; see `daq.protocols.session.Tally`.

    A sequence number that jumps, against the device time, adds nothing: the board was reset, or something is wrong.
    """

    def __init__(
        self, ticks_per_sample: float = 1e6 / RATE_HZ, *, counts_illegal: bool = False, tick_ns: int = 1000
    ) -> None:
        super().__init__()
        self._ns_per_sample = ticks_per_sample * tick_ns
        self.illegal = 0 if counts_illegal else None
        self._illegal_before: int | None = None
        self._ticks_per_sample = ticks_per_sample
        self._frames = frames.FrameReader()
        self._newest: tuple[int, int, int] | None = None  # sequence number, device time, samples

    def feed(self, data: bytes, at_s: float | None = None) -> None:
        """Take bytes as they came; their sequence numbers tell more than when they came."""
        for payload in self._frames.payloads(data):
            if payload[0] == frames.SAMPLES and len(payload) > frames.SAMPLES_HEADER:
                self._step(payload[3] | payload[4] << 8, int.from_bytes(payload[5:9], "little"), payload[2])
                if self.illegal is not None and self._newest is not None:
                    self._count_illegal(int.from_bytes(payload[9:11], "little"))
            elif payload[0] == frames.IDENT:
                self._identified(payload)
            elif payload[0] == frames.NOTICE:
                self.notice = printable(payload[2:].decode(errors="replace"))

    def _identified(self, payload: bytes) -> None:
        """Take an identification: behind the first sample, that of a board that has restarted."""
        self.resets += self._newest is not None
        self._newest = self._illegal_before = None
        ident = frames.decode_payload(payload, belt=False, edge=False)
        if isinstance(ident, frames.Ident) and not ident.implausible:
            self._ticks_per_sample = self._ns_per_sample / ident.tick_ns
            self.illegal = (self.illegal or 0) if frames.Capability.ILLEGAL in ident.capabilities else None

    def begin_again(self, reached: int) -> None:
        """Begin with sequence number 0 again, ``reached`` periods after the start."""
        self._frames = frames.FrameReader()
        self._newest = self._illegal_before = None
        super().begin_again(reached)

    def _count_illegal(self, count: int) -> None:
        """Take the board's own count, 16 bits wide, of a frame that may be late."""
        rise = count - self._illegal_before & 0xFFFF if self._illegal_before is not None else 0
        if rise < 1 << 15:
            self.illegal = (self.illegal or 0) + rise
            self._illegal_before = count

    def _step(self, seq: int, ticks: int, n: int) -> None:
        """Take a frame: its sequence number, device time and samples."""
        missing = 0
        if self._newest is None:
            missing = seq
        else:
            last, then, length = self._newest
            missing = seq - last - length & 0xFFFF
            if missing:
                periods = signed(ticks - then, 32) / self._ticks_per_sample
                if periods <= 0 and is_late(last - seq & 0xFFFF, -periods, length):
                    return
                step = missing + length
                step += 65536 * round((periods - step) / 65536)
                missing = step - length if step > length and fits(step, periods) else 0
        self.reached += missing + n
        self.received += n
        self._newest = seq, ticks, n
