"""Chapter 3: quadrature and counter signals, and a run of the rig through the whole pipe, by the other commands.

The simulated rig is recorded by ``daq``, its velocity estimated by ``process`` (finite differences, Savitzky-Golay) and
read from the exported tables.  The thesis's own records are lost: the scene `rig` has its range of positions, its
belt velocity and its encoder.
"""

import subprocess
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from daq.wire.quadrature import Decoder, levels_of
from rig_sim.atlas.figure import Computed, Panel, Trace
from rig_sim.atlas.statements import read_entries
from rig_sim.motion.play import ScenePlayer
from rig_sim.scenes.scene import scene
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.interpreter import start_python
from stickslip.errors import StickslipError

SCENE, DECODER = "rig", "jk"
SECONDS, RATE = 20.0, 1000
BELT_CM_S = 22.0
COLUMNS = ("time_s", "position_m", "velocity_m_per_s", "phase")
T, X, V = "time (s)", "displacement (cm)", "velocity (cm/s)"
NAMES = {"fd": "finite differences", "sg": "Savitzky-Golay"}  # of the methods


@dataclass(frozen=True)
class EstimatedRun:
    """A run as estimated by a method: time (s), position (cm), velocity (cm/s), stick or not; (n,) each."""

    t: Array
    x: Array
    v: Array
    stick: NDArray[np.bool_]


@cache
def record_runs() -> dict[str, EstimatedRun]:
    """Record the rig, and return the run by finite differences ('fd') and by Savitzky-Golay ('sg')."""
    series = {}
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        port = f"rig://{SCENE}?set=encoder.decoder%3D{DECODER}"
        run_command(folder, "daq.cli.app", "record", "--port", port, "--protocol", "frames", "--decoder", DECODER,
                    "--rate", str(RATE), "--duration", str(SECONDS), "-o", "run.h5")  # fmt: skip
        for method in ("fd", "sg"):
            run_command(folder, "processing.cli", "smooth", "run.h5", "--method", method)
            run_command(folder, "processing.cli", "export", "run.h5", "--csv", f"{method}.csv")
            series[method] = read_table(folder / f"{method}.csv")
    return series


def run_command(folder: Path, module: str, *arguments: str) -> None:
    """Run a command in a folder; raises StickslipError with the command's own message, where it fails."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with start_python(module, *arguments, cwd=folder, text=True, **quiet) as process:
        message = process.communicate()[1].strip()
    if process.returncode != 0:
        command = f"{module.partition('.')[0]} {arguments[0]}"
        raise StickslipError(message or f"exit code {process.returncode}", command, "run 'daq doctor'")


def read_table(table: Path) -> EstimatedRun:
    with table.open() as file:
        names = file.readline().strip().split(",")
        rows = [line.rstrip("\n").split(",") for line in file]
    t, x, v, phase = ([row[names.index(name)] for row in rows] for name in COLUMNS)
    metres = (np.array(values, dtype=np.float64) for values in (t, x, v))
    time, position, velocity = metres
    return EstimatedRun(time, 100.0 * position, 100.0 * velocity, np.array([name == "stick" for name in phase]))


@cache
def play_exact(until: float) -> tuple[Array, ...]:
    """Return t (s), x (cm), v (cm/s) of the recorded motion."""
    t, x, v, _ = ScenePlayer(scene(SCENE)).columns(np.arange(0.0, until, 0.002))
    return t, 100.0 * x, 100.0 * v


def draw_displacement() -> Computed:
    run = record_runs()["fd"]
    slips = run.x[find_sticks(run)[1]].tolist()
    numbers = {
        "least": run.x.min(),
        "least_slip": min(slips),
        "largest_slip": max(slips),
        "differ": max(slips) - min(slips) > 0.1,
    }
    return Computed((Panel(T, X, (Trace(run.t, run.x),)),), numbers)


def find_sticks(run: EstimatedRun) -> tuple[Integers, Integers]:
    starts = np.flatnonzero(run.stick[1:] & ~run.stick[:-1]) + 1
    ends = np.flatnonzero(~run.stick[1:] & run.stick[:-1])
    return starts, ends[ends > starts[0]]


def measure_sticks(run: EstimatedRun) -> Array:
    """Return the durations of the full sticks, s."""
    starts, ends = find_sticks(run)
    count = min(len(starts), len(ends))
    times: Array = run.t[ends[:count]] - run.t[starts[:count]]
    return times


def measure_fluctuation(run: EstimatedRun) -> float:
    """Return the rms deviation (cm/s) of the velocity from the belt's in the middle of sticks."""
    inside = run.stick.copy()
    for shift in range(1, RATE // 20):  # 50 ms from either end
        inside[shift:] &= run.stick[:-shift]
        inside[:-shift] &= run.stick[shift:]
    return float(np.sqrt(np.mean((run.v[inside] - BELT_CM_S) ** 2)))


def draw_velocity(method: str, until: float, with_exact: bool = False) -> Computed:
    """Return the velocity in time as estimated by a method, over that of the exact motion or not."""
    run, (t, _, v), fluctuations = (
        record_runs()[method],
        play_exact(8.0),
        {name: measure_fluctuation(run) for name, run in record_runs().items()},
    )
    drawn = run.t < until
    traces = [Trace(run.t[drawn], run.v[drawn], NAMES[method], "thin")]
    if with_exact:
        traces.append(Trace(t, v, "exact motion", "dashed", 1))
    smooth = record_runs()["sg"]
    lowest, true = float(smooth.v[smooth.t < 8.0].min()), float(v.min())
    full, half = measure_differences(1), measure_differences(2)
    numbers = {
        "v_min": smooth.v.min(),
        "v_stick": np.median(smooth.v[smooth.stick]),
        "t_stick": measure_sticks(smooth).mean(),
        "by_differences": fluctuations["fd"],
        "smoothed": fluctuations["sg"],
        "by_the_algorithm": fluctuations["fd"] > 5.0 * fluctuations["sg"],
        "every": full,
        "every_other": half,
        "reduced": full < half,
        "line": 100.0 * line_spacing() * RATE,
        "lowest": lowest,
        "true_lowest": true,
        "preserved": abs(lowest - true) < 0.02 * abs(true),
        "times_less": fluctuations["fd"] / fluctuations["sg"],
        "removed": fluctuations["fd"] > 3.0 * fluctuations["sg"],
    }
    return Computed((Panel(T, V, tuple(traces)),), numbers)


def measure_differences(every: int) -> float:
    """Return the rms (cm/s) about the belt's velocity, in stick, of differences between every so many samples."""
    run = record_runs()["fd"]
    x, t, stick = run.x[::every], run.t[::every], run.stick[::every]
    v = np.diff(x) / np.diff(t)
    inside = stick[1:] & stick[:-1]
    return float(np.sqrt(np.mean((v[inside] - np.mean(v[inside])) ** 2)))


def line_spacing() -> float:
    """Return the displacement of the mass for one line of the encoder, m."""
    encoder = scene(SCENE).encoder
    if encoder is None:
        raise ValueError(f"the scene {SCENE} has no encoder")
    return encoder.circumference / encoder.lines_per_rev


def draw_portrait(method: str) -> Computed:
    run = record_runs()[method]
    later = run.t > 1.0
    smooth = record_runs()["sg"]
    landings, slips = (smooth.x[places] for places in find_sticks(smooth))
    numbers = {
        "landing": np.mean(landings),
        "slip": np.mean(slips),
        "v_stick": np.median(run.v[run.stick]),
        "fluctuation": measure_fluctuation(run),
        "flat": measure_fluctuation(run) < 0.05 * BELT_CM_S,
    }
    return Computed((Panel(X, V, (Trace(run.x[later], run.v[later], NAMES[method], "thin"),)),), numbers)


def draw_signals() -> Computed:
    t = np.linspace(0.0, 1.0, 4001)
    edges = np.where(t < 0.5, 35.0 * t, 35.0 * (1.0 - t))  # x4 counts: up, then down
    levels = levels_of(np.floor(edges))
    high_a, high_b = (levels & 1).astype(np.float64), (levels >> 1).astype(np.float64)
    decoder = Decoder("jk")
    steps = decoder.feed(levels)
    up, down = np.zeros(len(t)), np.zeros(len(t))
    up[steps.index[steps.step > 0]] = 1.0
    down[steps.index[steps.step < 0]] = 1.0
    rises = np.flatnonzero(np.diff(high_a) > 0.0) + 1
    forwards, backwards = high_b[rises[t[rises] < 0.5]], high_b[rises[t[rises] > 0.5]]
    levels_drawn = (Trace(t, high_a + 1.5, "A", "line", 0), Trace(t, high_b, "B", "line", 1))
    counts = (
        Trace(t, np.cumsum(up), "up counter", "line", 2),
        Trace(t, np.cumsum(down), "down counter", "line", 3),
        Trace(t, np.cumsum(up - down), "displacement", "dashed", -1),
    )
    numbers = {
        "b_forwards": forwards.mean(),
        "b_back": backwards.mean(),
        "out_of_phase": not forwards.any() and bool(backwards.all()),
        "up": decoder.up,
        "down": decoder.down,
        "back_at_0": decoder.net == 0,
    }
    panels = (Panel("time (1)", "level, A raised (1)", levels_drawn), Panel("time (1)", "count (lines)", counts))
    return Computed(panels, numbers)


FIGURES = read_entries(
    "chapter3.toml",
    {
        "3.8": draw_signals,
        "3.15": draw_displacement,
        "3.16": partial(draw_velocity, "fd", SECONDS),
        "3.17": partial(draw_portrait, "fd"),
        "3.19": partial(draw_velocity, "fd", 8.0),
        "3.20": partial(draw_velocity, "sg", 8.0, with_exact=True),
        "3.21": partial(draw_portrait, "fd"),
        "3.22": partial(draw_portrait, "sg"),
    },
)
