"""From a recording to its motion, with its faults, sticks and slips, and the belt's speed.

`smooth` works in memory; `smooth_file` reads, smooths and writes a run block by block, whatever its length.  Both learn
from stretches of the record and apply that to its blocks (`processing.blocks`).  The rig's scene and its truth are
never read here.
"""

import logging
import time as clock
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from daq.runfile import store
from daq.runfile.nexus import EVERY
from processing import belt_motion, blocks, stage
from processing.blocks import BlockFindings, BlockMotion, MotionModel, Stretches
from processing.methods import registry
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
    data = series.from_recording(recording, times)
    n, setting = data.time.size, (method, window, order, belt_speed, repair_counts)
    if model:
        motion_model = restore(MotionModel, model, restore(Units, model["units"], Units()))
    else:
        motion_model, _ = _learn_model(
            lambda samples: _take_part(recording, data, samples), recording.position.__getitem__, n, *setting
        )
    margin, length = (0, n) if n <= LARGE else (_margin(motion_model), BLOCK)

    def read(begin: int, end: int) -> "tuple[Recording, Series, int]":
        first, last = max(begin - margin, 0), min(end + margin, n)
        return (recording, data, 0) if last - first == n else (*_take_part(recording, data, slice(first, last)), first)

    smoothed = list(_apply_in_blocks(read, n, length, motion_model, repair_counts))
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
    with store.open_reader(path, samples) as run:
        n = run.samples
        setting = method, window, order, belt_speed, repair_counts
        start = run.load(slice(0, 1))
        model, recording = _learn_model(lambda part: _read_part(run, part, times, start), run.positions, n, *setting)
    belt = belt_motion.has_belt_encoder(recording)
    block_findings: list[BlockFindings] = []
    summaries: list[SmoothingSummary] = []

    def write(entry: h5py.Group) -> None:
        table = stage.begin(entry, n, recording.unit, belt=belt)
        with store.open_reader(path, samples) as run:
            reader = _Reader(run, times, _margin(model), start)
            done = 0
            for block in _apply_in_blocks(reader.read, n, BLOCK, model, repair_counts):
                block_findings.append(block.findings)
                stage.fill(table, done, block.columns)
                done += block.findings.samples
                progress(done)
        header = blocks.join(
            model, block_findings, recording.unit, recording.rig.belt_speed, fixed=repair_counts == "fix"
        )
        summary = SmoothingSummary(**header, times=times, cpu_s=clock.process_time() - started)
        summaries.append(summary)
        stage.finish(entry, summary, recording.digest, samples)

    store.extend(path, "smooth", write, default="smooth")
    return summaries[0]


def _margin(model: MotionModel) -> int:
    """Return how many samples are also smoothed on either side of a block."""
    return int(np.clip(max(2 * model.window, MARGIN_SLIPS * model.slip), *MARGIN))


def _apply_in_blocks(
    read: "Callable[[int, int], tuple[Recording, Series, int]]", n: int, length: int, model: MotionModel, repair: str
) -> Iterator[BlockMotion]:
    """Smooth a record of n samples in blocks of ``length``.

    ``read`` returns the samples from one number to another with their neighbours, and the number of the first of these.
    """
    findings: list[BlockFindings] = []
    for begin in range(0, n, length):
        end = min(begin + length, n)
        part, data, low = read(begin, end)
        before = blocks.steps_before(findings, int(part.segment[0]), low)
        block = blocks.apply(part, data, slice(begin - low, end - low), low, model, repair=repair, before=before)
        findings.append(block.findings)
        yield block


def _check_options(method: str, repair_counts: str) -> None:
    registry.check_method(method)
    if repair_counts not in REPAIRS:
        raise InputError(f"is {repair_counts!r}", "--repair-counts", nearest(repair_counts, REPAIRS))


def _learn_model(
    read: "Callable[[slice], tuple[Recording, Series]]",
    positions: Callable[[slice], Array],
    n: int,
    method: str,
    window: int | str,
    order: int | None,
    belt_speed: float | str,
    repair_counts: str,
) -> "tuple[MotionModel, Recording]":
    """Return the model of a record of n samples, and the recording of the stretches that it was learned from.

    ``read`` returns some of the samples, ``positions`` only their positions, m.
    """
    record = survey(positions, n)
    requested_setting = Setting(None if window == "auto" else 0, order)
    for least in registry.sample_counts(method, requested_setting):
        picked_stretches = record.stretches(least)
        recording, data, number = _join_parts([read(stretch) for stretch in picked_stretches], picked_stretches)
        units = record.units(data.interval, float(data.time[0]))
        stretches = Stretches(recording, data, number, positions, record, units)
        setting = _parse_setting(window, order, belt_speed, data, recording.unit)
        model = blocks.learn(stretches, method, setting, steps=repair_counts != "off")
        if model.method.sticks is not None or data.time.size == n:
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


def _read_part(run: store.RunReader, samples: slice, times: str, start: "Recording") -> "tuple[Recording, Series]":
    recording = run.load(samples)
    return recording, series.from_recording(recording, times, start=start)


def _take_part(recording: "Recording", data: Series, samples: slice) -> "tuple[Recording, Series]":
    count, belt, raw = recording.count, recording.belt_count, recording.raw
    part = replace(
        recording,
        time=data.time[samples],
        position=recording.position[samples],
        count=None if count is None else count[samples],
        raw=None
        if raw is None
        else replace(raw, **{name: sent[samples] for name, sent in vars(raw).items() if sent is not None}),
        segment=recording.segment[samples],
        belt_count=None if belt is None else belt[samples],
    )
    kept = np.zeros(data.time.size, bool)
    kept[samples] = True
    # The interval of these samples, as when a file is read block by block.
    return part, replace(data.select(kept), interval=float(np.median(np.diff(part.time))))


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


class _Reader:
    """Reads blocks of a run with ``margin`` samples on either side, on a common time axis and from a common origin."""

    def __init__(self, run: store.RunReader, times: str, margin: int, start: "Recording") -> None:
        self._run, self._times, self._margin, self._start = run, times, margin, start
        self._anchors: dict[int, tuple[float, int]] = {}
        self._grid = None
        n = run.samples
        if times == "nominal" and self._start.raw is None:
            # An import has no sample numbers, so its even grid depends on the whole record.
            self._grid = series.learn_grid(run, [max(begin - margin, 0) for begin in range(0, n, BLOCK)])

    def read(self, begin: int, end: int) -> "tuple[Recording, Series, int]":
        """Return samples begin..end-1 with their neighbours, and the number of the first of these."""
        first, last = max(begin - self._margin, 0), min(end + self._margin, self._run.samples)
        recording = self._run.load(slice(first, last))
        grid = None if self._grid is None else self._grid.times(first, recording.time)
        data = series.from_recording(recording, self._times, self._anchor(recording), grid, self._start)
        return recording, data, first

    def _anchor(self, recording: "Recording") -> tuple[float, int] | None:
        """Return time and number of the first sample of the first segment of a block."""
        if self._times != "nominal" or recording.raw is None:
            return None
        for segment in np.unique(recording.segment).tolist():
            first = int(np.argmax(recording.segment == segment))
            self._anchors.setdefault(segment, (float(recording.time[first]), int(recording.raw.sample[first])))
        return self._anchors[int(recording.segment[0])]
