"""Intervals of belt speed and stiffness where the record leaves several laws."""

import pytest

from fitting.estimation.result import Parameter
from fitting.selection.result import LawResult
from fitting.selection.rig_intervals import law_dependent, over_the_set


def row(law, v_dr, error, *, in_set=True, **others):
    parameters = {"v_dr": Parameter(v_dr, error, v_dr - 2 * error, v_dr + 2 * error, "m/s"), **others}
    return LawResult(law, "", 0.0, 0.5, in_set, 1e-5, 1.0, 20, parameters, 1.0, (0.0, 0.0), 0.0, None, None)


def test_an_interval_contains_those_of_the_other_laws_in_the_set():
    level = Parameter(4.6, 0.1, 4.4, 4.8, "m s^-2")
    rows = [row(3, 0.20, 0.001, **{"Fs/m": level}), row(4, 0.23, 0.01), row(5, 0.30, 0.001, in_set=False)]
    first, second, third = over_the_set(rows)
    found = first.parameters["v_dr"]
    assert (found.value, found.lo, found.hi) == pytest.approx((0.20, 0.198, 0.25))
    assert found.stderr == pytest.approx(0.001 * 0.05 / 0.002)
    assert (second.parameters["v_dr"].lo, second.parameters["v_dr"].hi) == pytest.approx((0.198, 0.25))
    assert first.parameters["Fs/m"] is level  # a parameter of the law, not of the rig
    assert third.parameters == rows[2].parameters
    (said,) = law_dependent(rows)
    assert "0.2 by law 3, 0.23 by law 4" in said


def test_each_run_of_several_has_its_own_belt_speed():
    runs = [row(law, 0.2, 0.01, **{"v_dr (2)": Parameter(v, 0.001, v - 0.002, v + 0.002, "m/s")})
            for law, v in ((5, 0.1), (6, 0.11))]  # fmt: skip
    found = over_the_set(runs)[0].parameters
    assert (found["v_dr (2)"].lo, found["v_dr (2)"].hi) == pytest.approx((0.098, 0.112))
    assert (found["v_dr"].lo, found["v_dr"].hi) == pytest.approx((0.18, 0.22))


def test_one_law_alone_keeps_its_interval():
    rows = [row(5, 0.2, 0.01), row(6, 0.3, 0.01, in_set=False)]
    assert over_the_set(rows) == rows
    assert law_dependent(rows) == ()


def test_a_law_that_does_not_determine_the_belt_speed_does_not_count():
    rows = [row(1, 2.0, 0.1), row(2, 70.0, 70.0)]
    assert over_the_set(rows)[0].parameters == rows[0].parameters
    assert law_dependent(rows) == ()
