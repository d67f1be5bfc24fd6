"""Exact motion in a file: t, x, v and the friction force F on an even grid of times, as HDF5 (NeXus) or CSV.

Of two masses the columns are t, x1, v1, F1, x2, v2, F2.

The motion stands in /entry/motion (NXdata, the default plot); the scene as JSON, the method with its setting and the
outcome in /entry/simulation.  A CSV file holds the columns alone.
Units are written as SI; those of a dimensionless scene are its own.  This is no run of a board: it holds no counts.
"""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rig_sim.flow.modes import Outcome
from rig_sim.integrate.phases import sample_phase
from rig_sim.motion.play import DEFAULT_MAX_STEPS, SamplePhase, ScenePlayer
from rig_sim.motion.two_masses import COLUMNS as TWO_MASS_COLUMNS
from rig_sim.motion.two_masses import TwoMassPlayer
from rig_sim.scenes.model import Scene
from stickslip.errors import InputError
from stickslip.output import atomic, disk, suffix
from stickslip.version import VERSION

SAMPLES_AT_ONCE = 65_536
FORMS = {"h5": suffix.RUN, "csv": suffix.CSV}
MOST_SAMPLES = 100_000_000  # 3.2 GB of HDF5
_COLUMNS = {
    "t": ("time", "s"),
    "x": ("position of the mass", "m"),
    "v": ("velocity of the mass", "m/s"),
    "F": ("friction force on the mass, positive towards +x", "N"),
}


@dataclass(frozen=True)
class WrittenMotion:
    """The content of a file: ``samples`` rows, the outcome of the motion, and the steps taken."""

    samples: int
    outcome: str
    advice: str
    steps: int


def write(
    scene: Scene,
    path: Path,
    *,
    until: float,
    rate: float,
    phases: SamplePhase = sample_phase,
    method: str = "exact",
    max_steps: int = DEFAULT_MAX_STEPS,
    force: bool = False,
) -> WrittenMotion:
    """Play a scene and write t = 0, 1/rate ... up to ``until``; the file appears whole or not at all.

    The suffix of ``path`` decides between HDF5 and CSV.  ``phases`` plays one phase: methods other than the exact one
    come from `rig_sim.comparison.methods.choose_phases`, and ``method`` is stored with the file.  A run that takes more
    than ``max_steps`` (of dop853: evaluations of the right-hand side) ends early, and its outcome says so.
    """
    form = suffix.choose_form(path, FORMS, "--output")
    atomic.refuse_existing(path, force)
    samples = count_samples(until, rate)
    player = make_player(scene, phases, max_steps)
    with atomic.replacing(path, force) as temporary:
        if form == "csv":
            rows = _write_csv(player, temporary, samples, rate)
        else:
            rows = _write_h5(player, temporary, samples, rate, method)
    return WrittenMotion(rows, player.outcome.name, player.outcome.advice, player.steps)


def sample_scene(
    scene: Scene, *, until: float, rate: float, phases: SamplePhase = sample_phase, max_steps: int = DEFAULT_MAX_STEPS
) -> tuple[tuple[NDArray[np.float64], ...], WrittenMotion]:
    """Play a scene and return its columns, (n,) each, in memory; parameters and errors as those of `write`."""
    samples = count_samples(until, rate)
    player = make_player(scene, phases, max_steps)
    parts = list(zip(*play_stretches(player, samples, rate), strict=True))
    columns = tuple(np.concatenate(part) for part in parts)
    return columns, WrittenMotion(len(columns[0]), player.outcome.name, player.outcome.advice, player.steps)


def read(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a file that `write` has written."""
    if suffix.choose_form(path, FORMS) == "csv":
        rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
        return {name: rows[:, column] for column, name in enumerate(names)}
    import h5py

    with h5py.File(path) as file:
        return {name: file[f"entry/motion/{name}"][:] for name in names}


def count_samples(until: float, rate: float) -> int:
    for name, value in (("--until", until), ("--rate", rate)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"is {value:g}", name, "use a positive number")
    if until * rate > MOST_SAMPLES:
        problem = f"{until * rate:.3g} samples are more than the {MOST_SAMPLES} that a file may contain"
        raise InputError(problem, "--rate", "reduce --rate or --until")
    return math.floor(until * rate * (1 + 1e-15)) + 1


class _Player(Protocol):
    """Plays a scene of one mass or two into columns."""

    scene: Scene
    outcome: Outcome

    @property
    def steps(self) -> int: ...

    def columns(self, instants: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]: ...


def make_player(scene: Scene, phases: SamplePhase, max_steps: int) -> _Player:
    if scene.coupling is None:
        return ScenePlayer(scene, max_steps=max_steps, phases=phases)
    if phases is not sample_phase:
        raise InputError("supports only one mass", "--method", "use the method exact for two masses")
    return TwoMassPlayer(scene, max_steps=max_steps)


def describe_columns(scene: Scene) -> dict[str, tuple[str, str]]:
    return _COLUMNS if scene.coupling is None else TWO_MASS_COLUMNS


def play_stretches(player: _Player, samples: int, rate: float) -> Iterator[tuple[NDArray[np.float64], ...]]:
    """Yield the columns, stretch by stretch, until all samples are there or the motion ends early."""
    for first in range(0, samples, SAMPLES_AT_ONCE):
        instants = np.arange(first, min(first + SAMPLES_AT_ONCE, samples)) / rate
        columns = player.columns(instants)
        yield columns
        if len(columns[0]) < len(instants):
            return


def _write_csv(player: _Player, target: Path, samples: int, rate: float) -> int:
    rows = 0
    with target.open("w", encoding="ascii") as file:
        file.write(",".join(describe_columns(player.scene)) + "\n")
        for columns in play_stretches(player, samples, rate):
            lists = [column.tolist() for column in columns]
            file.writelines(",".join(map(repr, row)) + "\n" for row in zip(*lists, strict=True))
            rows += len(lists[0])
    return rows


def _write_h5(player: _Player, target: Path, samples: int, rate: float, method: str) -> int:
    from daq.runfile import nexus

    with disk.open_hdf5(target, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "entry"})
        entry = nexus.group(file, "entry", "NXentry", default="motion")
        nexus.field(entry, "title", player.scene.title or player.scene.name)
        nexus.field(entry, "program_name", "rig-sim", version=VERSION)
        simulation = nexus.group(entry, "simulation", "NXcollection")
        nexus.field(simulation, "scene", json.dumps(player.scene.model_dump(exclude_none=True)))
        nexus.field(simulation, "method", method)
        _, signal, *others = columns = describe_columns(player.scene)
        group = nexus.group(entry, "motion", "NXdata", signal=signal, axes="t", t_indices=0)
        group.attrs["auxiliary_signals"] = others
        fields = [
            nexus.column(group, name, samples, "f8", units, growing=True, long_name=text)
            for name, (text, units) in columns.items()
        ]
        rows = 0
        for stretch in play_stretches(player, samples, rate):
            for field, column in zip(fields, stretch, strict=True):
                field.resize(rows + len(column), axis=0)
                field[rows:] = column
            rows += len(stretch[0])
        nexus.field(simulation, "outcome", player.outcome.name)
    return rows
