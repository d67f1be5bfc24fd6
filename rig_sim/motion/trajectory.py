"""Trajectory: the exact motion at chosen times, and what a cubic between them needs."""

from dataclasses import dataclass

from rig_sim.flow.flow import Flow
from rig_sim.flow.memory import MemoryFlow
from stickslip.compute.arrays import Array, Integers


@dataclass(frozen=True)
class Nodes:
    """Exact motion at increasing times t (s): x (m) and v (m/s), all (n,).

    Where v jumps (a kick) the time appears twice, with the velocity before and after.
    """

    t: Array
    x: Array
    v: Array


@dataclass(frozen=True)
class Trajectory:
    """The motion over a stretch of time."""

    # At the stretch's start, at the requested times, at every event and, where these lie far apart, in between
    nodes: Nodes
    samples: Integers  # (s,) indices of the requested times; fewer where the motion ended early
    F: Array  # (s,) friction force on the mass at these times, N; empty unless requested
    flows: tuple[tuple[int, Flow | MemoryFlow], ...]  # each flow with its first node; the first from node 0
