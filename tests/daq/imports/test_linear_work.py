"""Reading text from outside takes work in proportion to its length, whatever stands in it."""

import importlib
import re
import time
from itertools import product

import pytest

from daq.imports import layout, table, table_to_run
from daq.imports.options import ImportOptions

MODULES = ("daq.imports.columns", "daq.imports.layout", "daq.imports.sigrok", "stickslip.units")
# Used by search or split, which begin anew at every place; all others by fullmatch or match.
SEARCHED = {"_IN_WORD", "_DATE_END", "_WIDE_GAP", "_GAP", "_PLUS_MINUS"}
EXPRESSIONS = {
    f"{name}.{own}": pattern.split if own in SEARCHED else pattern.fullmatch
    for name in MODULES
    for own, pattern in vars(importlib.import_module(name)).items()
    if isinstance(pattern, re.Pattern)
}
LENGTH = 20_000  # characters: a match that begins anew at each of them takes a second or more, not a millisecond
BEGINS = ("", "1", "x", "12:00:00")
REPEATED = ("1", " ", "a", "/", ",", "(", "[", ".", "e", "1e", "1 ", "T", "+", "in ", "\n1", "1.1", "x(")
ENDS = ("", "x", "\n!")


@pytest.mark.parametrize("match", EXPRESSIONS.values(), ids=EXPRESSIONS)
def test_an_expression_looks_at_each_character_a_few_times(match):
    """A column's name that ends in 20,000 blanks took 38 s, a sample rate of 1 MB of blanks would have had no end."""
    for begin, middle, end in product(BEGINS, REPEATED, ENDS):
        text = begin + middle * (LENGTH // len(middle)) + end
        before = time.process_time()
        match(text)
        assert time.process_time() - before < 0.3, (begin, middle, end)


@pytest.mark.parametrize("cell", ["1.5e", "1.5e-"])
def test_digits_before_an_unfinished_exponent_are_no_number(cell):
    """Python 3.11.0 to 3.11.4 match ``(?:ab)?+`` to "a" (gh-106052): there, "1.5e" was a number."""
    assert layout.read_number(cell, ".") is None


def test_a_header_of_blanks_is_read(tmp_path):
    path = tmp_path / "blanks.csv"
    path.write_text("t [s],x" + " " * 20_000 + "(mm)\n" + "".join(f"{i / 100},{i % 7}\n" for i in range(50)))
    found = table_to_run.read(path, ImportOptions())
    assert found.columns["position"].endswith("in mm")
    assert len(found.columns["position"]) < 100  # 20,000 blanks were printed


def test_a_long_line_above_or_beside_the_table_does_not_matter(tmp_path):
    path = tmp_path / "long.csv"
    lines = "".join(f"{i / 100},{i % 7}\n" for i in range(50))
    path.write_text("1," * table.LONGEST_LINE + "\n#" + "1," * table.LONGEST_LINE + "\nt,x\n" + lines)
    assert table_to_run.read(path, ImportOptions(preamble=1)).run.time.size == 50
