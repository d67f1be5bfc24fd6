"""docs/architecture.md names files and functions that exist, and every folder keeps its rules."""

import ast
import graphlib
import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
PAGE = (ROOT / "docs" / "architecture.md").read_text()
PATHS = sorted(set(re.findall(r"`((?:stickslip|daq|processing|fitting|rig_sim|tests|docs)/[\w/.]+)`", PAGE)))
NAMED = re.findall(r"`((?:stickslip|daq|processing|fitting|rig_sim)/[\w/]+\.py)` `(\w+)`", PAGE)


def test_the_page_was_read():
    assert len(PATHS) > 30
    assert len(NAMED) > 10


@pytest.mark.parametrize("path", PATHS)
def test_every_path_that_the_page_names_exists(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize(("path", "name"), NAMED)
def test_every_function_that_the_page_names_is_defined_there(path, name):
    tree = ast.parse((ROOT / path).read_text())
    assert name in {getattr(statement, "name", None) for statement in tree.body}


def drawing():
    """Return docs/draw_architecture.py as a module."""
    spec = importlib.util.spec_from_file_location("draw_architecture", ROOT / "docs" / "draw_architecture.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def test_no_files_import_each_other_in_a_circle():
    # Imports for annotations alone were not looked at: a recording and its picture, a motion and its picture, were two.
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py") if path.name != "__init__.py"]
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in paths}
    assert len(modules) > 150
    imported_names = drawing().imported_names
    imports = {name: imported_names(path, for_types=True) & set(modules) for name, path in modules.items()}
    order = graphlib.TopologicalSorter(imports)
    order.prepare()  # raises CycleError, naming the files
