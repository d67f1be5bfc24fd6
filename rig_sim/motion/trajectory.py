"""Trajectory: the exact motion at chosen times, and what a cubic between them needs."""

from dataclasses import dataclass

from daq.base.compute.arrays import Array, Integers
from rig_sim.flow.flow import Flow


@dataclass(frozen=True)
class Nodes:
    """Exact motion at increasing times t (s): x (m) and v (m/s), all (n,).

    Where v jumps (a kick) the time stands twice, with the velocity before and after.
    """

    t: Array
    x: Array
    v: Array


@dataclass(frozen=True)
class Trajectory:
    """The motion over a stretch of time."""

    # t, x, v at the stretch's start, at the times asked for, at every event between them and, where these lie far
    # apart, at times in between
    nodes: Nodes
    samples: Integers  # (s,) which nodes are the times asked for; fewer than asked for when the motion ended early
    F: Array  # (s,) friction force on the mass at these times, N; empty unless it was asked for
    flows: tuple[tuple[int, Flow], ...]  # from which node on each flow held; the first from node 0
