"""The wire: what is sent is what is read, garbage is survived, and docs/reference/wire.md says the truth."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.wire import frames as wire
from daq.wire.frames import Capability, Config, FrameReader, Ident, Notice, SampleBlock, TruthFrame

DOCUMENT = Path(__file__).parents[3] / "docs" / "reference" / "wire.md"

u8, u16, u32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
text = st.text(st.characters(codec="utf-8"), max_size=40)
real = st.floats(allow_nan=False)


@st.composite
def idents(draw):
    capabilities = draw(st.integers(0, 127)) & ~(Capability.BELT | Capability.EDGE_TIME)
    firmware = (draw(u8), draw(u8), draw(u8))
    decoder = draw(st.sampled_from(wire.DECODERS))
    numbers = (draw(u8), draw(u16), draw(u8), draw(u32), draw(u32))
    return Ident(firmware, decoder, Capability(capabilities), *numbers, draw(text))


@st.composite
def blocks(draw, belt=False, edge=False):
    n = draw(st.sampled_from([1, 2, 3, 8, 8, 8, 255]))

    def column():  # from bytes: numbers one by one are drawn thirty times as slowly
        return tuple(memoryview(draw(st.binary(min_size=2 * n, max_size=2 * n))).cast("H"))

    status = tuple(byte & 7 for byte in draw(st.binary(min_size=n, max_size=n)))
    columns = (column(), column(), column(), status)
    optional = {"belt": column() if belt else None, "edge": column() if edge else None}
    return SampleBlock(draw(u16), draw(u32), draw(u16), *columns, **optional)


truths = st.builds(TruthFrame, u16, st.lists(st.tuples(real, real, real, real), min_size=1, max_size=5).map(tuple))


def encoded(frame):
    if isinstance(frame, Ident):
        return wire.encode_ident(frame)
    if isinstance(frame, SampleBlock):
        return wire.encode_samples(frame)
    if isinstance(frame, TruthFrame):
        return wire.encode_truth(frame)
    return wire.encode_config(frame.toml) if isinstance(frame, Config) else wire.encode_notice(frame.text)


frames = st.one_of(idents(), blocks(), truths, st.builds(Config, text), st.builds(Notice, text))


def layout_ident(belt, edge):
    capabilities = Capability.BELT * belt | Capability.EDGE_TIME * edge
    return Ident((0, 0, 1), "x4", Capability(capabilities), 16, 1000, 8, 1000, 100_000, "")


@given(st.lists(frames, max_size=5), st.lists(st.integers(1, 60), min_size=1))
def test_every_frame_is_read_back_however_the_bytes_are_cut(sent, cuts):
    lines = [encoded(frame) for frame in sent]
    assert all(line.count(0) == 1 and line.endswith(b"\0") for line in lines)
    line = b"".join(lines)
    reader, got, at = FrameReader(), [], 0
    while at < len(line):
        for cut in cuts:
            got += reader.feed(line[at : at + cut])
            at += cut
    assert got == sent
    assert (reader.crc_errors, reader.unknown) == (0, 0)


@pytest.mark.parametrize(
    ("belt", "edge"),
    [(True, True), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((True, False), (False, True)))],
)
@given(data=st.data())
def test_optional_columns_are_read_as_the_identification_declares(belt, edge, data):
    sent = [layout_ident(belt, edge), data.draw(blocks(belt, edge))]
    assert FrameReader().feed(b"".join(map(encoded, sent))) == sent


@given(blocks(belt=True))
def test_a_sample_of_an_undeclared_length_is_counted_not_misread(block):
    reader = FrameReader()
    assert reader.feed(wire.encode_samples(block)) == []
    assert reader.unknown == 1


@given(blocks(), st.integers(0), st.integers(1, 255))
def test_a_changed_byte_never_passes_for_a_sample(block, place, change):
    """A burst of up to 16 bits is always found by a CRC of 16 bits; a byte made 0 cuts the line in two."""
    before, after = wire.encode_notice("before"), wire.encode_notice("after")
    line = bytearray(wire.encode_samples(block))
    line[place % len(line)] ^= change
    reader = FrameReader()
    got = reader.feed(before + bytes(line) + after + after)
    assert block not in got
    assert not any(isinstance(frame, SampleBlock) and frame != block for frame in got)
    assert got[0] == Notice("before")
    assert got[-1] == Notice("after")


def test_an_endless_line_is_thrown_away_and_held_in_no_memory():
    reader = FrameReader()
    reader.feed(wire.encode_notice("first"))
    for _ in range(20):
        reader.feed(b"\x07" * 10_000)
    assert reader.crc_errors == 1
    assert reader.feed(b"\0" + wire.encode_notice("next")) == [Notice("next")]


def test_listening_may_start_inside_a_frame_without_an_error():
    reader = FrameReader()
    line = wire.encode_notice("cut")
    assert reader.feed(line[3:] + line) == [Notice("cut")]
    assert reader.crc_errors == 0


def test_frames_of_a_newer_version_are_counted_and_skipped():
    reader = FrameReader()
    assert reader.feed(wire.enframe(b"S\x02anything") + wire.enframe(b"Z\x01")) == []
    assert reader.unknown == 2


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: wire.encode_samples(SampleBlock(0, 0, 0, (), (), (), ())), "1 to 255 samples, not 0"),
        (lambda: wire.encode_samples(SampleBlock(70_000, 0, 0, (0,), (0,), (0,), (0,))), "70000"),
        (lambda: wire.encode_samples(SampleBlock(0, 0, 0, (0,), (0, 1), (0,), (0,))), "zip"),
        (lambda: wire.encode_truth(TruthFrame(0, ())), "1 to 255 rows, not 0"),
        (lambda: wire.encode_config("x" * 20_000), "20000"),
        (lambda: wire.encode_ident(Ident((0, 0, 300), "x4", Capability(0), 16, 1, 1, 1, 1, "")), "300"),
    ],
)
def test_what_does_not_fit_its_field_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


ABLE = Capability.BLOCKS | Capability.LEVELS | Capability.ILLEGAL | Capability.CONFIG
EXAMPLES = {
    "ident": Ident((1, 2, 3), "x4", ABLE, 16, 1000, 8, 5000, 125_000, "rig 7"),
    "samples": SampleBlock(258, 1_000_000, 1, (0, 998), (1000, 1001), (65535, 65535), (1, 3)),
    "options": SampleBlock(7, 5000, 0, (0,), (3,), (0,), (6,), (12,), (65535,)),
    "config": Config("[rig]\nmass = 0.3\n"),
    "truth": TruthFrame(7, ((0.005, 0.25, -0.5, 1.5),)),
    "notice": Notice("R 0: no such rate"),
}


def test_the_document_shows_every_kind_of_frame_and_its_bytes_are_what_is_sent_and_read():
    content = DOCUMENT.read_text(encoding="utf-8")
    documented = re.findall(r"^payload +([0-9a-f ]+)\n(\w+) +([0-9a-f ]+)$", content, re.MULTILINE)
    assert [name for _, name, _ in documented] == list(EXAMPLES)
    for payload, name, line in documented:
        frame, sent = EXAMPLES[name], bytes.fromhex(line)
        assert encoded(frame) == sent
        assert wire.FrameReader().read_payloads(sent) == [bytes.fromhex(payload)]
        opening = wire.encode_ident(layout_ident(name == "options", name == "options"))
        assert FrameReader().feed(opening + sent)[1:] == [frame]
