"""Damaged streams of every protocol, and damaged journals: recorded and made into runs."""

import functools
import json
import random
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from daq.finalise.run import run_data
from daq.protocols import qsb, text
from daq.protocols.columns import parse_columns
from daq.protocols.frames import FrameTally
from daq.protocols.lines import LineTally
from daq.protocols.session import Tally
from daq.runfile import journal, schema
from daq.runfile.rig import Rig
from daq.wire import frames
from daq.wire.frames import Capability, Ident, SampleBlock, TruthFrame

from ...journals import HEADER, write_journal
from .mutation import bytewise, textual

TOGETHER = 25  # damaged frames, lines or records in a stream of twice as many
FRAMES = HEADER | {"protocol": "frames", "columns": None}
COLUMNS = ("t_us,count", "t_ms,count_up,count_down", None)
Records = Sequence[tuple[int, int, bytes]]


def damaged_frames(draw: random.Random, folder: Path) -> None:
    """Try a stream of frames that are damaged before and after their checksum is made."""
    kinds = payloads()
    sent: list[bytes] = []
    for number, damaged in enumerate(_half(draw)):
        kind = 0 if number == 0 else draw.choice((0, 1, 2, 2, 2, 2, 2, 2, 2, 3))
        payload = kinds[kind][number] if kind == 2 else draw.choice(kinds[kind])
        if damaged and draw.random() < 0.6:
            sent.append(frames.enframe(bytewise(draw, payload, kinds[2])[:2000] or b"\0"))
        else:
            line = frames.enframe(payload)
            sent.append(bytewise(draw, line, sent) if damaged else line)
    _record(draw, folder, FRAMES, b"".join(sent), FrameTally())


def _half(draw: random.Random) -> list[bool]:
    return draw.sample([False, True], 2 * TOGETHER, counts=[TOGETHER, TOGETHER])


@functools.cache
def payloads() -> tuple[list[bytes], ...]:
    able = [Capability(0), Capability.LEVELS | Capability.ILLEGAL, *map(Capability, (0x7F, 0x3F, Capability.BELT))]
    idents = [
        Ident((0, 2, 0), "x4", each, bits, 1000, 8, 4000, 100_000, "rig") for each in able for bits in (16, 32, 2)
    ]
    texts = [frames.encode_notice("too fast"), frames.encode_config(Rig(name="bench").to_toml())]
    samples, truths = [], []
    for k in range(200):
        up, wide = [8 * k + i for i in range(8)], k % 3
        block = SampleBlock(8 * k, 8000 * k, 0, [0] + 7 * [1000], up, 8 * [k % 5], 8 * [k % 4])
        if wide:
            block = block._replace(belt=up, edge=8 * [70] if wide == 2 else None)
        samples.append(frames.encode_samples(block))
        truths.append(frames.encode_truth(TruthFrame(8 * k, [(k / 1e3, 0.1, 0.2, 0.3)] * 8)))
    lines = (list(map(frames.encode_ident, idents)), texts, samples, truths)
    return tuple([payload for line in kind for payload in frames.FrameReader().read_payloads(line)] for kind in lines)


def damaged_text(draw: random.Random, folder: Path) -> None:
    """Try a stream of lines, most of them damaged, in columns that are declared or found."""
    declared, first = draw.choice(COLUMNS), draw.randrange(2**31)
    form = declared or draw.choice(COLUMNS[:2])
    lines = []
    for k, damaged in enumerate(_half(draw)):
        values = {"t_us": first + 1000 * k, "t_ms": first // 1000 + k}
        values |= {"count": 7 * k, "count_up": 9 * k, "count_down": k}
        line = b",".join(b"%d" % values[name] for name in form.split(",")) + b"\n"
        lines.append(textual(draw, line, lines) if damaged else line)
    header = HEADER | {"columns": declared, "rate_hz": draw.choice((1000.0, 1000.0, 1000.0, 1.0, 1e6))}
    _record(draw, folder, header, b"".join(lines), LineTally(partial(text.make_reader, parse_columns(form)), 1000.0))


def damaged_qsb(draw: random.Random, folder: Path) -> None:
    records: list[bytes] = []
    for k, damaged in enumerate(_half(draw)):
        record = draw.choice(
            (b"s0E %08X %08X !", b"s0E%08X%08X!", b"QSB-S 0E!%08X%08X", b"e%08X %08X!")[0 if k % 7 else 1 :]
        )
        record = record % (5 * k & 0xFFFFFFFF, k) + b"\r\n"
        records.append(bytewise(draw, record, records) if damaged else record)
    header = FRAMES | {"protocol": "qsb", "rate_hz": draw.choice((512.0, 1.0, 100.0))}
    _record(draw, folder, header, b"".join(records), LineTally(qsb.make_reader, 1.0))


def damaged_journal(draw: random.Random, folder: Path) -> None:
    """Try a journal with damaged records, times and fields of its header, or with damaged bytes."""
    idents, _, samples, _ = payloads()
    lines = [frames.enframe(payload) for payload in (idents[1], *samples)]
    header, records, stamp = dict(FRAMES), [], 0
    odd = (journal.LOST, journal.REOPENED, journal.DROPPED, journal.END, journal.CONFIGURATION)
    for k, damaged in enumerate(_half(draw)):
        kind, content = journal.RECEIVED, lines[k]
        stamp += 8_000_000
        if damaged:
            kind = draw.choice((kind, kind, kind, *odd, draw.randrange(256)))
            stamp += draw.choice((0, 0, 0, 0, 10**10, -(10**9), 10**16))
            content = bytewise(draw, content, lines) if draw.random() < 0.6 else content
        records.append((kind, max(stamp, 0), content))
    if draw.random() < 0.3:
        name = draw.choice(list(header))
        header[name] = _loaded(textual(draw, json.dumps(header[name]).encode()))
    part = _write(folder, header, records)
    if draw.random() < 0.5:
        part.write_bytes(bytewise(draw, part.read_bytes()))
    if draw.random() < 0.3:
        journal.markers_path(part).write_bytes(textual(draw, b"3 first\n17 second\n20 third\n"))
    _make_run(part)


def _loaded(text: bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text.decode(errors="replace")


def _record(draw: random.Random, folder: Path, header: dict[str, Any], stream: bytes, tally: Tally) -> None:
    """Follow a stream as the recorder does, and make a run of it."""
    records, at, stamp = [], 0, 0
    while at < len(stream):
        piece = stream[at : at + draw.choice((7, 64, 500, 4096, 4096))]
        stamp += draw.choice((1_000_000, 20_000_000, 0, 10_000_000_000))
        records.append((journal.RECEIVED, stamp, piece))
        tally.feed(piece)
        at += len(piece)
    tally.begin_again(draw.choice((0, 40, 10**9)))
    _make_run(_write(folder, header, records))


def _write(folder: Path, header: dict[str, Any], records: Records) -> Path:
    part = folder / "input.h5.part"
    journal.markers_path(part).unlink(missing_ok=True)
    return write_journal(part, records, header)


def _make_run(part: Path) -> None:
    """Make a run of a journal as `daq recover` does, but for writing it."""
    made, _ = run_data(journal.read(part), journal.read_markers(journal.markers_path(part)))
    schema.check(made)
