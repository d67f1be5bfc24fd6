"""Intervals of belt speed and stiffness where the record leaves several laws."""

import pytest

from fitting.judge.parameters import Parameter
from fitting.result import LawResult
from fitting.words.answer import law_dependent, over_compatible_laws


def row(law, v_dr, error, *, in_set=True, **others):
    parameters = {"v_dr": Parameter(v_dr, error, v_dr - 2 * error, v_dr + 2 * error, "m/s"), **others}
    return LawResult(law, "", 0.0, 0.5, in_set, 1e-5, 1.0, 20, parameters, 1.0, (0.0, 0.0), 0.0, None, None)


def test_an_interval_contains_those_of_the_other_laws_in_the_set():
    level = Parameter(4.6, 0.1, 4.4, 4.8, "m s^-2")
    rows = [row(3, 0.20, 0.001, **{"Fs/m": level}), row(4, 0.23, 0.01), row(5, 0.30, 0.001, in_set=False)]
    first, second, third = over_compatible_laws(rows, (3, 4))
    found = first.parameters["v_dr"]
    assert (found.value, found.lo, found.hi) == pytest.approx((0.20, 0.198, 0.25))
    assert found.stderr == pytest.approx(0.001 * 0.05 / 0.002)
    assert (second.parameters["v_dr"].lo, second.parameters["v_dr"].hi) == pytest.approx((0.198, 0.25))
    assert first.parameters["Fs/m"] is level  # a parameter of the law, not of the rig
    assert third.parameters == rows[2].parameters
    (said,) = law_dependent(rows, (3, 4))
    assert "0.2 under law 3, 0.23 under law 4" in said


def test_each_run_of_several_has_its_own_belt_speed():
    runs = [row(law, 0.2, 0.01, **{"v_dr (2)": Parameter(v, 0.001, v - 0.002, v + 0.002, "m/s")})
            for law, v in ((5, 0.1), (6, 0.11))]  # fmt: skip
    found = over_compatible_laws(runs, (5, 6))[0].parameters
    assert (found["v_dr (2)"].lo, found["v_dr (2)"].hi) == pytest.approx((0.098, 0.112))
    assert (found["v_dr"].lo, found["v_dr"].hi) == pytest.approx((0.18, 0.22))


@pytest.mark.parametrize("in_set", [True, False])
def test_what_a_compatible_law_leaves_undetermined_is_withheld(in_set):
    """Law 5 led a Stribeck contact without x0 by little, and its x0 missed the truth by 33 standard errors."""
    rest, level = Parameter(0.0103, 3e-4, 0.0097, 0.0109, "m"), Parameter(1.75, 0.22, 1.3, 2.2, "m s^-2")
    rows = [row(5, 0.03, 1e-4, x0=rest, **{"Fs/m": level}), row("stribeck", 0.03, 1e-4, in_set=in_set)]
    found = over_compatible_laws(rows, (5, "stribeck"))[0].parameters
    assert [found[name].trusted for name in ("x0", "Fs/m", "v_dr")] == [False, False, True]
    assert found["x0"].value == rest.value
    assert (
        "law stribeck, which the record does not exclude, leaves x0 undetermined"
        in law_dependent(rows, (5, "stribeck"))[0]
    )
    if not in_set:  # and excluded
        assert over_compatible_laws(rows, (5,))[0].parameters["x0"].trusted
