"""A rest position of the spring beside the travel of the mass: what is asked about, and what cannot be."""

import pytest

from daq.runfile.rest_position import FAR, explain_impossible, question_rest_position
from stickslip.units import Measured

LOW, HIGH = 0.02, 0.06


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_a_rest_position_far_outside_the_travel_is_asked_about_at_any_scale(scale: float) -> None:
    far = Measured(scale * (LOW - 1.01 * FAR * (HIGH - LOW)))
    near = Measured(scale * (LOW - 0.99 * FAR * (HIGH - LOW)))
    assert "Are its sign and its unit correct?" in question_rest_position(far, scale * LOW, scale * HIGH)
    assert question_rest_position(near, scale * LOW, scale * HIGH) == ""


def test_the_question_names_the_travel_and_the_sign() -> None:
    asked = question_rest_position(Measured(-0.18), LOW, HIGH)
    assert asked.startswith(
        "x0 (-180 mm) is 200 mm outside the travel of 20 to 60 mm. Are its sign and its unit correct?"
    )
    assert "8.3 % of Fs" in asked  # travel over twice the stretch at the break-away, 40 mm / (2 * 240 mm)
    asked = question_rest_position(Measured(-0.05), LOW, HIGH)
    assert asked.startswith(
        "x0 (-50 mm) is 70 mm outside the travel of 20 to 60 mm, and 50 mm lies inside it. Is its sign"
    )


def test_inside_the_travel_and_within_its_own_error_nothing_is_asked() -> None:
    assert question_rest_position(Measured(0.03), LOW, HIGH) == ""
    assert question_rest_position(Measured(-0.05, 0.02), LOW, HIGH) == ""


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_spring_that_pulls_along_with_the_belt_at_every_place_cannot_be(direction: float) -> None:
    low, high = sorted((direction * LOW, direction * HIGH))
    assert "outside the travel" in explain_impossible(Measured(direction * 0.07), low, high, direction)
    assert explain_impossible(Measured(direction * 0.07, 0.005), low, high, direction) == ""
    assert explain_impossible(Measured(direction * 0.01), low, high, direction) == ""
    assert explain_impossible(Measured(direction * 0.07), low, high, 0.0) == ""
