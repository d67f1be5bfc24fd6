"""The arrays of a whole stream hold what the frame reader returns, damaged or not, however it was cut."""

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.protocols.frames import FrameTally
from daq.wire import decode
from daq.wire import frames as wire
from daq.wire.frames import Capability, FrameReader, Ident, SampleBlock, TruthFrame

IDENT = Ident((0, 0, 1), "x4", Capability.LEVELS | Capability.TRUTH, 16, 1000, 8, 1000, 100_000, "rig")
COLUMNS = ("dt", "up", "down", "status")


def block(seq, n, draw, belt=False):
    column = [tuple(draw.choice((0, 0, draw.randrange(65536))) for _ in range(n)) for _ in range(3)]
    status = tuple(draw.randrange(8) for _ in range(n))
    seq_time = seq & 0xFFFF, draw.randrange(2**32), draw.choice((0, 1, 256, 65535))
    return SampleBlock(*seq_time, *column, status, belt=column[0] if belt else None)


def sent_line(seed, frames=40):
    """Return bytes of many kinds of frames, damaged in places, with garbage between."""
    draw = random.Random(seed)
    parts, seq, newest = [wire.encode_ident(IDENT)], 0, (0, 1)
    for _ in range(frames):
        n = draw.choice((1, 1, 1, 8, 8, 33, 34, 255))
        kind = draw.random()
        if kind < 0.05:
            piece = wire.encode_notice("stopped" * draw.randrange(60))
        elif kind < 0.1:
            piece = wire.encode_truth(TruthFrame(newest[0] & 0xFFFF, [(1.0, 2.0, 0.0, -1.0)] * newest[1]))
        elif kind < 0.12:
            piece = wire.encode_ident(IDENT)
        elif kind < 0.15:
            piece = wire.encode_samples(block(seq, n, draw, belt=True))  # of another layout
        elif kind < 0.18:
            piece = wire.enframe(bytes((wire.SAMPLES, draw.choice((1, 2)))) + bytes(draw.randrange(2, 40)))
        else:
            piece = wire.encode_samples(block(seq, n, draw))
            newest = seq, n
            seq += n
        if draw.random() < 0.2:
            wrong = bytearray(piece)
            at = draw.randrange(len(wrong))
            change = draw.randrange(3)
            if change == 0:
                wrong[at] ^= 1 << draw.randrange(8)
            elif change == 1:
                del wrong[at]
            else:
                wrong[at : at + 3] = draw.randbytes(3)
            piece = bytes(wrong)
        parts.append(piece)
    return b"".join(parts)


def decode_whole(reads):
    return next(decode.decode_pieces(reads, math.inf))


def in_reads(line, cuts):
    reads, at = [], 0
    while at < len(line):
        for size in cuts:
            reads.append((1000 + at, line[at : at + size]))
            at += size
    return reads


@settings(max_examples=30)
@given(st.integers(0, 2**32), st.lists(st.integers(4, 400), min_size=1, max_size=8))
def test_a_stream_holds_what_the_frame_reader_returns_however_it_was_cut(seed, cuts):
    line = sent_line(seed)
    found, whole = decode_whole(in_reads(line, cuts)), decode_whole([(0, line)])
    for name in ("first", "crc_frame", "idents", "truth", "length"):
        assert np.array_equal(getattr(found, name), getattr(whole, name), equal_nan=name == "truth"), name
    reader = FrameReader()
    frames = reader.feed(line)
    samples = [frame for frame in frames if isinstance(frame, SampleBlock)]
    assert found.n.tolist() == [len(frame.dt) for frame in samples]
    for name in ("seq", "illegal"):
        assert getattr(found, name).tolist() == [getattr(frame, name) for frame in samples]
    assert found.ticks.tolist() == [frame.time for frame in samples]
    for name in COLUMNS:
        assert getattr(found, name).tolist() == [value for frame in samples for value in getattr(frame, name)]
    exact, before = [], None
    for frame in frames:
        if isinstance(frame, SampleBlock):
            exact, before = [*exact, [[math.nan] * 4] * len(frame.dt)], frame
        elif isinstance(frame, TruthFrame) and before and (before.seq, len(before.dt)) == (frame.seq, len(frame.rows)):
            exact[-1] = frame.rows
    assert np.array_equal(found.truth, [row for rows in exact for row in rows], equal_nan=True)
    assert [text for _, text in found.notices] == [frame.text for frame in frames if isinstance(frame, wire.Notice)]
    assert len(found.idents) == sum(isinstance(frame, Ident) for frame in frames)
    assert (found.crc_errors, found.unknown) == (reader.crc_errors, reader.unknown)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.integers(0, 2**32), st.lists(st.integers(4, 400), min_size=1, max_size=8))
def test_a_frame_has_the_stamp_of_the_read_that_ended_it_and_a_part_that_of_the_read_that_ended_inside(seed, cuts):
    line = sent_line(seed)
    reads = in_reads(line, cuts)
    found = decode_whole(reads)
    reader, stamps = FrameReader(), []
    for stamp, data in reads:
        stamps += [stamp for frame in reader.feed(data) if isinstance(frame, SampleBlock)]
    assert found.stamp_ns.tolist() == stamps
    ends = np.cumsum([len(data) for _, data in reads])
    for stamp, frame, count in zip(found.part_stamp_ns, found.part_frame, found.part_bytes, strict=True):
        end = int(ends[[at for at, _ in reads].index(int(stamp))])
        here = end - int(count)  # where that frame begins
        whole = line[here : here + int(found.length[frame])]
        assert whole.endswith(b"\0")
        assert whole.count(b"\0") == 1
        assert FrameReader().feed(whole)[0].seq == found.seq[frame]


def test_the_layout_is_that_of_the_identification_before_the_samples():
    draw = random.Random(1)
    belted = Ident((0, 0, 1), "x4", Capability.BELT, 16, 1000, 8, 1000, 100_000, "rig")
    plain, wide = wire.encode_samples(block(0, 1, draw)), wire.encode_samples(block(0, 1, draw, belt=True))
    first, second = wire.encode_ident(IDENT), wire.encode_ident(belted)
    # What a board sent before it was identified has another layout: it is counted, not misread.
    found = decode_whole([(0, plain + second + wide + wide)])
    assert (len(found.n), found.unknown, len(found.belt)) == (2, 1, 2)
    found = decode_whole([(0, first + second + wide + first + plain)])
    assert (len(found.n), found.unknown, found.ident) == (2, 0, belted)  # the last frame used to be read as belted
    assert [(first, ident.capabilities) for first, _, ident in found.split_by_ident()] == [
        (0, belted.capabilities),
        (1, found.identified[2].capabilities),
    ]
    assert decode_whole([]).ident is None


def test_a_tally_counts_what_came_what_is_lost_and_what_is_illegal():
    tally = FrameTally(counts_illegal=True)
    for seq, illegal in ((0, 65_534), (16, 1), (24, 4)):  # eight samples are lost; the count passes 2^16
        columns = [0, *[1000] * 7], *[[0] * 8 for _ in range(3)]
        tally.feed(wire.encode_samples(wire.SampleBlock(seq, 1000 * seq, illegal, *columns, None, None)))
    assert (tally.reached, tally.received, tally.illegal) == (32, 24, 6)
    assert tally.describe(0.024) == "1000 Hz, 8 lost, 6 illegal"
    tally.begin_again(100)  # the port was lost for 68 periods: no lost samples
    assert tally.describe(1.0).endswith("92 Hz, 8 lost, 6 illegal")
