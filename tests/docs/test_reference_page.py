"""The reference page of the Python functions."""

import importlib
import re

import pytest

from . import examples

PAGE = (examples.ROOT / "docs" / "reference" / "api.md").read_text()


@pytest.mark.parametrize("package", ["daq", "processing", "fitting", "rig_sim"])
def test_every_public_name_has_an_entry_and_every_entry_of_a_package_is_public(package):
    public = set(importlib.import_module(package).__all__) - {"__version__"}
    named = set(re.findall(rf"auto(?:function|class|exception|data):: {package}\.(\w+)(?:\(\))?$", PAGE, re.MULTILINE))
    assert named - public == set()
    assert {name for name in public if not re.search(rf"auto\w+:: {package}\.(?:\w+\.)*{name}\b", PAGE)} == set()
