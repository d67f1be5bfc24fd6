"""The smoothed stage of a run file: /entry/smooth, beside the untouched raw data.

::

    smooth            NXprocess   @default=phase_portrait; program, version, date, sequence_index
      model           NXcollection  what was learned from the record, in groups (`processing.blocks.MotionModel`)
      parameters      NXparameters  how it was made, and the sha256 of what it was made from; first_sample and
                                  last_sample where a part of the run was smoothed
      kinematics      NXdata      time, position, velocity, acceleration and their errors (f4) over time; with a belt
                                  channel belt_velocity and its errors too
      phase_portrait  NXdata      velocity against position, and time: hard links, no copy
      phases          NXdata      one row a stick or slip: start, end, their errors, first, last, stick (1) or slip (0)
      losses          NXdata      one row a step of the position: first, last, counts, size (absent without any)
      kicks           NXdata      one row a step of the velocity: sample, step (absent without any)
      faults          NXdata      one row a run of samples left out: first, last, frozen (1) or spike (0) (likewise)
      findings        NXcollection  one row a contradiction or fault: code, text, value, expected, sigmas (likewise)
      break_aways     NXdata      one row a break-away: stick_time, slip_time, drop and break_away (the level) over
                                  time, NaN where the record does not show it whole (likewise)
      statistics      NXcollection  sticks, slips, spikes, frozen; mean, sd, min, max and trend of each of the columns
                                  of break_aways, as break_away_mean (absent with fewer than three slips)
"""

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.base.compute.arrays import Array
from daq.base.errors import InputError
from daq.runfile import nexus, store, trust
from daq.runfile.recording import Recording
from processing.model_values import unit_of
from processing.record import series
from processing.record.finding import Finding
from processing.record.kinematics import Kinematics, SmoothingSummary
from processing.record.motion import Fault, Phase, VelocityStep
from processing.record.noise import position_noise
from processing.record.position_steps import PositionStep, step_offsets
from processing.statistics import SlipEvent, StickSlipStatistics, from_kinematics, statistics

DERIVATIVES = {"position": "", "velocity": "/s", "acceleration": "/s^2"}
EVENTS = {"stick_s": "stick_time", "slip_s": "slip_time", "drop_m": "drop", "break_away_m": "break_away"}
PART = ("first_sample", "last_sample")  # parameters of a stage that holds a part of the run
COUNTS = ("sticks", "slips", "spikes", "frozen")
HASHED_AT_A_TIME = 1 << 20  # values, 8 MB
ADDED = ("start_errors", "end_errors", "size")  # columns that the first stages did not have
Column = tuple[Callable[[Any], float], type, str]  # of a row its value, the type and the units, {unit} for a length's
TABLES: dict[str, tuple[str, str, str, dict[str, Column]]] = {  # title, axis, signal, columns
    "phases": (
        "sticks and slips",
        "start",
        "stick",
        {
            "start": (attrgetter("start"), np.float64, "s"),
            "end": (attrgetter("end"), np.float64, "s"),
            "start_errors": (attrgetter("start_sd"), np.float32, "s"),
            "end_errors": (attrgetter("end_sd"), np.float32, "s"),
            "first": (attrgetter("first"), np.uint32, ""),
            "last": (attrgetter("last"), np.uint32, ""),
            "stick": (lambda phase: phase.kind == "stick", np.uint8, ""),
        },
    ),
    "losses": (
        "steps of the position",
        "first",
        "counts",
        {
            "first": (attrgetter("first"), np.uint32, ""),
            "last": (attrgetter("last"), np.uint32, ""),
            "counts": (attrgetter("counts"), np.int64, ""),
            "size": (attrgetter("size"), np.float64, "{unit}"),
        },
    ),
    "kicks": (
        "steps of the velocity",
        "sample",
        "step",
        {"sample": (attrgetter("sample"), np.uint32, ""), "step": (attrgetter("step"), np.float64, "{unit}/s")},
    ),
    "faults": (
        "samples left out",
        "first",
        "last",
        {
            "first": (attrgetter("first"), np.uint32, ""),
            "last": (attrgetter("last"), np.uint32, ""),
            "frozen": (lambda fault: fault.kind == "frozen", np.uint8, ""),
        },
    ),
}


def save(kinematics: Kinematics, path: Path, own: slice = nexus.EVERY) -> None:
    """Write the stage into the run file, replacing an earlier one (and dropping what was fitted to that).

    ``own`` are the samples of the run that were smoothed, where they are a part of it.
    """

    def write(entry: h5py.Group) -> None:
        smooth = begin(entry)
        table = empty(smooth, kinematics.samples, kinematics.unit, belt=kinematics.belt_counted)
        fill(table, 0, {name: getattr(kinematics, name) for name in table})
        finish(smooth, kinematics, kinematics.recording.digest, own)

    store.extend(path, "smooth", write, default="smooth")


def begin(entry: h5py.Group) -> h5py.Group:
    """Make the group of the stage."""
    return nexus.process(entry, "smooth", "process smooth", 1, "phase_portrait")


def empty(smooth: h5py.Group, n: int, unit: str, *, belt: bool = False) -> h5py.Group:
    """Make the table of the kinematics for ``n`` samples yet to be written, with columns for a counted ``belt``."""
    made = nexus.group(smooth, "kinematics", "NXdata", signal="velocity", axes="time", title="kinematics")
    made.attrs["time_indices"] = np.int64(0)
    made.attrs["auxiliary_signals"] = ["position", "acceleration"]
    nexus.column(made, "time", n, "f8", "s")
    for name, per in DERIVATIVES.items():
        nexus.column(made, name, n, "f8", unit + per)
        nexus.column(made, f"{name}_errors", n, "f4", unit + per)
    if belt:
        nexus.column(made, "belt_velocity", n, "f8", f"{unit}/s")
        nexus.column(made, "belt_velocity_errors", n, "f4", f"{unit}/s")
    nexus.scale(made, "time")
    return made


def fill(table: h5py.Group, begin: int, columns: Mapping[str, Array]) -> None:
    """Write columns of shape (k,) into the table from sample ``begin`` on."""
    for name, values in columns.items():
        table[name][begin : begin + values.size] = values


def finish(smooth: h5py.Group, motion: Kinematics | SmoothingSummary, digest: str, own: slice = nexus.EVERY) -> None:
    """Write how the motion was made, its portrait, and its phases, beside the kinematics."""
    unit = motion.unit
    parameters = nexus.group(smooth, "parameters", "NXparameters")
    nexus.field(parameters, "method", motion.method)
    nexus.field(parameters, "window", np.int64(motion.window))
    nexus.field(parameters, "order", np.int64(motion.order))
    nexus.field(parameters, "times", motion.times)
    nexus.field(parameters, "belt_speed", np.float64(motion.belt_speed), f"{unit}/s")
    nexus.field(parameters, "lost_counts", np.int64(motion.lost_counts))
    nexus.field(parameters, "repaired", np.int64(motion.repaired))
    nexus.field(parameters, "dropped_frames", np.int64(motion.dropped_frames))
    nexus.field(parameters, "noise", np.float64(motion.noise), unit)
    nexus.field(parameters, "cpu_time", np.float64(motion.cpu_s), "s")
    nexus.field(parameters, "sha256_input", digest)
    if own != nexus.EVERY:
        for name, sample in zip(PART, (own.start, own.stop - 1), strict=True):
            nexus.field(parameters, name, np.int64(sample))
    _write_model(nexus.group(smooth, "model", "NXcollection"), motion.model, unit)
    portrait = nexus.group(
        smooth, "phase_portrait", "NXdata", signal="velocity", axes="position", title="phase portrait"
    )
    portrait.attrs["position_indices"] = np.int64(0)
    # The time too: it is the dimension scale of the other two, which xarray looks for in the group itself.
    for name in ("time", "position", "velocity"):
        nexus.link(portrait, name, smooth["kinematics"][name])
    for name, (title, axis, signal, columns) in TABLES.items():
        rows = getattr(motion, name)
        if rows:
            made: dict[str, tuple[Any, str]] = {
                column: (np.array([value(row) for row in rows], dtype), units.format(unit=unit))
                for column, (value, dtype, units) in columns.items()
            }
            nexus.table(smooth, name, made, axis=axis, signal=signal, title=title)
    if motion.findings:
        made = nexus.group(smooth, "findings", "NXcollection")
        for name in ("code", "text"):
            nexus.field(made, name, [getattr(finding, name) for finding in motion.findings])
        for name in ("value", "expected", "sigmas"):
            nexus.field(made, name, np.array([getattr(finding, name) for finding in motion.findings]), "")
    kinematics = smooth["kinematics"]
    position, time = kinematics["position"][()], kinematics["time"][()]
    if motion.losses and not motion.repaired:
        raw = "raw/segment"
        segment = smooth.parent[raw][own] if raw in smooth.parent else np.zeros(time.size, np.int64)
        position -= step_offsets(segment, motion.losses)
    _write_statistics(smooth, statistics(motion, position, time), unit)


def _write_statistics(smooth: h5py.Group, counted: StickSlipStatistics, unit: str) -> None:
    made = nexus.group(smooth, "statistics", "NXcollection")
    for name in COUNTS:
        nexus.field(made, name, np.int64(getattr(counted, name)))
    for name, stored in EVENTS.items():
        own = "s" if name.endswith("_s") else unit
        for key, value in (counted.summary(name) or {}).items():
            if value is not None:
                per = "/s" if key == "trend_per_s" else ""
                nexus.field(made, f"{stored}_{key.removesuffix('_per_s')}", np.float64(value), own + per)
    if counted.events:
        columns = {EVENTS[name]: (counted.column(name), "s" if name.endswith("_s") else unit) for name in EVENTS}
        columns["time"] = (counted.column("t"), "s")
        nexus.table(smooth, "break_aways", columns, axis="time", signal="break_away", title="break-aways")


def digest(entry: h5py.Group) -> str:
    """Return the sha256 of the smoothed velocity in a run's /entry; "" where it holds no stage."""
    velocity = entry.get("smooth/kinematics/velocity")
    if not isinstance(velocity, h5py.Dataset):
        return ""
    sha = hashlib.sha256()
    for first in range(0, velocity.size, HASHED_AT_A_TIME):
        sha.update(np.ascontiguousarray(velocity[first : first + HASHED_AT_A_TIME], "<f8").tobytes())
    return sha.hexdigest()


def load(path: Path) -> Kinematics | None:
    """Read the stage back; None when the run holds none.

    Raises
    ------
    InputError
        For a file that is no run, or a stage that is damaged or was made from other raw data.
    """
    with store.opened(path) as file, trust.damage(path):
        entry = file["entry"]
        if "smooth" not in entry:
            return None
        part = _part(entry, path)
        recording = _with_own_events(store.load(path, part), part)
        made_from = nexus.read_text(entry, "smooth/parameters/sha256_input", path)
        if made_from != recording.digest:
            raise InputError(
                "its smoothed motion was made from other raw data", str(path), f"run: process smooth {path.name}"
            )
        columns = {}
        belt = ("belt_velocity", "belt_velocity_errors") if "smooth/kinematics/belt_velocity" in entry else ()
        for name in ("time", *(key for base in DERIVATIVES for key in (base, f"{base}_errors")), *belt):
            columns[name] = nexus.read_array(entry, f"smooth/kinematics/{name}", np.float64, path)
            nexus.check_length(columns[name].size, recording.time.size, f"smooth/kinematics/{name}", path)
        parameters = "smooth/parameters"
        times = nexus.read_text(entry, f"{parameters}/times", path)
        return Kinematics(
            recording=recording,
            **columns,
            method=nexus.read_text(entry, f"{parameters}/method", path),
            window=int(nexus.read_number(entry, f"{parameters}/window", path)),
            order=int(nexus.read_number(entry, f"{parameters}/order", path)),
            times=times,
            belt_speed=nexus.read_number(entry, f"{parameters}/belt_speed", path),
            phases=tuple(
                Phase("stick" if stuck else "slip", start, end, first, last, start_sd, end_sd)
                for start, end, start_sd, end_sd, first, last, stuck in _stored(entry, "phases", path)
            ),
            losses=_losses(entry, recording, path),
            kicks=tuple(VelocityStep(*row) for row in _stored(entry, "kicks", path)),
            faults=tuple(
                Fault(first, last, "frozen" if frozen else "spike")
                for first, last, frozen in _stored(entry, "faults", path)
            ),
            dropped_frames=_dropped_frames(entry, path),
            noise=_noise(entry, recording, times, path),
            findings=_findings(entry, path),
            repaired="repaired" in entry[parameters] and bool(nexus.read_number(entry, f"{parameters}/repaired", path)),
            cpu_s=nexus.read_number(entry, f"{parameters}/cpu_time", path),
            model=_read_model(entry["smooth/model"]) if "smooth/model" in entry else {},
        )


def _write_model(made: h5py.Group, model: Mapping[str, Any], unit: str) -> None:
    """Write the values of a model, each with its units, and its parts as groups."""
    for name, value in model.items():
        if isinstance(value, Mapping):
            _write_model(nexus.group(made, name, "NXcollection"), value, unit)
        elif isinstance(value, str):
            nexus.field(made, name, value)
        else:
            numbers = np.asarray(value)
            units = unit_of(name, unit) if numbers.dtype.kind == "f" else None
            nexus.field(made, name, numbers.astype(np.uint8) if numbers.dtype == bool else numbers, units)


def _read_model(made: h5py.Group) -> dict[str, Any]:
    """Return the values of a model as they were written."""
    found: dict[str, Any] = {}
    for name, member in made.items():
        if isinstance(member, h5py.Group):
            found[name] = _read_model(member)
        else:
            found[name] = member.asstr()[()] if h5py.check_string_dtype(member.dtype) else member[()]
    return found


def _with_own_events(recording: Recording, part: slice) -> Recording:
    """Return a part of a run with the events of its samples alone, numbered from its first one."""
    if part == nexus.EVERY:
        return recording
    events = zip(recording.event_sample.tolist(), recording.event_kind, recording.event_note, strict=True)
    inside = [(sample - part.start, kind, note) for sample, kind, note in events if part.start <= sample < part.stop]
    samples, kinds, notes = zip(*inside, strict=True) if inside else ((), (), ())
    return replace(recording, event_sample=np.array(samples, np.uint32), event_kind=kinds, event_note=notes)


def _part(entry: h5py.Group, path: Path) -> slice:
    """Return which samples of the run the stage holds."""
    if f"smooth/parameters/{PART[0]}" not in entry:
        return nexus.EVERY
    first, last = (int(nexus.read_number(entry, f"smooth/parameters/{name}", path)) for name in PART)
    return slice(first, last + 1)


def load_statistics(path: Path) -> StickSlipStatistics:
    """Read the statistics of stick-slip back; of a stage written before they were stored, computed again.

    Raises
    ------
    InputError
        As `load` does, and for a run that is not smoothed.
    """
    with store.opened(path) as file, trust.damage(path):
        entry = file["entry"]
        if "smooth/statistics" in entry:
            counts = [int(nexus.read_number(entry, f"smooth/statistics/{name}", path)) for name in COUNTS]
            return StickSlipStatistics(
                **dict(zip(COUNTS, counts, strict=True)),
                dropped_frames=_dropped_frames(entry, path),
                events=_slip_events(entry, path),
            )
    motion = load(path)
    if motion is None:
        raise InputError("is not smoothed yet", str(path), f"run: process smooth {path.name}")
    return from_kinematics(motion)


def _noise(entry: h5py.Group, recording: Recording, times: str, path: Path) -> float:
    """Return the noise of a position; of a stage written before it was kept, estimated from the record."""
    if "noise" in entry["smooth/parameters"]:
        return nexus.read_number(entry, "smooth/parameters/noise", path)
    return position_noise(series.from_recording(recording, times))


def _stored(entry: h5py.Group, name: str, path: Path) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a table of `TABLES`; NaN for the columns `ADDED` in a stage written without them."""
    if f"smooth/{name}" not in entry:
        return
    columns: list[list[float]] = []
    for column, (_, dtype, _) in TABLES[name][3].items():
        place = f"smooth/{name}/{column}"
        if column in ADDED and place not in entry:
            columns.append([math.nan] * len(columns[0]))
        else:
            read_as = np.int64 if np.issubdtype(dtype, np.integer) else np.float64
            columns.append(nexus.read_array(entry, place, read_as, path).tolist())
    yield from zip(*columns, strict=True)


def _dropped_frames(entry: h5py.Group, path: Path) -> int:
    if "dropped_frames" not in entry["smooth/parameters"]:
        return 0  # of a stage written before they were looked for
    return int(nexus.read_number(entry, "smooth/parameters/dropped_frames", path))


def _findings(entry: h5py.Group, path: Path) -> tuple[Finding, ...]:
    if "smooth/findings" not in entry:
        return ()
    code, text = (nexus.read_texts(entry, f"smooth/findings/{name}", path) for name in ("code", "text"))
    numbers = [
        nexus.read_array(entry, f"smooth/findings/{name}", np.float64, path).tolist()
        for name in ("value", "expected", "sigmas")
    ]
    return tuple(Finding(*row) for row in zip(code, text, *numbers, strict=True))


def _slip_events(entry: h5py.Group, path: Path) -> tuple[SlipEvent, ...]:
    if "smooth/break_aways" not in entry:
        return ()
    names = ("time", *EVENTS.values())
    columns = [nexus.read_array(entry, f"smooth/break_aways/{name}", np.float64, path) for name in names]
    return tuple(SlipEvent(*row) for row in zip(*(column.tolist() for column in columns), strict=True))


def _losses(entry: h5py.Group, recording: Recording, path: Path) -> tuple[PositionStep, ...]:
    metres = recording.rig.metres_per_count
    pitch = 1.0 if metres is None else abs(metres.value)
    # Without a size: of a stage written before it was stored, all of whose steps are lost counts.
    return tuple(
        PositionStep(first, last, counts, counts * pitch if math.isnan(size) else size)
        for first, last, counts, size in _stored(entry, "losses", path)
    )
