"""The interval that draws give a special point."""

import numpy as np
import pytest

from rig_sim.analyses.limit_cycles.branches import estimate_interval


@pytest.mark.parametrize("draws", [10, 40, 200])
def test_the_interval_of_few_draws_holds_as_much_as_that_of_many(draws):
    """The interval between the quantiles of 40 draws used to hold a further one with 90 %, not 95 %."""
    rng = np.random.default_rng(7)
    held = []
    for row in rng.standard_normal((4000, draws + 1)).tolist():
        found = estimate_interval(row[1:])
        held.append(found.lo <= row[0] <= found.hi)
    expected = 0.95 if draws >= 39 else (draws - 1) / (draws + 1)  # of few draws, from the least to the largest
    assert np.mean(held) == pytest.approx(expected, abs=0.012)
