"""Departures one by one: the response of the positions to each, and the table that they are rows of."""

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fitting.judge import library
from fitting.model.forces import spaced

ROOT = Path(library.__file__).parents[2]


@pytest.mark.parametrize("departure", library.DEPARTURES, ids=lambda departure: departure.name)
def test_a_departure_says_what_it_is(departure):
    assert departure.columns in (1, 2)
    assert departure.parameter
    assert (departure.scales is None) == (not departure.scale)
    assert f"- ``{departure.name}``: " in library.__doc__


def test_no_departure_is_named_outside_the_library():
    others = [path for path in Path(library.__file__).parent.glob("*.py") if path.name != "library.py"]
    for path in others:
        named = {node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)}
        assert not named & {departure.name for departure in library.DEPARTURES}, path


def test_wavelengths_are_a_quarter_of_the_resolution_apart():
    found = spaced(0.05, 0.3, 0.25)
    np.testing.assert_allclose(np.diff(1 / found), 1.0)
    assert found.max() <= 0.3
    assert found.min() > 0.05
    assert spaced(0.3, 0.05, 0.25).size == 0


def test_help_imports_no_departure():
    code = "import sys, fitting.cli; sys.exit(any(name.startswith('fitting.departures') for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
