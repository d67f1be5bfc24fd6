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
from daq.wire.counters import agree_on_gap, is_late, wrap_signed
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
        raise InputError(
            "with the protocol 'frames' the board declares the columns",
            "--columns",
            "omit it; it applies only to the protocol 'text'",
        )
    if request.decoder is not None:
        check_known(request.decoder, frames.DECODERS, "decoder", "--decoder")


def decode_pieces(
    reads: Iterable[tuple[int, bytes]], header: Mapping[str, Any], most_bytes: float
) -> "Iterator[Stream]":
    from daq.wire import decode

    return decode.decode_pieces(reads, most_bytes, header.get("decoder"))


class Frames(Session):
    def __init__(self, port: Port, url: str, request: RecordRequest) -> None:
        super().__init__(port, url, request)
        self._settings: tuple[str, ...] = ()
        self._ticks_per_sample = 1.0
        self._tick_ns = 1000
        self._counts_illegal = False

    def identify(self) -> Identity:
        """Stop a running stream and request the identification.

        Raises DeviceError if there is no answer in this protocol, or the board does not have the decoder.
        """
        self.send("", "X")  # the empty line ends an incomplete command of a program that crashed
        earlier = self.drain()
        identity = self._ask(earlier)
        if self.request.decoder in (None, identity.ident.decoder):
            return identity
        self.send(f"M {self.request.decoder}")  # its counters start again
        return self._ask(b"")

    def plan(self, identity: Identity) -> Plan:
        """Return the requested rate (default 1000 Hz) in frames as long as the rate allows."""
        rate_hz = float(self.request.rate_hz or RATE_HZ)
        block = link_budget.choose_block_size(identity.ident, rate_hz)
        return Plan(rate_hz, block, link_budget.compute_load(identity.ident, rate_hz, block))

    def prepare(self, plan: Plan) -> Identity:
        """Set rate and samples per frame; the next identification confirms them.

        Raises DeviceError with the board's reason if it refuses.
        """
        self._settings = f"R {round(plan.rate_hz)}", f"B {plan.block}"
        self.send(*self._settings)
        identity = self._ask(b"")
        if identity.ident.block_size != plan.block:
            what = f"the board uses {identity.ident.block_size} samples per frame, not {plan.block} as requested"
            raise DeviceError(what, self.url, "update its firmware")
        if self.request.decoder not in (None, identity.ident.decoder):
            what = f"the board decodes as {identity.ident.decoder}, although {self.request.decoder} was requested"
            raise DeviceError(what, self.url, "update its firmware, or omit --decoder")
        self._tick_ns = identity.ident.tick_ns
        self._ticks_per_sample = 1e9 / (plan.rate_hz * self._tick_ns)
        self._counts_illegal = frames.Capability.ILLEGAL in identity.ident.capabilities
        return identity

    def start(self) -> None:
        """Start the samples at sequence number 0."""
        self.send("S")

    def restart(self) -> None:
        """Configure and start a board that has just reset, without waiting for answers.

        Its identification, requested once more, declares the format of the samples after it.
        """
        decoder = [] if self.request.decoder is None else [f"M {self.request.decoder}"]
        self.send(*decoder, *self._settings, "I", "S")

    def stop(self) -> None:
        """Stop the samples; the board still sends the incomplete block."""
        self.send("X")

    def tally(self) -> "FrameTally":
        return FrameTally(self._ticks_per_sample, counts_illegal=self._counts_illegal, tick_ns=self._tick_ns)

    def _ask(self, earlier: bytes) -> Identity:
        """Send `I` until an identification arrives, and its CONFIG if it announces one."""
        reader = frames.FrameReader()
        until = time.monotonic() + sessions.ANSWER_S
        ask = 0.0
        ident: frames.Ident | None = None
        bytes_heard = len(earlier)
        while time.monotonic() < until:
            if ident is None and time.monotonic() >= ask:
                self.send("I")
                ask = time.monotonic() + sessions.ASK_AGAIN_S
            data = self.read()
            if not data:
                continue
            bytes_heard += len(data)
            self.received.append((time.monotonic_ns(), data))
            for frame in reader.feed(data):
                if isinstance(frame, frames.Notice):
                    raise DeviceError(
                        f"the board refuses: {frame.text}", self.url, "request a setting that the board supports"
                    )
                if isinstance(frame, frames.Ident):
                    if frame.implausible:
                        what = f"the board's identification is implausible: {frame.implausible}"
                        do = "correct its firmware (docs/reference/wire.md), or check the cable"
                        raise DeviceError(what, self.url, do)
                    ident = frame
                    self._drop_before(ident)
                if isinstance(frame, frames.Config) and ident is not None:
                    return self._await_silence(ident, frame.toml)
            if ident is not None and frames.Capability.CONFIG not in ident.capabilities:
                return self._await_silence(ident, None)
        if ident is not None:
            raise DeviceError(
                "the board announces a configuration (CONFIG) but does not send it", self.url, "reset it and try again"
            )
        do = "check the baud rate, and that the board runs stickslip firmware; otherwise use --protocol qsb or text"
        raise self.explain_no_answer(bytes_heard, "the board runs stickslip firmware", do)

    def _drop_before(self, ident: frames.Ident) -> None:
        """Drop the bytes before an identification: noise from a board that was finding the baud rate."""
        received = b"".join(data for _, data in self.received)
        start = received.rfind(frames.encode_ident(ident))
        if start > 0:
            self.received[:] = [(self.received[-1][0], received[start:])]

    def _await_silence(self, ident: frames.Ident, config: str | None) -> Identity:
        # A slow board may answer each `I` that was sent while it booted: those answers must precede the samples.
        late_answers = self.drain()
        if late_answers:
            self.received.append((time.monotonic_ns(), late_answers))
        escaped = replace(ident, name=printable(ident.name))
        return Identity(escaped, None if config is None else storable(config))


session = Frames


class FrameTally(Tally):
    """How far a stream of frames has advanced; see `daq.protocols.session.Tally`.

    A sequence number that jumps, compared with the device time, adds nothing: the board was reset, or something is
    wrong.
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
        """Count the frames that the bytes complete, by their sequence numbers; ``at_s`` is not used."""
        for payload in self._frames.read_payloads(data):
            if payload[0] == frames.SAMPLES and len(payload) > frames.SAMPLES_HEADER:
                self._take_frame(payload[3] | payload[4] << 8, int.from_bytes(payload[5:9], "little"), payload[2])
                if self.illegal is not None and self._newest is not None:
                    self._count_illegal(int.from_bytes(payload[9:11], "little"))
            elif payload[0] == frames.IDENT:
                self._take_ident(payload)
            elif payload[0] == frames.NOTICE:
                self.notice = printable(payload[2:].decode(errors="replace"))

    def _take_ident(self, payload: bytes) -> None:
        """Take an identification: after the first sample, the board has restarted."""
        self.resets += self._newest is not None
        self._newest = self._illegal_before = None
        ident = frames.decode_payload(payload, belt=False, edge=False)
        if isinstance(ident, frames.Ident) and not ident.implausible:
            self._ticks_per_sample = self._ns_per_sample / ident.tick_ns
            self.illegal = (self.illegal or 0) if frames.Capability.ILLEGAL in ident.capabilities else None

    def begin_again(self, reached: int) -> None:
        """Restart at sequence number 0, ``reached`` periods after the start."""
        self._frames = frames.FrameReader()
        self._newest = self._illegal_before = None
        super().begin_again(reached)

    def _count_illegal(self, count: int) -> None:
        """Add the rise of the board's own count, 16 bits wide, of a frame that may be late."""
        rise = count - self._illegal_before & 0xFFFF if self._illegal_before is not None else 0
        if rise < 1 << 15:
            self.illegal = (self.illegal or 0) + rise
            self._illegal_before = count

    def _take_frame(self, seq: int, ticks: int, n: int) -> None:
        missing = 0
        if self._newest is None:
            missing = seq
        else:
            last, last_ticks, length = self._newest
            missing = seq - last - length & 0xFFFF
            if missing:
                periods = wrap_signed(ticks - last_ticks, 32) / self._ticks_per_sample
                if periods <= 0 and is_late(last - seq & 0xFFFF, -periods, length):
                    return
                step = missing + length
                step += 65536 * round((periods - step) / 65536)
                missing = step - length if step > length and agree_on_gap(step, periods) else 0
        self.reached += missing + n
        self.received += n
        self._newest = seq, ticks, n
