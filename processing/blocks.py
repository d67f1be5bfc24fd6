"""Learn from a record how to smooth its motion, apply that to each block of it, and join the blocks.

`learn` returns the `MotionModel` of a record, from stretches that represent it: noise levels, thresholds and speeds.
`apply` smooths a block with some samples on either side, and uses nothing else: sticks and slips do not depend on where
blocks begin, and a smoothing can be repeated from its model.  A record in memory is one block.  `join` combines the
findings of the blocks: a few numbers for each stick and slip, so that memory does not grow with the record.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from processing import methods
from processing.belt_motion import BeltNoise, BeltRecord, learn_noise, smooth_belt
from processing.defects import faults, frames
from processing.defects.faults import CheckedRecord
from processing.defects.frames import belt_findings, drift_finding, sensor_findings, step_findings
from processing.kalman import white_jerk
from processing.methods import MethodModel
from processing.model_values import values_in_si
from processing.record.motion import (
    DERIVATIVES,
    BeltMotion,
    Corner,
    Fault,
    Finding,
    Motion,
    Phase,
    PhaseSegmentation,
    VelocityStep,
)
from processing.record.series import PositionStep, Series, Units, measured_in, speed_in
from processing.record.setting import Setting
from processing.record.stretches import Survey, moving_samples
from processing.stick_slip import plateaus
from processing.stick_slip.plateaus import segment_at_corners
from stickslip.compute.arrays import Array, Integers
from stickslip.units import Measured

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


PARTS = 8  # of a block, whose means show a drift
LONGEST = 2**16  # samples of the longest window of a smoother


@dataclass(frozen=True, eq=False)
class Stretches:
    """The stretches that represent a record, as one series."""

    recording: "Recording"
    data: Series
    number: Integers  # of each sample in the record
    positions: Callable[[slice], Array]  # returns a slice of all positions of the record, m
    seen: Survey  # of the record
    units: Units  # of the record


@dataclass(frozen=True, eq=False)
class MotionModel:
    """The model of a record: all that is needed to smooth a block of it."""

    units: Units  # of the record, and of all fields that follow
    interval: float  # median sample interval
    moving: tuple[int, int]  # first and last sample of the motion of the record
    faults: faults.FaultModel
    method: MethodModel
    rule: plateaus.PlateauRule | None  # for finding sticks in the motion; None if the method finds them itself
    belt_speed: float  # from the sticks, signed; NaN without sticks
    belt_noise: BeltNoise | None  # of a belt with an encoder
    # the record without its faults, reused if it was learned from as a whole; not stored
    checked: CheckedRecord | None = field(default=None, metadata={"stored": False})

    @property
    def window(self) -> int:
        """Samples that the method smooths over."""
        return self.method.window or white_jerk.equivalent_window(self.method.jerk.rho(self.interval), LONGEST)

    @property
    def slip(self) -> float:
        """Samples of a usual slip; 0 if the method does not search for sticks, or finds none."""
        return 0.0 if self.method.sticks is None else self.method.sticks.slip / self.interval

    @property
    def plateau_speed(self) -> float:
        """Common speed of the plateaus, m/s; NaN without plateaus."""
        return self.units.of(1, -1) * (self.belt_speed if self.rule is None else self.rule.speed)


@dataclass(frozen=True, eq=False)
class BlockFindings:
    """The findings in a block, by the samples' numbers in the record."""

    phases: tuple[Phase, ...]  # cut off at the ends of the block
    continues: bool  # whether the first phase continues one of the block before
    faults: tuple[Fault, ...]
    steps: tuple[PositionStep, ...]
    step_segments: tuple[int, ...]  # segment number of each step of the position
    kicks: tuple[VelocityStep, ...]
    corners: tuple[Corner, ...]
    step_sums: Array  # `processing.defects.frames.step_sums`; zeros where a board's sample numbers show missing samples
    means: list[tuple[float, float]]  # time, s, and position, m, of parts of the block
    samples: int
    ends: tuple[float, float]  # times of the first and the last sample, s
    window: int
    order: int
    belt_speed: float  # m/s


@dataclass(frozen=True, eq=False)
class BlockMotion:
    columns: dict[str, Array]  # time, position, velocity, acceleration, errors, and belt velocity if measured, by name
    findings: BlockFindings


def learn(stretches: Stretches, method: str, setting: Setting, *, steps: bool) -> MotionModel:
    """Learn the model of a record; ``steps`` tells whether to search for steps of the position."""
    recording, units, record = stretches.recording, stretches.units, stretches.seen
    data, length = stretches.data.in_units(units), units.length_unit
    fault_model, checked = faults.learn(data, recording.segment, steps=steps)
    slack = plateaus.slack_at_rest(data.pitch, record.travel / abs(length), fault_model.noise)
    moving = moving_samples(lambda part: stretches.positions(part) / length, record.n, slack)
    setting = replace(setting, belt_speed=speed_in(units, setting.belt_speed))
    clean_series = replace(checked.series, moving=_motion_span(data.time, stretches.number, moving))
    checked = replace(checked, series=clean_series)
    kept_series = clean_series.select(checked.kept) if checked.faults else clean_series
    method_model = methods.learn(method, clean_series, setting, fault_model.noise)
    belt = BeltRecord.of(recording, checked.kept, kept_series, units)
    noise = None if belt is None else learn_noise(belt)
    whole_record = checked if clean_series.time.size == record.n else None
    model = MotionModel(units, data.interval, moving, fault_model, method_model, None, math.nan, noise, whole_record)
    if whole_record is None:
        model = replace(model, method=replace(method_model, first_pass=None))
    if method_model.sticks is not None:
        return replace(model, belt_speed=method_model.sticks.speed)
    motion = methods.apply(kept_series, method_model)
    belt_motion = _smooth_belt(belt, model, motion, kept_series)
    rule, _, speed = plateaus.learn(kept_series, motion, method_model.stated, belt_motion)
    return replace(model, rule=rule, belt_speed=speed)


def apply(
    recording: "Recording",
    data: Series,
    samples: slice,
    first_number: int,
    model: MotionModel,
    *,
    repair: str,
    before: float = 0.0,
) -> BlockMotion:
    """Smooth one block of a record, the ``samples`` of a recording that has neighbouring ones on either side.

    ``first_number`` is the number of the first neighbour in the record, and ``before`` the sum of the steps of the
    position before it in its segment, m.  Steps are removed from the position if ``repair`` is "fix".
    """
    units, recorded = model.units, data.time[samples]
    data = data.in_units(units)
    span = _motion_span(data.time, first_number + np.arange(data.time.size), model.moving)
    data = replace(data, interval=model.interval, moving=span)
    if model.checked is not None and model.checked.series.time.size == data.time.size:
        checked = model.checked
    else:
        checked = faults.find(data, recording.segment, model.faults, first_number)
    clean_series = checked.series
    motion = methods.apply(clean_series, model.method)
    belt = _smooth_belt(
        BeltRecord.of(recording, np.ones(clean_series.time.size, bool), clean_series, units),
        model,
        motion,
        clean_series,
    )
    segmentation = _segment_motion(recording, clean_series, motion, belt, model)
    phases = segmentation.phases
    columns = {"time": recorded}
    for power, name in enumerate(DERIVATIVES):
        unit = units.of(1, -power)
        columns |= {name: getattr(motion, name)[samples] * unit}
        columns |= {f"{name}_errors": getattr(motion, f"{name}_errors")[samples] * abs(unit)}
    if repair == "fix":
        segment = recording.segment
        columns["position"] = columns["position"] - np.where(segment[samples] == segment[0], before, 0.0)
    else:
        columns["position"] = columns["position"] + checked.offset[samples] * units.length_unit
    if belt is not None:
        columns["belt_velocity"] = belt.velocity[samples] * units.of(1, -1)
        columns["belt_velocity_errors"] = belt.velocity_errors[samples] * abs(units.of(1, -1))
    steps = tuple(step for step in checked.steps if samples.start <= step.first < samples.stop)
    parts = [part for part in np.array_split(np.arange(recorded.size), PARTS) if part.size]
    numbered = recording.raw is not None
    return BlockMotion(
        columns,
        BlockFindings(
            phases=tuple(
                _cut_phase(phase, data, samples, first_number, units) for phase in phases if _overlaps(phase, samples)
            ),
            continues=any(phase.first < samples.start <= phase.last for phase in phases),
            faults=tuple(
                Fault(
                    max(fault.first, samples.start) + first_number,
                    min(fault.last, samples.stop - 1) + first_number,
                    fault.kind,
                )
                for fault in checked.faults
                if _overlaps(fault, samples)
            ),
            steps=tuple(_convert_step(step, first_number, units) for step in steps),
            step_segments=tuple(int(recording.segment[step.first]) for step in steps),
            kicks=tuple(
                VelocityStep(kick.sample + first_number, kick.step * units.of(1, -1))
                for kick in checked.kicks
                if samples.start <= kick.sample < samples.stop
            ),
            corners=_select_corners(motion, data, samples, units),
            # The sample numbers of a board show where samples are missing.  Steps may be frames lost in fast motion.
            step_sums=np.zeros(frames.SUMS)
            if numbered
            else frames.step_sums(
                replace(clean_series, position=clean_series.position + checked.offset),
                samples,
                model.faults.noise,
                model.faults.step,
            ),
            means=[(float(recorded[k].mean()), float(columns["position"][k].mean())) for k in parts],
            samples=samples.stop - samples.start,
            ends=(float(recorded[0]), float(recorded[-1])),
            window=motion.window,
            order=motion.order,
            belt_speed=segmentation.belt_speed * units.of(1, -1),
        ),
    )


def join(
    model: MotionModel, blocks: Sequence[BlockFindings], unit: str, stated: Measured | None, *, fixed: bool
) -> dict[str, Any]:
    """Return the fields of `SmoothingSummary` from the findings of the blocks, in order.

    ``stated`` is the rig's belt speed, m/s; ``fixed`` tells whether steps were removed from the position.
    """
    phases: list[Phase] = []
    for block in blocks:
        block_phases = list(block.phases)
        if (
            block.continues
            and phases
            and phases[-1].kind == block_phases[0].kind
            and phases[-1].last + 1 == block_phases[0].first
        ):
            previous = phases.pop()
            block_phases[0] = replace(
                block_phases[0], start=previous.start, first=previous.first, start_sd=previous.start_sd
            )
        phases += block_phases
    stuck = sum(phase.kind == "stick" for phase in phases)
    windows = [(block.window, block.order) for block in blocks]
    window, order = max(set(windows), key=windows.count)
    steps = tuple(step for block in blocks for step in block.steps)
    block_faults = tuple(fault for block in blocks for fault in block.faults)
    frame_count = frames.count_frames(np.sum([block.step_sums for block in blocks], axis=0))
    speeds = [block.belt_speed for block in blocks if math.isfinite(block.belt_speed)]
    return {
        "method": model.method.method,
        "window": window,
        "order": order,
        "belt_speed": float(np.median(speeds)) if speeds else math.nan,
        "plateau_speed": model.plateau_speed,
        "phases": tuple(phases),
        "losses": steps,
        "kicks": tuple(kick for block in blocks for kick in block.kicks),
        "corners": tuple(corner for block in blocks for corner in block.corners),
        "faults": block_faults,
        "dropped_frames": frame_count.lost,
        "findings": (
            *sensor_findings(block_faults, frame_count, sum(block.samples for block in blocks)),
            *step_findings(list(steps), frame_count, unit, repaired=fixed),
            *([] if stuck > 1 else _find_drift(blocks, unit)),
            *belt_findings(stated, model.plateau_speed if stuck else math.nan, unit),
        ),
        "noise": model.faults.noise * abs(model.units.length_unit),
        "repaired": fixed and bool(steps),
        "samples": sum(block.samples for block in blocks),
        "span": blocks[-1].ends[1] - blocks[0].ends[0],
        "unit": unit,
        "belt_counted": model.belt_noise is not None,
        "model": values_in_si(model, model.units),
    }


def steps_before(blocks: Sequence[BlockFindings], segment: int, sample: int) -> float:
    """Return the sum of the steps of the position in a segment before a sample, m."""
    return sum(
        step.size
        for block in blocks
        for step, step_segment in zip(block.steps, block.step_segments, strict=True)
        if step_segment == segment and step.first < sample
    )


def _motion_span(time: Array, number: Integers, moving: tuple[int, int]) -> tuple[float, float]:
    """Return the times, s, of the first and last moving sample, from some samples of these numbers; else infinite."""
    first, last = np.searchsorted(number, moving[0]), np.searchsorted(number, moving[1], side="right") - 1
    begin = -math.inf if moving[0] <= number[0] else float(time[first]) if first < number.size else math.inf
    end = math.inf if moving[1] >= number[-1] else float(time[last]) if last >= 0 else -math.inf
    return begin, end


def _smooth_belt(belt: BeltRecord | None, model: MotionModel, motion: Motion, kept_series: Series) -> BeltMotion | None:
    if belt is None or model.belt_noise is None:
        return None
    return smooth_belt(belt, model.belt_noise, motion, model.method, kept_series.pitch)


def _segment_motion(
    recording: "Recording", kept_series: Series, motion: Motion, belt: BeltMotion | None, model: MotionModel
) -> PhaseSegmentation:
    measured = measured_in(model.units, recording.rig.belt_speed if recording.unit == "m" else None)
    stated, level = model.method.stated, model.belt_speed
    if model.rule is not None:
        return plateaus.segment(kept_series, motion, model.rule, level, measured, stated, belt)
    moving = plateaus.in_motion(kept_series)
    segmentation = segment_at_corners(kept_series, motion, moving, level, stated, measured)
    return segmentation if belt is None or stated is not None else replace(segmentation, belt_speed=belt.speed(moving))


def _overlaps(interval: Phase | Fault, samples: slice) -> bool:
    return bool(interval.first < samples.stop and interval.last >= samples.start)


def _cut_phase(phase: Phase, data: Series, samples: slice, first_number: int, units: Units) -> Phase:
    """Return the part of a phase that lies in a block, in SI units."""
    first, last = max(phase.first, samples.start), min(phase.last, samples.stop - 1)
    cut_before, cut_behind = first > phase.first, last < phase.last
    return Phase(
        phase.kind,
        units.start + units.time_unit * (float(data.time[first]) if cut_before else phase.start),
        units.start + units.time_unit * (float(data.time[last]) if cut_behind else phase.end),
        first + first_number,
        last + first_number,
        math.inf if cut_before else units.time_unit * phase.start_sd,
        math.inf if cut_behind else units.time_unit * phase.end_sd,
    )


def _select_corners(motion: Motion, data: Series, samples: slice, units: Units) -> tuple[Corner, ...]:
    """Return the corners in a block, in SI units; one between blocks belongs to the block of the sample after it."""
    low = float(data.time[samples.start - 1]) if samples.start else -math.inf
    high = float(data.time[samples.stop - 1]) if samples.stop < data.time.size else math.inf
    return tuple(
        Corner(units.start + units.time_unit * corner.time, units.time_unit * corner.sd, corner.what)
        for corner in motion.corners
        if low < corner.time <= high
    )


def _convert_step(step: PositionStep, first_number: int, units: Units) -> PositionStep:
    """Return a step of the position by the numbers of the record, in SI units."""
    direction = 1 if units.length_unit > 0 else -1
    return PositionStep(
        step.first + first_number, step.last + first_number, direction * step.counts, step.size * units.length_unit
    )


def _find_drift(blocks: Sequence[BlockFindings], unit: str) -> list[Finding]:
    """Return the drift of a record that moves but never slips."""
    means = [mean for block in blocks for mean in block.means]
    if len(means) < PARTS:
        return []
    time, position = np.array(means).T
    finding = drift_finding(time, position, unit)
    return [] if finding is None else [finding]
