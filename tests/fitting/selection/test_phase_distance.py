"""How far a law's orbit runs from the measured one: distances to the nearest of many points."""

import numpy as np

from fitting.selection.phase_distance import nearest_distances


def test_the_nearest_point_is_found_by_looking_no_further_than_it_lies():
    rng = np.random.default_rng(3)
    x, y = np.sort(rng.uniform(size=300)).round(2), rng.uniform(size=300)  # rounded: points with the same x
    at = rng.uniform(-0.2, 1.2, (2, 100))
    found = np.empty(100)
    nearest_distances(x, y, *at, found)
    expected = np.hypot(x - at[0][:, None], y - at[1][:, None]).min(axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
