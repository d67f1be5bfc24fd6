"""From a recording to its motion, with its faults, sticks and slips, and the belt's speed.

`smooth` works in memory; `smooth_file` reads, smooths and writes a run block by block, whatever its length.  Both learn
from stretches of the record and apply that to its blocks (`processing.blocks`).  The rig's scene and its truth are
never read here.
"""

import logging
import time as clock
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from daq.runfile import store
from daq.runfile.nexus import EVERY
from processing import belt_motion, blocks, methods, stage
from processing.blocks import BlockFindings, BlockMotion, MotionModel, Stretches
from processing.model_values import restore
from processing.record import series
from processing.record.kinematics import Kinematics, SmoothingSummary
from processing.record.series import Series, Units
from processing.record.setting import Setting, parse_belt_speed, parse_window
from processing.record.stretches import survey
from stickslip.compute.arrays import Array, Integers
from stickslip.errors import InputError, nearest

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


logger = logging.getLogger(__name__)
REPAIRS = ("off", "flag", "fix")

BLOCK = 2**16  # samples kept at a time: memory grows with it (200 to 250 MB), and CPU time for margins falls
MARGIN = 2**12, 2**16  # samples that are also smoothed on either side of a block, at least and at most
MARGIN_SLIPS = 2.0  # slips in a margin, since its end cuts one and can hide the stick next to it
LARGE = 2**19  # samples: longer records are smoothed block by block; this length needs about 300 MB


def smooth(
    recording: "Recording",
    method: str = "auto",
    window: int | str = "auto",
    order: int | None = None,
    times: str = "recorded",
    belt_speed: float | str = "auto",
    repair_counts: str = "flag",
    model: Mapping[str, Any] | None = None,
) -> Kinematics:
    """Estimate position, velocity and acceleration from a recording; see `processing.smooth` for the parameters."""
    started = clock.process_time()
    _check_options(method, repair_counts)
    run = _Samples.of_recording(recording, times)
    if model:
        motion_model = restore(MotionModel, model, restore(Units, model["units"], Units()))
    else:
        motion_model, _ = _learn_model(run, method, window, order, belt_speed, repair_counts)
    margin, length = (0, run.number) if run.number <= LARGE else (_margin(motion_model), BLOCK)
    smoothed = list(_apply_in_blocks(run, length, margin, motion_model, repair_counts))
    findings = [block.findings for block in smoothed]
    header = blocks.join(motion_model, findings, recording.unit, recording.rig.belt_speed, fixed=repair_counts == "fix")
    columns: dict[str, Any] = {
        name: np.concatenate([block.columns[name] for block in smoothed]) for name in smoothed[0].columns
    }
    kinematics = Kinematics(recording=recording, times=times, **columns, **header, cpu_s=clock.process_time() - started)
    details = kinematics.recording.name, kinematics.method, len(kinematics.sticks), kinematics.cpu_s
    logger.info("smoothed %s: %s, %d sticks, %.2f s of CPU time", *details)
    return kinematics


def smooth_file(
    path: Path,
    method: str = "auto",
    window: int | str = "auto",
    order: int | None = None,
    times: str = "recorded",
    belt_speed: float | str = "auto",
    repair_counts: str = "flag",
    progress: Callable[[float], None] = lambda done: None,
    samples: slice = EVERY,
) -> SmoothingSummary:
    """Smooth ``samples`` of a run file block by block and write the stage into it, with the same phases as `smooth`.

    ``progress`` is called with the number of samples done.
    """
    started = clock.process_time()
    _check_options(method, repair_counts)
    with store.open_reader(path, samples) as reader:
        run = _Samples.of_file(reader, times)
        model, recording = _learn_model(run, method, window, order, belt_speed, repair_counts)
    belt = belt_motion.has_belt_encoder(recording)
    summaries: list[SmoothingSummary] = []

    def write(entry: h5py.Group) -> None:
        findings: list[BlockFindings] = []
        table = stage.begin(entry, run.number, recording.unit, belt=belt)
        done = 0
        with store.open_reader(path, samples) as reader:
            again = replace(run, load=reader.load, positions=reader.positions)
            for block in _apply_in_blocks(again, BLOCK, _margin(model), model, repair_counts):
                findings.append(block.findings)
                stage.fill(table, done, block.columns)
                done += block.findings.samples
                progress(done)
        header = blocks.join(model, findings, recording.unit, recording.rig.belt_speed, fixed=repair_counts == "fix")
        summary = SmoothingSummary(**header, times=times, cpu_s=clock.process_time() - started)
        summaries.append(summary)
        stage.finish(entry, summary, recording.digest, samples)

    store.extend(path, "smooth", write, default="smooth")
    return summaries[0]


@dataclass(frozen=True, eq=False)
class _Samples:
    """The samples of a run, in memory or in a file, of which some are read at a time."""

    number: int
    load: "Callable[[slice], Recording]"
    positions: Callable[[slice], Array]  # m or counts
    first: "Recording"  # the first sample, which positions are relative to
    axis: Array | None  # even times of all samples, s; None for the recorded ones

    @classmethod
    def of_recording(cls, recording: "Recording", times: str) -> "_Samples":
        data = series.from_recording(recording, times)  # refuses a record that cannot be smoothed
        part = partial(_take_part, replace(recording, time=data.time))
        return cls(data.time.size, part, recording.position.__getitem__, recording, None)

    @classmethod
    def of_file(cls, reader: store.RunReader, times: str) -> "_Samples":
        axis = series.read_nominal_times(reader) if times == "nominal" else None
        return cls(reader.samples, reader.load, reader.positions, reader.load(slice(0, 1)), axis)

    def read(self, part: slice) -> "tuple[Recording, Series]":
        """Return some of the samples."""
        recording = self.load(part)
        return recording, series.from_recording(
            recording if self.axis is None else replace(recording, time=self.axis[part]), start=self.first
        )


def _margin(model: MotionModel) -> int:
    """Return how many samples are also smoothed on either side of a block."""
    return int(np.clip(max(2 * model.window, MARGIN_SLIPS * model.slip), *MARGIN))


def _apply_in_blocks(run: _Samples, length: int, margin: int, model: MotionModel, repair: str) -> Iterator[BlockMotion]:
    """Smooth a record in blocks of ``length`` samples, each with ``margin`` samples on either side."""
    findings: list[BlockFindings] = []
    for begin in range(0, run.number, length):
        end, low = min(begin + length, run.number), max(begin - margin, 0)
        part, data = run.read(slice(low, min(end + margin, run.number)))
        before = blocks.steps_before(findings, int(part.segment[0]), low)
        block = blocks.apply(part, data, slice(begin - low, end - low), low, model, repair=repair, before=before)
        findings.append(block.findings)
        yield block


def _check_options(method: str, repair_counts: str) -> None:
    methods.check_method(method)
    if repair_counts not in REPAIRS:
        raise InputError(f"is {repair_counts!r}", "--repair-counts", nearest(repair_counts, REPAIRS))


def _learn_model(
    run: _Samples, method: str, window: int | str, order: int | None, belt_speed: float | str, repair_counts: str
) -> "tuple[MotionModel, Recording]":
    """Return the model of a record, and the recording of the stretches that it was learned from."""
    record = survey(run.positions, run.number)
    requested_setting = Setting(None if window == "auto" else 0, order)
    for least in methods.sample_counts(method, requested_setting):
        picked_stretches = record.stretches(least)
        recording, data, number = _join_parts([run.read(stretch) for stretch in picked_stretches], picked_stretches)
        units = record.units(data.interval, float(data.time[0]))
        stretches = Stretches(recording, data, number, run.positions, record, units)
        setting = _parse_setting(window, order, belt_speed, data, recording.unit)
        model = blocks.learn(stretches, method, setting, steps=repair_counts != "off")
        if model.method.sticks is not None or data.time.size == run.number:
            break
    return model, recording


def _parse_setting(window: int | str, order: int | None, belt_speed: float | str, data: Series, unit: str) -> Setting:
    speed = parse_belt_speed(belt_speed)
    if speed is not None and unit != "m":
        raise InputError(
            f"{speed:g} m/s, but the positions are in counts (no metres per count)",
            "--belt-speed",
            "use 'auto', or add metres_per_count to a rig.toml, then run: daq replay RUN.h5 --rig rig.toml -o NEW.h5",
        )
    return replace(parse_window(window, order, data), belt_speed=speed)


def _take_part(recording: "Recording", samples: slice) -> "Recording":
    count, belt, raw = recording.count, recording.belt_count, recording.raw
    return replace(
        recording,
        time=recording.time[samples],
        position=recording.position[samples],
        count=None if count is None else count[samples],
        raw=None
        if raw is None
        else replace(raw, **{name: sent[samples] for name, sent in vars(raw).items() if sent is not None}),
        segment=recording.segment[samples],
        belt_count=None if belt is None else belt[samples],
    )


def _join_parts(parts: "list[tuple[Recording, Series]]", slices: list[slice]) -> "tuple[Recording, Series, Integers]":
    """Return the parts of a record, its ``slices``, joined into one, and the samples' numbers."""
    recording, data = parts[0]
    number = np.concatenate([np.arange(part.start, part.stop) for part in slices])
    if len(parts) > 1:
        pieces, offset = [], 0
        for _, part in parts:
            pieces += [slice(piece.start + offset, piece.stop + offset) for piece in part.pieces]
            offset += part.time.size
        belts = [part.belt_count for part, _ in parts if part.belt_count is not None]
        recording = replace(
            recording,
            time=np.concatenate([part.time for _, part in parts]),
            position=np.concatenate([part.position for part, _ in parts]),
            count=None,
            segment=np.concatenate([np.full(part.time.size, k, np.uint16) for k, (_, part) in enumerate(parts)]),
            belt_count=np.concatenate(belts) if belts else None,
        )
        data = replace(
            data,
            time=recording.time,
            position=np.concatenate([part.position for _, part in parts]),
            interval=float(np.median([part.interval for _, part in parts])),
            pieces=tuple(pieces),
        )
    return recording, data, number
