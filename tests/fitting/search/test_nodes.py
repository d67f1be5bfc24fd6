"""Samples through nodes: what a straight line of residuals becomes, and that no sample is lost."""

import numpy as np
import pytest

from fitting.laws import SIX
from fitting.model.problem import EstimationProblem
from fitting.model.windows import SampleNodes, Thinning


@pytest.mark.parametrize("stride", [1, 7])
def test_every_sample_counts_once_a_constant_stays_and_windows_keep_their_ends(runs_of, stride):
    whole = EstimationProblem.build(SIX[5], runs_of(law=5, seed=1, duration=10.0)).windows(thinned=False)
    nodes = SampleNodes.of(whole, [Thinning(stride)])
    own, every = nodes.windows, whole
    assert nodes.count.sum() == pytest.approx(every.time.size)
    assert own.rows[-1].stop == own.time.size == nodes.count.size
    assert (own.time.size == every.time.size) == (stride == 1)
    seen = nodes.with_mean_residuals(own.position, np.full(every.time.size, 3e-6))
    assert own.position - seen.position == pytest.approx(np.full(nodes.count.size, 3e-6))
    for last in (0, 1):  # the first sample of each window, and its last
        ends = [w.table[:, 2] + last * (w.table[:, 3] - 1) for w in (own, every)]
        assert np.array_equal(own.time[ends[0]], every.time[ends[1]])
