"""A formula typeset_formula says what was typed: read back from the page it is the same curve."""

from xml.etree import ElementTree

import pytest

from fitting.laws import PUBLISHED
from fitting.report.symbols import typeset_formula
from rig_sim.friction.formula import Formula

MARKS = {"\N{MINUS SIGN}": "-", "\N{INVISIBLE TIMES}": "*", "\N{MIDDLE DOT}": "*", "\N{FUNCTION APPLICATION}": ""}


def read(element):
    """Return the text of a formula that an element shows."""
    parts = [read(child) for child in element]
    tag = element.tag
    if tag == "msup":
        base, exponent = parts
        return f"exp({exponent})" if base == "e" else f"({base})**({exponent})"
    if tag == "mfrac":
        return f"(({parts[0]})/({parts[1]}))"
    if tag == "msqrt":
        return f"sqrt({''.join(parts)})"
    if tag == "msub":
        return "_".join(parts)
    if tag in ("math", "mrow"):
        text = "".join(parts)
        return f"abs({text[1:-1]})" if text.startswith("|") else text.replace("ln(", "log(")
    return MARKS.get(element.text, element.text)


@pytest.mark.parametrize(
    "text",
    [
        *(law.formula for law in PUBLISHED.values()),
        "-(a - b)*s**2 - (c - (d - s))",
        "a/(b/(c*s)) + 2*s*3",
        "(-a)**2 + (a/b)**c**s - -b",
        "max(a - b*s, tanh(s/v), 0.1)*sqrt(a + s) + abs(b - s)",
        "exp(-(s/v)**p)*(a + b)",
    ],
)
def test_what_is_shown_is_the_formula(text):
    shown = Formula.parse(read(ElementTree.fromstring(typeset_formula(text).replace("&#x2062;", "\u2062"))))
    formula = Formula.parse(text)
    # names are shown with subscripts: Fs is F with an index
    values = {name: 0.3 + 0.17 * k for k, name in enumerate(formula.parameters)}
    renamed = {name.replace("_", ""): value for name, value in values.items()}
    found = {name: renamed[name.replace("_", "")] for name in shown.parameters}
    for s in (0.2, 0.7):
        assert float(shown.value(s, found)) == pytest.approx(float(formula.value(s, values)), rel=1e-12)
