"""What tests of the simulator share."""

import json
import math
import os
from collections.abc import Callable

import mpmath
import pytest

from rig_sim.comparison import reference
from rig_sim.flow.flow import Flow

from .shared import REFERENCE_FOLDER

STORED_EVENTS = REFERENCE_FOLDER / "events.json"
STORED_DIGITS = 25


@pytest.fixture(scope="session")
def reference_events() -> Callable[..., list[reference.Event]]:
    """Return a function like `reference.events` that reads tests/reference/events.json instead of computing.

    A case that is not there fails; ``STICKSLIP_STORE_EVENTS=1 pytest tests/rig_sim`` computes and stores it.
    """
    stored = json.loads(STORED_EVENTS.read_text()) if STORED_EVENTS.exists() else {}

    def events(flow: Flow, x: float, v: float, t_max: float) -> list[reference.Event]:
        changes = {name: value for name, value in flow._asdict().items() if value != Flow._field_defaults[name]}
        key = json.dumps([changes, x, v, t_max])
        if key not in stored and "STICKSLIP_STORE_EVENTS" in os.environ:
            stored[key] = _computed_events(key)
            lines = (f"{json.dumps(case)}: {json.dumps(rows)}" for case, rows in sorted(stored.items()))
            STORED_EVENTS.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        with mpmath.workdps(2 * STORED_DIGITS):
            return [(mpmath.mpf(t), kind, mpmath.mpf(x)) for t, kind, x in stored[key]]

    return events


@pytest.fixture(scope="session")
def computed_events() -> Callable[..., list[list[str]]]:
    """Return the function that computes a stored case anew."""
    return _computed_events


def _computed_events(key: str, until: float = math.inf) -> list[list[str]]:
    """Return the events of a case of tests/reference/events.json up to a time, in the form they are stored in."""
    changes, x, v, t_max = json.loads(key)
    with mpmath.workdps(reference.DIGITS):
        found = reference.events(Flow(**changes), x, v, min(t_max, until))
        return [[mpmath.nstr(t, STORED_DIGITS), kind, mpmath.nstr(x, STORED_DIGITS)] for t, kind, x in found]
