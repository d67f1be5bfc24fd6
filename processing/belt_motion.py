"""The motion of a belt with an encoder, smoothed as the mass's is, and the motion of the mass relative to it.

The relative motion is smoothed as one record, the difference of both: in stick it is at rest, whatever the belt does,
and a filter blurs both equally at a corner.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from processing import methods
from processing.kalman import white_jerk
from processing.methods import MethodModel
from processing.record.motion import BeltMotion, Motion
from processing.record.noise import position_noise
from processing.record.series import Series, Units
from stickslip.compute.arrays import Mask

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


def has_belt_encoder(recording: "Recording") -> bool:
    """Return whether the recording has belt counts that `smooth_belt` can use."""
    rig = recording.rig
    return recording.belt_count is not None and rig.belt_metres_per_count is not None and recording.unit == "m"


@dataclass(frozen=True, eq=False)
class BeltRecord:
    belt: Series
    relative: Series  # positions of the mass relative to the belt, of the same samples

    @classmethod
    def of(cls, recording: "Recording", kept: Mask, series: Series, units: Units) -> "BeltRecord | None":
        """Return the belt of a recording; None without a channel or a common unit.

        ``kept`` is the mask of the samples in ``series``, the prepared positions of the mass in these units.
        """
        pitch = recording.rig.belt_metres_per_count
        if not has_belt_encoder(recording) or recording.belt_count is None or pitch is None:
            return None
        metres_per_count = pitch.value / units.length_unit
        travel = (recording.belt_count[kept] - recording.belt_count[0]) * metres_per_count
        relative_pitch = float(np.hypot(series.pitch, metres_per_count))
        return cls(
            replace(series, position=travel, origin=0.0, pitch=abs(metres_per_count)),
            replace(series, position=series.position - travel, origin=0.0, pitch=relative_pitch),
        )


@dataclass(frozen=True)
class BeltNoise:
    """Standard deviations of a position of the belt and of the mass relative to it, m."""

    belt: float
    relative: float


def learn_noise(record: BeltRecord) -> BeltNoise:
    return BeltNoise(position_noise(record.belt), position_noise(record.relative))


def smooth_belt(record: BeltRecord, noise: BeltNoise, motion: Motion, model: MethodModel, pitch: float) -> BeltMotion:
    """Return the motion of the belt, and that of the mass relative to it, given ``motion`` and ``model`` of the latter.

    Savitzky-Golay and differences are applied to the belt too; otherwise it is smoothed by
    `processing.kalman.white_jerk` with the jerk of the mass, since a belt has no corners, or softer ones.  The relative
    motion is filtered by Savitzky-Golay with the same window, which is sharper at landings.  ``pitch`` is that of the
    mass, m, or 0.
    """
    order = motion.order if motion.method == "sg" else 4
    relative_model = model
    if model.method != "fd":
        relative_model = MethodModel(method="sg", noise=0.0, jerk=model.jerk, window=motion.window, order=order)
    relative = methods.apply(record.relative, replace(relative_model, noise=noise.relative))
    if model.method not in methods.SMOOTHERS:
        belt = methods.apply(record.belt, replace(relative_model, noise=noise.belt))
    else:
        finer = (record.belt.pitch / pitch) ** 2 if pitch else 1.0
        belt = white_jerk.smooth(record.belt, white_jerk.Noise(model.jerk.jerk, model.jerk.reading * finer))
    return BeltMotion(belt.velocity, belt.velocity_errors, record.relative, relative)
