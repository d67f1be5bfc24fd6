"""Exact motion in a file: t, x, v and the friction force F on an even grid of times, as HDF5 (NeXus) or CSV.

The motion stands in /entry/motion (NXdata, the default plot); the scene as JSON, the method with its setting and the
outcome in /entry/simulation.  A CSV file holds the columns alone.
Units are written as SI; those of a dimensionless scene are its own.  This is no run of a board: it holds no counts.
"""

import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.errors import InputError
from daq.output import disk
from rig_sim.comparison.methods import phases_by
from rig_sim.motion.play import DEFAULT_MAX_STEPS, Motion
from rig_sim.scenes.scene import Scene

SAMPLES_AT_ONCE = 65_536
MOST_SAMPLES = 100_000_000  # 3.2 GB of HDF5
_CHUNK = 16_384
_COLUMNS = {
    "t": ("time", "s"),
    "x": ("position of the mass", "m"),
    "v": ("velocity of the mass", "m/s"),
    "F": ("friction force on the mass, positive towards +x", "N"),
}


@dataclass(frozen=True)
class Written:
    """What went into the file: ``samples`` rows, how the motion ended, and the steps it took."""

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
    method: str = "exact",
    step: float | None = None,
    rtol: float | None = None,
    max_steps: int = DEFAULT_MAX_STEPS,
) -> Written:
    """Play a scene and write t = 0, 1/rate ... up to ``until``; the file appears whole or not at all.

    Parameters
    ----------
    scene : Scene
        What to play.
    path : Path
        Ends in .h5 or .csv; replaced if it exists.
    until, rate : float
        End of the run, and samples per unit of time.
    method, step, rtol
        As for `rig_sim.comparison.methods.phases_by`; every section of a scene plays with every method.
    max_steps : int
        Of the integrator (of dop853: evaluations of the right-hand side); a run that needs more ends early, and its
        outcome says so.

    Raises
    ------
    InputError
        Another ending of ``path``, a folder that does not exist, a time or rate that is not positive, or a method or
        setting that is not known.
    RefusedError
        The disk refuses.
    """
    if path.suffix not in (".h5", ".csv"):
        raise InputError(f"ending {path.suffix!r}", str(path), "name the file .h5 or .csv")
    if not path.parent.is_dir():
        raise InputError("no such folder", str(path.parent), "make it first")
    for name, value in (("--until", until), ("--rate", rate)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"is {value:g}", name, "give a positive number")
    if until * rate > MOST_SAMPLES:
        what = f"{until * rate:.3g} samples, more than the {MOST_SAMPLES} a file may hold"
        raise InputError(what, "--rate", "lower --rate or --until")
    phases, setting = phases_by(method, scene, step=step, rtol=rtol)
    motion = Motion(scene, max_steps=max_steps, phases=phases)
    samples = math.floor(until * rate * (1 + 1e-15)) + 1
    part = path.with_name(path.name + ".part")
    with disk.writing(path):
        try:
            written = (
                _write_csv(motion, part, samples, rate)
                if path.suffix == ".csv"
                else _write_h5(motion, part, samples, rate, f"{method} {setting}".strip())
            )
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    return Written(written, motion.outcome.name, motion.outcome.advice, motion.steps)


def _stretches(motion: Motion, samples: int, rate: float) -> Iterator[tuple[NDArray[np.float64], ...]]:
    """Yield columns t, x, v, F until all samples are there or the motion ends early."""
    for first in range(0, samples, SAMPLES_AT_ONCE):
        wanted = np.arange(first, min(first + SAMPLES_AT_ONCE, samples)) / rate
        path = motion.follow(wanted, forces=True)
        at = path.samples
        yield path.nodes.t[at], path.nodes.x[at], path.nodes.v[at], path.F
        if len(at) < len(wanted):
            return


def _write_csv(motion: Motion, part: Path, samples: int, rate: float) -> int:
    rows = 0
    with part.open("w", encoding="ascii") as file:
        file.write(",".join(_COLUMNS) + "\n")
        for columns in _stretches(motion, samples, rate):
            lists = [column.tolist() for column in columns]
            file.writelines(f"{t!r},{x!r},{v!r},{F!r}\n" for t, x, v, F in zip(*lists, strict=True))
            rows += len(lists[0])
    return rows


def _write_h5(motion: Motion, part: Path, samples: int, rate: float, method: str) -> int:
    from importlib.metadata import version

    with disk.hdf5(part, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "entry"})
        entry = file.create_group("entry")
        entry.attrs.update({"NX_class": "NXentry", "default": "motion"})
        entry["title"] = motion.scene.title or motion.scene.name
        program = entry.create_dataset("program_name", data="rig-sim")
        program.attrs["version"] = version("stickslip")
        simulation = entry.create_group("simulation")
        simulation.attrs["NX_class"] = "NXcollection"
        simulation["scene"] = json.dumps(motion.scene.model_dump(exclude_none=True))
        simulation["method"] = method
        group = entry.create_group("motion")
        group.attrs.update({"NX_class": "NXdata", "signal": "x", "axes": "t", "t_indices": 0})
        group.attrs["auxiliary_signals"] = ["v", "F"]
        fields = [_field(group, name, min(_CHUNK, samples)) for name in _COLUMNS]
        rows = 0
        for columns in _stretches(motion, samples, rate):
            for field, column in zip(fields, columns, strict=True):
                field.resize(rows + len(column), axis=0)
                field[rows:] = column
            rows += len(columns[0])
        simulation["outcome"] = motion.outcome.name
    return rows


def _field(group: Any, name: str, chunk: int) -> Any:
    long_name, units = _COLUMNS[name]
    field = group.create_dataset(
        name,
        shape=(0,),
        maxshape=(None,),
        chunks=(chunk,),
        dtype="f8",
        compression="gzip",
        shuffle=True,
        fletcher32=True,
    )
    field.attrs.update({"long_name": long_name, "units": units})
    return field
