"""Benchmarks write tables of the pages: rows replace their own, and every marked table has a benchmark."""

import ast
import importlib
import re
import sys

import pytest

from . import examples

BENCHMARKS = examples.ROOT / "benchmarks"
DOCS = examples.ROOT / "docs"
PAGES = ("velocity.md", "accuracy.md", "identification.md")  # of which the benchmarks write the tables
PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
PAGE = """# Errors

<!-- begin: race methods; python benchmarks/race.py --write -->

| method | error | CPU |
|---|---|---|
| exact | 1e-14 | 1 |
| rk4 | 1e-3 | 22 |

<!-- end: race methods -->

| method | error | CPU |
|---|---|---|
| exact | by hand | |
"""


def benchmark(name):
    """Import a benchmark, or what benchmarks share."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize("path", sorted(BENCHMARKS.rglob("*.py")), ids=lambda path: path.name)
def test_what_a_benchmark_imports_of_the_packages_is_there(path):
    """Benchmarks are not type-checked: one imported a module by the name that it had before."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in PACKAGES:
            module = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names if not hasattr(module, alias.name)):
                importlib.import_module(f"{node.module}.{name}")


@pytest.fixture(scope="module")
def pages():
    return benchmark("pages")


def test_rows_replace_those_of_their_name_and_no_others(pages, tmp_path):
    (tmp_path / "page.md").write_text(PAGE)
    pages.write("page.md", "race methods", {"exact": ["2e-14", "1"], "heyoka": ["3e-12", "4.4"]}, docs=tmp_path)
    written = (tmp_path / "page.md").read_text()
    assert written == PAGE.replace("| exact | 1e-14 | 1 |", "| exact | 2e-14 | 1 |").replace(
        "| rk4 | 1e-3 | 22 |\n", "| rk4 | 1e-3 | 22 |\n| heyoka | 3e-12 | 4.4 |\n"
    )


@pytest.mark.parametrize("damage", ["begin: race methods", "end: race methods"])
def test_a_page_without_the_marker_is_refused_and_left_alone(pages, tmp_path, damage):
    (tmp_path / "page.md").write_text(PAGE.replace(damage, "other"))
    with pytest.raises(ValueError, match="race methods"):
        pages.write("page.md", "race methods", {"exact": ["2e-14", "1"]}, docs=tmp_path)
    assert (tmp_path / "page.md").read_text() == PAGE.replace(damage, "other")


def test_every_marked_table_names_a_benchmark_that_writes_it(pages):
    named = set()
    for path in sorted(DOCS.rglob("*.md")):
        text = path.read_text()
        for name, command in pages.marked(text):
            script = BENCHMARKS / f"{name.split()[0]}.py"
            assert script.is_file(), f"{path}: {name}"
            assert "pages.write(" in script.read_text(), script
            if command:
                assert re.fullmatch(rf"python benchmarks/{script.name}( .*)? --write", command), command
            assert pages.with_rows(text, name, {}) == text, f"{path}: {name}"
            named.add((path.relative_to(DOCS).as_posix(), name))
    assert {page for page, _ in named} >= set(PAGES)
