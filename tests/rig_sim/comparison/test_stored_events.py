"""The events stored in tests/reference are what the multi-precision reference computes."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

STORED = json.loads((Path(__file__).parents[2] / "reference" / "events.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("key", STORED)
def test_stored_events_are_what_the_reference_computes(
    key: str, computed_events: Callable[[str], list[list[str]]]
) -> None:
    assert computed_events(key) == STORED[key]
