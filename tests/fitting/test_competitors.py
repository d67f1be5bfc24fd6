"""Which laws compete, and what is given of their parameters: how it is typed, and what is refused."""

import math

import pytest

from fitting.competitors import ALL_LAWS, Competitors, Given, restated
from fitting.law import PUBLISHED, Law, read_law
from stickslip.errors import InputError


def test_laws_are_numbers_published_names_and_formulas():
    found = Competitors.typed("1-3,6,stribeck", ["power", "mine: Fs/(1 + s/v)"], ["mine"])
    assert found.laws == (1, 2, 3, 6)
    assert found.names == ("stribeck", "power", "mine")
    assert [law.ramp for law in found.formulas] == [False, False, True]
    same = Competitors.of(("1-3", 6, "stribeck", "power", Law("mine", "Fs/(1 + s/v)", ramp=True)))
    assert (same.laws, same.formulas) == (found.laws, found.formulas)


@pytest.mark.parametrize(
    ("laws", "expected"), [(5, ((5,), ())), ("stribeck", ((), ("stribeck",))), (ALL_LAWS, (ALL_LAWS, ()))]
)
def test_one_law_need_not_be_in_a_list(laws, expected):
    """``laws=5`` used to end in "'int' object is not iterable"."""
    found = Competitors.of(laws)
    assert (found.laws, found.names) == expected


def test_a_name_alone_is_that_of_every_law_that_has_it():
    found = Competitors.typed(
        "1-6",
        ["mine: Fc + a*exp(-s/v_s)"],
        [],
        ["gamma=9.6", "mine.v_s=0.05"],
        ["k/m=30:40", "5.d=:1"][:1],
        ["6.d=0.03"],
    )
    assert found.of_law(5) == {"gamma": Given(9.6, 9.6, 9.6), "k/m": Given(30.0, 40.0)}
    assert found.of_law(6) == {"gamma": Given(9.6, 9.6, 9.6), "k/m": Given(30.0, 40.0), "d": Given(start=0.03)}
    assert found.of_law(1) == {"k/m": Given(30.0, 40.0)}
    assert found.of_law(found.formulas[0]) == {"v_s": Given(0.05, 0.05, 0.05), "k/m": Given(30.0, 40.0)}
    assert found.of_law(5)["gamma"].fixed


def test_a_formula_may_call_its_parameters_as_the_rig_does():
    law = Law("mine", "k - c*s")
    found = Competitors(laws=(), formulas=(law,), fix={"c": -2.0})
    assert found.of_law(law) == {"c": Given(-2.0, -2.0, -2.0)}
    with pytest.raises(InputError, match="c is -2"):  # of the damping, which every other law has
        Competitors(laws=(5,), formulas=(law,), fix={"c": -2.0})


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"laws": "7"}, "unknown law 7"),
        ({"laws": ""}, "no law to fit"),
        ({"laws": "5,strib"}, "did you mean 'stribeck'"),
        ({"law": ["mine"]}, "no published law"),
        ({"law": ["stribeck: Fs - G*s"]}, "name of a published law"),
        ({"law": ["mine: Fs", "mine: Fs - G*s"]}, "two laws have the name mine"),
        ({"ramp": ["mine"]}, "unknown law 'mine'"),
        ({"fix": ["gama=1"]}, "did you mean 'gamma'"),
        ({"fix": ["3.gamma=1"]}, "no law that is fitted has a parameter 3.gamma"),
        ({"fix": ["mine.v_s=1"]}, "there is no law mine"),
        ({"laws": "5", "fix": ["d=0.1"]}, "no law that is fitted has a parameter d"),
        ({"fix": ["gamma"]}, "is not NAME=VALUE"),
        ({"fix": ["gamma=fast"]}, "not a number"),
        ({"fix": ["gamma=1", "gamma=2"]}, "given twice"),
        ({"fix": ["static=0.5"]}, "at least 1"),
        ({"fix": ["k/m=0"]}, "above 0"),
        ({"bound": ["gamma=2:1"]}, "give the lower one first"),
        ({"bound": ["gamma=:"]}, "write LO:HI"),
        ({"bound": ["gamma=1:2"], "fix": ["gamma=1.5"]}, "fixed and has bounds"),
        ({"bound": ["gamma=1:2"], "start": ["gamma=3"]}, "not within 1 and 2"),
    ],
)
def test_what_cannot_be_is_refused(typed, said):
    with pytest.raises(InputError, match=said):
        Competitors.typed(**{"laws": "1-6"} | typed)


def test_bounds_may_be_open():
    found = Competitors.typed("5", bound=["gamma=2:", "k/m=:40"]).of_law(5)
    assert found == {"gamma": Given(2.0, math.inf), "k/m": Given(-math.inf, 40.0)}


def test_the_slope_of_a_linear_law_is_given_to_its_formula():
    found = Competitors.typed("3-5", fix=["G_slip=0.6"])
    assert found.direct == (5,)
    assert found.searched == ALL_LAWS
    assert {law: (own.formula, own.ramp) for law, own in found.restated.items()} == {
        3: ("Fs - G_slip*s", False),
        4: ("Fs - G_slip*s", True),
    }
    assert restated(6).ramp


def test_a_published_law_may_be_written_out():
    law = PUBLISHED["stribeck"]
    assert read_law(str(law)) is law
