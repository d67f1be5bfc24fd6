"""The motion at given times, interpreted or compiled: one flow, event after event."""

import numpy as np

from rig_sim.flow.flow import Flow
from rig_sim.flow.modes import FORCE_REVERSAL
from rig_sim.integrate.events import new_samples
from rig_sim.integrate.phases import Samples, State, sample_phase
from rig_sim.integrate.work import Work, new_work, unboxed
from stickslip.compute.arrays import Array


def sample_motion(flow: Flow, state: State, times: Array, *, compiled: bool = False) -> tuple[Array, Array]:
    """Return x (m) and v (m/s), (n,) each, at increasing times (s, none before the state); fewer where the motion ends.

    ``compiled`` uses numba: worth its start-up above about 10^4 events.
    """
    samples = new_samples(times if compiled else times.tolist(), compiled=compiled)
    if compiled:
        from rig_sim.integrate.compiled import compiled as compile_kernel
        from rig_sim.integrate.compiled import for_kernels

        reached = compile_kernel(store_motion)(for_kernels(flow), state, samples, new_work(compiled=True))
    else:
        reached = store_motion(flow, state, samples, new_work())
    return np.asarray(samples.x[:reached]), np.asarray(samples.v[:reached])


def store_motion(flow: Flow, state: State, samples: Samples, work: Work) -> int:
    """Store the motion at the times of ``samples``; return how many are reached."""
    work = unboxed(work)
    i = 0
    while i < samples.n:
        kind, state, i = sample_phase(flow, state, samples.t[samples.n - 1], samples, i, work)
        if kind >= FORCE_REVERSAL:
            break
    return i
