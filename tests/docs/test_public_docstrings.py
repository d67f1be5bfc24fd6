"""The reference page has every public name, each described in full: what ruff does not ask of internal names."""

import importlib
import inspect
import re

import pytest

from . import examples

PAGE = (examples.ROOT / "docs" / "reference" / "api.md").read_text()
ENTRY = re.compile(r"\.\. auto(function|class):: ([\w.]+)(?:\(.*\))?((?:\n   :.*)*)")


def _resolve(path):
    parts = path.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            value = getattr(value, name)
        return value
    raise AssertionError(f"{path} is not importable")


def _described():
    """Yield the path of each documented function, class, method and property."""
    for _, path, options in ENTRY.findall(PAGE):
        yield path
        members = re.search(r":members:(.*)", options)
        named = [name.strip() for name in members[1].split(",") if name.strip()] if members else []
        yield from (f"{path}.{name}" for name in named)


def _own_docstring(value):
    return inspect.cleandoc(getattr(value, "__doc__", None) or "")


@pytest.mark.parametrize("path", sorted(set(_described())))
def test_a_public_name_has_a_docstring(path):
    value = _resolve(path)
    if not inspect.isroutine(value) and not inspect.isclass(value) and not isinstance(value, property):
        return  # a field, described by its class
    assert _own_docstring(value), f"{path} has no docstring"


@pytest.mark.parametrize("path", sorted({path for kind, path, _ in ENTRY.findall(PAGE) if kind == "function"}))
def test_a_public_function_says_its_parameters_and_its_result(path):
    function = _resolve(path)
    text, signature = _own_docstring(function), inspect.signature(function)
    if signature.parameters:
        assert "Parameters\n----------" in text
        section = text.split("Parameters\n----------")[1].split("\n\n")[0]
        described = {
            name.strip("* ")
            for line in re.findall(r"^(\S.*?) ?(?::|$)", section, re.MULTILINE)
            for name in line.split(",")
        }
        assert set(signature.parameters) - described == set()
    assert re.search(r"^(Returns|Yields)\n-+$", text, re.MULTILINE) or signature.return_annotation in (None, "None")


@pytest.mark.parametrize("package", ["daq", "processing", "fitting", "rig_sim"])
def test_every_public_name_has_an_entry_and_every_entry_of_a_package_is_public(package):
    public = set(importlib.import_module(package).__all__) - {"__version__"}
    named = set(re.findall(rf"auto(?:function|class|exception|data):: {package}\.(\w+)(?:\(\))?$", PAGE, re.MULTILINE))
    assert named - public == set()
    assert {name for name in public if not re.search(rf"auto\w+:: {package}\.(?:\w+\.)*{name}\b", PAGE)} == set()
