"""The belt's own motion, where the board counts it: smoothed as the mass's is, and the mass as the belt sees it.

The mass seen from the belt is smoothed as one record, their difference: in stick it stands, whatever the belt does, and
what a filter blurs at a corner it blurs in both alike.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from processing.kalman import white_jerk
from processing.methods import registry
from processing.methods.registry import Motion, Setting
from processing.record.series import Series

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


@dataclass(frozen=True, eq=False)
class Belt:
    """The belt beside the mass, arrays of shape (n,).

    Attributes
    ----------
    velocity, velocity_errors : array
        Of the belt, m/s, signed, and one standard error.
    series, motion : Series, Motion
        The mass seen from the belt: x less the belt's travel, and what the method makes of it.
    """

    velocity: Array
    velocity_errors: Array
    series: Series
    motion: Motion

    def speed(self, moving: NDArray[np.bool_]) -> float:
        """Return the belt's median speed while the mass is in motion, m/s, signed; NaN when it never is."""
        return float(np.median(self.velocity[moving])) if moving.any() else math.nan


def counted(recording: "Recording") -> bool:
    """Tell whether the recording has a belt's counts that `beside` can use."""
    rig = recording.rig
    return recording.belt_count is not None and rig.belt_metres_per_count is not None and recording.unit == "m"


def beside(recording: "Recording", series: Series, motion: Motion) -> Belt | None:
    """Return the belt of a recording; None without a channel or a common unit.

    Savitzky-Golay and differences take the belt as they took the mass; for the others it is
    `processing.kalman.white_jerk` with the mass's own jerk, as a belt knows no corners, or softer ones.  The mass seen
    from the belt goes through a Savitzky-Golay filter as wide: sharper at the landings, which are looked for there.

    Parameters
    ----------
    recording : Recording
        The run.
    series : Series
        Its positions, made ready.
    motion : Motion
        What a method made of the positions.
    """
    pitch = recording.rig.belt_metres_per_count
    if not counted(recording) or recording.belt_count is None or pitch is None:
        return None
    travel = (recording.belt_count - recording.belt_count[0]) * pitch.value
    own = replace(series, position=travel, origin=0.0, pitch=abs(pitch.value))
    seen = replace(
        series, position=series.position - travel, origin=0.0, pitch=float(np.hypot(series.pitch, pitch.value))
    )
    if motion.method == "fd":
        belt, relative = (registry.estimate("fd", other, Setting()) for other in (own, seen))
        return Belt(belt.velocity, belt.velocity_errors, seen, relative)
    setting = Setting(motion.window, motion.order if motion.method == "sg" else 4)
    relative = registry.estimate("sg", seen, setting)
    if motion.method == "sg":
        belt = registry.estimate("sg", own, setting)
    else:
        noise = white_jerk.fit(series)
        finer = (own.pitch / series.pitch) ** 2 if series.pitch else 1.0
        belt = white_jerk.smooth(own, white_jerk.Noise(noise.jerk, noise.reading * finer))
    return Belt(belt.velocity, belt.velocity_errors, seen, relative)
