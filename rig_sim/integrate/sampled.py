"""The motion at given times, interpreted or compiled: one flow, event after event."""

from collections.abc import Callable
from functools import cache

import numpy as np

from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import FORCE_REVERSAL
from rig_sim.integrate.events import new_samples
from rig_sim.integrate.phases import Samples, State, sample_phase
from rig_sim.integrate.work import Work, new_work, unboxed
from stickslip.compute.arrays import Array


def sampled(flow: Flow, at: State, times: Array, *, compiled: bool = False) -> tuple[Array, Array]:
    """Return x (m) and v (m/s), (n,) each, at increasing times (s) of a motion; fewer where it ends.

    Parameters
    ----------
    flow, at
        What moves, and from where; no time is before that of the state.
    times : (n,) float64
    compiled : bool
        Use numba: worth its start-up above some 10^4 events.
    """
    samples = new_samples(times if compiled else times.tolist(), compiled=compiled)
    if compiled:
        from rig_sim.integrate.compiled import for_kernels

        served = _compiled()(for_kernels(flow), at, samples, new_work(compiled=True))
    else:
        served = follow(flow, at, samples, new_work())
    return np.asarray(samples.x[:served]), np.asarray(samples.v[:served])


def follow(flow: Flow, at: State, wanted: Samples, work: Work) -> int:
    """Store the motion at the times wanted; return how many it comes to."""
    work = unboxed(work)
    i = 0
    while i < wanted.n:
        kind, at, i = sample_phase(flow, at, wanted.t[wanted.n - 1], wanted, i, work)
        if kind >= FORCE_REVERSAL:
            break
    return i


@cache
def _compiled() -> Callable[..., int]:
    """Return `follow` as machine code."""
    from rig_sim.integrate.compiled import compiled

    return compiled(follow)
