"""The motion of a belt with an encoder, smoothed as the mass's is, and the motion of the mass relative to it.

The relative motion is smoothed as one record, the difference of both: in stick it is at rest, whatever the belt does,
and what a filter blurs at a corner it blurs in both alike.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from daq.compute.arrays import Mask
from processing.kalman import white_jerk
from processing.methods import registry
from processing.record.estimates import RecordEstimates
from processing.record.motion import BeltMotion, Motion
from processing.record.series import Series
from processing.record.setting import Setting

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


def has_belt_encoder(recording: "Recording") -> bool:
    """Return whether the recording has belt counts that `smooth_belt` can use."""
    rig = recording.rig
    return recording.belt_count is not None and rig.belt_metres_per_count is not None and recording.unit == "m"


def smooth_belt(
    recording: "Recording", kept: Mask, series: Series, motion: Motion, estimates: RecordEstimates
) -> BeltMotion | None:
    """Return the belt of a recording; None without a channel or a common unit.

    Savitzky-Golay and differences take the belt as they took the mass; for the others it is
    `processing.kalman.white_jerk` with the mass's own jerk, as a belt knows no corners, or softer ones.  The mass seen
    from the belt goes through a Savitzky-Golay filter as wide: sharper at the landings, which are looked for there.

    Parameters
    ----------
    recording : Recording
        The run.
    kept : array of bool, shape (n,)
        True for the m samples of the run that are in the series.
    series : Series
        Its positions, made ready.
    motion : Motion
        What a method made of the positions.
    estimates : RecordEstimates
        Those that the method used; the belt's become a part of them.
    """
    pitch = recording.rig.belt_metres_per_count
    if not has_belt_encoder(recording) or recording.belt_count is None or pitch is None:
        return None
    travel = (recording.belt_count[kept] - recording.belt_count[0]) * pitch.value
    own = replace(series, position=travel, origin=0.0, pitch=abs(pitch.value))
    seen = replace(
        series, position=series.position - travel, origin=0.0, pitch=float(np.hypot(series.pitch, pitch.value))
    )
    if motion.method == "fd":
        belt, relative = (
            registry.estimate("fd", other, Setting(), estimates.part(name))
            for name, other in (("belt", own), ("relative", seen))
        )
        return BeltMotion(belt.velocity, belt.velocity_errors, seen, relative)
    setting = Setting(motion.window, motion.order if motion.method == "sg" else 4)
    relative = registry.estimate("sg", seen, setting, estimates.part("relative"))
    if motion.method == "sg":
        belt = registry.estimate("sg", own, setting, estimates.part("belt"))
    else:
        noise = estimates.once("jerk", lambda: white_jerk.fit(series))
        finer = (own.pitch / series.pitch) ** 2 if series.pitch else 1.0
        belt = white_jerk.smooth(own, white_jerk.Noise(noise.jerk, noise.reading * finer))
    return BeltMotion(belt.velocity, belt.velocity_errors, seen, relative)
