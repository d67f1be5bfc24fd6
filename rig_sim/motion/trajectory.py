"""Trajectory: the exact motion at chosen times, and what a cubic between them needs."""

from dataclasses import dataclass

from rig_sim.flow.flow import Flow
from stickslip.compute.arrays import Array, Integers


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
    """The motion over a stretch of time.

    Attributes
    ----------
    nodes : Nodes
        t, x, v at the stretch's start, at the times asked for, at every event between them and, where these lie far
        apart, at times in between.
    samples : (s,) int64
        Which nodes are the times asked for; fewer than asked for when the motion ended early.
    F : (s,) float64
        Friction force on the mass at these times, N; empty unless it was asked for.
    flows : tuple of (int, Flow)
        From which node on each flow held; the first from node 0.
    """

    nodes: Nodes
    samples: Integers
    F: Array
    flows: tuple[tuple[int, Flow], ...]
