"""The page of the numbers that decide, made from the source."""

import importlib.util
import re

from . import examples


def test_the_page_has_every_number_with_its_comment_and_none_is_in_seconds_hertz_or_metres():
    """A hole in a record was long from 30 ms on, whatever the contact."""
    spec = importlib.util.spec_from_file_location("constants_page", examples.ROOT / "docs" / "constants_page.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    rows, page = script.all_constants(), script.page()
    assert [row.name for row in rows if f"| `{row.name}` | `" not in page] == []
    units = re.compile(r"(s|ms|Hz|m|mm|um|m/s|rad/s)\b[:;,.]")
    found = [(row.module, row.name) for row in rows if units.match(row.comment)]
    assert found == [("fitting/model/path.py", "FARTHEST")]  # where a search that diverges is stopped
