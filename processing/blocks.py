"""Learn from a record how its motion is to be smoothed, apply that to each block of it, and join the blocks.

`learn` takes stretches that represent a record and returns its `MotionModel`: noise levels, thresholds and speeds.
`apply` smooths a block with some samples on either side, and looks at nothing else: sticks and slips do not depend on
where blocks begin, and a smoothing can be repeated from its model.  A record in memory is one block.  `join` puts
together what was found in the blocks: a few numbers for each stick and slip, so that memory does not grow with the
record.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from processing.belt_motion import BeltNoise, BeltRecord, learn_noise, smooth_belt
from processing.defects import faults, frames
from processing.defects.faults import CheckedRecord
from processing.defects.findings import belt_findings, drift_finding, sensor_findings, step_findings
from processing.kalman import white_jerk
from processing.methods import registry
from processing.methods.method_model import MethodModel
from processing.model_values import values
from processing.record.finding import Finding
from processing.record.motion import (
    DERIVATIVES,
    BeltMotion,
    Corner,
    Fault,
    Motion,
    Phase,
    PhaseSegmentation,
    VelocityStep,
)
from processing.record.position_steps import PositionStep
from processing.record.series import Series
from processing.record.setting import Setting
from processing.record.stretches import Survey, moving_samples
from processing.record.units import Units, measured_in, speed_in
from processing.segmentation import plateaus
from processing.segmentation.phase_layout import segment_at_corners
from stickslip.compute.arrays import Array, Integers
from stickslip.units import Measured

if TYPE_CHECKING:
    from daq.runfile.recording import Recording

PARTS = 8  # of a block, whose means show a drift
LONGEST = 2**16  # samples: no smoother's window counts as longer


@dataclass(frozen=True, eq=False)
class Stretches:
    """The stretches that represent a record, as one.

    ``number`` (m,) are the samples' numbers in the record, ``positions`` returns a slice of all its positions, m,
    ``seen`` is how these move, and ``units`` are those of the record.
    """

    recording: "Recording"
    data: Series
    number: Integers
    positions: Callable[[slice], Array]
    seen: Survey
    units: Units


@dataclass(frozen=True, eq=False)
class MotionModel:
    """What is learned from a record: all that smoothing a block of it needs."""

    units: Units  # of the record: those of all that follows
    interval: float  # median sample interval
    moving: tuple[int, int]  # (int, int) samples of the first motion of the record and of the last one
    faults: faults.FaultModel  # what faults of the record are judged by
    method: MethodModel  # the method that runs, and what it learned
    # how sticks show in the motion that the method makes; None where the method finds them itself
    rule: plateaus.PlateauRule | None
    belt_speed: float  # of the belt by its sticks, signed; NaN where there are none
    belt_noise: BeltNoise | None  # of a belt with an encoder
    # the record and its faults where all of it was learned from, which is not stored: in one block it is smoothed from
    # there
    checked: CheckedRecord | None = field(default=None, metadata={"stored": False})

    @property
    def window(self) -> int:
        """Samples that the method smooths over."""
        return self.method.window or white_jerk.equivalent_window(self.method.jerk.rho(self.interval), LONGEST)

    @property
    def slip(self) -> float:
        """Samples of a usual slip; 0 where the method does not look for sticks, or finds none."""
        return 0.0 if self.method.sticks is None else self.method.sticks.slip / self.interval

    @property
    def plateau_speed(self) -> float:
        """Common speed of the plateaus, m/s; NaN without plateaus."""
        return self.units.of(1, -1) * (self.belt_speed if self.rule is None else self.rule.speed)


@dataclass(frozen=True, eq=False)
class BlockFindings:
    """What was found in a block, by the samples' numbers in the record."""

    phases: tuple[Phase, ...]  # cut off at the ends of the block
    continues: bool  # whether the first phase goes on from the block before
    faults: tuple[Fault, ...]
    steps: tuple[PositionStep, ...]
    step_segments: tuple[int, ...]  # segment of every step of the position
    kicks: tuple[VelocityStep, ...]
    corners: tuple[Corner, ...]
    step_sums: Array  # `processing.defects.frames.step_sums`; zeros where a board's sample numbers show missing samples
    means: list[tuple[float, float]]  # Time, s, and position, m, of parts of the block
    samples: int
    window: int
    order: int
    belt_speed: float  # m/s


@dataclass(frozen=True, eq=False)
class BlockMotion:
    """The motion of the k samples of a block, and what was found in it.

    ``columns`` are arrays of shape (k,) by name: time, position, velocity, acceleration, their errors, and the belt's
    velocity where it has an encoder.
    """

    columns: dict[str, Array]
    found: BlockFindings


def learn(stretches: Stretches, method: str, setting: Setting, *, steps: bool) -> MotionModel:
    """Learn the model of a record.

    stretches: Those that represent the record.
    method: Name in `processing.methods.registry`.
    setting: Window, order and stated belt speed.
    steps: Whether to look for steps of the position.
    """
    recording, units, record = stretches.recording, stretches.units, stretches.seen
    data, length = stretches.data.in_units(units), units.length_unit
    known, checked = faults.learn(data, recording.segment, steps=steps)
    slack = plateaus.slack_at_rest(data.pitch, record.travel / abs(length), known.noise)
    moving = moving_samples(lambda part: stretches.positions(part) / length, record.n, slack)
    setting = replace(setting, belt_speed=speed_in(units, setting.belt_speed))
    sound = replace(checked.series, moving=_span(data.time, stretches.number, moving))
    checked = replace(checked, series=sound)
    seen = sound.taken(checked.kept) if checked.faults else sound
    how = registry.learn(method, sound, setting, known.noise)
    belt = BeltRecord.of(recording, checked.kept, seen, units)
    noise = None if belt is None else learn_noise(belt)
    whole = checked if sound.time.size == record.n else None
    model = MotionModel(units, data.interval, moving, known, how, None, math.nan, noise, whole)
    if whole is None:
        model = replace(model, method=replace(how, known=None))
    if how.sticks is not None:
        return replace(model, belt_speed=how.sticks.speed)
    motion = registry.apply(seen, how)
    rides = _belt_motion(belt, model, motion, seen)
    rule, speed = plateaus.learn(seen, motion, how.stated, rides)
    return replace(model, rule=rule, belt_speed=speed)


def apply(
    recording: "Recording", data: Series, own: slice, low: int, model: MotionModel, *, repair: str, before: float = 0.0
) -> BlockMotion:
    """Smooth one block of a record.

    recording, data: The block with its neighbouring samples, m in all.
    own: The k samples of the block among them.
    low: Number of the first of the m samples in the record.
    model: Of the record.
    repair: Whether the position is without its steps ("fix") or as it was read.
    before: Sum of the steps of the position before the first of the m samples, in its segment, m.
    """
    units, recorded = model.units, data.time[own]
    data = data.in_units(units)
    span = _span(data.time, low + np.arange(data.time.size), model.moving)
    data = replace(data, interval=model.interval, moving=span)
    if model.checked is not None and model.checked.series.time.size == data.time.size:
        checked = model.checked
    else:
        checked = faults.find(data, recording.segment, model.faults, low)
    sound = checked.series
    motion = registry.apply(sound, model.method)
    belt = _belt_motion(BeltRecord.of(recording, np.ones(sound.time.size, bool), sound, units), model, motion, sound)
    found = _phases(recording, sound, motion, belt, model)
    phases = found.phases
    columns = {"time": recorded}
    for power, name in enumerate(DERIVATIVES):
        unit = units.of(1, -power)
        columns |= {name: getattr(motion, name)[own] * unit}
        columns |= {f"{name}_errors": getattr(motion, f"{name}_errors")[own] * abs(unit)}
    if repair == "fix":
        segment = recording.segment
        columns["position"] = columns["position"] - np.where(segment[own] == segment[0], before, 0.0)
    else:
        columns["position"] = columns["position"] + checked.offset[own] * units.length_unit
    if belt is not None:
        columns["belt_velocity"] = belt.velocity[own] * units.of(1, -1)
        columns["belt_velocity_errors"] = belt.velocity_errors[own] * abs(units.of(1, -1))
    steps = tuple(step for step in checked.steps if own.start <= step.first < own.stop)
    parts = [part for part in np.array_split(np.arange(recorded.size), PARTS) if part.size]
    numbered = recording.raw is not None
    return BlockMotion(
        columns,
        BlockFindings(
            phases=tuple(_cut(phase, data, own, low, units) for phase in phases if _meets(phase, own)),
            continues=any(phase.first < own.start <= phase.last for phase in phases),
            faults=tuple(
                Fault(max(fault.first, own.start) + low, min(fault.last, own.stop - 1) + low, fault.kind)
                for fault in checked.faults
                if _meets(fault, own)
            ),
            steps=tuple(_in_si(step, low, units) for step in steps),
            step_segments=tuple(int(recording.segment[step.first]) for step in steps),
            kicks=tuple(
                VelocityStep(kick.sample + low, kick.step * units.of(1, -1))
                for kick in checked.kicks
                if own.start <= kick.sample < own.stop
            ),
            corners=_corners(motion, data, own, units),
            # A board's sample numbers show where samples are missing.  Steps may be frames lost where the mass is fast.
            step_sums=np.zeros(frames.SUMS)
            if numbered
            else frames.step_sums(
                replace(sound, position=sound.position + checked.offset), own, model.faults.noise, model.faults.step
            ),
            means=[(float(recorded[k].mean()), float(columns["position"][k].mean())) for k in parts],
            samples=own.stop - own.start,
            window=motion.window,
            order=motion.order,
            belt_speed=found.belt_speed * units.of(1, -1),
        ),
    )


def join(
    model: MotionModel, blocks: Sequence[BlockFindings], unit: str, stated: Measured | None, *, fixed: bool
) -> dict[str, Any]:
    """Return what `SmoothingHeader` states of a record, from what was found in its blocks, in order.

    model: Of the record.
    blocks: In order.
    unit: Of the positions.
    stated: The rig's belt speed, m/s.
    fixed: Whether steps of the position were taken out of it.
    """
    phases: list[Phase] = []
    for block in blocks:
        own = list(block.phases)
        if block.continues and phases and phases[-1].kind == own[0].kind and phases[-1].last + 1 == own[0].first:
            begun = phases.pop()
            own[0] = replace(own[0], start=begun.start, first=begun.first, start_sd=begun.start_sd)
        phases += own
    stuck = sum(phase.kind == "stick" for phase in phases)
    windows = [(block.window, block.order) for block in blocks]
    window, order = max(set(windows), key=windows.count)
    steps = tuple(step for block in blocks for step in block.steps)
    every = tuple(fault for block in blocks for fault in block.faults)
    counted = frames.count_frames(np.sum([block.step_sums for block in blocks], axis=0))
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
        "faults": every,
        "dropped_frames": counted.lost,
        "findings": (
            *sensor_findings(every, counted, sum(block.samples for block in blocks)),
            *step_findings(list(steps), counted, unit, repaired=fixed),
            *([] if stuck > 1 else _drift(blocks, unit)),
            *belt_findings(stated, model.plateau_speed if stuck else math.nan, unit),
        ),
        "noise": model.faults.noise * abs(model.units.length_unit),
        "repaired": fixed and bool(steps),
        "model": values(model, model.units),
    }


def steps_before(blocks: Sequence[BlockFindings], segment: int, sample: int) -> float:
    """Return the sum of the steps of the position in a segment before a sample, m."""
    return sum(
        step.size
        for block in blocks
        for step, own in zip(block.steps, block.step_segments, strict=True)
        if own == segment and step.first < sample
    )


def _span(time: Array, number: Integers, moving: tuple[int, int]) -> tuple[float, float]:
    """Return when the motion between two samples of the record begins and ends, s, as seen from some of its samples.

    ``number`` (n,) are these samples' numbers; what lies before the first of them or behind the last is infinite.
    """
    first, last = np.searchsorted(number, moving[0]), np.searchsorted(number, moving[1], side="right") - 1
    begin = -math.inf if moving[0] <= number[0] else float(time[first]) if first < number.size else math.inf
    end = math.inf if moving[1] >= number[-1] else float(time[last]) if last >= 0 else -math.inf
    return begin, end


def _belt_motion(belt: BeltRecord | None, model: MotionModel, motion: Motion, seen: Series) -> BeltMotion | None:
    if belt is None or model.belt_noise is None:
        return None
    return smooth_belt(belt, model.belt_noise, motion, model.method, seen.pitch)


def _phases(
    recording: "Recording", seen: Series, motion: Motion, belt: BeltMotion | None, model: MotionModel
) -> PhaseSegmentation:
    """Return the sticks and slips of the samples ``seen``."""
    measured = measured_in(model.units, recording.rig.belt_speed if recording.unit == "m" else None)
    stated, level = model.method.stated, model.belt_speed
    if model.rule is not None:
        return plateaus.segment(seen, motion, model.rule, level, measured, stated, belt)
    moving = plateaus.in_motion(seen)
    found = segment_at_corners(seen, motion, moving, level, stated, measured)
    return found if belt is None or stated is not None else replace(found, belt_speed=belt.speed(moving))


def _meets(found: Phase | Fault, own: slice) -> bool:
    return bool(found.first < own.stop and found.last >= own.start)


def _cut(phase: Phase, data: Series, own: slice, low: int, units: Units) -> Phase:
    """Return the part of a phase that lies in a block, in SI units."""
    first, last = max(phase.first, own.start), min(phase.last, own.stop - 1)
    cut_before, cut_behind = first > phase.first, last < phase.last
    return Phase(
        phase.kind,
        units.start + units.time_unit * (float(data.time[first]) if cut_before else phase.start),
        units.start + units.time_unit * (float(data.time[last]) if cut_behind else phase.end),
        first + low,
        last + low,
        math.inf if cut_before else units.time_unit * phase.start_sd,
        math.inf if cut_behind else units.time_unit * phase.end_sd,
    )


def _corners(motion: Motion, data: Series, own: slice, units: Units) -> tuple[Corner, ...]:
    """Return the corners in a block, each up to and including the sample behind it, in SI units."""
    low = float(data.time[own.start - 1]) if own.start else -math.inf
    high = float(data.time[own.stop - 1]) if own.stop < data.time.size else math.inf
    return tuple(
        Corner(units.start + units.time_unit * corner.time, units.time_unit * corner.sd, corner.what)
        for corner in motion.corners
        if low < corner.time <= high
    )


def _in_si(step: PositionStep, low: int, units: Units) -> PositionStep:
    """Return a step of the position of the record, by the record's numbers, in SI units."""
    way = 1 if units.length_unit > 0 else -1
    return PositionStep(step.first + low, step.last + low, way * step.counts, step.size * units.length_unit)


def _drift(blocks: Sequence[BlockFindings], unit: str) -> list[Finding]:
    """Return the drift of a record that moves, and never slips."""
    means = [mean for block in blocks for mean in block.means]
    if len(means) < PARTS:
        return []
    time, position = np.array(means).T
    found = drift_finding(time, position, unit)
    return [] if found is None else [found]
