"""The smoothed stage of a run file: /entry/smooth, next to the unchanged raw data; its tree is `TREE`.

A stage of a part of the run states its samples; the values of a model are stored in groups like the fields of
`processing.blocks.MotionModel`.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.runfile import nexus, store, tree, trust
from daq.runfile.recording import Recording
from daq.runfile.tree import LENGTH, Field, Group
from processing.model_values import unit_of
from processing.record import series
from processing.record.kinematics import Kinematics, SmoothingSummary
from processing.record.motion import Corner, Fault, Finding, Phase, VelocityStep
from processing.record.noise import position_noise
from processing.record.series import PositionStep, step_offsets
from processing.statistics import SlipEvent, StickSlipStatistics, from_kinematics, statistics
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

SPEED = f"{LENGTH}/s"
BREAK_AWAYS = {  # column: attribute of a `SlipEvent`, unit, what it is
    "stick_time": ("stick_s", "s", "duration of the stick"),
    "slip_time": ("slip_s", "s", "duration of the slip"),
    "drop": ("drop_m", LENGTH, "distance travelled back during the slip"),
    "break_away": ("break_away_m", LENGTH, "extension of the spring at break-away"),
}
CORNERS = {"land": 1, "leave": 2, "start": 3, "stop": 4, "overtake": 5, "kick": 6}  # 5 is of earlier versions
CORNERS_SAID = ", ".join(f"{code} {what}" for what, code in CORNERS.items())
SUMMARY = {"mean": "mean", "sd": "sd", "min": "min", "max": "max", "trend": "trend_per_s"}
HASHED_AT_A_TIME = 1 << 20  # values, 8 MB


@dataclass(frozen=True)
class _Stage:
    """The source of the fields of the stage."""

    motion: SmoothingSummary
    digest: str  # sha256 of the raw data
    part: slice  # samples of the run
    statistics: StickSlipStatistics

    @cached_property
    def summaries(self) -> dict[str, dict[str, float | None]]:
        """The summary of each quantity of a `SlipEvent`, empty where there are few slips."""
        return {of: self.statistics.summary(of) or {} for of, _, _ in BREAK_AWAYS.values()}

    @property
    def first(self) -> int | None:
        return None if self.part == nexus.EVERY else self.part.start

    @property
    def last(self) -> int | None:
        return None if self.part == nexus.EVERY else self.part.stop - 1


def _make_summary_getter(of: str, key: str) -> Callable[[_Stage], float | None]:
    return lambda stage: stage.summaries[of].get(key)


def _make_columns(name: str, unit: str, text: str) -> tuple[Field, Field]:
    path = f"smooth/kinematics/{name}"
    errors = Field(f"{path}_errors", "f4[n]", unit, "", f"motion.{name}_errors")
    return Field(path, "f8[n]", unit, text, f"motion.{name}"), errors


# Optional fields are absent in the stages of earlier releases, optional groups where they would be empty.
BELT = _make_columns("belt_velocity", SPEED, "the belt's, of its own encoder")
KINEMATICS: tree.Tree = (
    tree.table("smooth/kinematics", "time", "velocity", "kinematics", auxiliary=("position", "acceleration")),
    Field("smooth/kinematics/time", "f8[n]", "s", "since the first sample of the run", "motion.time"),
    *_make_columns("position", LENGTH, "smoothed"),
    *_make_columns("velocity", SPEED, "positive towards +x"),
    *_make_columns("acceleration", f"{SPEED}^2", "positive towards +x"),
)
PARAMETERS: tree.Tree = (
    Group("smooth/parameters", "NXparameters"),
    Field("smooth/parameters/method", "text", "", "of smoothing", "motion.method"),
    Field("smooth/parameters/window", "i8", "", "samples in the window", "motion.window"),
    Field("smooth/parameters/order", "i8", "", "degree of its polynomial", "motion.order"),
    Field("smooth/parameters/times", "text", "", "`recorded` or `nominal`", "motion.times"),
    Field("smooth/parameters/belt_speed", "f8", SPEED, "signed; NaN when unknown", "motion.belt_speed"),
    Field("smooth/parameters/lost_counts", "i8", "", "times counts went missing", value=lambda s: s.motion.lost_counts),
    Field("smooth/parameters/repaired", "i8", "", "1 if steps were removed", "motion.repaired", optional=True),
    Field("smooth/parameters/dropped_frames", "i8", "", "frames lost", "motion.dropped_frames", optional=True),
    Field("smooth/parameters/noise", "f8", LENGTH, "standard deviation of one position", "motion.noise", optional=True),
    Field("smooth/parameters/cpu_time", "f8", "s", "spent", "motion.cpu_s"),
    Field("smooth/parameters/sha256_input", "text", "", "of the raw data it was made from", "digest"),
    Field("smooth/parameters/first_sample", "i8", "", "of a part of the run", "first", optional=True),
    Field("smooth/parameters/last_sample", "i8", "", "of a part of the run", "last", optional=True),
)
ROWS: tree.Tree = (
    tree.table("smooth/phases", "start", "stick", "sticks and slips", optional=True),
    Field("smooth/phases/start", "f8[p]", "s", "it begins", "motion.phases.start"),
    Field("smooth/phases/end", "f8[p]", "s", "it ends", "motion.phases.end"),
    Field("smooth/phases/start_errors", "f4[p]", "s", "", "motion.phases.start_sd", optional=True),
    Field("smooth/phases/end_errors", "f4[p]", "s", "", "motion.phases.end_sd", optional=True),
    Field("smooth/phases/first", "u4[p]", "", "first sample", "motion.phases.first"),
    Field("smooth/phases/last", "u4[p]", "", "last sample", "motion.phases.last"),
    Field("smooth/phases/stick", "u1[p]", "", "1 stick, 0 slip", "motion.phases.kind", codes={"slip": 0, "stick": 1}),
    tree.table("smooth/losses", "first", "counts", "steps of the position", optional=True),
    Field("smooth/losses/first", "u4[l]", "", "first sample", "motion.losses.first"),
    Field("smooth/losses/last", "u4[l]", "", "last sample", "motion.losses.last"),
    Field("smooth/losses/counts", "i8[l]", "", "counts that went missing", "motion.losses.counts"),
    Field("smooth/losses/size", "f8[l]", LENGTH, "step of the position", "motion.losses.size", optional=True),
    tree.table("smooth/kicks", "sample", "step", "steps of the velocity", optional=True),
    Field("smooth/kicks/sample", "u4[k]", "", "sample", "motion.kicks.sample"),
    Field("smooth/kicks/step", "f8[k]", SPEED, "step of the velocity", "motion.kicks.step"),
    tree.table("smooth/corners", "time", "what", "corners of the velocity", optional=True),
    Field("smooth/corners/time", "f8[q]", "s", "of the corner", "motion.corners.time"),
    Field("smooth/corners/time_errors", "f4[q]", "s", "", "motion.corners.sd"),
    Field("smooth/corners/what", "u1[q]", "", CORNERS_SAID, "motion.corners.what", codes=CORNERS),
    tree.table("smooth/faults", "first", "last", "samples omitted", optional=True),
    Field("smooth/faults/first", "u4[f]", "", "first sample", "motion.faults.first"),
    Field("smooth/faults/last", "u4[f]", "", "last sample", "motion.faults.last"),
    Field(
        "smooth/faults/frozen", "u1[f]", "", "1 frozen, 0 spike", "motion.faults.kind", codes={"spike": 0, "frozen": 1}
    ),
    Group("smooth/findings", "NXcollection", optional=True),
    Field("smooth/findings/code", "text[d]", "", "name of the contradiction or fault", "motion.findings.code"),
    Field("smooth/findings/text", "text[d]", "", "the same in words", "motion.findings.text"),
    Field("smooth/findings/value", "f8[d]", "", "what the record shows", "motion.findings.value"),
    Field("smooth/findings/expected", "f8[d]", "", "the stated value", "motion.findings.expected"),
    Field("smooth/findings/sigmas", "f8[d]", "", "standard deviations between both", "motion.findings.sigmas"),
)
PORTRAIT: tree.Tree = (
    Group(
        "smooth/phase_portrait",
        "NXdata",
        attributes={
            "signal": "velocity",
            "axes": "position",
            "title": "phase portrait",
            "position_indices": np.int64(0),
        },
    ),
    # The time too: it is the dimension scale of the other two, which xarray looks for in the group itself.
    *(
        Field(f"smooth/phase_portrait/{name}", "link", unit, f"smooth/kinematics/{name}", value=lambda stage: True)
        for name, unit in (("time", "s"), ("position", LENGTH), ("velocity", SPEED))
    ),
)
STATISTICS: tree.Tree = (
    Group("smooth/statistics", "NXcollection", optional=True),
    *(
        Field(f"smooth/statistics/{name}", "i8", "", "how many", f"statistics.{name}")
        for name in ("sticks", "slips", "spikes", "frozen")
    ),
    *(
        Field(
            f"smooth/statistics/{name}_{key}",
            "f8",
            f"{unit}/s" if key == "trend" else unit,
            f"{text}: mean; `_sd`, `_min`, `_max` and `_trend`" if key == "mean" else "",
            value=_make_summary_getter(of, kind),
            optional=True,
        )
        for name, (of, unit, text) in BREAK_AWAYS.items()
        for key, kind in SUMMARY.items()
    ),
    tree.table("smooth/break_aways", "time", "break_away", "break-aways", optional=True),
    *(
        Field(f"smooth/break_aways/{name}", "f8[b]", unit, text, f"statistics.events.{of}")
        for name, (of, unit, text) in BREAK_AWAYS.items()
    ),
    Field("smooth/break_aways/time", "f8[b]", "s", "of the break-away", "statistics.events.t"),
)
STAGE = tree.process("smooth", "process smooth", 1, "phase_portrait")
MADE: tree.Tree = (
    *PARAMETERS,
    Group("smooth/model", "NXcollection"),
    *PORTRAIT,
    *ROWS,
    *STATISTICS,
)  # everything but KINEMATICS
TREE: tree.Tree = (*STAGE, *KINEMATICS, *BELT, *MADE)


def save(kinematics: Kinematics, path: Path, samples: slice = nexus.EVERY) -> None:
    """Write the stage of some samples of a run into its file, replacing an earlier one and the fits to that."""

    def write(entry: h5py.Group) -> None:
        table = begin(entry, kinematics.samples, kinematics.unit, belt=kinematics.belt_counted)
        fill(table, 0, {name: getattr(kinematics, name) for name in table})
        finish(entry, kinematics, kinematics.recording.digest, samples)

    store.extend(path, "smooth", write, default="smooth")


def begin(entry: h5py.Group, n: int, unit: str, *, belt: bool = False) -> h5py.Group:
    """Create the stage with an empty table of the kinematics for ``n`` samples, and return the table.

    ``unit`` is that of the position; ``belt`` adds columns for the velocity of the belt.
    """
    tree.write(entry, STAGE, None)
    tree.empty(entry, (*KINEMATICS, *(BELT if belt else ())), n, {LENGTH: unit})
    return entry["smooth/kinematics"]


def fill(table: h5py.Group, begin: int, columns: Mapping[str, Array]) -> None:
    """Write columns of shape (k,) into the table from sample ``begin`` on."""
    for name, values in columns.items():
        table[name][begin : begin + values.size] = values


def finish(entry: h5py.Group, motion: SmoothingSummary, digest: str, samples: slice = nexus.EVERY) -> None:
    """Write the parameters, the model, the portrait, the phases and the statistics after the kinematics."""
    kinematics = entry["smooth/kinematics"]
    position, time = kinematics["position"][()], kinematics["time"][()]
    if motion.losses and not motion.repaired:
        segment = entry["raw/segment"][samples] if "raw/segment" in entry else np.zeros(time.size, np.int64)
        position -= step_offsets(segment, motion.losses)
    stage = _Stage(motion, digest, samples, statistics(motion, position, time))
    tree.write(entry, MADE, stage, {LENGTH: motion.unit})
    _write_model(entry["smooth/model"], motion.model, motion.unit)


def digest(entry: h5py.Group) -> str:
    """Return the sha256 of the smoothed velocity in a run's /entry; "" without a stage."""
    velocity = entry.get("smooth/kinematics/velocity")
    if not isinstance(velocity, h5py.Dataset):
        return ""
    sha = hashlib.sha256()
    for first in range(0, velocity.size, HASHED_AT_A_TIME):
        sha.update(np.ascontiguousarray(velocity[first : first + HASHED_AT_A_TIME], "<f8").tobytes())
    return sha.hexdigest()


def load(path: Path) -> Kinematics | None:
    """Read the stage back, or None without one; InputError if it is damaged or was computed from other raw data."""
    with store.open_run(path) as file, trust.damage(path):
        entry = file["entry"]
        if "smooth" not in entry:
            return None
        belt = BELT if "smooth/kinematics/belt_velocity" in entry else ()
        stored = tree.read(entry, (*PARAMETERS, *KINEMATICS, *belt, *ROWS), path)
        part = slice(stored["first"], stored["last"] + 1) if "first" in stored else nexus.EVERY
        recording = _select_events(store.load(path, part), part)
        if stored["digest"] != recording.digest:
            raise InputError(
                "the smoothed motion was computed from other raw data", str(path), f"run 'process smooth {path.name}'"
            )
        nexus.check_length(stored["motion.time"].size, recording.time.size, "smooth/kinematics/time", path)
        values = tree.select_part(stored, "motion")
        values["repaired"] = bool(values.get("repaired", False))
        if "noise" not in values:
            values["noise"] = position_noise(series.from_recording(recording, values["times"]))
        unknown = {"start_sd": math.nan, "end_sd": math.nan}
        return Kinematics(
            recording=recording,
            **values,
            samples=recording.time.size,
            span=float(values["time"][-1] - values["time"][0]),
            unit=recording.unit,
            belt_counted=bool(belt),
            phases=tuple(Phase(**unknown | row) for row in tree.rows(stored, "motion.phases")),
            losses=tuple(_restore_loss(recording, **row) for row in tree.rows(stored, "motion.losses")),
            kicks=tuple(VelocityStep(**row) for row in tree.rows(stored, "motion.kicks")),
            corners=tuple(Corner(**row) for row in tree.rows(stored, "motion.corners")),
            faults=tuple(Fault(**row) for row in tree.rows(stored, "motion.faults")),
            findings=tuple(Finding(**row) for row in tree.rows(stored, "motion.findings")),
            model=_read_model(entry["smooth/model"]) if "smooth/model" in entry else {},
        )


def _write_model(group: h5py.Group, model: Mapping[str, Any], unit: str) -> None:
    """Write the values of a model, each with its units, and its parts as groups."""
    for name, value in model.items():
        if isinstance(value, Mapping):
            _write_model(nexus.group(group, name, "NXcollection"), value, unit)
        elif isinstance(value, str):
            nexus.field(group, name, value)
        else:
            numbers = np.asarray(value)
            units = unit_of(name, unit) if numbers.dtype.kind == "f" else None
            nexus.field(group, name, numbers.astype(np.uint8) if numbers.dtype == bool else numbers, units)


def _read_model(group: h5py.Group) -> dict[str, Any]:
    """Return the values of a model in SI units."""
    values: dict[str, Any] = {}
    for name, member in group.items():
        if isinstance(member, h5py.Group):
            values[name] = _read_model(member)
        else:
            values[name] = member.asstr()[()] if h5py.check_string_dtype(member.dtype) else member[()]
    return values


def _select_events(recording: Recording, part: slice) -> Recording:
    """Return a part of a run with only the events of its samples, numbered from its first sample."""
    if part == nexus.EVERY:
        return recording
    events = zip(recording.event_sample.tolist(), recording.event_kind, recording.event_note, strict=True)
    events_inside = [
        (sample - part.start, kind, note) for sample, kind, note in events if part.start <= sample < part.stop
    ]
    samples, kinds, notes = zip(*events_inside, strict=True) if events_inside else ((), (), ())
    return replace(recording, event_sample=np.array(samples, np.uint32), event_kind=kinds, event_note=notes)


def load_statistics(path: Path) -> StickSlipStatistics:
    """Read the statistics of stick-slip back, or compute them for a stage of an earlier release.

    InputError as in `load`, and for a run that is not smoothed.
    """
    with store.open_run(path) as file, trust.damage(path):
        entry = file["entry"]
        if "smooth/statistics" in entry:
            stored = tree.read(entry, (*PARAMETERS, *STATISTICS), path)
            return StickSlipStatistics(
                **tree.select_part(stored, "statistics"),
                dropped_frames=stored.get("motion.dropped_frames", 0),
                events=tuple(SlipEvent(**row) for row in tree.rows(stored, "statistics.events")),
            )
    motion = load(path)
    if motion is None:
        raise InputError("is not smoothed yet", str(path), f"run 'process smooth {path.name}'")
    return from_kinematics(motion)


def _restore_loss(recording: Recording, first: int, last: int, counts: int, size: float | None = None) -> PositionStep:
    """Return a step of the position; steps without a size, of an earlier release, are lost counts."""
    metres = recording.rig.metres_per_count
    pitch = 1.0 if metres is None else abs(metres.value)
    return PositionStep(first, last, counts, counts * pitch if size is None else size)
