"""Departures one by one: the response of the positions to each, and what a table without one loses."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fitting.departures import library
from fitting.forces.departure import spaced

ROOT = Path(library.__file__).parents[3]


def test_every_file_of_the_library_has_a_row_and_every_row_a_file():
    files = {path.stem for path in Path(library.__file__).parent.glob("*.py")} - {"__init__"}
    assert files == set(library.ROWS)


@pytest.mark.parametrize("departure", library.departures(), ids=lambda departure: departure.name)
def test_a_departure_says_what_it_is(departure):
    assert departure.columns in (1, 2)
    assert departure.parameter
    assert (departure.scales is None) == (not departure.scale)
    module = sys.modules[departure.forcing.__module__]
    assert module.__doc__
    assert " in " in module.__doc__ or "relative" in module.__doc__ or "m2/m" in module.__doc__


def test_no_departure_is_named_outside_its_folder():
    folder = Path(library.__file__).parents[1]
    others = [path for path in folder.rglob("*.py") if path.parent.name != "library"]
    for path in others:
        named = {node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)}
        assert not named & {departure.name for departure in library.departures()}, path
        assert "fitting.departures.library." not in path.read_text()


@pytest.mark.parametrize("row", library.ROWS)
def test_without_its_file_and_its_row_the_others_are_still_there(row, monkeypatch):
    monkeypatch.setitem(sys.modules, f"{library.__name__}.{row}", None)  # as if the file were not there
    others = tuple(name for name in library.ROWS if name != row)
    library.departures.cache_clear()
    found = library.departures(others)
    library.departures.cache_clear()
    assert len(found) == len(library.ROWS) - 1


def test_wavelengths_are_a_quarter_of_the_resolution_apart():
    found = spaced(0.05, 0.3, 0.25)
    np.testing.assert_allclose(np.diff(1 / found), 1.0)
    assert found.max() <= 0.3
    assert found.min() > 0.05
    assert spaced(0.3, 0.05, 0.25).size == 0


def test_help_imports_no_departure():
    code = "import sys, fitting.cli; sys.exit(any(name.startswith('fitting.departures') for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
