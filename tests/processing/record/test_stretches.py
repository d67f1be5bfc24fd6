"""Rest at the ends of a record is distinguished from a mass that turns round there."""

import numpy as np
import pytest

from processing.record.stretches import moving_samples

PITCH = 1e-3  # of swings to and fro between -1 and 1


@pytest.mark.parametrize("seed", range(60))
def test_a_mass_that_turns_near_an_end_does_not_rest(seed):
    """It passes its first place once more: up to a few counts a swing looks flat for twice as long."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi / rng.uniform(200, 1000)  # of a sample
    turn = rng.uniform(0, 3) * np.sqrt(2 * 2.5 * PITCH) / omega
    x = np.floor(np.cos(omega * (np.arange(1500) - turn)) / PITCH + rng.uniform()) * PITCH
    assert moving_samples(x.__getitem__, x.size, 2.5 * PITCH)[0] == 0
    back = x[::-1].copy()
    assert moving_samples(back.__getitem__, x.size, 2.5 * PITCH)[1] == x.size - 1


@pytest.mark.parametrize("seed", range(20))
def test_a_mass_that_rests_before_it_swings_does_rest(seed):
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi / rng.uniform(200, 1000)
    least = np.sqrt(2 * 2.5 * PITCH) / omega  # what it takes to move by the slack from rest
    begin = rng.uniform(4, 20) * least
    x = 1 - np.cos(omega * np.maximum(np.arange(3000) - begin, 0))
    x = np.floor(x / PITCH + rng.uniform()) * PITCH
    first, _ = moving_samples(x.__getitem__, x.size, 2.5 * PITCH)
    assert begin - 5 <= first <= begin + 2 * least + 5
