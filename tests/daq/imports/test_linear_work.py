"""Reading text from outside takes work in proportion to its length, whatever stands in it.

Work is counted, not timed: a backtracking matcher of the expressions counts the characters it looks at.
"""

import importlib
import re
from collections.abc import Callable
from itertools import product
from re import _constants as codes  # type: ignore[attr-defined]
from re import _parser as parser  # type: ignore[attr-defined]
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from daq.imports import columns, layout, table, table_to_run
from daq.imports.options import ImportOptions
from stickslip.errors import InputError

MODULES = ("daq.imports.columns", "daq.imports.layout", "daq.imports.sigrok", "stickslip.units")
# Used by search or split, which begin anew at every place; all others by fullmatch or match.
SEARCHED = {"_IN_WORD", "_DATE_END", "_WIDE_GAP", "_GAP", "_PLUS_MINUS"}
EXPRESSIONS = {
    f"{name}.{own}": (found, own in SEARCHED)
    for name in MODULES
    for own, found in vars(importlib.import_module(name)).items()
    if isinstance(found, re.Pattern)
}
BEGINS = ("", "1", "x", "12:00:00", "1 k")
REPEATED = ("1", " ", "a", "/", ",", "(", "[", ".", "e", "1e", "1 ", "T", "+", "in ", "\n1", "1.1", "x(")
ENDS = ("", "x", " ", "!", "\n!")


class CountedMatch:
    """A backtracking matcher of the parse tree of an expression; ``work`` counts the characters it looks at."""

    def __init__(self, pattern: re.Pattern[str]) -> None:
        self.flags = pattern.flags
        self.tree = list(parser.parse(pattern.pattern, pattern.flags & ~re.UNICODE))
        self.work = 0

    def fullmatch(self, text: str) -> bool:
        return self._match(self.tree, text, 0, lambda at: at == len(text))

    def search_all(self, text: str) -> None:
        at = 0
        while at <= len(text):
            end = self._first_end(self.tree, text, at)
            at = at + 1 if end is None else max(end, at + 1)

    def _first_end(self, nodes: list[Any], text: str, at: int) -> int | None:
        ends: list[int] = []
        found = self._match(nodes, text, at, lambda end: not ends.append(end))
        return ends[0] if found else None

    def _match(self, nodes: list[Any], text: str, at: int, then: Callable[[int], bool]) -> bool:
        if not nodes:
            return then(at)
        (kind, value), rest = nodes[0], nodes[1:]

        def go_on(end: int) -> bool:
            return self._match(rest, text, end, then)

        if kind is codes.SUBPATTERN:
            return self._match(list(value[3]), text, at, go_on)
        if kind is codes.ATOMIC_GROUP:
            end = self._first_end(list(value), text, at)
            return end is not None and go_on(end)
        if kind is codes.BRANCH:
            return any(self._match(list(branch), text, at, go_on) for branch in value[1])
        if kind in (codes.MAX_REPEAT, codes.MIN_REPEAT):
            return self._repeat(kind is codes.MAX_REPEAT, *value, text, at, go_on)
        if kind is codes.POSSESSIVE_REPEAT:
            least, most, body = value
            for number in range(int(most)):
                end = self._first_end(list(body), text, at)
                if end is None or end == at:
                    if number < least:
                        return False
                    break
                at = end
            return go_on(at)
        if kind in (codes.ASSERT, codes.ASSERT_NOT):
            direction, body = value
            found = (direction > 0 or at > 0) and self._match(list(body), text, at - (direction < 0), lambda _: True)
            return found == (kind is codes.ASSERT) and go_on(at)
        # One character, or a place between two: left to `re`, and counted.
        self.work += 1
        return self._single(kind, value, text, at, go_on)

    def _single(self, kind: Any, value: Any, text: str, at: int, then: Callable[[int], bool]) -> bool:
        if kind is codes.AT:
            where = {codes.AT_BOUNDARY: r"\b", codes.AT_BEGINNING: "^", codes.AT_END: "$"}[value]
            return bool(re.compile(where).match(text, at)) and then(at)
        if at == len(text):
            return False
        return self._is_in(kind, value, text[at]) and then(at + 1)

    def _is_in(self, kind: Any, value: Any, one: str) -> bool:
        same = {one, one.lower(), one.upper()} if self.flags & re.IGNORECASE else {one}
        if kind is codes.LITERAL:
            return chr(value) in same
        if kind is codes.NOT_LITERAL:
            return chr(value) not in same
        if kind is codes.ANY:
            return one != "\n" or bool(self.flags & re.DOTALL)
        negated = value[0][0] is codes.NEGATE
        classes = {codes.CATEGORY_DIGIT: r"\d", codes.CATEGORY_SPACE: r"\s", codes.CATEGORY_NOT_SPACE: r"\S"}
        found = False
        for member, what in value[negated:]:
            if member is codes.RANGE:
                found |= any(what[0] <= ord(each) <= what[1] for each in same)
            elif member is codes.CATEGORY:
                found |= bool(re.match(classes[what], one))
            else:
                found |= chr(what) in same
        return found != negated

    def _repeat(
        self, greedy: bool, least: int, most: Any, body: Any, text: str, at: int, then: Callable[[int], bool]
    ) -> bool:
        ends = [at]
        while len(ends) <= int(most):
            end = self._first_end(list(body), text, ends[-1])
            if end is None or end == ends[-1]:
                break
            ends.append(end)
        tried = ends[least:]
        return any(then(end) for end in (reversed(tried) if greedy else tried))


def work(pattern: re.Pattern[str], text: str, searched: bool) -> int:
    counted = CountedMatch(pattern)
    if searched:
        counted.search_all(text)
    else:
        counted.fullmatch(text)
    return counted.work


def worst(pattern: re.Pattern[str], length: int, searched: bool) -> int:
    texts = (begin + middle * (length // len(middle)) + end for begin, middle, end in product(BEGINS, REPEATED, ENDS))
    return max(work(pattern, text, searched) for text in texts)


@pytest.mark.parametrize(("pattern", "searched"), EXPRESSIONS.values(), ids=EXPRESSIONS)
def test_an_expression_looks_at_each_character_a_few_times(pattern, searched):
    """A column's name that ends in 20,000 blanks took 38 s, a sample rate of 1 MB of blanks would have had no end."""
    short = worst(pattern, 20, searched)
    assert short < 12 * 20
    assert worst(pattern, 40, searched) <= 2.3 * short


@pytest.mark.parametrize(
    ("expression", "searched"),
    [
        (r"^(.*?)\s*(?:\(([^()]*)\)|(?:/|,|\bin\b)\s*(\S+))$", False),  # of units
        (r"(\d+(?:\.\d+)?)\s*([kKmMgG]?)\s*(?:[hH][zZ])?", False),  # of sample rates
        (r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", False),  # of numbers
        (r"\s*(?:±|\+-|\+/-)\s*", True),  # of standard deviations
    ],
)
def test_the_count_of_work_finds_the_expressions_that_were_quadratic(expression, searched):
    pattern = re.compile(expression)
    assert worst(pattern, 24, searched) > 3 * worst(pattern, 12, searched)


@pytest.mark.parametrize("own", sorted(EXPRESSIONS))
@given(text=st.text("1.e+- x(/,inkHz:T", max_size=12))
def test_the_counted_match_is_that_of_the_library(own, text):
    pattern, _ = EXPRESSIONS[own]
    assert CountedMatch(pattern).fullmatch(text) == bool(pattern.fullmatch(text))


def loose_repeats(nodes: list[Any]) -> int:
    """Return how many possessive repeats have a body of several parts that is no atomic group."""
    found = 0
    for kind, value in nodes:
        if kind is codes.POSSESSIVE_REPEAT and len(value[2]) > 1:
            found += 1
        inner: list[Any] = []
        if kind in (codes.MAX_REPEAT, codes.MIN_REPEAT, codes.POSSESSIVE_REPEAT):
            inner = [value[2]]
        elif kind is codes.SUBPATTERN:
            inner = [value[3]]
        elif kind is codes.BRANCH:
            inner = value[1]
        elif kind is codes.ATOMIC_GROUP:
            inner = [value]
        elif kind in (codes.ASSERT, codes.ASSERT_NOT):
            inner = [value[1]]
        found += sum(loose_repeats(list(body)) for body in inner)
    return found


@pytest.mark.parametrize("module", [*MODULES, "daq.protocols.columns", "daq.protocols.qsb"])
def test_a_possessive_repeat_repeats_one_part(module):
    """Python 3.11.0 to 3.11.4 match ``(?:ab)?+`` to "a" (gh-106052), not ``(?>ab)?+``: "1.5e" was a number."""
    patterns = [own for own in vars(importlib.import_module(module)).values() if isinstance(own, re.Pattern)]
    assert all(loose_repeats(list(parser.parse(own.pattern, own.flags & ~re.UNICODE))) == 0 for own in patterns)
    assert loose_repeats(list(parser.parse(r"(x(?:ab)?+)"))) == 1


def test_digits_before_an_unfinished_exponent_are_no_number():
    assert layout.read_number("1.5e", ".") is None
    assert layout.read_number("1.5e-", ".") is None


UNIT = re.compile(r"^(.*?)\s*(?:\(([^()]*)\)|\[([^\[\]]*)\]|(?:/|,|\bin\b)\s*(\S+))$")


@given(st.lists(st.sampled_from(["x", "m", " ", "/", ",", "(", ")", "[", "]", "in", "_"]), max_size=9).map("".join))
@example("F (N/m)")
@example("x / , cm")
def test_a_unit_is_split_off_a_name_as_its_expression_says(name):
    """`UNIT` says what a unit is; on a name with n blanks it takes n^2 steps, for which `split_unit` stands."""
    name = name.strip()
    found = UNIT.match(name)
    expected = (name, None)
    if found and found[1]:
        expected = (found[1], next(part for part in found.groups()[1:] if part is not None).strip())
    assert columns.split_unit(name) == expected


def test_a_header_of_blanks_is_read(tmp_path):
    path = tmp_path / "blanks.csv"
    path.write_text("t [s],x" + " " * 20_000 + "(mm)\n" + "".join(f"{i / 100},{i % 7}\n" for i in range(50)))
    found = table_to_run.read(path, ImportOptions())
    assert found.columns["position"].endswith("in mm")
    assert len(found.columns["position"]) < 100  # 20,000 blanks were printed


def test_a_line_longer_than_a_table_has_is_refused_unread(tmp_path, monkeypatch):
    """A line of 4 MB was split by every delimiter and each of its cells tried as a number: 11 s."""
    path = tmp_path / "long.csv"
    path.write_text("t,x\n0,1\n" + "1," * table.LONGEST_LINE + "\n0.1,2\n")
    monkeypatch.setattr(layout, "split_cells", lambda *_: pytest.fail("a line was split"))
    with pytest.raises(InputError) as refused:
        table_to_run.read(path, ImportOptions())
    assert (refused.value.where, refused.value.do) == (
        f"{path}, line 3",
        "delete that line; if the table begins below it, give --preamble 3",
    )
    assert f"holds {2 * table.LONGEST_LINE} characters" in refused.value.what


def test_a_long_line_above_or_beside_the_table_does_not_matter(tmp_path):
    path = tmp_path / "long.csv"
    lines = "".join(f"{i / 100},{i % 7}\n" for i in range(50))
    path.write_text("1," * table.LONGEST_LINE + "\n#" + "1," * table.LONGEST_LINE + "\nt,x\n" + lines)
    assert table_to_run.read(path, ImportOptions(preamble=1)).run.time.size == 50
