"""Every parameter that a fit can report has a meaning, in the code and in the documentation."""

from pathlib import Path

from fitting.judge.parameters import TABLE
from fitting.laws import SIX
from fitting.report.symbols import SYMBOLS, formula, symbols

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "laws.md"


def test_every_parameter_has_a_meaning() -> None:
    names = {row.name for row in TABLE} | {"Fs0/m", "wear"}
    assert {name.removesuffix("/m") for name in names} <= set(SYMBOLS)
    shown = dict(symbols(names))
    assert set(shown) == set(SYMBOLS)
    assert "gamma" not in dict(symbols(["G_slip/m"]))


def test_the_page_holds_every_symbol_and_formula() -> None:
    text = PAGE.read_text()
    for symbol, meaning in SYMBOLS.items():
        assert f"| {symbol} | {meaning} |" in text
    for law in SIX.values():
        begin = formula(law).split(" with ")[0]
        assert begin.replace("|", r"\|").replace("(Fs)", "Fs").replace("(Fs/(1 + gamma s))", "Fs/(1 + gamma s)") in text
