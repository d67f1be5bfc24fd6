"""Text from outside: what a file cannot hold is escaped in it, what would act on a terminal is shown as an escape."""

import os
import unicodedata

import h5py
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.runfile import nexus
from stickslip.text import printable, storable

ANY = st.text(st.characters(codec=None), max_size=30)


@given(ANY)
def test_every_text_has_a_form_that_hdf5_can_hold(text):
    with h5py.File("memory.h5", "w", driver="core", backing_store=False) as file:
        nexus.field(file, "text", text, title=text)
        nexus.field(file, "texts", [text, "b"])
        assert nexus.text(file["text"][()]) == storable(text)
        assert file["texts"].asstr()[0] == file["text"].attrs["title"] == storable(text)


@given(ANY)
def test_no_printed_text_controls_a_terminal(text):
    shown = printable(text)
    assert all(letter in "\n\t" or unicodedata.category(letter) not in ("Cc", "Cs", "Zl", "Zp") for letter in shown)
    assert not any(unicodedata.bidirectional(letter) in {"LRE", "RLE", "LRO", "RLO", "PDF"} for letter in shown)
    assert printable(shown) == shown


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b]0;title\x07\r", r"a\x1b]0;title\x07\x0d"),
        ("\x9b31m \x7f\0", r"\x9b31m \x7f\x00"),
        ("run\u202e5h.\u2066", r"run\u202e5h.\u2066"),
        (os.fsdecode(b"r\xfe.h5"), r"r\xfe.h5" if os.name == "posix" else "r\ufffd.h5"),
        ("Gerät µ, 摩擦\tא\n", "Gerät µ, 摩擦\tא\n"),
    ],
)
def test_what_does_not_show_is_printed_as_an_escape(text, shown):
    assert printable(text) == shown


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("utf-8", "1 … 2 ± 3 µm 摩"),
        ("cp850", r"1 ... 2 ± 3 µm \u6469"),
        ("latin-1", r"1 ... 2 ± 3 µm \u6469"),
        ("ascii", r"1 ... 2 +- 3 um \u6469"),
    ],
)
def test_what_an_encoding_lacks_is_spelled(encoding, shown):
    assert printable("1 … 2 ± 3 µm 摩", encoding) == shown
