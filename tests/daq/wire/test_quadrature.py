"""Decoders against their truth tables, against each other, and at their known failings."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.wire.quadrature import DECODERS, EDGES_PER_COUNT, Decoder, PulseDecoder, levels_of

# What each change of the levels A + 2 B does, written out by hand: x4, x1, jk (+1 up, -1 down, 0 nothing).
TABLE = {
    (0, 1): (1, 1, 1),
    (1, 3): (1, 0, 0),
    (3, 2): (1, 0, 0),
    (2, 0): (1, 0, 0),
    (1, 0): (-1, -1, 0),
    (3, 1): (-1, 0, 0),
    (2, 3): (-1, 0, -1),
    (0, 2): (-1, 0, 0),
}
# A walk of single steps: what an encoder can do.
walks = st.lists(st.sampled_from([-1, 1]), max_size=80).map(lambda steps: np.cumsum([0, *steps]))


def decoded(kind, levels, start=None):
    decoder = Decoder(kind, start)
    return decoder, decoder.feed(levels)


def totals(decoder):
    return decoder.up, decoder.down, decoder.illegal, decoder.edges, decoder.latched_up


def scalar_latched(levels):
    """Follow the J-K flip-flop edge by edge, with its clock, J and K spelt out."""
    q, up, down = 1, 0, 0  # the latched direction starts as up
    for before, after in pairwise(levels):
        if (before ^ after) == 3:
            continue
        a, b = after & 1, after >> 1
        if b and not before >> 1:
            j, k = a, 1 - a
            q = {(1, 0): 1, (0, 1): 0}[j, k]
        if a and not before & 1:
            up, down = up + q, down + 1 - q
    return up, down


@pytest.mark.parametrize("change", TABLE)
def test_legal_changes_do_what_the_table_says(change):
    for kind, expected in zip(("x4", "x1", "jk"), TABLE[change], strict=True):
        _, steps = decoded(kind, np.array(change))
        assert (steps.step.tolist(), steps.illegal.any()) == ([expected], False)


@pytest.mark.parametrize("kind", DECODERS)
def test_a_double_change_is_illegal_and_never_guessed_and_a_steady_level_is_no_edge(kind):
    for change in ((0, 3), (3, 0), (1, 2), (2, 1)):
        decoder, steps = decoded(kind, np.array(change))
        assert totals(decoder)[:4] == (0, 0, 1, 1)
        assert steps.illegal.tolist() == [True]
    decoder, steps = decoded(kind, np.full(101, 2))
    assert (decoder.edges, len(steps.index)) == (0, 0)


def test_the_latch_takes_a_at_each_rise_of_b():
    decoder, steps = decoded("jk-latched", levels_of(-np.arange(9)))
    assert (decoder.up, decoder.down) == (0, 2)
    assert steps.step.tolist() == [0, -1, 0, 0, 0, -1, 0, 0]
    assert decoder.latched_up is False


@given(walks)
def test_x4_counts_every_step_and_x1_is_never_a_line_off(walk):
    decoder, steps = decoded("x4", levels_of(walk))
    assert (decoder.net, decoder.edges) == (walk[-1], len(walk) - 1)
    assert np.array_equal(np.cumsum(steps.step), walk[1:])
    # One line each time the walk passes from 4 k to 4 k + 1.
    assert decoded("x1", levels_of(walk))[0].net == (walk[-1] + 3) // 4


@given(st.lists(st.integers(0, 3), max_size=60), st.lists(st.integers(0, 12), max_size=8))
@pytest.mark.parametrize("kind", DECODERS)
def test_chunks_decode_as_the_whole(kind, levels, cuts):
    whole, steps = decoded(kind, np.array(levels, dtype=np.uint8))
    pieces = Decoder(kind)
    index, signs, at = [], [], 0
    for cut in [*cuts, len(levels)]:
        found = pieces.feed(np.array(levels[at : at + cut], dtype=np.uint8))
        index += (found.index + at).tolist()
        signs += found.step.tolist()
        at = min(at + cut, len(levels))
    assert totals(pieces) == totals(whole)
    assert (index, signs) == (steps.index.tolist(), steps.step.tolist())
    if kind == "jk-latched":
        assert (whole.up, whole.down) == scalar_latched(levels)


@pytest.mark.parametrize(
    ("kind", "least", "most"), [("x4", 0, 0), ("x1", -3, 3), ("jk", 39_996, 40_003), ("jk-latched", 39_996, 40_003)]
)
def test_ten_thousand_dithers_about_one_rise_of_a(kind, least, most):
    """Errors in x4 counts; the J-K boxes gain a line, four counts, each time: +39,999 within one line."""
    x = 1 + 0.3 * np.tile([-1, 1], 10_000)  # in counts: A rises between count 0 and count 1
    n = np.floor(x).astype(int)
    decoder, _ = decoded(kind, levels_of(n), start=0)
    assert least <= EDGES_PER_COUNT[kind] * decoder.net - n[-1] <= most


@pytest.mark.parametrize(
    ("decode", "words"),
    [
        (lambda: Decoder("x4").feed(np.array([0, 4])), "sample 1"),
        (lambda: Decoder("x4").feed(np.array([0, 255, 1])), "sample 1"),
        (lambda: Decoder("x2"), "x4, x1, jk, jk-latched"),
    ],
)
def test_what_cannot_be_decoded_is_refused(decode, words):
    with pytest.raises(ValueError, match=words):
        decode()


def test_step_and_direction_count_rises_only():
    step = np.array([1, 0, 1, 1, 0, 1, 0, 1])  # high at first: no rise was seen
    direction = np.array([1, 1, 1, 0, 0, 0, 1, 1])
    decoder = PulseDecoder()
    found = decoder.feed(step + 2 * direction)
    assert (decoder.up, decoder.down, decoder.edges, decoder.net) == (2, 1, 3, 1)
    assert found.index.tolist() == [2, 5, 7]
