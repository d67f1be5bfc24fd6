"""Which laws compete, and what is given of their parameters: how it is typed, and what is refused."""

import math
from types import SimpleNamespace

import pytest

from fitting.judge.calibrations import apply_to_formula
from fitting.laws import PUBLISHED, SIX, Competitors, Given, Law, read_law
from stickslip.errors import InputError


def test_laws_are_numbers_published_names_and_formulas():
    found = Competitors.typed("1-3,6,stribeck", ["power", "mine: Fs/(1 + s/v)"], ["mine"])
    assert [law.key for law in found.laws] == [1, 2, 3, 6, "stribeck", "power", "mine"]
    assert [law.ramp for law in found.formulas] == [False, False, True]
    same = Competitors.of(("1-3", 6, "stribeck", "power", Law("mine", "Fs/(1 + s/v)", ramp=True)))
    assert same.laws == found.laws


def test_a_name_alone_is_that_of_every_law_that_has_it():
    found = Competitors.typed(
        "1-6",
        ["mine: Fc + a*exp(-s/v_s)"],
        [],
        ["gamma=9.6", "mine.v_s=0.05"],
        ["k/m=30:40", "5.d=:1"][:1],
        ["6.d=0.03"],
    )
    assert found.of_law(SIX[5]) == {"gamma": Given(9.6, 9.6, 9.6), "k/m": Given(30.0, 40.0)}
    assert found.of_law(SIX[6]) == {"gamma": Given(9.6, 9.6, 9.6), "k/m": Given(30.0, 40.0), "d": Given(start=0.03)}
    assert found.of_law(SIX[1]) == {"k/m": Given(30.0, 40.0)}
    assert found.of_law(found.formulas[0]) == {"v_s": Given(0.05, 0.05, 0.05), "k/m": Given(30.0, 40.0)}
    assert found.of_law(SIX[5])["gamma"].fixed


def test_a_formula_may_call_its_parameters_as_the_rig_does():
    law = Law("mine", "k - c*s")
    found = Competitors(laws=(law,), fix={"c": -2.0})
    assert found.of_law(law) == {"c": Given(-2.0, -2.0, -2.0)}
    with pytest.raises(InputError, match="c is -2"):  # of the damping, which every other law has
        Competitors(laws=(SIX[5], law), fix={"c": -2.0})


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ({"laws": "3-1"}, "3-1"),
        ({"laws": ""}, "no law was requested"),
        ({"laws": "5,strib"}, "did you mean 'stribeck'"),
        ({"law": ["mine"]}, "no published law"),
        ({"law": ["stribeck: Fs - G*s"]}, "is the name of a published law"),
        ({"law": ["mine: Fs", "mine: Fs - G*s"]}, "two laws have the name mine"),
        ({"ramp": ["mine"]}, "unknown law 'mine'"),
        ({"fix": ["3.gamma=1"]}, "none of the fitted laws has a parameter 3.gamma"),
        ({"fix": ["mine.v_s=1"]}, "there is no law mine"),
        ({"fix": ["gamma=1", "gamma=2"]}, "given twice"),
        ({"fix": ["static=0.5"]}, "at least 1"),
        ({"fix": ["k/m=0"]}, "above 0"),
        ({"bound": ["gamma=:"]}, "write LO:HI"),
        ({"bound": ["gamma=1:2"], "fix": ["gamma=1.5"]}, "both a fixed value and bounds"),
        ({"bound": ["gamma=1:2"], "start": ["gamma=3"]}, "outside its bounds, 1 to 2"),
        ({"law": ["1-3"]}, "did you mean laws 1-3"),
        ({"fix": ["gamma=inf"]}, "gamma is 'inf'"),
        ({"start": ["static=1.2 m"]}, "without a unit"),
        ({"fix": ["Fs=1 N", "Fs=4 m/s^2"]}, "given twice"),
        ({"law": ["mine: Fs/(1+g*S)"]}, "did you mean s for S"),  # these were fitted as constants
        ({"law": ["mine: v"]}, "did you mean s for v"),
        ({"law": ["mine: Fs - Fc"]}, "for constant friction use law 1"),
        ({"law": ["mine: Fs/(1+g*\uff53)"]}, "fullwidth latin small letter s"),
        ({"law": ["mine: Fs/(1+g*\u0455)"]}, "cyrillic small letter dze.*did you mean s"),
    ],
)
def test_what_cannot_be_is_refused(typed, said):
    with pytest.raises(InputError, match=said):
        Competitors.typed(**{"laws": "1-6"} | typed)


@pytest.mark.parametrize(
    ("law", "typed", "expected"),
    [
        (5, {"fix": ["gamma=9.6e-3 s/mm"]}, {"gamma": Given(9.6, 9.6, 9.6)}),
        (5, {"start": ["Fs=4.6 m/s^2"]}, {"Fs/m": Given(start=4.6)}),
        (5, {"start": ["5.Fs=4.6 N/kg"]}, {"Fs/m": Given(start=4.6)}),
        (5, {"start": ["Fs=0.5 kN"]}, {"Fs": Given(start=500.0)}),
        (5, {"bound": ["k=9:11 N/mm"]}, {"k": Given(9e3, 11e3)}),
        (6, {"bound": ["d=:30 mm/s"]}, {"d": Given(high=0.03)}),
        (6, {"bound": ["d=1 mm/s:3 cm/s"]}, {"d": Given(0.001, 0.03)}),
        (5, {"fix": ["x0=60 mm"]}, {"x0": Given(0.06, 0.06, 0.06)}),
        (5, {"bound": ["gamma=2:", "k/m=:40"]}, {"gamma": Given(2.0, math.inf), "k/m": Given(-math.inf, 40.0)}),
    ],
)
def test_values_take_units_and_bounds_may_be_open(law, typed, expected):
    assert Competitors.typed(str(law), **typed).of_law(SIX[law]) == expected


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"start": {"gamma": math.inf}}, "gamma is inf"),  # the record was blamed
        ({"fix": {"gamma": 10**400}}, "gamma is 1000"),
        ({"start": {"gamma": None}}, "of gamma is None"),
        ({"bounds": {"gamma": (0.0, math.nan)}}, "gamma is "),
        ({"bounds": {"gamma": (0.0, "20 kg")}}, "not a unit of this quantity"),
        ({"laws": object()}, "is not a law"),  # a TypeError
        ({"laws": 5.5}, "5.5 is not a law"),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments, said):
    with pytest.raises(InputError, match=said):
        Competitors.of(**{"laws": 5} | arguments)


def test_arguments_take_units():
    found = Competitors.of("5,stribeck", {"gamma": "9.6 s/m"}, {"v_s": (0, "30 cm/s")}, {"v_s": "30 mm/s"})
    assert (found.fix, found.bounds, found.start) == ({"gamma": 9.6}, {"v_s": (0, 0.3)}, {"v_s": 0.03})
    assert Law("mine", "Fs*exp(-s/v_s)", start={"v_s": "30 mm/s"}).start == {"v_s": 0.03}


def test_the_slope_of_a_linear_law_is_given_to_its_formula():
    found = Competitors.typed("3-5", fix=["G_slip=0.6"])
    assert [law.key for law in found.laws if found.by_kernel(law)] == [5]
    assert found.searched == tuple(SIX.values())


@pytest.mark.parametrize(
    ("given", "bounds"),
    [(Given(start=0.03), (0.0, None)), (Given(high=0.3), (0.0, 0.3)), (Given(low=0.01), (0.01, None))],
)
def test_an_end_that_is_not_given_is_that_of_the_law(given, bounds):
    """A first value took the bounds of a published law away."""
    law = apply_to_formula(PUBLISHED["stribeck"], {"v_s": given}, SimpleNamespace())
    assert law.bounds["v_s"] == bounds


@pytest.mark.parametrize("name", ["7", "5", "my law", "a.b", ""])
def test_a_name_is_a_word(name):
    with pytest.raises(InputError, match="is no name of a law"):
        Law(name, "Fs")


def test_a_published_law_may_be_written_out():
    law = PUBLISHED["stribeck"]
    assert read_law(str(law)) is law
