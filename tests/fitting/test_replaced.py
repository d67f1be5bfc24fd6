"""A stored value that a flag overrides by more than the errors is a finding, and positions in mm are asked about."""

from pathlib import Path

import pytest

import daq
import fitting

RUN = Path(__file__).parents[2] / "data_samples" / "law5.h5"


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ({"mass": "300 kg"}, "mass: 300 kg replaces the stored 0.299"),
        ({"stiffness": "10.5 N/mm"}, "replaces the stored 0.299"),  # which implies a mass of 300 kg
        ({"mass": "300 g"}, None),
        ({"stiffness": "10.5 N/m"}, None),
    ],
)
def test_a_replaced_value_is_a_finding(flags, words):
    ranking = fitting.rank(daq.load(RUN), laws=5, **flags)
    rows = [row for row in ranking.findings if row.code == "replaced"]
    assert len(rows) == (words is not None)
    for row in rows:
        assert words in row.text
        assert row.text in ranking.warnings
        assert row.value == pytest.approx(300, rel=0.03)
        assert row.expected == pytest.approx(0.3, rel=0.01)
        assert row.sigmas > 10


@pytest.mark.parametrize("call", [lambda t, x: fitting.rank(t, x, laws=5), daq.Recording.from_arrays])
def test_positions_in_mm_are_asked_about(call):
    run = daq.load(RUN)
    with pytest.warns(UserWarning, match="are the positions in m"):
        call(run.time, 1000 * run.position)
