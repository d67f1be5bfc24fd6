"""The wire format between a board and the recorder, byte for byte; frames <-> values, no I/O.

Rule: a frame on the line is ``COBS(payload + CRC) + 0x00``.  The CRC is CRC-16/CCITT-FALSE over the payload, sent low
byte first; every integer and float is little endian; the payload starts with a kind (one ASCII letter) and a format
version.  The full description with worked example bytes is docs/reference/wire.md.

Not here: what the numbers mean over time (roll-over of the 16-bit counters, the 16-bit sequence number and the 32-bit
device time: `daq.wire.counters`) and the vectorised decoding of whole journals (`daq.wire.decode`).
"""

import struct
from binascii import crc_hqx
from dataclasses import dataclass
from enum import IntFlag
from functools import cache
from typing import NamedTuple

from cobs import cobs

from daq.wire.splitter import Splitter

VERSION = 1
DELIMITER = b"\x00"
CRC_SEED = 0xFFFF
LONGEST_LINE = 16_384  # bytes between two delimiters; a longer run cannot be a frame
SHORTEST_BODY = 4  # bytes: kind, version, CRC
WIDEST_COUNTER = 32  # bits; frames carry 16, the text protocols 32
LONGEST_TICK_NS = 2_000_000  # a QSB counts 512 ticks a second, boards with the firmware a million
DECODERS = ("x4", "x1", "jk", "jk-latched", "two-counter")  # index = code on the wire

IDENT, SAMPLES, CONFIG, TRUTH, NOTICE = b"ISCTX"  # the kinds, as byte values

# Status bits of one sample.
A_HIGH, B_HIGH, OVERRUN = 1, 2, 4
LEVELS = A_HIGH | B_HIGH
NO_EDGE = 0xFFFF  # "edge" of a sample without an edge in the last 65,535 ticks


class Capability(IntFlag):
    """The content of a board's frames; declared once in the identification frame."""

    BLOCKS = 1  # more than one sample per frame
    LEVELS = 2  # the status bits A and B are real
    ILLEGAL = 4  # the illegal count is real
    BELT = 8  # every sample carries a belt-encoder count
    EDGE_TIME = 16  # every sample carries the ticks since the last edge
    CONFIG = 32  # the board answers `I` with a CONFIG frame too
    TRUTH = 64  # TRUTH frames may follow (a simulated rig with output.truth)


NO_CAPABILITY = Capability(0)


@dataclass(frozen=True, slots=True)
class Ident:
    """The board's identification: sent at power-up and in answer to ``I``; or what is known of one that sends none."""

    firmware: tuple[int, int, int] = (0, 0, 0)  # major, minor, patch
    decoder: str = "x4"  # one of `DECODERS`
    capabilities: Capability = NO_CAPABILITY
    counter_bits: int = 16  # width of the counters, the belt's too
    tick_ns: int = 1000  # unit of the device time, ns; at most `LONGEST_TICK_NS`
    block_size: int = 1  # samples per SAMPLES frame as currently set
    max_rate_hz: int = 1_000_000  # fastest sampling, and fastest edges the decoder follows without error
    max_edge_rate_hz: int = 0
    name: str = ""

    @property
    def implausible(self) -> str:
        """What cannot be true of the identification, as text; "" if all of it can."""
        if not 2 <= self.counter_bits <= WIDEST_COUNTER:
            return f"its counters have {self.counter_bits} bits"
        if not 1 <= self.tick_ns <= LONGEST_TICK_NS:
            return f"its clock's tick is {self.tick_ns} ns"
        if self.block_size < 1 or self.max_rate_hz < 1:
            return f"it sends {self.block_size} samples per frame at up to {self.max_rate_hz} Hz"
        return ""


class SampleBlock(NamedTuple):
    """One SAMPLES frame of n samples, n = 1 to 255; the sequences all have length n.

    A named tuple rather than a dataclass: a stream makes thousands a second, and a tuple takes a quarter of the time.
    """

    seq: int  # sequence number of the first sample, modulo 2^16; advances over samples that were lost, too
    time: int  # device time of the first sample, ticks modulo 2^32
    illegal: int  # illegal double transitions the decoder has counted up to the last sample, modulo 2^16
    dt: tuple[int, ...] | list[int]  # ticks since the previous sample of this frame; 0 for the first
    up: tuple[int, ...] | list[int]  # the two counters, modulo 2^16
    down: tuple[int, ...] | list[int]
    status: tuple[int, ...] | list[int]  # `A_HIGH` | `B_HIGH` | `OVERRUN`
    # Belt-encoder count modulo its width; ticks from the last edge to the sample (`NO_EDGE`: none).  None when the
    # board does not send them.
    belt: tuple[int, ...] | list[int] | None = None
    edge: tuple[int, ...] | list[int] | None = None


@dataclass(frozen=True, slots=True)
class Config:
    """The lab's calibration of this rig, as the TOML text of `daq.runfile.rig`."""

    toml: str


@dataclass(frozen=True, slots=True)
class TruthFrame:
    """Exact motion at sample times, sent only by a simulated rig whose scene requests it.

    ``rows`` holds (time s, x m, v m/s, F N) of the samples seq, seq + 1, ...: F is the friction force on the mass.
    """

    seq: int
    rows: tuple[tuple[float, float, float, float], ...] | list[tuple[float, float, float, float]]


@dataclass(frozen=True, slots=True)
class Notice:
    """An error the board reports, such as a command it cannot carry out."""

    text: str


Frame = Ident | SampleBlock | Config | TruthFrame | Notice

_IDENT = struct.Struct("<BB3BBHBHBII")
_SAMPLES = struct.Struct("<BBBHIH")
_TRUTH = struct.Struct("<BBBH")
SAMPLES_HEADER = _SAMPLES.size  # 11 bytes: kind, version, n, seq, time, illegal
TRUTH_HEADER = _TRUTH.size  # 5 bytes: kind, version, n, seq


def sample_format(belt: bool, edge: bool) -> str:
    """Return the struct format of one sample: dt, up, down, status[, belt][, edge]."""
    return "HHHB" + "H" * (belt + edge)


def enframe(payload: bytes) -> bytes:
    """Return the bytes on the line for a payload: CRC appended, COBS, delimiter."""
    line: bytes = cobs.encode(payload + crc_hqx(payload, CRC_SEED).to_bytes(2, "little"))
    return line + DELIMITER


def unstuff(lines: list[bytes]) -> list[bytes]:
    """Return payload and CRC, unchecked, of the bytes between delimiters; b"" where COBS is invalid."""
    if max(map(len, lines), default=0) <= LONGEST_LINE:
        try:
            return list(map(cobs.decode, lines))
        except cobs.DecodeError:  # of one line at least
            pass
    return list(map(_unstuff_line, lines))


def _unstuff_line(line: bytes) -> bytes:
    try:
        body: bytes = cobs.decode(line) if len(line) <= LONGEST_LINE else b""
    except cobs.DecodeError:
        return b""
    return body


def _check_crc(body: bytes) -> bytes | None:
    payload = body[:-2]
    if len(body) < SHORTEST_BODY or crc_hqx(payload, CRC_SEED) != body[-2] | body[-1] << 8:
        return None
    return payload


def encode_ident(ident: Ident) -> bytes:
    """Return an identification frame; ValueError for a number that its field cannot hold."""
    try:
        head = _IDENT.pack(
            IDENT,
            VERSION,
            *ident.firmware,
            DECODERS.index(ident.decoder),
            ident.capabilities,
            ident.counter_bits,
            ident.tick_ns,
            ident.block_size,
            ident.max_rate_hz,
            ident.max_edge_rate_hz,
        )
    except struct.error as error:
        raise ValueError(f"identification {ident} does not fit its frame: {error}") from error
    return enframe(head + ident.name.encode())


def encode_samples(block: SampleBlock) -> bytes:
    """Return a SAMPLES frame; ValueError for an empty or uneven block or a number that its field cannot hold."""
    columns = [block.dt, block.up, block.down, block.status]
    columns += [column for column in (block.belt, block.edge) if column is not None]
    n = len(block.dt)
    row = sample_format(block.belt is not None, block.edge is not None)
    try:
        flat = [value for sample in zip(*columns, strict=True) for value in sample]
        head = _SAMPLES.pack(SAMPLES, VERSION, n, block.seq, block.time, block.illegal)
        body = struct.pack("<" + row * n, *flat)
    except struct.error as error:
        raise ValueError(f"sample block at seq {block.seq} does not fit its frame: {error}") from error
    if n == 0:
        raise ValueError("a sample block must have 1 to 255 samples, not 0")
    return enframe(head + body)


def encode_config(toml: str) -> bytes:
    return _encode_text(CONFIG, toml)


def encode_notice(text: str) -> bytes:
    return _encode_text(NOTICE, text)


def _encode_text(kind: int, text: str) -> bytes:
    line = enframe(bytes((kind, VERSION)) + text.encode())
    if len(line) > LONGEST_LINE:
        raise ValueError(f"text of {len(text)} characters is too long for a frame of {LONGEST_LINE} bytes")
    return line


def encode_truth(truth: TruthFrame) -> bytes:
    """Return a TRUTH frame; ValueError for no or more than 255 rows."""
    n = len(truth.rows)
    if not 1 <= n <= 255:
        raise ValueError(f"a truth frame must have 1 to 255 rows, not {n}")
    flat = [value for row in truth.rows for value in row]
    return enframe(_TRUTH.pack(TRUTH, VERSION, n, truth.seq) + struct.pack(f"<{4 * n}d", *flat))


def decode_payload(payload: bytes, belt: bool, edge: bool) -> Frame | None:
    """Return the frame of a checked payload, or None if its kind, version or length is unknown.

    ``belt`` and ``edge`` are whether the last identification declared these columns.
    """
    kind, version = payload[0], payload[1]
    if version != VERSION:
        return None
    if kind == SAMPLES:
        return _decode_samples(payload, belt, edge)
    if kind == TRUTH:
        return _decode_truth(payload)
    try:
        if kind == CONFIG:
            return Config(payload[2:].decode())
        if kind == NOTICE:
            return Notice(payload[2:].decode())
        if kind == IDENT:
            return _decode_ident(payload)
    except UnicodeDecodeError:
        return None
    return None


def _decode_ident(payload: bytes) -> Ident | None:
    if len(payload) < _IDENT.size:
        return None
    _, _, major, minor, patch, decoder, capabilities, bits, tick, block, rate, edges = _IDENT.unpack_from(payload)
    if decoder >= len(DECODERS):
        return None
    return Ident(
        firmware=(major, minor, patch),
        decoder=DECODERS[decoder],
        capabilities=Capability(capabilities),
        counter_bits=bits,
        tick_ns=tick,
        block_size=block,
        max_rate_hz=rate,
        max_edge_rate_hz=edges,
        name=payload[_IDENT.size :].decode(),
    )


def _decode_samples(payload: bytes, belt: bool, edge: bool) -> SampleBlock | None:
    if len(payload) < SAMPLES_HEADER or payload[2] == 0:
        return None
    layout, size = _make_struct(belt, edge, payload[2])
    if len(payload) != layout.size:
        return None
    flat = layout.unpack(payload)
    seq, time, illegal = flat[3:6]
    dt, up, down, status, *optional = (flat[field::size] for field in range(6, 6 + size))
    belts = optional[0] if belt else None
    return SampleBlock(seq, time, illegal, dt, up, down, status, belts, optional[-1] if edge else None)


@cache
def _make_struct(belt: bool, edge: bool, n: int) -> tuple[struct.Struct, int]:
    """Return the struct of a whole SAMPLES payload, and how many numbers make one sample."""
    row = sample_format(belt, edge)
    return struct.Struct(_SAMPLES.format + row * n), len(row)


def _decode_truth(payload: bytes) -> TruthFrame | None:
    if len(payload) < TRUTH_HEADER:
        return None
    _, _, n, seq = _TRUTH.unpack_from(payload)
    if n == 0 or len(payload) != TRUTH_HEADER + 32 * n:
        return None
    return TruthFrame(seq, tuple(struct.iter_unpack("<4d", payload[TRUTH_HEADER:])))


class FrameReader:
    """Read frames from a byte stream; never raises on garbage, synchronised again at the next 0x00.

    crc_errors: Lines with invalid COBS or CRC.  An invalid first line is not counted: listening may start anywhere
        inside a frame.
    unknown: Frames with a valid CRC whose kind, version or length is unknown (a newer board, another layout).
    """

    def __init__(self) -> None:
        self.crc_errors = 0
        self.unknown = 0
        self._belt = False
        self._edge = False
        self._splitter = Splitter(DELIMITER, LONGEST_LINE)
        self._first = True

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that the bytes complete, in order."""
        frames: list[Frame] = []
        for payload in self.read_payloads(data):
            frame = decode_payload(payload, self._belt, self._edge)
            if frame is None:
                self.unknown += 1
                continue
            if isinstance(frame, Ident):
                self._belt = Capability.BELT in frame.capabilities
                self._edge = Capability.EDGE_TIME in frame.capabilities
            frames.append(frame)
        return frames

    def read_payloads(self, data: bytes) -> list[bytes]:
        """Return the payloads with a valid CRC that the bytes complete, in order."""
        lines = [line for line in self._splitter.feed(data) if line]
        checked = [_check_crc(body) for body in unstuff(lines)]
        payloads = [payload for payload in checked if payload is not None]
        if len(payloads) < len(checked):
            self.crc_errors += len(checked) - len(payloads) - (self._first and checked[0] is None)
        self._first = self._first and not lines
        return payloads
