"""Lines come out of the splitter however the bytes arrive, and one that never ends fills no memory."""

from hypothesis import given
from hypothesis import strategies as st

from daq.wire.splitter import Splitter


def in_pieces(data, cuts):
    at = 0
    while at < len(data):
        for size in cuts:
            yield data[at : at + size]
            at += size


@given(st.lists(st.binary(max_size=40).map(lambda line: line.replace(b"!", b"")), max_size=20), st.data())
def test_lines_are_the_same_however_the_bytes_are_cut(sent, data):
    cuts = data.draw(st.lists(st.integers(1, 30), min_size=1, max_size=5))
    splitter = Splitter(b"!", 40)
    got = [line for piece in in_pieces(b"".join(line + b"!" for line in sent), cuts) for line in splitter.feed(piece)]
    assert got == sent
    assert splitter.pending_bytes == 0


@given(st.lists(st.integers(1, 300), min_size=1, max_size=5))
def test_an_endless_line_is_returned_once_and_its_rest_is_dropped(cuts):
    splitter = Splitter(b"!", 40)
    got, held = [], 0
    for piece in in_pieces(b"good!" + b"7" * 2000 + b"!" + b"next!", cuts):
        got += splitter.feed(piece)
        held = max(held, splitter.pending_bytes)
    good, endless, after = got
    assert (good, after) == (b"good", b"next")
    assert len(endless) > 40
    assert held <= 40
