"""A truth for the tests of this folder: the motion of the tests' own rig, and records of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.runfile.run_data import Truth
from stickslip.units import Measured

from ..rig import Contact, follow

Array = NDArray[np.float64]

OMEGA2, FS_K, GAMMA, BELT = 35.184, 0.13068, 9.618, 0.22  # s^-2, m, s/m, m/s
G_SLIP, MASS, RAMP = 0.6, 0.3, 0.03  # N s/m, kg, m/s
COUNT = 7.67e-6  # m
BEYOND = 5.0  # s after the end of a record in which its last stick ends
GRAZE = 1e-5  # s: a touch of the belt that is no stick


@dataclass(frozen=True, eq=False)
class Motion:
    """Exact x, v at the sample times and the sticks as (start, end), s."""

    time: Array
    x: Array
    v: Array
    sticks: tuple[tuple[float, float], ...]

    @property
    def stuck(self) -> NDArray[np.bool_]:
        """True within sticks, (n,)."""
        return np.logical_or.reduce([(self.time > start) & (self.time < end) for start, end in self.sticks])

    def without(self, left_out: NDArray[np.bool_]) -> "Motion":
        """Return the motion without these samples."""
        return replace(self, time=self.time[~left_out], x=self.x[~left_out], v=self.v[~left_out])


@dataclass(frozen=True, eq=False)
class PulledRecord:
    """A force record, and its slips as (start, end), s."""

    recording: Recording
    slips: tuple[tuple[float, float], ...]


@lru_cache(maxsize=16)
def motion(
    law: int = 5,
    duration: float = 60.0,
    jitter: float = 30e-6,
    scatter: float = 0.03,
    seed: int = 1,
    start: float = 0.0,
    belt: float = BELT,
    rate: float = 1000.0,
) -> Motion:
    """Return the motion at jittered sample times; the mirror image for a belt that runs backwards."""
    rng = np.random.default_rng(seed + 100)
    time = np.arange(int(duration * rate)) / rate
    time = np.maximum(time + jitter * rng.standard_normal(time.size), 0.0)
    ramp = RAMP if law % 2 == 0 else 0.0
    contact = Contact(
        curve=("constant", "linear", "hyperbolic")[(law - 1) // 2],
        Fs=MASS * OMEGA2 * FS_K,
        gamma=GAMMA,
        G_slip=G_SLIP,
        ramp=ramp,
        m=MASS,
        k=MASS * OMEGA2,
        belt=abs(belt),
        belt_start=start,
        duration=duration,
        scatter=0.0 if ramp or law == 1 else scatter,
        farthest=np.inf,
        sticks_at_start=not (ramp or start),
        seed=seed,
    )
    order = np.argsort(time, kind="stable")
    chance = np.random.default_rng(seed)
    level = 1.0 if ramp else 1.0 + scatter * chance.standard_normal()
    found = follow(contact, np.r_[time[order], time[-1] + BEYOND], chance, level)
    x, v = np.empty((2, time.size))
    x[order], v[order] = np.sign(belt) * found.position[:-1], np.sign(belt) * found.velocity[:-1]
    begins, ends = found.landings, found.break_aways[1:]  # the first slip begins with the belt
    if contact.sticks_at_start:
        begins, ends = np.r_[start, found.landings], found.break_aways
    last = time[-1] if ramp else np.inf
    sticks = [(a, min(b, last)) for a, b in zip(begins, ends, strict=False) if a < time[-1] and b - a > GRAZE]
    return Motion(time, x, v, tuple(sticks))


def _recording(name: str, time: Array, position: Array, rate: float, rig: Rig, **more: Any) -> Recording:
    start, end = "2026-01-01T00:00:00+00:00", "2026-01-01T00:01:00+00:00"
    return Recording("bench", start, end, rate, rig, time, position, source=Path(name), **more)


def recorded(true: Motion, pitch: float = COUNT, rate: float = 1000.0, rig: Rig | None = None) -> Recording:
    """Return what an encoder and a clock of 1 us make of the motion."""
    count = np.floor(true.x / pitch).astype(np.int64)
    time = np.round(true.time * 1e6) * 1e-6
    rig = rig or Rig(metres_per_count=Measured(pitch), datum=Measured(pitch / 2))
    return _recording("bench.h5", time - time[0], count * pitch + pitch / 2, rate, rig, count=count)


def imported(time: Array, position: Array, rate: float = 1000.0) -> Recording:
    """Return a track without counts, as a camera gives it."""
    return _recording("track.h5", np.asarray(time, float), np.asarray(position, float), rate, Rig())


def run_data(true: Motion, with_truth: bool = False) -> Recording:
    """Return the recorded motion on its way into a run file, with its truth when that is asked for."""
    run = recorded(true)
    truth = Truth(run.time, true.x, true.v, np.zeros_like(true.x)) if with_truth else None
    return replace(run, truth=truth)


def pulled(duration: float, speed: float = 0.0258, seed: int = 1, rate: float = 2000.0) -> PulledRecord:
    """Return the force of a slider that is pulled slowly: creep before break-away, slips of 25 ms, spikes.

    Sizes are those of the published records of paper on paper: force over weight, sticks of 0.7 to 2 s, 18 spikes a
    second, noise of one printed step.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration * rate)) / rate
    v, slips = np.full(time.size, speed), []
    at = rng.uniform(0.3, 1.0)
    while at < duration:
        fall, slip = rng.uniform(0.02, 0.06), rng.uniform(0.02, 0.03)
        creep = (time > at - 0.4) & (time <= at)
        v[creep] *= 1 - 0.5 * ((time[creep] - at + 0.4) / 0.4) ** 2
        own = (time > at) & (time <= at + slip)
        v[own] = speed - (fall / slip + speed) * (1 - np.cos(2 * np.pi * (time[own] - at) / slip))
        slips.append((at, at + slip))
        at += slip + rng.uniform(0.7, 2.0) * 0.0258 / speed
    x = np.cumsum(v) / rate + 7e-4 * rng.standard_normal(time.size)
    spikes = rng.random(time.size) < 18 / rate
    x[spikes] += rng.choice([-1.0, 1.0], spikes.sum()) * rng.uniform(5e-3, 3e-2, spikes.sum())
    record = _recording("pulled.h5", time, np.round(x / 6e-4) * 6e-4, rate, Rig())
    return PulledRecord(record, tuple(own for own in slips if own[1] < duration))


@pytest.fixture(scope="session", autouse=True)
def _compiled(smoothing_kernels: None) -> None:
    """Nothing here speaks of compiling on stderr."""


@pytest.fixture(name="motion")
def _motion() -> Callable[..., Motion]:
    return motion


@pytest.fixture(name="recorded")
def _recorded() -> Callable[..., Recording]:
    return recorded


@pytest.fixture(name="imported")
def _imported() -> Callable[..., Recording]:
    return imported


@pytest.fixture(name="pulled")
def _pulled() -> Callable[..., PulledRecord]:
    return pulled


@pytest.fixture(name="run_data")
def _run_data() -> Callable[..., Recording]:
    return run_data
