"""The curve through a formula: within its tolerance everywhere, with an end, and refusals that name the speed."""

import math

import numpy as np
import pytest

from rig_sim.friction.curve import CONSTANT, LINEAR, MEASURED
from rig_sim.friction.formula import Formula
from rig_sim.friction.formula_curve import MOST_PIECES, TOLERANCE, WIDEST, FormulaCurve, formula_curve
from rig_sim.friction.spline import about, piece_of
from stickslip.errors import InputError

GAUSSIAN = "Fc + (Fs - Fc)*exp(-(s/v_s)**2) + b*s"
LOGARITHMIC = "Fs - b*log(1 + s/v0)"


def curve(text: str, fastest: float, **values: float) -> FormulaCurve:
    formula = Formula.parse(text)
    return formula_curve(formula, tuple(values[name] for name in formula.parameters), fastest)


def friction(found: FormulaCurve, s: float) -> tuple[float, float]:
    """Return the friction (N) and its slope (N s/m) that the kernels read."""
    value, slope, *_ = about(found.table, found.pieces, piece_of(found.table, found.pieces, s), s)
    return found.Fs * value, found.Fs * slope


@pytest.mark.parametrize(
    ("text", "values", "fastest", "reach"),
    [
        ("Fs/(1 + gamma*s)", {"Fs": 1.0, "gamma": 3.0}, 2.0, 128.0),
        (GAUSSIAN, {"Fc": 0.6, "Fs": 1.0, "v_s": 0.15, "b": 0.02}, 1.9, 128.0),
        (GAUSSIAN, {"Fc": 0.6, "Fs": 1.0, "v_s": 0.001, "b": 0.0}, 1.9, 128.0),  # a fall within a thousandth of it
        (LOGARITHMIC, {"Fs": 1.38, "b": 0.2, "v0": 0.01}, 1.2, 8.0),
        ("max(Fs - s, Fc)", {"Fs": 1.0, "Fc": 0.3}, 2.0, 128.0),  # a corner
        ("Fs*exp(-s/v)", {"Fs": 1.0, "v": 0.05}, 2.0, 128.0),  # vanishes within the range
        ("Fs*exp(s/v)", {"Fs": 1.0, "v": 0.5}, 2.0, 16.0),  # grows by 12 decades beyond: the end comes earlier
    ],
)
def test_the_curve_is_the_formula_to_the_tolerance(
    text: str, values: dict[str, float], fastest: float, reach: float
) -> None:
    found = curve(text, fastest, **values)
    formula = Formula.parse(text)
    assert found.curve == MEASURED
    assert found.pieces <= MOST_PIECES + 1
    assert found.table[5 * found.pieces :] == (math.inf, reach)
    near = np.concatenate((np.geomspace(1e-6, fastest, 3001), np.linspace(0.0, fastest, 3001)))
    exact = formula.value(near, values)
    away = np.abs(np.array([friction(found, s)[0] for s in near.tolist()]) - exact)
    assert away.max() < 1.5 * TOLERANCE * exact.max()  # a corner between the nine places of a piece: measured 1.22
    beyond = np.geomspace(fastest, reach, 1001)
    expected = formula.value(beyond, values)
    away = np.abs(np.array([friction(found, s)[0] for s in beyond.tolist()]) - expected)
    assert np.all(away < 1.5 * TOLERANCE * np.maximum(exact.max(), expected))


def test_straight_lines_are_the_closed_forms_of_laws_1_and_3() -> None:
    assert curve("Fs", 2.0, Fs=0.7) == FormulaCurve(0.7, CONSTANT, 0.0)
    assert curve("min(Fs, 5)", 2.0, Fs=0.7) == FormulaCurve(0.7, CONSTANT, 0.0)
    falling = curve("Fs - G*s", 2.0, Fs=1.0, G=0.05)
    assert (falling.curve, falling.G_slip) == (
        LINEAR,
        0.05,
    )  # negative from s = 20 on: a force reversal there, as law 3
    assert curve("Fs + b*s", 2.0, Fs=1.0, b=0.05).G_slip == -0.05


def test_huge_numbers_beyond_the_reach_end_the_curve_without_a_warning() -> None:
    found = curve("Fs*exp(s/v)", 2.0, Fs=1.0, v=0.1804)  # 1e308 at the widest end tried: the cubics overflow
    assert 2.0 <= found.table[-1] < 2.0 * WIDEST


@pytest.mark.parametrize("fastest", [0.0, 1e-70, 1e70, math.inf])
def test_a_speed_out_of_the_range_of_numbers_is_refused(fastest: float) -> None:
    with pytest.raises(InputError, match="choose other units"):
        curve(GAUSSIAN, fastest, Fc=0.6, Fs=1.0, v_s=0.15, b=0.02)


@pytest.mark.parametrize(
    ("text", "values", "said"),
    [
        ("Fs*s", {"Fs": 1.0}, "friction at rest is 0, at s = 0 m/s with Fs = 1"),
        ("Fs - 2*s**2", {"Fs": 1.0}, "friction is negative"),
        ("Fs - 2*s", {"Fs": 1.0}, "friction is negative, -3, at s = 2 m/s with Fs = 1; the mass may reach s = 2 m/s"),
        ("Fs/abs(s - 1)", {"Fs": 1.0}, "division by 0"),
        ("Fs - sqrt(s)/9", {"Fs": 1.0}, "derivative with respect to s is not finite at s = 0 m/s"),
        ("Fs + 1e-3/((s - 1.05)**2 + 1e-28)", {"Fs": 1.0}, "friction|abruptly"),
        ("Fs + tanh((s - 1.03)/1e-14)/2", {"Fs": 1.0}, "changes too abruptly"),
    ],
)
def test_what_is_no_friction_curve_is_refused_with_the_speed(text: str, values: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        curve(text, 2.0, **values)
