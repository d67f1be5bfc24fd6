"""docs/architecture.md names files and functions that exist, and every folder keeps its rules."""

import ast
import graphlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("daq", "processing", "fitting", "rig_sim")
PAGE = (ROOT / "docs" / "architecture.md").read_text()
PATHS = sorted(set(re.findall(r"`((?:daq|processing|fitting|rig_sim|tests|docs)/[\w/.]+)`", PAGE)))
NAMED = re.findall(r"`((?:daq|processing|fitting|rig_sim)/[\w/]+\.py)` `(\w+)`", PAGE)
FOLDERS = sorted({path.parent for package in PACKAGES for path in (ROOT / package).rglob("*.py")})


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


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_no_folder_holds_more_than_twelve_modules(folder):
    modules = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
    assert len(modules) <= 12


def imported_modules(path, known):
    """Return which of the known modules a file imports, at any depth, type checking left out."""
    tree = ast.parse(path.read_text())
    checks = [node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    names = set()
    for node in set(ast.walk(tree)) - {inner for check in checks for inner in ast.walk(check)}:
        if isinstance(node, ast.ImportFrom):
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names & known


def test_no_files_import_each_other_in_a_circle():
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py") if path.name != "__init__.py"]
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in paths}
    assert len(modules) > 150
    order = graphlib.TopologicalSorter({name: imported_modules(path, set(modules)) for name, path in modules.items()})
    order.prepare()  # raises CycleError, naming the files


def test_no_two_classes_share_a_name():
    # Three classes were called Motion once: a traceback that named one named no place.
    places: dict[str, list[str]] = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for statement in ast.parse(path.read_text()).body:
                if isinstance(statement, ast.ClassDef):
                    places.setdefault(statement.name, []).append(str(path.relative_to(ROOT)))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
