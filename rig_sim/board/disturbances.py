"""What a board loses or misses: counts of a slipping cog, samples that are not sent, sampling instants off their grid.

Each draws from random numbers of its own.

Slip loss: the encoder's cog slips on the beam at random times, and its counters miss some of the motion for good.

The encoder then reads x minus what was lost.  Losses begin at random, ``rate`` per second of device time; each is
``counts`` x4 counts, spread over ``samples`` sampling periods from the first sample after its beginning, along a cubic
3 s^2 - 2 s^3 (no jump of the speed, and the encoder interpolates by cubics).  Its sign is opposite to the motion of
that first sample: part of a movement is lost.  A mass at rest loses nothing.

Not modelled: a slip that the mass's acceleration brings about, a cog that jumps by whole teeth.

Gaps: samples that the board takes but never sends; their sequence numbers are missing on the wire.

A gap begins at random, ``rate`` times per second of device time that is no gap, and lasts ``duration`` seconds.  The
counters go on counting meanwhile, so the position after the gap is right as long as a 16-bit counter has advanced by
less than half its range.

Not modelled: samples that the line damages (a CRC error), a board that restarts.

Jitter: sampling instants that miss their grid; the board records the true instant, to its tick.
"""

import random
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from rig_sim.motion.trajectory import Nodes
from rig_sim.scenes.sections import Gaps, Jitter, SlipLoss

LARGEST = 0.45  # share of a sampling period, either way: from 0.5 on, samples could change their order
SELDOM = 3  # standard deviations: where the limit is farther out, at most 0.3 % of the draws are clipped


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


class SilentStretches:
    """Decides for each sampling instant, in order, whether its sample is sent; draws from its own random numbers."""

    def __init__(self, section: Gaps, seed: int) -> None:
        self.section = section
        self._draw = random.Random(f"{seed}/gaps")
        self._begin = self._draw.expovariate(section.rate)

    def mark_sent(self, instants: Iterable[float]) -> list[bool]:
        """Return for increasing times (s) whether each lies outside all gaps."""
        outside = []
        for t in instants:
            while t >= self._begin + self.section.duration:
                self._begin += self.section.duration + self._draw.expovariate(self.section.rate)
            outside.append(t < self._begin)
        return outside


class JitteringClock:
    """Draws the offset of each sampling instant from its grid; draws from its own random numbers."""

    def __init__(self, section: Jitter, seed: int) -> None:
        self._rms = section.rms
        self._draw = random.Random(f"{seed}/jitter")

    def draw_offsets(self, count: int, period: float, *, first: bool) -> NDArray[np.float64]:
        """Return ``count`` offsets (s), normal and clipped; the ``first`` is 0, as it starts the clock."""
        noise = np.array([self._draw.gauss(0.0, self._rms) for _ in range(count)])
        if first:
            noise[0] = 0.0
        limit = self.limit(period)
        offsets: NDArray[np.float64] = np.clip(noise, -limit, limit)
        return offsets

    def limit(self, period: float) -> float:
        """Return the offset (s) at which offsets are clipped."""
        return LARGEST * period

    def is_clipped(self, period: float) -> bool:
        """Return whether more than 0.3 % of the offsets are clipped."""
        return SELDOM * self._rms > self.limit(period)
