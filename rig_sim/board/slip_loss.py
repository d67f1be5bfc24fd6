"""Slip loss: the encoder's cog slips on the beam at random times, and its counters miss some of the motion for good.

The encoder then reads x minus what was lost.  Losses begin at random, ``rate`` per second of device time; each is
``counts`` x4 counts, spread over ``samples`` sampling periods from the first sample after its beginning, along a cubic
3 s^2 - 2 s^3 (no jump of the speed, and the encoder interpolates by cubics).  Its sign is opposite to the motion of
that first sample: part of a movement is lost.  A mass at rest loses nothing.

Not modelled: a slip that the mass's acceleration brings about, a cog that jumps by whole teeth.
"""

import random

import numpy as np
from numpy.typing import NDArray

from rig_sim.motion.trajectory import Nodes
from rig_sim.scenes.sections import SlipLoss


class LosingCog:
    """The slipping cog, with the losses so far and those in progress; draws from its own random numbers."""

    def __init__(self, section: SlipLoss, seed: int, metres_per_count: float) -> None:
        self.section = section
        # Start (s) and size (m, signed: taken off the reading) of each loss in progress
        self.losses: list[tuple[float, float]] = []
        self.lost = 0.0  # sum of those completed, m
        self._size = section.counts * metres_per_count
        self._draw = random.Random(f"{seed}/slip_loss")
        self._next = self._draw_wait()

    def apply_losses(self, nodes: Nodes, samples: NDArray[np.int64], period: float) -> Nodes:
        """Return the motion since the last call as the encoder sees it, ``samples`` taken one ``period`` (s) apart."""
        for sample in samples:
            t, v = float(nodes.t[sample]), float(nodes.v[sample])
            if self._next <= t:  # at most one loss a sample: the cog slips or it grips
                self._next = t + self._draw_wait()
                if v != 0.0:
                    self.losses.append((t, self._size if v > 0.0 else -self._size))
        duration = self.section.samples * period
        shift, rate = np.full_like(nodes.x, self.lost), np.zeros_like(nodes.v)
        for start, size in self.losses:
            s = np.clip((nodes.t - start) / duration, 0.0, 1.0)
            shift += size * s * s * (3.0 - 2.0 * s)
            rate += size * 6.0 * s * (1.0 - s) / duration
        end = float(nodes.t[-1])
        self.lost += sum(size for start, size in self.losses if start + duration < end)
        self.losses = [loss for loss in self.losses if loss[0] + duration >= end]
        return Nodes(nodes.t, nodes.x - shift, nodes.v - rate)

    def _draw_wait(self) -> float:
        return self._draw.expovariate(self.section.rate)
