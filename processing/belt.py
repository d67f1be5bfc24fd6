"""The belt's own motion, where the board counts it: smoothed as the mass's is, and the mass as the belt sees it.

Both go through the same filter, so that what the filter blurs at a corner it blurs alike, and in stick their difference
is the noise of two counters and nothing else.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from processing import methods
from processing.methods import Motion, Setting
from processing.series import Series

if TYPE_CHECKING:
    from daq.recording import Recording

Array = NDArray[np.float64]


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


def beside(recording: "Recording", series: Series, method: str, motion: Motion) -> Belt | None:
    """Return the belt of a recording, smoothed as ``motion`` was; None without a channel or a common unit.

    Parameters
    ----------
    recording : Recording
        The run.
    series : Series
        Its positions, made ready.
    method : str
        "sg" or "fd".
    motion : Motion
        What that method made of the positions: its window and order are taken.
    """
    pitch = recording.rig.belt_metres_per_count
    if recording.belt_count is None or pitch is None or recording.unit != "m":
        return None
    setting = Setting() if method == "fd" else Setting(motion.window, motion.order)
    travel = (recording.belt_count - recording.belt_count[0]) * pitch.value
    own = replace(series, position=travel, origin=0.0, pitch=abs(pitch.value))
    seen = replace(
        series, position=series.position - travel, origin=0.0, pitch=float(np.hypot(series.pitch, pitch.value))
    )
    smoothed = methods.estimate(method, own, setting)
    return Belt(smoothed.velocity, smoothed.velocity_errors, seen, methods.estimate(method, seen, setting))
