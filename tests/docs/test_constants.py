"""The page of the numbers that decide, made from the source."""

import importlib.util
import re
from types import ModuleType

import pytest

from . import examples


@pytest.fixture(scope="module")
def constants_page() -> ModuleType:
    spec = importlib.util.spec_from_file_location("constants_page", examples.ROOT / "docs" / "constants_page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_no_number_that_decides_is_in_seconds_hertz_or_metres(constants_page):
    """A hole in a record was long from 30 ms on, whatever the contact."""
    units = re.compile(r"(s|ms|Hz|m|mm|um|m/s|rad/s)\b[:;,.]")
    found = [(row.module, row.name) for row in constants_page.all_constants() if units.match(row.comment)]
    assert found == [("fitting/model/path.py", "FARTHEST")]  # where a search that diverges is stopped


def test_the_page_has_every_number_with_its_comment(constants_page):
    rows, page = constants_page.all_constants(), constants_page.page()
    assert rows
    for row in rows:
        assert f"| `{row.name}` | `" in page
    parts = [row for row in rows if row.module == "processing/defects/frames.py"]
    assert [row.comment for row in parts if row.name == "NEAR"] == [
        "of the usual step: how near a multiple a step must lie"
    ]
    clear = next(row.comment for row in parts if row.name == "CLEAR")
    assert clear.startswith("Standard deviations of a step that the usual step must have to be compared.  At 5 noise ")
    assert clear.endswith("At 10 steps must be twice as long as at 5.")
