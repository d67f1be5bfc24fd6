"""Roll-over, order and consistency: what was sent modulo its width comes back whole, and nothing is guessed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.wire import counters

NONE = np.empty(0, dtype=np.int64)


@given(
    st.sampled_from([8, 16, 24, 32]),
    st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1)), min_size=1, max_size=30),
)
def test_net_counts_follow_both_counters_through_any_number_of_roll_overs(bits, moves):
    width = 1 << bits
    up, down = (np.cumsum([move[which] % width for move in moves]) for which in (0, 1))
    sent = ((column % width).astype(np.uint32) for column in (up, down))
    begins, every = np.arange(len(up)) == 0, np.ones(len(up), np.int64)
    net = counters.net_count(*sent, begins, bits * every, every)
    assert np.array_equal(np.diff(net), np.diff(up - down))
    assert (net[0] - (up - down)[0]) % width == 0
    assert -width // 2 <= net[0] < width // 2


def placed(index, start=0, period=1000):
    """Return the order of frames of 8 samples in one piece, by their true indices, and the ticks at index 0."""
    ticks = (start + index * period) % (1 << 32)
    return counters.FrameOrder(1000.0).place(index % 65536, ticks, np.full(len(index), 8), NONE)


@given(st.lists(st.integers(0, 400_000), min_size=1, max_size=40), st.integers(0, (1 << 32) - 1))
def test_gaps_of_any_length_are_sized_with_the_device_time(gaps, start_ticks):
    """A gap of 65,536 samples leaves no trace in the sequence number; the time tells."""
    true = np.cumsum([0, *(8 + gap for gap in gaps)])
    order = placed(true, start_ticks)
    assert order.keep.all()
    assert not order.restart.any()
    assert np.array_equal(order.index, true)
    assert np.array_equal(order.ticks, start_ticks + 1000 * true)


@pytest.mark.parametrize("lost", [1, 250_000])
@pytest.mark.parametrize("off", [1e-3, 0.05])
def test_a_gap_on_which_sequence_and_clock_agree_is_a_gap(lost, off):
    """Also that of a board whose sample period is not the nominal one."""
    period = round(1000 * (1 + off))
    first = np.arange(50) * 8
    order = placed(np.concatenate((first, 400 + 8 * lost + first)), period=period)
    assert order.keep.all()
    assert not order.restart.any()
    assert order.index[50] - order.index[49] == 8 + 8 * lost
