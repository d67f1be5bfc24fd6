"""A truth of our own for the tests of this folder: the bench's motion from closed forms and a fine ODE solution."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from daq.base.measured import Measured
from daq.runfile.recording import Recording, Truth
from daq.runfile.rig import Rig

Array = NDArray[np.float64]

OMEGA2, FS_K, GAMMA, BELT = 35.184, 0.13068, 9.618, 0.22  # s^-2, m, s/m, m/s
G_SLIP, MASS, RAMP = 0.6, 0.3, 0.03  # N s/m, kg, m/s
COUNT = 7.67e-6  # m


@dataclass(frozen=True, eq=False)
class Motion:
    """Exact x, v at the sample times and the sticks as (start, end), s."""

    time: Array
    x: Array
    v: Array
    sticks: tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class PulledRecord:
    """A force record, and its slips as (start, end), s."""

    recording: Recording
    slips: tuple[tuple[float, float], ...]


def curve(law: int, s: float) -> float:
    """Friction over mass, as a share of Fs/m, at slip speed s >= 0."""
    if law in (1, 2):
        return 1.0
    if law in (3, 4):
        return 1.0 - G_SLIP / MASS * s / (OMEGA2 * FS_K)
    return 1.0 / (1.0 + GAMMA * s)


def jump_motion(time: Array, law: int, scatter: float, seed: int, start: float, belt: float) -> Motion:
    """Laws 1, 3, 5: stick in closed form, slip by DOP853; rest until the belt starts."""
    rng = np.random.default_rng(seed)
    x, v = np.zeros_like(time), np.zeros_like(time)
    level = OMEGA2 * FS_K
    factor = 1 + scatter * rng.standard_normal()
    t, state, sticks = start, np.zeros(2), []
    dragging = start > 0

    def land(s: float, y: Array) -> float:
        return float(y[1] - belt) if s > 0.02 else -1.0

    land.terminal, land.direction = True, 1.0  # type: ignore[attr-defined]
    while t < time[-1] and len(sticks) < 1000:
        if not dragging:
            end = t + max(factor * FS_K - state[0], 0.0) / belt
            own = slice(*np.searchsorted(time, (t, end)))
            x[own], v[own] = state[0] + belt * (time[own] - t), belt
            sticks.append((t, end))
            t, state = end, np.array([state[0] + belt * (end - t), belt])
        now = factor * level
        solved = solve_ivp(
            lambda _, y, now=now: [y[1], -OMEGA2 * y[0] + now * curve(law, max(belt - y[1], 0.0))],
            (0, 5 if law != 1 else time[-1] - t + 1),
            [state[0], state[1] - 1e-12],
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
            events=land,
            dense_output=True,
        )
        landing = t + (solved.t_events[0][0] if solved.t_events[0].size else solved.t[-1])
        own = slice(*np.searchsorted(time, (t, landing)))
        if own.stop > own.start:
            x[own], v[own] = solved.sol(time[own] - t)
        t, state, dragging = landing, solved.y[:, -1].copy(), False
        factor = 1 + scatter * rng.standard_normal()
    return Motion(time, x, v, tuple(sticks))


def ramp_motion(time: Array, law: int, start: float, belt: float) -> Motion:
    """Laws 2, 4, 6: one continuous force, by LSODA; sticks are where |w| <= the ramp's half width."""
    level = OMEGA2 * FS_K

    def rate(_: float, y: Array) -> list[float]:
        w = y[1] - belt
        force = -w / RAMP if abs(w) <= RAMP else -np.sign(w) * curve(law, abs(w) - RAMP)
        return [y[1], -OMEGA2 * y[0] + level * force]

    x, v = np.zeros_like(time), np.zeros_like(time)
    own = time > start
    solved = solve_ivp(rate, (start, time[-1]), [0, 0], "LSODA", t_eval=time[own], rtol=1e-8, atol=1e-10, max_step=0.02)
    x[own], v[own] = solved.y
    inside = np.concatenate(([0], (np.abs(v - belt) <= RAMP).astype(int), [0]))
    first, last = np.flatnonzero(np.diff(inside) == 1), np.flatnonzero(np.diff(inside) == -1) - 1
    return Motion(time, x, v, tuple((time[i], time[j]) for i, j in zip(first, last, strict=True)))


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
    speed = abs(belt)
    found = jump_motion(time, law, scatter, seed, start, speed) if law % 2 else ramp_motion(time, law, start, speed)
    sign = np.sign(belt)
    return Motion(time, sign * found.x, sign * found.v, found.sticks)


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
