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
