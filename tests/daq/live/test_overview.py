"""A long record in a bounded number of its own samples: no extreme is lost."""

import numpy as np
import pytest

from daq.live.overview import PICKED, ROWS, Overview, find_extremes


def record(n: int) -> np.ndarray:
    draw = np.random.default_rng(8)
    return np.array([np.arange(n) / 1000, np.cumsum(draw.normal(size=n)), draw.normal(size=n), draw.normal(size=n)])


@pytest.mark.parametrize("n", [500, ROWS, ROWS + 1, 300_000])
@pytest.mark.parametrize("piece", [97, 5000])
def test_an_overview_is_bounded_and_holds_the_extremes(n: int, piece: int) -> None:
    rows = record(n)
    rows[1, n // 3], rows[2, n // 2] = 1e4, -1e4
    overview = Overview(4)
    for first in range(0, n, piece):
        overview.add(rows[:, first : first + piece])
    kept = overview.collect_rows()
    assert kept.shape[1] <= ROWS + max(overview._stretch, piece) + 1
    assert kept.shape[1] >= min(n, ROWS // 8)
    assert np.all(np.diff(kept[0]) > 0)
    at = np.searchsorted(rows[0], kept[0])
    np.testing.assert_array_equal(kept, rows[:, at])  # samples of the record, as they were
    assert (kept[1].max(), kept[2].min()) == (1e4, -1e4)
    assert (kept[0, 0], kept[1].min()) == (rows[0, at[0]], rows[1].min())


def test_extremes_of_stretches_are_picked_and_unknown_velocities_pass() -> None:
    rows = record(1000)
    rows[2, 100:300] = np.nan
    picked = find_extremes(rows, 10)
    assert picked.size <= 10 * PICKED
    for k in range(10):
        own = slice(100 * k, 100 * k + 100)
        inside = picked[(picked >= own.start) & (picked < own.stop)]
        assert rows[1, inside].min() == rows[1, own].min()
        assert rows[1, inside].max() == rows[1, own].max()
        if k not in (1, 2):
            assert rows[2, inside].max() == rows[2, own].max()
    np.testing.assert_array_equal(find_extremes(rows[:, :8], 3), np.arange(8))
