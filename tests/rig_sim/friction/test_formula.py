"""Formulas: read as arithmetic reads them, differentiated exactly, never run as Python; each fault has its caret."""

import ast
import math
import operator
import re

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rig_sim.friction.formula import DEEPEST, LONGEST, Formula
from stickslip.errors import InputError

STRIBECK = "Fc + (Fs - Fc)*exp(-(s/v_s)**2) + b*s"
STEP = mpmath.mpf("1e-20")  # of a central difference in 60 digits: less than the spacing of doubles

FUNCTIONS = {
    "exp": mpmath.exp,
    "log": mpmath.log,
    "sqrt": mpmath.sqrt,
    "tanh": mpmath.tanh,
    "abs": abs,
    "min": min,
    "max": max,
}
OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def exact(node: ast.expr, known: dict[str, mpmath.mpf]) -> mpmath.mpf:
    """Return the value of what Python reads in a text, in mpmath."""
    if isinstance(node, ast.Constant):
        return mpmath.mpf(node.value)
    if isinstance(node, ast.Name):
        return known[node.id]
    if isinstance(node, ast.Call):
        found = FUNCTIONS[ast.unparse(node.func)](*(exact(part, known) for part in node.args))
    elif isinstance(node, ast.UnaryOp):
        found = -exact(node.operand, known)
    else:
        assert isinstance(node, ast.BinOp)
        found = OPERATORS[type(node.op)](exact(node.left, known), exact(node.right, known))
    if isinstance(found, mpmath.mpc) or not mpmath.isfinite(found) or not 1e-4 < abs(found) < 1e4:
        raise ValueError("out of the range in which rounding is small")
    return found


def has_corner(node: ast.expr, known: dict[str, mpmath.mpf]) -> bool:
    """Return whether the arguments of a min or max in it are nearer to each other than `STEP` and rounding resolve."""
    pairs = [call.args for call in ast.walk(node) if isinstance(call, ast.Call) and len(call.args) == 2]
    values = [[exact(part, known) for part in pair] for pair in pairs]
    return any(abs(left - right) < 1e-12 * abs(left) for left, right in values)


def _grown(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    operand = st.one_of(inner, inner.map("({})".format))
    return st.one_of(
        st.tuples(operand, st.sampled_from(["+", "-", "*", "/", "**"]), operand).map("".join),
        operand.map("-{}".format),
        st.tuples(st.sampled_from(["exp", "log", "sqrt", "tanh", "abs"]), inner).map("{0[0]}({0[1]})".format),
        st.tuples(st.sampled_from(["min", "max"]), inner, inner).map("{0[0]}({0[1]}, {0[2]})".format),
    )


NUMBERS = st.floats(0.1, 9.0).map(lambda number: repr(round(number, 3)))
TEXTS = st.recursive(st.one_of(st.sampled_from("sab"), NUMBERS), _grown, max_leaves=12)


@settings(max_examples=300, deadline=None)
@given(TEXTS, st.floats(0.1, 3.0), st.floats(0.1, 3.0), st.floats(0.1, 3.0))
def test_a_formula_is_read_as_python_reads_it_with_exact_derivatives(text: str, s: float, a: float, b: float) -> None:
    formula, tree = Formula.parse(text), ast.parse(text, mode="eval").body
    known = {"s": s, "a": a, "b": b}
    with mpmath.workdps(60):
        numbers = {name: mpmath.mpf(value) for name, value in known.items()}
        try:
            expected = exact(tree, numbers)
            slopes = {
                name: (exact(tree, {**numbers, name: x + STEP}) - exact(tree, {**numbers, name: x - STEP})) / (2 * STEP)
                for name, x in numbers.items()
            }
        except (ValueError, ZeroDivisionError):
            assume(False)
    assert set(formula.parameters) == set(re.findall(r"\b[ab]\b", text))
    assert float(formula.value(s, known)) == pytest.approx(float(expected), rel=1e-7)
    found = {"s": float(formula.slope(s, known))} | dict(
        zip(formula.parameters, formula.gradient(s, known).tolist(), strict=True)
    )
    for name, slope in found.items():
        assume(abs(slopes[name]) < 1e6)
        # at a corner of min or max the central difference is the mean of both sides
        assert slope == pytest.approx(float(slopes[name]), rel=1e-6, abs=1e-6) or has_corner(tree, numbers)


@pytest.mark.parametrize(
    ("text", "value"),
    [("-2**2", -4.0), ("2**3**2", 512.0), ("2**-1", 0.5), ("8/4/2", 1.0), ("7-2-1", 4.0), ("--2", 2.0)],
)
def test_signs_and_powers_bind_as_in_algebra(text: str, value: float) -> None:
    assert Formula.parse(text).value(1.0, {}) == value


def test_at_a_corner_the_derivative_is_that_towards_larger_values() -> None:
    assert Formula.parse("abs(s - 1)").slope(1.0, {}) == 1.0
    assert Formula.parse("max(s, 1)").slope(1.0, {}) == 1.0
    assert Formula.parse("min(s, 1)").slope(1.0, {}) == 0.0
    assert Formula.parse("abs(s - a)").gradient(1.0, {"a": 1.0}).tolist() == [1.0]


def test_a_power_of_zero_has_the_derivatives_of_its_limit() -> None:
    power = Formula.parse("(s/v)**p")
    assert power.slope(0.0, {"v": 0.5, "p": 1.0}) == 2.0
    assert power.slope(0.0, {"v": 0.5, "p": 2.0}) == 0.0
    assert power.gradient(0.0, {"v": 0.5, "p": 1.5}).tolist() == [0.0, 0.0]


def test_an_overflow_within_a_finite_result_is_no_error() -> None:
    assert Formula.parse("1/(1 + exp(s/v))").value(100.0, {"v": 0.01}) == 0.0


FAULTS = [  # text, the caret's column, a word of what is said
    ("__import__('os').system('true')", 11, "no meaning"),
    ("s.__class__", 1, "letters, digits"),
    ("eval(s)", 0, "unknown function eval"),
    ("s[0]", 1, "round brackets"),
    ("s < 1", 2, "no meaning"),
    ("s if s else 1", 2, "operator is missing"),
    ("F = s", 2, "right-hand side"),
    ("s^2", 1, "write ** for powers"),
    ("a*z; z' = 1 - s*z/D", 3, "the rate of a state"),
    ("2s", 1, "operator is missing"),
    ("Fs(1 + s)", 0, "a product needs a *"),
    ("epx(-s)", 0, "did you mean 'exp'?"),
    ("exp", 0, "write exp(...)"),
    ("exp()", 0, "exp has 0 arguments; pass one"),
    ("min(s)", 0, "pass two or more"),
    ("Fs*(1 - s", 3, "not closed"),
    ("Fs*(1 - s))", 10, "no matching opening bracket"),
    ("Fs -", 4, "value is missing"),
    ("", 0, "value is missing"),
    ("* s", 0, "value is missing"),
    ("1,5*s", 1, "decimal point"),
    ("(1,5)*s", 2, "decimal point"),
    ("1e999*s", 0, "beyond"),
    ("s\x00", 1, "no meaning"),
    ("(s)(2)", 3, "write * for a product"),
]


@pytest.mark.parametrize(("text", "column", "said"), FAULTS)
def test_a_fault_is_shown_with_a_caret_under_it(text: str, column: int, said: str) -> None:
    with pytest.raises(InputError) as caught:
        Formula.parse(text)
    error = caught.value
    assert said in str(error)
    shown, caret = error.do.split("\n")[1:]
    assert caret.index("^") - 4 == column
    assert shown[4:].ljust(column) == text.replace("\x00", "?").ljust(column)


def test_long_and_deep_formulas_are_refused_at_once() -> None:
    for text in ("(" * 10_000 + "s" + ")" * 10_000, "s" + "+s" * 1_000_000):
        with pytest.raises(InputError, match=f"at most {LONGEST}"):
            Formula.parse(text)
    for text in ("(" * 500 + "s" + ")" * 500, "-" * 500 + "s", "s" + "**s" * 500, "exp(" * 300 + "s" + ")" * 300):
        with pytest.raises(InputError, match=f"at most {DEEPEST} levels"):
            Formula.parse(text)
    depth = DEEPEST - 1
    assert Formula.parse("(" * depth + "s" + ")" * depth).value(2.0, {}) == 2.0
    assert Formula.parse("s" + "+s" * 900).value(1.0, {}) == 901.0


@pytest.mark.parametrize(
    ("text", "values", "speeds", "said", "column"),
    [
        ("2**10**10", {}, [1.0], "overflow", 1),
        ("Fs/(1 - s/v)", {"Fs": 1.0, "v": 0.5}, [0.1, 0.5], "s = 0.5 m/s with Fs = 1, v = 0.5: division by 0", 2),
        ("Fs - b*log(s)", {"Fs": 1.0, "b": 0.1}, [0.0], "log of 0", 7),
        ("log(1 - s)", {}, [0.5, 2.0], "log of -1", 0),
        ("sqrt(a - s)", {"a": 1.0}, [3.0], "sqrt of -2", 0),
        ("(s - 1)**p", {"p": 0.5}, [0.0], "-1 to the power 0.5", 7),
        ("exp(s/v)", {"v": 1e-3}, [1.0], "overflow", 0),
        ("Fs + s", {"Fs": math.inf}, [1.0], "Fs is not finite", 0),
    ],
)
def test_a_numerical_failure_is_a_sentence_with_speed_and_parameters(
    text: str, values: dict[str, float], speeds: list[float], said: str, column: int
) -> None:
    with pytest.raises(InputError) as caught:
        Formula.parse(text).value(np.array(speeds), values)
    assert said in caught.value.what
    assert caught.value.do.split("\n")[2].index("^") - 4 == column


def test_a_slope_that_is_not_finite_and_a_missing_parameter_are_sentences() -> None:
    with pytest.raises(InputError, match="derivative with respect to s is not finite at s = 0 m/s"):
        Formula.parse("1 - sqrt(s)").slope(np.array([0.0, 1.0]), {})
    with pytest.raises(InputError, match="no value for v_s, b"):
        Formula.parse(STRIBECK).value(0.0, {"Fc": 0.5, "Fs": 1.0})
