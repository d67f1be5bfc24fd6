"""Noise levels of a motion that sticks and slips: roughness of each part, steps at corners.

Each level is brought to its greatest likelihood by a fixed point of its own, which the smoother's way back yields.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from daq.compute.arrays import Array
from daq.compute.compile import compiled
from processing.kalman import snap_kernel, white_jerk
from processing.kalman.snap_kernel import CUT, LABELS, LANDING, LEAVING, MET, ONSET, REST, RIDE, SLIP, STICK
from processing.record.motion import Motion
from processing.record.series import Series
from processing.segmentation.switching_times import KERNELS, Labels, Layout, Stretch, labels, looked_at, without


@dataclass(frozen=True, eq=False)
class Levels:
    """Density and mean of the snap and variance of a reading per label, and the variances of steps at corners.

    ``peak`` (m/s^2) is about the largest acceleration.
    """

    q: Array
    u: Array
    r: Array
    jump: Array
    peak: float


class Room:
    """Memory for what the filters write down, used again and again: fresh pages cost more than filtering."""

    def __init__(self) -> None:
        self._held = np.empty(0)

    def stored(self, n: int, columns: int) -> Array:
        """Return an array (n, columns); what it held before is gone."""
        if self._held.size < n * columns:
            self._held = np.empty(n * columns)
        return self._held[: n * columns].reshape(n, columns)


def first_levels(series: Series, noise: white_jerk.Noise, pilot: Motion, unit: float) -> Levels:
    """Guess the levels: as rough as the first motion near a landing, ever smoother away from it."""
    rate = (noise.jerk / (noise.reading * series.interval)) ** (1 / 6)
    rough = noise.jerk * rate**2
    q = np.full(LABELS, rough * math.exp(-6))
    q[LANDING : LANDING + 4] = rough * np.exp([0.0, -1.0, -3.0, -5.0])
    q[ONSET : ONSET + 4] = rough * math.exp(-5)
    q[MET] = rough
    q[LEAVING] = rough * math.exp(-5)
    q[STICK] = q[REST] = 0.0
    stride = max(series.time.size // 2**14, 1)
    peak = float(np.percentile(np.abs(pilot.acceleration[::stride]), 99))
    kick = 0.1 * float(np.percentile(np.abs(pilot.velocity[::stride]), 99))
    step = [0.01 * peak, peak / unit, peak, 8 * peak / unit, kick, peak, 8 * peak / unit, peak, 8 * peak / unit]
    q[CUT : CUT + 4] = q[LANDING : LANDING + 4]
    return Levels(q, np.zeros(LABELS), np.full(LABELS, noise.reading), np.array(step) ** 2, peak)


def filtered(series: Series, layout: Layout, levels: Levels, stretch: Stretch, room: Room) -> tuple[Labels, Array]:
    """Filter a stretch; return its labels and what was expected of each sample."""
    time, position = series.time[stretch.own], series.position[stretch.own]
    label = labels(series, layout, stretch)
    state = np.empty(snap_kernel.STATE)
    stored = room.stored(time.size, snap_kernel.STORED)
    still = stretch.first in (STICK, REST)
    compiled(snap_kernel.start, KERNELS)(time, position, float(levels.r[stretch.first]), still, state)
    compiled(snap_kernel.forward, KERNELS)(
        time,
        position,
        label,
        layout.at[stretch.corners],
        layout.kind[stretch.corners],
        levels.q,
        levels.u,
        levels.r,
        levels.jump,
        state,
        stored,
    )
    return label, stored


def learned(series: Series, room: Room, layout: Layout, levels: Levels, times: int, *, bare: bool = False) -> Levels:
    """Return noise levels under which the record is more likely; ``bare``: as if it had no corners."""
    back = compiled(snap_kernel.backward, KERNELS)
    stretches = looked_at(series, layout)
    if bare:
        layout = without(layout, np.ones(layout.at.size, bool))
        stretches = [Stretch(own.own, SLIP, slice(0, 0)) for own in stretches]
    least = 0.25 * white_jerk.least_variance(series)
    for _ in range(times):
        noise, steps = np.zeros((LABELS, 4)), np.zeros((snap_kernel.JUMPS, 2))
        for stretch in stretches:
            label, stored = filtered(series, layout, levels, stretch, room)
            at, kind = layout.at[stretch.corners], layout.kind[stretch.corners]
            back(series.time[stretch.own], label, at, kind, stored, False, np.empty((6, 0)), noise, steps)
        q = levels.q * _ratio(levels.q, noise[:, 0], noise[:, 1])
        q[CUT : CUT + 4] = q[LANDING : LANDING + 4]
        jump = levels.jump * _ratio(levels.jump, steps[:, 0], steps[:, 1])
        r = levels.r.copy()
        slipping = np.ones(LABELS, bool)
        slipping[[STICK, RIDE, MET, LEAVING, REST]] = False
        for group in (slipping, np.isin(np.arange(LABELS), (STICK,)), np.isin(np.arange(LABELS), (RIDE, MET, LEAVING))):
            if noise[group, 3].any():
                r[group] = max(r[group][0] * noise[group, 2].sum() / noise[group, 3].sum(), least)
        levels = replace(levels, q=q, r=r, jump=jump)
    return levels


def _ratio(level: Array, square: Array, expected: Array) -> Array:
    """Return what brings a level nearer to its greatest likelihood; half a degree of freedom says leave it."""
    ratio = (level * square + 0.5) / (level * expected + 0.5)
    return np.asarray(np.clip(ratio, 1e-4, 1e4))


def without_corners(levels: Levels) -> Levels:
    """Return levels with one roughness for a record without corners."""
    return replace(
        levels, q=np.full(LABELS, levels.q[LANDING + 1]), u=np.zeros(LABELS), r=np.full(LABELS, levels.r[SLIP])
    )


def merged(even: Levels, riding: Levels) -> Levels:
    """Return the levels of the even sticks with those of the ridden ones."""
    q, r, jump = even.q.copy(), even.r.copy(), even.jump.copy()
    for label in (RIDE, MET, LEAVING):
        q[label], r[label] = riding.q[label], riding.r[label]
    jump[2:4] = riding.jump[2:4]
    return replace(even, q=q, r=r, jump=jump)
