"""Samples held against what came with them."""

from dataclasses import replace

import numpy as np
import pytest

from daq.wire import counters, frames
from daq.wire.quadrature import levels_of

from ..samples import check_counts, make_samples

IDENT = frames.Ident(
    (1, 0, 0), "x4", frames.Capability.LEVELS | frames.Capability.ILLEGAL, 16, 1000, 4, 5000, 10**6, "test"
)


def samples(true, missed, illegal, part=None, **columns):
    """Return samples of a board that has missed so many counts by then, in frames of four."""
    n = len(true)
    part = np.zeros(n, dtype=np.int64) if part is None else part
    made = {"part": part, "frame": np.arange(n) // 4, "up": (true - missed).astype(np.uint16)}
    made |= {"status": levels_of(true), "illegal": illegal.astype(np.uint16), "ticks": np.arange(n) * 1000}
    made |= {"time": np.arange(n) / 1000}
    index = np.arange(n) - np.searchsorted(part, part)
    return make_samples(index, ("restarted",) * (part[-1] + 1), **made | columns)


def check(samples, rate_hz=1000.0):
    return check_counts(samples, IDENT, rate_hz)


def test_every_sample_after_an_illegal_transition_is_flagged():
    # An even number of misses does not show in the phase.
    n = 40
    true = 10 * np.arange(n)
    missed = np.where(np.arange(n) >= 30, 4, np.where(np.arange(n) >= 9, 2, 0))
    illegal = np.repeat((missed // 2).reshape(-1, 4)[:, -1], 4) + 65_535  # as sent: at the end of its frame
    flags = check(samples(true, missed, illegal)).flags
    assert np.all(flags[missed > 0] & counters.FLAG_COUNT_UNCERTAIN)
    assert not np.any(flags[:8])
    assert np.array_equal((flags & counters.FLAG_PHASE) > 0, missed % 4 > 0)
    assert np.flatnonzero(flags & counters.FLAG_ILLEGAL).tolist() == [8, 9, 10, 11, 28, 29, 30, 31]


def test_the_doubt_ends_where_the_board_began_anew():
    n = 24
    missed = np.where((np.arange(n) >= 5) & (np.arange(n) < 12), 2, 0)
    illegal = np.where((np.arange(n) >= 4) & (np.arange(n) < 12), 1, 0)
    part = np.repeat([0, 1], 12)
    flags = check(samples(10 * np.arange(n), missed, illegal, part)).flags
    assert np.flatnonzero(flags & counters.FLAG_COUNT_UNCERTAIN).tolist() == list(range(4, 12))


@pytest.mark.parametrize("rate_hz", [1000, 100_000])
def test_a_fast_signal_gives_its_rate_whatever_the_jitter(rate_hz):
    n = 2 * rate_hz
    jitter = np.clip(np.random.default_rng(3).normal(0, 30e-6, n), -0.45 / rate_hz, 0.45 / rate_hz)
    time = np.arange(n) / rate_hz + jitter
    true = np.floor(60_000 * time).astype(np.int64)
    checked = check(samples(true, 0, 0 * true, time=time), float(rate_hz))
    assert checked.peak_count_rate == pytest.approx(60_000, rel=0.06)
    assert len(checked.starts) == 1


def test_gaps_everywhere_leave_the_peak_of_what_is_between_them():
    n = 3000
    time = np.arange(n) / 30_000
    index = np.arange(n) + np.arange(n) // 10  # every eleventh is lost: no stretch is a millisecond long
    true = np.floor(60_000 * time).astype(np.int64)
    checked = check(replace(samples(true, 0, 0 * true, time=time), index=index), 30_000.0)
    assert checked.peak_count_rate == pytest.approx(60_000, rel=0.3)


def test_more_than_65536_segments_have_numbers_of_their_own():
    n = 70_000
    part = np.arange(n)
    many = check(samples(np.arange(n), 0, np.zeros(n), part)).segment
    assert np.array_equal(many, np.arange(n))
    few = check(samples(np.arange(9), 0, np.zeros(9), part[:9])).segment
    assert few.dtype == np.uint16  # as in files of the releases before
