"""The study of identification writes its rows into the tables of the pages."""

import sys

import pytest

from . import examples

BENCHMARKS = str(examples.ROOT / "benchmarks")


@pytest.fixture(scope="module")
def identify():
    sys.path.insert(0, BENCHMARKS)
    try:
        import identify
    finally:
        sys.path.remove(BENCHMARKS)
    return identify


ROWS = [
    {"scene": "nominal", "law": 3, "set": [3]},
    {"scene": "nominal", "law": 5, "set": [5, 6]},
    {"scene": "nominal", "law": 5, "set": [6]},
]


def test_a_scene_is_counted_by_its_laws(identify):
    found = identify.page_rows(ROWS)
    assert found["identification.md"]["nominal, all laws"] == ["2/3", "2/3", "1/3", "1/2"]
    assert found["identification.md"]["nominal, law 3"] == ["1/1", "1/1", "1/1", "1/1"]
    assert found["identification.md"]["nominal, law 5"] == ["1/2", "1/2", "0/2", "0/1"]
    assert found["explanation/how-sure.md"] == {identify.SAID["nominal"]: ["2 of 3", "1 of 2"]}


@pytest.mark.parametrize("page", ["identification.md", "explanation/how-sure.md"])
def test_its_rows_replace_their_own_and_no_others(identify, page):
    text = (examples.ROOT / "docs" / page).read_text()
    assert identify.pages.with_rows(text, "identify", {}) == text
    cells = identify.page_rows(ROWS)[page]
    name = next(iter(cells))
    assert f"\n| {name} | " in text
    written = identify.pages.with_rows(text, "identify", {name: cells[name]})
    changed = [line for line in written.splitlines() if line not in text.splitlines()]
    assert changed == [f"| {' | '.join([name, *cells[name]])} |"]
    assert len(written.splitlines()) == len(text.splitlines())
