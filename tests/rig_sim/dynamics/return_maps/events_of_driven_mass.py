"""Break-aways, landings and strobes from the list of events, which tests of the integrator hold to mpmath."""

import math
import sys
from typing import Any

import numpy as np

from rig_sim.flow.flow import Flow
from rig_sim.integrate.events import list_events

from ...shared import sample_motion


def list_passages(
    flow: Flow, x: float, v: float, until: float, t: float = 0.0, landings: int = sys.maxsize
) -> tuple[Any, Any]:
    """Return (t, x) of each break-away and of so many landings."""
    found = list_events(flow, x, v, until, t=t, max_events=min(2 * landings, 1000), every_cycle=True)
    rows = np.column_stack([found.t, found.x])
    breaks = np.array([kind.startswith("S>") for kind in found.kinds])
    return rows[breaks], rows[~breaks][:landings]


def list_strobes(flow: Flow, x: float, v: float, until: float) -> Any:
    """Return x (m) and v (m/s) at phase 0 of each drive period."""
    period = 2.0 * math.pi / flow.omega
    return np.column_stack(sample_motion(flow, x, v, [n * period for n in range(math.floor(until / period) + 1)]))[1:]
