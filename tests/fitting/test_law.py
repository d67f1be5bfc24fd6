"""A law as a formula: what is refused and how it is said, and the units of its parameters."""

import pytest

from fitting.laws import PUBLISHED, Law
from stickslip.errors import InputError


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"start": {"vs": 0.1}}, "vs is no parameter"),
        ({"bounds": {"v_s": (0.2, 0.1)}}, "bounds of v_s"),
        ({"bounds": {"v_s": (0.0, None)}, "start": {"v_s": -1.0}}, "v_s is -1"),
        ({"fix": {"v_s": float("nan")}}, "v_s is nan"),
    ],
)
def test_values_that_cannot_be_are_refused(changes, said):
    with pytest.raises(InputError, match=said):
        Law("mine", "Fs*exp(-s/v_s)", **changes)


@pytest.mark.parametrize("name", ["5", "my law", "a.b", ""])
def test_a_name_is_a_word(name):
    with pytest.raises(InputError, match="no name of a law"):
        Law(name, "Fs")


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
