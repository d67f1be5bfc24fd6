"""Formulas in kernels against the same ones on arrays, and the states that they lead to."""

from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from rig_sim.friction import pair
from rig_sim.friction.formula import Formula
from stickslip.compute.compile import compiled

FORMULAS = [
    "F0 + a*log(s/v0) + b*log(z*v0/a)",
    "min(a, b*z, F0) - max(s, z)/v0**2",
    "-sqrt(abs(s - z))*tanh(a*z)/exp(b*s) + 2.5e-1",
    "(F0 - a*z)**3 + z**b - (-a)**2",
    "1/(1 + exp(5*s/v0)) + abs(z - a)*0.5",
]
NAMES = ("F0", "a", "b", "v0")


@pytest.mark.parametrize("machine_code", [True, False])
@pytest.mark.parametrize("text", FORMULAS)
def test_values_and_derivatives_are_those_of_the_formula(text, machine_code):
    formula, chance = Formula.parse(text), np.random.default_rng(1)
    law = pair.encode(formula, Formula.parse("1 - s*z/v0"), NAMES, 1e-9, 1.0)
    evaluate = compiled(pair.evaluate, (pair.__name__,), _nrt=False) if machine_code else pair.evaluate
    for _ in range(5):
        s, z, *p = chance.uniform(0.2, 2.0, 2 + len(NAMES))
        pair.set_parameters(law, np.array(p), 0)
        values = dict(zip(NAMES, p, strict=True)) | {"z": z}
        place = evaluate(law, False, s, z, 3 + len(NAMES))
        found = law[place : place + 3 + len(NAMES)]
        expected = [formula.value(s, values), formula.slope(s, values), *formula.gradient(s, values, ("z", *NAMES))]
        assert found == pytest.approx(np.array(expected, float), rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("text", ["log(a - 3*s)", "sqrt(0 - z)", "(0 - z)**a", "a/(s - s)"])
def test_operations_outside_their_range_give_nan(text):
    law = pair.encode(Formula.parse(text), Formula.parse("1 - z"), ("a",), 1e-9, 1.0)
    pair.set_parameters(law, np.array([0.5]), 0)
    assert np.isnan(law[pair.evaluate(law, False, 1.0, 1.0, 4)])


@pytest.mark.parametrize(
    ("rate", "seed"),
    [("1 - s*z/a", 1.0), ("b/a*exp(-z) - s/a", 0.0), ("s*(1 - z**3/b)", 5.0), ("(s - z)/a - z**3", 1.0)],
)
def test_a_steady_state_is_where_its_rate_is_0(rate, seed):
    law = pair.encode(Formula.parse("z"), formula := Formula.parse(rate), ("a", "b"), 1e-9, seed)
    for s, a, b in ((0.1, 0.2, 0.3), (2.0, 1e-3, 0.7)):
        pair.set_parameters(law, np.array([a, b]), 0)
        rate_at = partial(
            lambda values, z: float(formula.value(values["s"], values | {"z": z})), {"s": s, "a": a, "b": b}
        )
        expected = brentq(rate_at, -20.0, 40.0, xtol=1e-14)
        assert pair.steady_state(law, s) == pytest.approx(expected, rel=1e-9)


def test_a_rate_that_is_never_0_has_no_steady_state():
    law = pair.encode(Formula.parse("a*z"), Formula.parse("exp(z)"), ("a",), 1e-9, 1.0)
    pair.set_parameters(law, np.ones(1), 0)
    with np.errstate(all="ignore"):  # of the numbers of the array, interpreted
        assert np.isnan(pair.steady_state(law, 0.1))


def test_friction_along_a_motion_is_that_of_scipys_state():
    friction, rate, p = Formula.parse("a + b*z"), Formula.parse("(s - z)/tau"), np.array([2.0, 0.5, 0.05])
    law = pair.encode(friction, rate, ("a", "b", "tau"), 1e-9, 1.0)
    time = np.linspace(0.0, 2.0, 4001)
    speed = 0.5 + 0.4 * np.sin(7 * time)
    found, by_p = np.empty(time.size), np.empty((time.size, 3))
    pair.friction_along(law, p, time, speed, found, by_p)
    state = solve_ivp(
        lambda t, z: (0.5 + 0.4 * np.sin(7 * t) - z) / p[2], (0.0, 2.0), [0.5], t_eval=time, rtol=1e-9, atol=1e-12
    ).y[0]
    assert np.max(np.abs(found - (p[0] + p[1] * state))) < 2e-3  # implicit Euler at this step
    assert by_p[:, 1] == pytest.approx((found - p[0]) / p[1])
