"""Samples through nodes: what a straight line of residuals becomes, and that no sample is lost."""

import numpy as np
import pytest

from fitting.laws import SIX
from fitting.model.problem import EstimationProblem
from fitting.model.windows import SampleNodes, Thinning


@pytest.mark.parametrize("stride", [1, 7])
def test_every_sample_counts_once_and_a_constant_stays(runs_of, stride):
    whole = EstimationProblem.build(SIX[5], runs_of(law=5, seed=1)).windows(thinned=False)
    nodes = SampleNodes.of(whole, [Thinning(stride)])
    assert nodes.count.sum() == pytest.approx(whole.time.size)
    assert nodes.windows.rows[-1].stop == nodes.windows.time.size == nodes.count.size
    assert (nodes.windows.time.size == whole.time.size) == (stride == 1)
    seen = nodes.seen(nodes.windows.position, np.full(whole.time.size, 3e-6))
    assert nodes.windows.position - seen.position == pytest.approx(np.full(nodes.count.size, 3e-6))


def test_nodes_keep_first_and_last_sample_of_every_window(runs_of):
    whole = EstimationProblem.build(SIX[5], runs_of(law=5, seed=1)).windows(thinned=False)
    nodes = SampleNodes.of(whole, [Thinning(9)])
    for own, all_of_it in zip(nodes.windows.table, whole.table, strict=True):
        first, last = own[2], own[2] + own[3] - 1
        assert nodes.windows.time[first] == whole.time[all_of_it[2]]
        assert nodes.windows.time[last] == whole.time[all_of_it[2] + all_of_it[3] - 1]
