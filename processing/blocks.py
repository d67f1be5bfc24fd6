"""One block of a record smoothed, and what is found in the blocks joined over the record.

A record in memory is one block.  A longer one is smoothed block by block, each with some samples on either side, of
which only the block itself is kept.  Noise levels, thresholds and speeds are estimated once, from stretches that
represent the record (`BlockSmoother.learn`), so that sticks and slips do not depend on where blocks begin.  Lost counts
and phases that cross a boundary are carried from block to block.  That takes a few numbers for each stick and slip;
otherwise memory does not grow with the record.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.compute.arrays import Array
from daq.runfile.rig import Measured
from processing import belt_motion
from processing.defects import frames, position_steps, velocity_steps
from processing.defects.findings import belt_findings, drift_finding, sensor_findings, step_findings
from processing.defects.sensor_faults import SoundRecord, without_faults
from processing.kalman import white_jerk
from processing.kalman.bridge import across_faults
from processing.methods import registry
from processing.record.estimates import RecordEstimates
from processing.record.finding import Finding
from processing.record.motion import BeltMotion, Fault, Motion, Phase, PhaseSegmentation, VelocityStep
from processing.record.position_steps import PositionStep, step_offsets, without_steps
from processing.record.series import Series
from processing.record.setting import Setting
from processing.record.stretches import moving_samples
from processing.segmentation import plateaus

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


PARTS = 8  # of a block, whose means show a drift
SOUND = 0.9  # share of the samples around a velocity step that must be positions; a bridged hole has a kink at its ends


class BlockSmoother:
    """Smooths the blocks of a record, in order.

    Parameters
    ----------
    method : str
        Name in `processing.methods.registry`.
    setting : Setting
        Window, order and stated belt speed, for all blocks alike.
    repair : {"off", "flag", "fix"}
        What to do about steps of the position: lost counts, or a datum that moved.
    """

    def __init__(self, method: str, setting: Setting, repair: str) -> None:
        self.method, self.setting, self.repair = method, setting, repair
        self._estimates = RecordEstimates()
        self._moving: tuple[int, int] | None = None
        self._interval = 0.0
        self._phases: list[Phase] = []
        self._losses: list[PositionStep] = []
        self._steps: list[VelocityStep] = []
        self._methods: dict[str, int] = {}
        self._windows: list[tuple[int, int]] = []
        self._belt_speeds: list[float] = []
        self._plateau_speeds: list[float] = []
        self._noises: list[float] = []
        self._faults: list[Fault] = []
        self._step_sums = np.zeros(frames.SUMS)
        self._samples = 0
        self._unit = ""
        self._stated_speed: Measured | None = None
        self._means: list[tuple[float, float]] = []
        self._offset = 0.0  # sum of the steps so far in this segment

    def learn(
        self, stretches: "tuple[Recording, Series]", positions: Callable[[slice], Array], n: int, travel: float
    ) -> int:
        """Estimate what all blocks share; return the window of the smoother in samples.

        Parameters
        ----------
        stretches : (Recording, Series)
            Those that represent the record (`learning_stretches`), as one.
        positions : callable
            Returns the positions of a slice of samples, m.
        n, travel : int, float
            Samples of the record, and how far it travels, m.
        """
        made = self._find(*stretches)
        self._estimates.close()
        self._interval = made.data.interval
        first, last = moving_samples(positions, n, plateaus.slack_at_rest(made.data.pitch, travel, made.sound.noise))
        least = plateaus.LEAST_STICK / self._interval
        if first <= last:
            first, last = first if first > least else 0, last if n - 1 - last > least else n - 1
        self._moving = first, last
        return made.motion.window

    def smooth(self, recording: "Recording", data: Series, own: slice, low: int = 0) -> dict[str, Any]:
        """Smooth one block.

        Parameters
        ----------
        recording, data : Recording, Series
            The block with its neighbouring samples, m in all.
        own : slice
            The k samples of the block among them.
        low : int
            Number of the first of the m samples in the record.

        Returns
        -------
        dict of arrays of shape (k,)
            time, position, velocity, acceleration, their errors, and the belt's velocity where it has an encoder.
        """
        if self._moving is not None:
            first, last = (own - low for own in self._moving)
            begin = -math.inf if first <= 0 else float(data.time[first]) if first < data.time.size else math.inf
            end = math.inf if last >= data.time.size - 1 else float(data.time[last]) if last >= 0 else -math.inf
            data = replace(data, interval=self._interval, moving=(begin, end))
        made = self._find(recording, data)
        sound, losses, offset, belt = made.sound, made.losses, made.offset, made.belt
        data, seen, motion, found = made.data, made.seen, made.motion, made.found
        phases = found.phases
        self._noises.append(sound.noise)
        if sound.faults:
            number = np.flatnonzero(sound.kept)
            phases = tuple(replace(own, first=int(number[own.first]), last=int(number[own.last])) for own in phases)
            jerk = self._estimates.once("jerk", lambda: white_jerk.fit(seen)).jerk
            motion = across_faults(data.time, sound.kept, motion, jerk)
        if self.repair == "fix":
            shift = -self._offset_before(recording, own, losses)
        else:
            shift = offset[own]
        columns = {
            "time": data.time[own],
            "position": motion.position[own] + shift,
            "velocity": motion.velocity[own],
            "acceleration": motion.acceleration[own],
            "position_errors": motion.position_errors[own],
            "velocity_errors": motion.velocity_errors[own],
            "acceleration_errors": motion.acceleration_errors[own],
        }
        if belt is not None:
            for name, values in (("belt_velocity", belt.velocity), ("belt_velocity_errors", belt.velocity_errors)):
                whole = np.interp(data.time, seen.time, values) if sound.faults else values
                columns[name] = whole[own]
        for fault in sound.faults:
            first, last = max(fault.first, own.start), min(fault.last, own.stop - 1)
            if first <= last:
                self._faults.append(Fault(first + low, last + low, fault.kind))
        if recording.raw is None:  # a board's sample numbers show where samples are missing
            self._step_sums += frames.step_sums(sound.bridged, own, sound.noise)
        for loss in losses:
            if own.start <= loss.first < own.stop:
                self._losses.append(replace(loss, first=loss.first + low, last=loss.last + low))
        for step in velocity_steps.velocity_steps(data):
            near = slice(max(step.sample - velocity_steps.AROUND, 0), step.sample + velocity_steps.AROUND)
            if own.start <= step.sample < own.stop and sound.kept[near].mean() > SOUND:
                self._steps.append(VelocityStep(step.sample + low, step.step))
        self._samples += own.stop - own.start
        self._unit, self._stated_speed = recording.unit, recording.rig.belt_speed
        for part in np.array_split(np.arange(own.start, own.stop), PARTS):
            if part.size:
                self._means.append((float(data.time[part].mean()), float(columns["position"][part - own.start].mean())))
        self._join(phases, data, low, own.start + low, own.stop + low)
        self._methods[motion.method] = self._methods.get(motion.method, 0) + own.stop - own.start
        self._windows.append((motion.window, motion.order))
        self._belt_speeds.append(found.belt_speed)
        self._plateau_speeds.append(found.plateau_speed)
        return columns

    def _find(self, recording: "Recording", data: Series) -> "BlockResult":
        """Find faults, losses, motion and phases of a block with its neighbouring samples."""
        estimates = self._estimates
        sound = without_faults(data, estimates.part("faults"))
        losses = position_steps.position_steps(sound.bridged, estimates.part("steps")) if self.repair != "off" else ()
        losses = tuple(loss for loss in losses if sound.kept[loss.first : loss.last + 1].all())
        offset = step_offsets(recording.segment, losses)
        data = without_steps(sound.bridged, offset)
        seen = without_steps(sound.series, offset[sound.kept])
        motion = registry.estimate(self.method, seen, self.setting, estimates)
        belt = belt_motion.smooth_belt(recording, sound.kept, seen, motion, estimates)
        measured = recording.rig.belt_speed if recording.unit == "m" else None
        found = plateaus.segment(seen, motion, measured, self.setting.belt_speed, belt, estimates.part("phases"))
        return BlockResult(data, sound, losses, offset, seen, motion, belt, found)

    @property
    def sticks(self) -> list[Phase]:
        """The sticks found so far."""
        return [phase for phase in self._phases if phase.kind == "stick"]

    def header(self) -> dict[str, Any]:
        """Return what `SmoothingHeader` states: the method and window of most samples, the median belt speed."""
        window, order = max(set(self._windows), key=self._windows.count)
        faults, noise, plateau_speed = tuple(self._faults), self._noise(), _median(self._plateau_speeds)
        counted = frames.count_frames(self._step_sums)
        return {
            "method": max(self._methods, key=lambda name: self._methods[name]),
            "window": window,
            "order": order,
            "belt_speed": _median(self._belt_speeds),
            "plateau_speed": plateau_speed,
            "phases": tuple(self._phases),
            "losses": tuple(self._losses),
            "kicks": tuple(self._steps),
            "faults": faults,
            "dropped_frames": counted.lost,
            "findings": (
                *sensor_findings(faults, counted, self._samples),
                *step_findings(self._losses, counted, self._unit, repaired=self.repair == "fix"),
                *self._drift(),
                *belt_findings(self._stated_speed, plateau_speed if self.sticks else math.nan, self._unit),
            ),
            "noise": noise,
            "repaired": self.repair == "fix" and bool(self._losses),
        }

    def _drift(self) -> list[Finding]:
        """Return the drift of a record that moves, and never slips."""
        if len(self._means) < PARTS or len(self.sticks) > 1:
            return []
        time, position = np.array(self._means).T
        found = drift_finding(time, position, self._unit)
        return [] if found is None else [found]

    def _noise(self) -> float:
        """Return the median noise of the blocks in which anything changes."""
        changing = [noise for noise in self._noises if noise > 0]
        return float(np.median(changing)) if changing else 0.0

    def _offset_before(self, recording: "Recording", own: slice, losses: tuple[PositionStep, ...]) -> Array:
        """Return the steps in the segment before the first sample read, for every sample of the block."""
        segment = recording.segment[own]
        earlier = sum(loss.size for loss in losses if loss.first < own.start)
        before = np.where(segment == segment[0], self._offset - earlier, 0.0)
        if segment[-1] != segment[0]:
            self._offset = 0.0
        inside = [loss for loss in losses if own.start <= loss.first < own.stop]
        self._offset += sum(loss.size for loss in inside if recording.segment[loss.first] == segment[-1])
        return np.asarray(before)

    def _join(self, phases: tuple[Phase, ...], data: Series, low: int, begin: int, end: int) -> None:
        """Take the block's share of its phases; one that continues the block before is merged with it."""
        for phase in phases:
            first, last = max(phase.first + low, begin), min(phase.last + low, end - 1)
            if last < first:
                continue
            cut_before, cut_behind = first > phase.first + low, last < phase.last + low
            own = Phase(
                phase.kind,
                float(data.time[first - low]) if cut_before else phase.start,
                float(data.time[last - low]) if cut_behind else phase.end,
                first,
                last,
                math.inf if cut_before else phase.start_sd,
                math.inf if cut_behind else phase.end_sd,
            )
            before = self._phases[-1] if self._phases else None
            if before is not None and cut_before and before.kind == own.kind and before.last + 1 == own.first:
                self._phases[-1] = replace(own, start=before.start, first=before.first, start_sd=before.start_sd)
            else:
                self._phases.append(own)


@dataclass(frozen=True, eq=False)
class BlockResult:
    """What is found in the m samples of a block and of its neighbourhood.

    Attributes
    ----------
    data, seen : Series
        Without steps of the position: all m samples, with lines across faults, and those that are positions.
    sound, losses, offset : SoundRecord, tuple of PositionStep, array of shape (m,)
        Faults, steps, and the sum of the steps before each sample, m.
    motion, belt, found : Motion, BeltMotion or None, PhaseSegmentation
        Of the samples ``seen``.
    """

    data: Series
    sound: SoundRecord
    losses: tuple[PositionStep, ...]
    offset: Array
    seen: Series
    motion: Motion
    belt: BeltMotion | None
    found: PhaseSegmentation


def _median(speeds: list[float]) -> float:
    finite = [speed for speed in speeds if math.isfinite(speed)]
    return float(np.median(finite)) if finite else math.nan
