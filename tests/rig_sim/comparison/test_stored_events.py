"""The events stored in tests/reference are what the multi-precision reference computes.

All of them take 70 s of CPU time.  They are compared in full where the reference, the stored events or mpmath are not
those of the last full comparison, whose digest is stored beside the events; else to the first event of each motion.
``STICKSLIP_STORE_EVENTS=1 pytest -m slow`` of this file stores the digest of a full comparison.
"""

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import mpmath
import pytest

from rig_sim.comparison import reference

from ..shared import REFERENCE_FOLDER

EVENTS, COMPARED = REFERENCE_FOLDER / "events.json", REFERENCE_FOLDER / "events.sha256"
STORED = json.loads(EVENTS.read_text())


def digest() -> str:
    """Return the digest of all that the comparison depends on."""
    parts = (Path(str(reference.__file__)).read_bytes(), EVENTS.read_bytes(), mpmath.__version__.encode())
    return hashlib.sha256(b"".join(parts)).hexdigest()


@pytest.fixture(scope="module")
def known(request: pytest.FixtureRequest) -> Iterator[bool]:
    """Give whether nothing has changed since the last full comparison."""
    known = COMPARED.exists() and COMPARED.read_text().strip() == digest()
    yield known
    if not known and "STICKSLIP_STORE_EVENTS" in os.environ and request.session.testsfailed == 0:
        COMPARED.write_text(digest() + "\n")


@pytest.mark.slow
@pytest.mark.parametrize("key", STORED)
def test_stored_events_are_what_the_reference_computes(
    key: str, known: bool, computed_events: Callable[..., list[list[str]]]
) -> None:
    until = float(STORED[key][0][0]) + 1e-6 if known and STORED[key] else math.inf
    stored = [event for event in STORED[key] if float(event[0]) <= until]
    assert computed_events(key, until) == stored
