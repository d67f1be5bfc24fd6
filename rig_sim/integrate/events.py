"""List the events of a flow: the Python face of `rig_sim.integrate.hybrid.run`, interpreted or compiled."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rig_sim.integrate.hybrid import run
from rig_sim.integrate.modes import (
    KINDS,
    LIST_FULL,
    OUTCOMES,
    STEPS,
    Flow,
    initial_mode,
    new_work,
    validate,
)

ROOM = 1024  # events per call of the kernel


@dataclass(frozen=True)
class EventList:
    """Events of one run.

    Parameters
    ----------
    t, x : tuple of float
        Time (s) and position (m) of each event.
    kinds : tuple of str
        'N>S', 'S>N', 'N>P' ...: the mode left and the one entered (S: stick or ramp).
    outcome, advice : str
        'completed', or the reason why the run ended early and what to do.
    steps : int
        Closed-form phases and Taylor steps taken.
    """

    t: tuple[float, ...]
    x: tuple[float, ...]
    kinds: tuple[str, ...]
    outcome: str
    advice: str
    steps: int


def list_events(
    flow: Flow, x: float, v: float, t_max: float, *, t: float = 0.0, max_steps: int = 1_000_000, compiled: bool = False
) -> EventList:
    """Return the events between t and t_max (s) of a motion that starts at x (m) with velocity v (m/s).

    ``compiled`` uses numba: worth its start-up above some 10^4 events.

    Raises
    ------
    ValueError
        For a flow that is not physical, or a start or end that is not finite.
    """
    validate(flow)
    if not all(math.isfinite(number) for number in (x, v, t, t_max)):
        raise ValueError(f"x, v, t, t_max are {x}, {v}, {t}, {t_max}; need finite numbers")
    step: Callable[..., Any] = run
    if compiled:
        from rig_sim.integrate.compiled import compiled as compile_kernel

        step = compile_kernel("run")
    work = new_work(max_steps, compiled=compiled)
    buffers = new_lists(ROOM, 3, compiled=compiled)
    mode = initial_mode(flow, x, v, t)
    w = v - flow.v_belt
    found_t: list[float] = []
    found_x: list[float] = []
    kinds: list[str] = []
    outcome = LIST_FULL
    while outcome == LIST_FULL:
        outcome, count, mode, x, w, t = step(flow, mode, x, w, t, t_max, ROOM, *buffers, work)
        found_t.extend(float(value) for value in buffers[0][:count])
        found_x.extend(float(value) for value in buffers[1][:count])
        kinds.extend(KINDS[int(value)] for value in buffers[2][:count])
    name, advice = OUTCOMES[outcome]
    return EventList(tuple(found_t), tuple(found_x), tuple(kinds), name, advice, int(work[5][STEPS]))


def new_lists(length: int, number: int, *, compiled: bool) -> list[list[float]]:
    """Return ``number`` buffers of zeros: lists, or float64 arrays for compiled kernels."""
    if not compiled:
        return [[0.0] * length for _ in range(number)]
    import numpy

    return [numpy.zeros(length) for _ in range(number)]  # type: ignore[misc]
