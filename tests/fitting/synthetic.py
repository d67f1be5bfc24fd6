"""A rig for the fit's tests, integrated on its own: classical RK4 between events, nothing shared with rig_sim.

Wear, joint kicks, scatter of each landing, damping, jitter, counts and an error of the datum can be switched on, so
that the fit is judged on motion that its own flow did not make.
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from daq.base.measured import Measured
from daq.imports import track
from daq.imports.options import ImportOptions
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig

STICK, SLIP, RAMP = 0, 1, 2


@dataclass(frozen=True)
class Scene:
    """The rig scene of the design in SI units, with what disturbs it."""

    law: int = 5
    m: float = 0.3
    K: float = 35.184  # k/m, 1/s^2
    Fs_over_k: float = 0.13068
    gamma: float = 9.618
    G_slip: float = 0.6
    d: float = 0.03
    belt: float = 0.22
    belt_start: float = 0.5
    static: float = 1.0
    scatter: float = 0.03
    wear: float = 0.0  # fraction of Fs lost over the run
    kick: float = 0.0  # m/s
    belt_length: float = 1.6
    damping: float = 0.0  # c/m, 1/s
    x: float = 0.0
    duration: float = 20.0
    rate: float = 1000.0
    jitter: float = 30e-6
    delta: float = 7.67e-6
    datum_error: float = 0.0
    seed: int = 1
    changes: dict = field(default_factory=dict)


def magnitude(scene, s):
    """Friction per unit mass over its level, at slip speed s beyond the ramp."""
    F = scene.K * scene.Fs_over_k
    if scene.law in (1, 2):
        return F
    if scene.law in (3, 4):
        return F - scene.G_slip / scene.m * s
    return F / (1 + scene.gamma * s)


def motion(scene, h=5e-4):
    """Integrate; return the step grid (t, x, v) and the events (t, x, kind)."""
    rng = np.random.default_rng(scene.seed)
    F, d = scene.K * scene.Fs_over_k, scene.d if scene.law in (2, 4, 6) else 0.0
    t, x, v, factor = 0.0, scene.x, 0.0, 1.0
    mode = STICK if not d else RAMP
    grid, events = [(t, x, v)], []
    turns = 0

    def level(time):
        return factor * (1 - scene.wear * time / scene.duration)

    def belt(time):
        return scene.belt if time >= scene.belt_start - 1e-12 else 0.0

    def force(time, w):
        s = abs(w)
        if mode == RAMP:
            return -level(time) * scene.static * F * w / d
        return math.copysign(level(time) * magnitude(scene, s - d), -side)

    def rates(time, x, v):
        return v, force(time, v - V) - scene.damping * v - scene.K * x

    def step(time, x, v, h):
        a1, b1 = rates(time, x, v)
        a2, b2 = rates(time + h / 2, x + h / 2 * a1, v + h / 2 * b1)
        a3, b3 = rates(time + h / 2, x + h / 2 * a2, v + h / 2 * b2)
        a4, b4 = rates(time + h, x + h * a3, v + h * b3)
        return x + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4), v + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)

    side = -1.0  # sign of w while slipping
    end = scene.duration + 0.01
    while t < end:
        V = belt(t)
        limit = end if t >= scene.belt_start or not scene.belt_start else scene.belt_start
        nudge = min(h, limit - t)
        if mode == STICK and V != v:  # the belt has just begun to move
            mode, side = SLIP, math.copysign(1.0, v - V)
        if mode == RAMP and abs(v - V) > d:
            mode, side = SLIP, math.copysign(1.0, v - V)
        if scene.kick and V and math.floor(V * (t + nudge) / scene.belt_length) > turns:
            turns += 1
            v += scene.kick * rng.choice((-1.0, 1.0))
            mode, side = (RAMP, side) if d and abs(v - V) < d else (SLIP, math.copysign(1.0, v - V))
        if mode == STICK:
            t2, x2 = t + nudge, x + V * nudge
            pull = scene.K * x2 + scene.damping * V
            if abs(pull) > level(t) * scene.static * F:
                events.append((t2, x2, "break"))
                mode, side = SLIP, -math.copysign(1.0, pull)
            t, x, v = t2, x2, V
        else:
            x2, v2 = step(t, x, v, nudge)
            w2 = v2 - V
            crossed = w2 * side <= d if mode == SLIP else abs(w2) > d
            if crossed:
                edge = side * d if mode == SLIP else math.copysign(d, w2)
                lo, hi = 0.0, nudge
                for _ in range(50):
                    mid = (lo + hi) / 2
                    wm = step(t, x, v, mid)[1] - V
                    past = (wm - edge) * side <= 0 if mode == SLIP else (wm - edge) * edge > 0
                    lo, hi = (lo, mid) if past else (mid, hi)
                x2, v2 = step(t, x, v, hi)
                nudge = hi
                if mode == SLIP:
                    factor = 1 + scene.scatter * rng.standard_normal()
                    events.append((t + hi, x2, "land"))
                    if d:
                        mode = RAMP
                    else:
                        v2 = V
                        pull = scene.K * x2 + scene.damping * V
                        if abs(pull) <= level(t) * scene.static * F:
                            mode = STICK
                        else:
                            side = -math.copysign(1.0, pull)
                            v2 += 1e-12 * side
                else:
                    events.append((t + hi, x2, "break"))
                    mode, side = SLIP, math.copysign(1.0, edge)
            t, x, v = t + nudge, x2, v2
        grid.append((t, x, v))
    return np.array(grid), events


def sampled(scene):
    """Sample and count the motion: recorded times (s), true x and v there, counted position (m)."""
    grid, events = motion(scene)
    keep = np.r_[True, np.diff(grid[:, 0]) > 0]
    t, x, v = grid[keep].T
    rng = np.random.default_rng(scene.seed + 10_000)
    n = int(scene.duration * scene.rate)
    when = np.arange(n) / scene.rate + scene.jitter * rng.standard_normal(n)
    when = np.maximum(when, 0.0)
    j = np.clip(np.searchsorted(t, when, side="right") - 1, 0, t.size - 2)
    h, u = t[j + 1] - t[j], when - t[j]
    r = u / h
    xs = (
        (1 + 2 * r) * (1 - r) ** 2 * x[j]
        + r * (1 - r) ** 2 * h * v[j]
        + r**2 * (3 - 2 * r) * x[j + 1]
        + r**2 * (r - 1) * h * v[j + 1]
    )
    recorded = np.round(when, 6) if scene.jitter else when
    counted = (np.floor(xs / scene.delta) + 0.5) * scene.delta if scene.delta else xs
    return recorded, xs, counted + scene.datum_error, events


def recording(scene=None, **changes):
    """Return a Recording of the scene as daq would load it, calibrated as the rig's own board calibrates it."""
    scene = replace(scene or Scene(), **changes)
    backwards = scene.belt < 0
    if backwards:
        scene = replace(scene, belt=-scene.belt)
    time, _, position, _ = sampled(scene)
    if backwards:
        position = -position
    rng = np.random.default_rng(scene.seed + 20_000)
    belt = scene.belt * (1 + 0.01 * rng.standard_normal()) * (-1 if backwards else 1)
    critical = 2 * scene.m * math.sqrt(scene.K)
    rig = Rig(
        name="synthetic",
        metres_per_count=Measured(scene.delta),
        mass=Measured(scene.m * (1 + 1e-3 * rng.standard_normal()), 1e-3 * scene.m),
        datum=Measured(0.0, 5e-4),
        damping=Measured(max(0.0, scene.damping * scene.m + 1e-3 * critical * rng.standard_normal()), 1e-3 * critical),
        belt_speed=Measured(belt, 0.01 * scene.belt),
    )
    time = time - time[0]
    return Recording(
        source=Path("synthetic.h5"),
        title=f"law {scene.law}",
        started="2026-01-01T00:00:00+00:00",
        ended="2026-01-01T00:00:20+00:00",
        time=time,
        position=position,
        rate_hz=scene.rate,
        rig=rig,
    )


def written(path, recording):
    """Write a recording as a run file and return its path."""
    data = Recording(
        title="synthetic",
        started=recording.started,
        ended=recording.ended,
        rate_hz=recording.rate_hz,
        rig=recording.rig,
        time=recording.time,
        position=recording.position,
    )
    store.write(path, data)
    return path


def nominal(law, seed, **changes):
    """Return a scene with the nominal disturbances drawn for this seed."""
    rng = np.random.default_rng(1000 * law + seed)
    critical = 2 * math.sqrt(Scene.K)
    return replace(
        Scene(law=law, seed=seed),
        scatter=rng.uniform(0.03, 0.10),
        wear=rng.uniform(0.03, 0.15),
        kick=rng.uniform(0.0, 0.02),
        jitter=rng.uniform(0, 100e-6),
        delta=float(rng.choice((7.67e-6, 50e-6))),
        damping=rng.uniform(0.001, 0.01) * critical,
        datum_error=5e-4 * rng.standard_normal(),
        **changes,
    )


def camera(law, noise, seed=1, duration=30.0, **changes):
    """Return times (s) and positions (m) of a camera track: 400 frames a second, ``noise`` (m) on each position."""
    scene = replace(
        Scene(law=law, seed=seed, duration=duration, rate=400.0, jitter=0.0, delta=0.0, G_slip=0.3), **changes
    )
    time, _, position, _ = sampled(scene)
    return time - time[0], position + np.random.default_rng([seed, 400]).normal(0, noise, time.size)


def imported(path, time, position, decimals=5, **options):
    """Write a table of times and positions, and return the recording that is imported from it, bare of calibration."""
    rows = np.c_[time, np.round(position, decimals)]
    np.savetxt(path, rows, fmt=["%.6f", f"%.{max(decimals, 1)}f"], delimiter=",", header="t,x", comments="")
    return track.read(path, ImportOptions(**options)).run
