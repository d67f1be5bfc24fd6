"""A law as a formula: what is refused, units of its parameters, and those that it has only together."""

import re

import pytest

from fitting.laws import MEMORY, PUBLISHED, Law, read_law, undetermined
from stickslip.errors import InputError


def test_of_parameters_that_enter_only_together_the_first_has_the_unit():
    """Half of a unit for each was rounded either way, by the processor, and then no parameter had any."""
    assert Law("two", "a*b/(1 + s/v_s)").dimensions == {"a": (1, 0), "b": (0, 0), "v_s": (0, 1)}
    assert Law("two", "F*(1 + b*c*s)/q").dimensions == {"F": (1, 0), "b": (0, -1), "c": (0, 0), "q": (0, 0)}


def test_units_follow_from_the_formula():
    law = PUBLISHED["stribeck-viscous"]
    found = {name: (law.unit(name), law.unit(name, newtons=True)) for name in law.curve.parameters}
    assert found == {
        "Fc": ("m s^-2", "N"),
        "Fs": ("m s^-2", "N"),
        "v_s": ("m/s", "m/s"),
        "Fv": ("s^-1", "N s/m"),
    }
    assert PUBLISHED["power"].unit("p") == ""
    # a fall whose exponent is a parameter has no unit of its own
    assert Law("mine", "Fs - b*s**p").dimensions == {}


def test_a_fixed_parameter_is_not_fitted():
    assert Law("mine", "Fs/(1 + gamma*s)", fix={"gamma": 2.0}).free == ("Fs",)


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        ("a*b/(1 + gamma*s)", ["friction depends only on a combination of a and b"]),
        (
            "Fs*a*b*exp(-c*d*s)",
            [
                "friction depends only on a combination of Fs, a and b",
                "friction depends only on a combination of c and d",
            ],
        ),
        ("Fs - (a + b)*s", ["friction depends only on a combination of a and b"]),
        ("Fs*exp(-s/v) + a*exp(-s/v)", ["friction depends only on a combination of Fs and a"]),
        ("Fs + 0*a", ["friction does not depend on a"]),
        ("Fc + (Fs - Fc)*exp(-(s/v_s)**p) + b*s", []),
    ],
)
def test_parameters_that_are_known_only_together_are_named(formula, said):
    assert [str(one) for one in undetermined(Law("mine", formula), 4.6, 0.5)] == said


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_forms_are_determined(name):
    assert undetermined(PUBLISHED[name], 4.6, 0.5) == ()


def test_as_many_are_free_as_the_formula_has_too_many():
    (group,) = undetermined(Law("mine", "Fs*a*b/(1 + s/v)"), 4.6, 0.5)
    assert group.names == ("Fs", "a", "b")
    assert group.free == 2


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("mine: F0 + b*log(z); z = 1 - s*z/D", "the part after ; is not the rate of a state z"),
        ("mine: F0 + b*s; z' = 1 - s*z/D", "formula: that of law mine does not contain the state z"),
        ("mine: F0 + b*z; z' = 1 - s/D", "rate: that of law mine does not contain the state z"),
        ("mine: F0 + b*z; z' = 1 - s*z/", "a value is missing at the end"),
    ],
)
def test_a_rate_that_is_none_is_refused(spec, said):
    with pytest.raises(InputError, match=re.escape(said)):
        read_law(spec)


@pytest.mark.parametrize("law", [MEMORY["lugre"], read_law("mine: F0 + b*z; z' = 1 - s*z/D")])
def test_a_law_with_memory_has_no_ramp(law):
    with pytest.raises(InputError, match=f"^ramp: law {law.name} has memory and cannot have a ramp"):
        law.behind_ramp()


def test_a_law_reads_back_as_it_is_written():
    law = read_law("mine: F0 + b*z; z'= 1 - s*z/D")
    assert read_law(str(law)) == law
    assert (law.rate, law.parameters) == ("1 - s*z/D", ("F0", "b", "D"))
    assert Law("slip", "Fs - G*s").words == "slip"
