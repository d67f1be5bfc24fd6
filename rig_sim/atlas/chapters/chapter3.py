"""Chapter 3: quadrature and counter signals, and a run of the rig through the whole pipe, by the other commands.

The simulated rig is recorded by ``daq``, its velocity estimated by ``process`` (finite differences, Savitzky-Golay) and
read from the exported tables.  The thesis's own records are lost: the scene `rig` has its range of positions, its
belt velocity and its encoder.
"""

import subprocess
import sys
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from daq.base.compute.arrays import Array
from daq.base.errors import StickslipError
from daq.wire.quadrature import Decoder, levels_of
from rig_sim.atlas.figure import Drawing, Entry, Panel, StatementCheck, Trace, compare, state
from rig_sim.motion.play import ScenePlayer
from rig_sim.scenes.scene import scene

SCENE, DECODER = "rig", "jk"
SECONDS, RATE = 20.0, 1000
BELT_CM_S = 22.0
COLUMNS = ("time_s", "position_m", "velocity_m_per_s", "phase")
T, X, V = "time (s)", "displacement (cm)", "velocity (cm/s)"
RECORD = (
    f"the sampling rate, {RATE} Hz, the mass, the spring and the friction: the scene {SCENE}, whose encoder has the "
    "thesis's 4096 lines, counted by its J-K circuit"
)
OWN_RECORD = "the thesis's own record; the scene is chosen to have its range of positions and its belt velocity"


@dataclass(frozen=True)
class EstimatedRun:
    """A run as a method estimates it: time (s), position (cm), velocity (cm/s), stick or not; (n,) each."""

    t: Array
    x: Array
    v: Array
    stick: NDArray[np.bool_]


@cache
def runs() -> dict[str, EstimatedRun]:
    """Record the rig, and return the run by finite differences ('fd') and by Savitzky-Golay ('sg')."""
    found = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        port = f"rig://{SCENE}?set=encoder.decoder%3D{DECODER}"
        call(folder, "daq.cli.app", "record", "--port", port, "--protocol", "frames", "--decoder", DECODER, "--rate",
             str(RATE), "--duration", str(SECONDS), "-o", "run.h5")  # fmt: skip
        for method in ("fd", "sg"):
            call(folder, "processing.cli", "smooth", "run.h5", "--method", method)
            call(folder, "processing.cli", "export", "run.h5", "--csv", f"{method}.csv")
            found[method] = read(folder / f"{method}.csv")
    return found


def call(folder: Path, module: str, *arguments: str) -> None:
    """Run a command in a folder.

    Raises
    ------
    StickslipError
        With the command's own message, where it fails.
    """
    done = subprocess.run([sys.executable, "-m", module, *arguments], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        command = f"{module.partition('.')[0]} {arguments[0]}"
        raise StickslipError(done.stderr.strip() or f"exit code {done.returncode}", command, "run 'daq doctor'")


def read(table: Path) -> EstimatedRun:
    """Read an exported table."""
    with table.open() as file:
        names = file.readline().strip().split(",")
        rows = [line.rstrip("\n").split(",") for line in file]
    t, x, v, phase = ([row[names.index(name)] for row in rows] for name in COLUMNS)
    metres = (np.array(values, dtype=np.float64) for values in (t, x, v))
    time, position, velocity = metres
    return EstimatedRun(time, 100.0 * position, 100.0 * velocity, np.array([name == "stick" for name in phase]))


@cache
def exact(until: float) -> tuple[Array, ...]:
    """Return t (s), x (cm), v (cm/s) of the motion that was recorded."""
    t, x, v, _ = ScenePlayer(scene(SCENE)).columns(np.arange(0.0, until, 0.002))
    return t, 100.0 * x, 100.0 * v


def displacement() -> Drawing:
    """Figure 3.15."""
    run = runs()["fd"]
    _, slips = turns(run)
    return Drawing(
        "Displacement of the mass in the encoder experiment: a saw tooth of long sticks and short slips, no two alike.",
        (Panel(T, X, (Trace(run.t, run.x),)),),
        (
            compare("smallest displacement (cm)", "-12", float(run.x.min()), OWN_RECORD),
            state(
                "the mass does not slip or stick at the same displacement each time",
                "yes",
                f"sticks end between {min(slips):.3g} and {max(slips):.3g} cm",
                max(slips) - min(slips) > 0.1,
            ),
        ),
        choices=RECORD,
    )


def turns(run: EstimatedRun) -> tuple[list[float], list[float]]:
    """Return the displacements (cm) at which sticks begin and end, each a full one."""
    begins = np.flatnonzero(run.stick[1:] & ~run.stick[:-1]) + 1
    ends = np.flatnonzero(~run.stick[1:] & run.stick[:-1])
    ends = ends[ends > begins[0]]
    return run.x[begins].tolist(), run.x[ends].tolist()


def stick_times(run: EstimatedRun) -> Array:
    """Return the durations of the full sticks, s."""
    begins = np.flatnonzero(run.stick[1:] & ~run.stick[:-1]) + 1
    ends = np.flatnonzero(~run.stick[1:] & run.stick[:-1])
    ends = ends[ends > begins[0]]
    count = min(len(begins), len(ends))
    times: Array = run.t[ends[:count]] - run.t[begins[:count]]
    return times


def fluctuation(run: EstimatedRun) -> float:
    """Return the rms deviation (cm/s) of the velocity from the belt's in the middle of sticks."""
    inside = run.stick.copy()
    for shift in range(1, RATE // 20):  # 50 ms from either end
        inside[shift:] &= run.stick[:-shift]
        inside[:-shift] &= run.stick[shift:]
    return float(np.sqrt(np.mean((run.v[inside] - BELT_CM_S) ** 2)))


def velocity(method: str, number: str) -> Drawing:
    """Figures 3.16, 3.19 and 3.20: velocity in time."""
    run = runs()[method]
    shown = run.t < 8.0 if number != "3.16" else run.t < SECONDS
    traces = [Trace(run.t[shown], run.v[shown], "finite differences" if method == "fd" else "Savitzky-Golay", "thin")]
    if number == "3.20":
        t, _, v = exact(8.0)
        traces.append(Trace(t, v, "exact motion", "dashed", 1))
    table = {"3.16": experiment_table, "3.19": noise_table, "3.20": preserved_table}[number]()
    sentences = {
        "3.16": "Velocity by finite differences: it steps by one line of the encoder per sample, which hides that the "
        "sticks' velocity is constant.",
        "3.19": "Velocity by finite differences, enlarged: in stick it fluctuates about the belt's 22 cm/s.",
        "3.20": "Velocity of the same record by a Savitzky-Golay filter, over the exact motion of the simulated rig.",
    }
    return Drawing(sentences[number], (Panel(T, V, tuple(traces)),), table, choices=RECORD)


def experiment_table() -> tuple[StatementCheck, ...]:
    """Return what the thesis reads off figure 3.16."""
    run = runs()["sg"]
    sticks = stick_times(run)
    return (
        compare("smallest velocity (cm/s), after smoothing", "-80", float(run.v.min()), OWN_RECORD, within=10.0),
        compare("velocity of sticks (cm/s), after smoothing", "22", float(np.median(run.v[run.stick])), within=1.0),
        compare("duration of a stick (s), mean", "1.5", float(sticks.mean()), OWN_RECORD),
        state(
            "the velocity in stick fluctuates although the displacement does not",
            "by the algorithm, not by vibration",
            f"{fluctuation(runs()['fd']):.3g} cm/s rms by finite differences, {fluctuation(run):.3g} after smoothing",
            fluctuation(runs()["fd"]) > 5.0 * fluctuation(run),
        ),
    )


def noise_table() -> tuple[StatementCheck, ...]:
    """Return what the thesis says of finite differences."""
    full, half = differenced(1), differenced(2)
    line = 100.0 * step_of_a_line() * RATE
    return (
        state(
            "a shorter step between samples reduces the errors (3.3)",
            "yes, at the cost of the file's size",
            f"fluctuation in stick {full:.3g} cm/s rms, {half:.3g} with every other sample",
            full < half,
            f"the error is that of whole encoder lines, {line:.3g} cm/s for one line per sample, not the truncation or "
            "the rounding of the text: it doubles with the rate",
        ),
    )


def differenced(every: int) -> float:
    """Return the rms (cm/s) about the belt's velocity, in stick, of differences between every so many samples."""
    run = runs()["fd"]
    x, t, stick = run.x[::every], run.t[::every], run.stick[::every]
    v = np.diff(x) / np.diff(t)
    inside = stick[1:] & stick[:-1]
    return float(np.sqrt(np.mean((v[inside] - np.mean(v[inside])) ** 2)))


def step_of_a_line() -> float:
    """Return how far the mass moves for one line of the encoder, m."""
    encoder = scene(SCENE).encoder
    if encoder is None:
        raise ValueError(f"the scene {SCENE} has no encoder")
    return encoder.circumference / encoder.lines_per_rev


def preserved_table() -> tuple[StatementCheck, ...]:
    """Return what the thesis says of the smoothed velocity."""
    v = exact(8.0)[2]
    run = runs()["sg"]
    found, true = float(run.v[run.t < 8.0].min()), float(v.min())
    smoother = fluctuation(runs()["fd"]) / fluctuation(run)
    return (
        state(
            "smoothing preserves heights and widths",
            "yes",
            f"smallest velocity {found:.2f} cm/s, of the exact motion {true:.2f}",
            abs(found - true) < 0.02 * abs(true),
        ),
        state("smoothing removes the fluctuations", "yes", f"{smoother:.0f} times less in stick", smoother > 3.0),
    )


def portrait(method: str, number: str) -> Drawing:
    """Figures 3.17, 3.21 and 3.22: phase portraits."""
    run = runs()[method]
    later = run.t > 1.0
    name = "finite differences" if method == "fd" else "Savitzky-Golay"
    landings, slips = turns(runs()["sg"])
    table: tuple[StatementCheck, ...] = ()
    if number == "3.17":
        table = (
            compare("displacement at which a stick ends (cm)", "15", float(np.mean(slips)), OWN_RECORD, within=2.0),
        )
    if number == "3.22":
        table = (
            state(
                "the portrait has a flat top",
                "as that of law 5",
                f"sticks from {np.mean(landings):.3g} to {np.mean(slips):.3g} cm at "
                f"{np.median(run.v[run.stick]):.4g} +- {fluctuation(run):.2g} cm/s",
                fluctuation(run) < 0.05 * BELT_CM_S,
            ),
        )
    return Drawing(
        {
            "3.17": "Phase portrait of the encoder experiment by finite differences: no two turns are alike.",
            "3.21": "Phase portrait by finite differences: the steps of the encoder scatter the velocity.",
            "3.22": "Phase portrait of the same record by a Savitzky-Golay filter: slips, and the flat top of stick.",
        }[number],
        (Panel(X, V, (Trace(run.x[later], run.v[later], name, "thin"),)),),
        table,
        choices=RECORD,
    )


def signals() -> Drawing:
    """Figure 3.8."""
    t = np.linspace(0.0, 1.0, 4001)
    edges = np.where(t < 0.5, 35.0 * t, 35.0 * (1.0 - t))  # x4 counts: up, then down
    levels = levels_of(np.floor(edges))
    high_a, high_b = (levels & 1).astype(np.float64), (levels >> 1).astype(np.float64)
    decoder = Decoder("jk")
    found = decoder.feed(levels)
    up, down = np.zeros(len(t)), np.zeros(len(t))
    up[found.index[found.step > 0]] = 1.0
    down[found.index[found.step < 0]] = 1.0
    rises = np.flatnonzero(np.diff(high_a) > 0.0) + 1
    forwards, backwards = high_b[rises[t[rises] < 0.5]], high_b[rises[t[rises] > 0.5]]
    return Drawing(
        "Signals A and B of the encoder as the mass moves forwards and, from 0.5 on, back; below, the counts that the "
        "J-K circuit sends to the up and to the down counter.",
        (
            Panel(
                "time (1)",
                "level, A raised (1)",
                (Trace(t, high_a + 1.5, "A", "line", 0), Trace(t, high_b, "B", "line", 1)),
            ),
            Panel(
                "time (1)",
                "count (lines)",
                (
                    Trace(t, np.cumsum(up), "up counter", "line", 2),
                    Trace(t, np.cumsum(down), "down counter", "line", 3),
                    Trace(t, np.cumsum(up - down), "displacement", "dashed", -1),
                ),
            ),
        ),
        (
            state(
                "pulses of either direction are out of phase by 90 degrees",
                "anticlockwise against clockwise",
                f"where A rises, B is {forwards.mean():.0f} forwards and {backwards.mean():.0f} back",
                not forwards.any() and bool(backwards.all()),
            ),
            state(
                "the two counts combined give the displacement",
                "yes",
                f"{decoder.up} up, {decoder.down} down, after 17 edges and back",
                decoder.net == 0,
                "the circuit counts the rises of A, which lie at different places of a line forwards and back: each "
                "reversal can add a line",
            ),
        ),
        choices="the motion",
    )


FIGURES = (
    Entry("3.8", "square waves of the encoder, and the counters' signals", signals),
    Entry("3.15", "displacement, third experiment", displacement),
    Entry("3.16", "velocity, third experiment", partial(velocity, "fd", "3.16")),
    Entry("3.17", "phase portrait, third experiment", partial(portrait, "fd", "3.17")),
    Entry("3.19", "velocity without smoothing", partial(velocity, "fd", "3.19")),
    Entry("3.20", "velocity smoothed by a Savitzky-Golay filter", partial(velocity, "sg", "3.20")),
    Entry("3.21", "phase portrait without smoothing", partial(portrait, "fd", "3.21")),
    Entry("3.22", "phase portrait smoothed by a Savitzky-Golay filter", partial(portrait, "sg", "3.22")),
)
