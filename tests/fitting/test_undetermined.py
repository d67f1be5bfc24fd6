"""Parameters that a formula has only together are named."""

import pytest

from fitting.laws import PUBLISHED, Law, natural_size, undetermined


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        ("a*b/(1 + gamma*s)", ["a and b enter only together"]),
        ("Fs*a*b*exp(-c*d*s)", ["Fs, a and b enter only together", "c and d enter only together"]),
        ("Fs - (a + b)*s", ["a and b enter only together"]),
        ("Fs - (a - b)*s", ["a and b enter only together"]),
        ("Fs/(1 + s*a/b)", ["a and b enter only together"]),
        ("Fs*exp(-s/v) + a*exp(-s/v)", ["Fs and a enter only together"]),
        ("a*b**2 - G*s", ["a and b enter only together"]),
        ("Fs + 0*a", ["a does not change friction"]),
        ("Fc + (Fs - Fc)*exp(-(s/v_s)**p) + b*s", []),
    ],
)
def test_parameters_that_are_known_only_together_are_named(formula, said):
    assert [str(one) for one in undetermined(Law("mine", formula), 4.6, 0.5)] == said


def test_sizes_are_above_0_beside_a_measured_curve_below_0():
    """A curve without a known level may be negative; a fit of its formulas ended in "Initial guess is outside"."""
    law = PUBLISHED["stribeck-gaussian-viscous"]
    assert [natural_size(law, name, -38.0, 0.5) for name in ("Fs", "v_s", "Fv")] == [38.0, 0.5, 76.0]


def test_a_fixed_parameter_leaves_the_other_determined():
    assert undetermined(Law("mine", "a*b/(1 + gamma*s)", fix={"b": 1.0}), 4.6, 0.5) == ()


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_forms_are_determined(name):
    assert undetermined(PUBLISHED[name], 4.6, 0.5) == ()


def test_as_many_are_free_as_the_formula_has_too_many():
    (group,) = undetermined(Law("mine", "Fs*a*b/(1 + s/v)"), 4.6, 0.5)
    assert group.names == ("Fs", "a", "b")
    assert group.free == 2
