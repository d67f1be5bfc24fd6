"""The motion of a belt with an encoder, smoothed as the mass's is, and the motion of the mass relative to it.

The relative motion is smoothed as one record, the difference of both: in stick it is at rest, whatever the belt does,
and what a filter blurs at a corner it blurs in both alike.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from processing.kalman import white_jerk
from processing.methods import registry
from processing.methods.method_model import MethodModel
from processing.record.motion import BeltMotion, Motion
from processing.record.noise import position_noise
from processing.record.series import Series
from processing.record.units import Units
from stickslip.compute.arrays import Mask

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


def has_belt_encoder(recording: "Recording") -> bool:
    """Return whether the recording has belt counts that `smooth_belt` can use."""
    rig = recording.rig
    return recording.belt_count is not None and rig.belt_metres_per_count is not None and recording.unit == "m"


@dataclass(frozen=True, eq=False)
class BeltRecord:
    """The counts of a belt as a record, and the positions of the mass seen from it, of the same n samples."""

    belt: Series
    relative: Series

    @classmethod
    def of(cls, recording: "Recording", kept: Mask, series: Series, units: Units) -> "BeltRecord | None":
        """Return the belt of a recording; None without a channel or a common unit.

        ``kept`` is True for the samples of the run that are in ``series``, its positions made ready, in these units.
        """
        pitch = recording.rig.belt_metres_per_count
        if not has_belt_encoder(recording) or recording.belt_count is None or pitch is None:
            return None
        count = pitch.value / units.length_unit
        travel = (recording.belt_count[kept] - recording.belt_count[0]) * count
        both = float(np.hypot(series.pitch, count))
        return cls(
            replace(series, position=travel, origin=0.0, pitch=abs(count)),
            replace(series, position=series.position - travel, origin=0.0, pitch=both),
        )


@dataclass(frozen=True)
class BeltNoise:
    """Standard deviations of a position of the belt and of the mass seen from it, m."""

    belt: float
    relative: float


def learn_noise(record: BeltRecord) -> BeltNoise:
    return BeltNoise(position_noise(record.belt), position_noise(record.relative))


def smooth_belt(record: BeltRecord, noise: BeltNoise, motion: Motion, model: MethodModel, pitch: float) -> BeltMotion:
    """Return the motion of the belt, and that of the mass relative to it.

    Savitzky-Golay and differences take the belt as they took the mass; for the others it is
    `processing.kalman.white_jerk` with the mass's own jerk, as a belt knows no corners, or softer ones.  The mass seen
    from the belt goes through a Savitzky-Golay filter as wide: sharper at the landings, which are looked for there.

    record, noise: The belt of a record or of a block of it, and the noise of the record.
    motion: What a method made of the positions of the mass.
    model: What that method learned.
    pitch: Of the positions of the mass, m; 0 for a record without counts.
    """
    order = motion.order if motion.method == "sg" else 4
    how = model
    if model.method != "fd":
        how = MethodModel(method="sg", noise=0.0, jerk=model.jerk, window=motion.window, order=order)
    relative = registry.apply(record.relative, replace(how, noise=noise.relative))
    if model.method not in registry.SMOOTHERS:
        belt = registry.apply(record.belt, replace(how, noise=noise.belt))
    else:
        finer = (record.belt.pitch / pitch) ** 2 if pitch else 1.0
        belt = white_jerk.smooth(record.belt, white_jerk.Noise(model.jerk.jerk, model.jerk.reading * finer))
    return BeltMotion(belt.velocity, belt.velocity_errors, record.relative, relative)
