"""Belt channel: an encoder on the belt's roller, so that the board sends beside every sample how far the belt has run.

Its count is floor(belt travel / metres per count), up and down, with the pitch of the mass's encoder.  The travel is
that of the belt as it is, started, rippling, drooping:

    X(t) = integral of (v_belt + ripple sin(...) - droop F/Fs) dt

What droop takes is an impulse of friction, which the mass's own motion gives without a look at the curve:

    integral of F dt = m dv + c dx + k (integral of x dt - x0 dt) - integral of the drive dt

with x between two nodes the cubic through their x and v: exact in stick, where belt and mass move together, and far
below a count elsewhere.

Not modelled: slip of the belt on its roller, a belt that stretches, play, and what the joint does to the speed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from rig_sim.flow.flow import Flow
from rig_sim.flow.memory import MemoryFlow
from rig_sim.motion.trajectory import Trajectory
from rig_sim.scenes.model import Scene
from rig_sim.scenes.sections import Belt, Drive
from stickslip.compute.arrays import Array


class BeltEncoder:
    """The belt's encoder at work; its travel is carried from one stretch of motion to the next."""

    def __init__(self, scene: Scene) -> None:
        if scene.belt is None or scene.encoder is None:
            raise ValueError("a belt channel requires a belt and an encoder")
        self.delta = scene.encoder.metres_per_count  # metres of belt per count
        self.travel = 0.0  # of the belt since t = 0, m, signed
        self._belt: Belt = scene.belt
        self._drive = scene.drive
        self._origin = 0

    def restart(self) -> None:
        """Restart the counter at 0 from the belt's present position."""
        self._origin = math.floor(self.travel / self.delta)

    def read(self, path: Trajectory) -> NDArray[np.int64]:
        """Follow the belt through a stretch of motion and return its counts (s,) at the samples, never wrapped."""
        nodes = path.nodes
        steps = np.zeros(len(nodes.t))
        ends = [first for first, _ in path.flows[1:]] + [len(nodes.t) - 1]
        for (first, flow), last in zip(path.flows, ends, strict=True):
            piece = slice(first, last + 1)
            steps[first + 1 : last + 1] = self._travel_steps(flow, nodes.t[piece], nodes.x[piece], nodes.v[piece])
        travel = self.travel + np.cumsum(steps)
        self.travel = float(travel[-1])
        counts: NDArray[np.int64] = np.floor(travel[path.samples] / self.delta).astype(np.int64) - self._origin
        return counts

    def _travel_steps(self, flow: Flow | MemoryFlow, t: Array, x: Array, v: Array) -> Array:
        """Return the travel of the belt (m) from node to node under one flow."""
        h = np.diff(t)
        steps: Array = flow.v_belt * h
        if flow.v_belt != 0.0 and self._belt.ripple and self._belt.ripple_hz:
            omega = 2.0 * math.pi * self._belt.ripple_hz
            steps = steps - self._belt.ripple / omega * np.diff(np.cos(omega * (t - self._belt.start)))
        if flow.droop > 0.0:
            area = h * (x[1:] + x[:-1]) / 2.0 - h * h * np.diff(v) / 12.0
            impulse = flow.m * np.diff(v) + flow.c * np.diff(x) + flow.k * (area - flow.x0 * h)
            impulse[h == 0.0] = 0.0  # a kick is not friction
            if self._drive is not None:
                impulse -= integrate_drive(self._drive, t)
            steps = steps - flow.droop / (flow.factor * flow.Fs) * impulse
        return steps


def integrate_drive(drive: Drive, t: Array) -> Array:
    """Return the integral of u0 cos(omega t) from node to node, N s."""
    if drive.omega == 0.0:
        return drive.u0 * np.diff(t)
    half = drive.omega * np.diff(t) / 2.0
    middle = drive.omega * (t[1:] + t[:-1]) / 2.0
    impulse: Array = 2.0 * drive.u0 / drive.omega * np.cos(middle) * np.sin(half)
    return impulse
