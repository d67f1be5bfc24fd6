"""What tests of the simulator share."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from rig_sim.integrate import modes
from rig_sim.integrate.buffer import new_work
from rig_sim.integrate.contact_state import initial_mode
from rig_sim.integrate.flow import Flow
from rig_sim.integrate.phases import sample_phase


@pytest.fixture(scope="session")
def sampled() -> Callable[..., tuple[Any, Any, Any]]:
    """Return a function that samples a motion phase by phase."""
    return _sampled


def _sampled(flow: Flow, x: float, v: float, times: Sequence[float]) -> tuple[Any, Any, Any]:
    """Return x (m), v (m/s) and mode, (n,) each, at increasing times (s); the motion starts at the first of them."""
    n, i, t, w = len(times), 0, times[0], v - flow.v_belt
    out: list[list[float]] = [[0.0] * n for _ in range(3)]
    mode, work = initial_mode(flow, x, v, t), new_work()
    while i < n:
        kind, mode, x, w, t, i = sample_phase(flow, mode, x, w, t, list(times), i, n, times[-1], *out, work)
        assert kind < modes.FORCE_REVERSAL
    return tuple(np.array(column) for column in out)  # type: ignore[return-value]
