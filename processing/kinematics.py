"""The motion behind a run: position, velocity and acceleration with errors, and where the mass stuck and slipped.

`processing.smoothing` makes a `Kinematics` of a recording, `processing.stage` keeps it in the run file.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from daq.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Phase:
    """One stretch of stick or slip.

    Attributes
    ----------
    kind : "stick" or "slip"
    start, end : float
        Times, s, on the recording's axis; corners are placed between samples.
    first, last : int
        First and last sample that lie inside (both included).
    """

    kind: Literal["stick", "slip"]
    start: float
    end: float
    first: int
    last: int

    @property
    def duration(self) -> float:
        """Length of the phase, s."""
        return self.end - self.start


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The motion rebuilt from a recording, every array of shape (n,).

    Attributes
    ----------
    recording : Recording
        What it was made from.
    time : array
        s; the recorded times, or the even grid when `times` is "nominal".
    position, velocity, acceleration : array
        m, m/s, m/s^2; positive towards +x.  In counts instead of metres for a rig without a calibration.
    position_errors, velocity_errors, acceleration_errors : array
        One standard error each; infinite where a derivative cannot be known (a lone sample between two gaps).
    method : str
        "sg" or "fd": what `auto` chose, never "auto" itself.
    window, order : int
        Samples in the smoothing window (2 for finite differences) and degree of its polynomial.
    times : str
        "recorded" or "nominal".
    belt_speed : float
        m/s, signed; with a belt channel the belt's median speed while the mass is in motion, unless one was stated;
        NaN when the record shows no stick and nobody stated it.
    stick : array of bool
        True while the mass rides on the belt.
    phases : tuple of Phase
        Sticks and slips in order of time; rest before the belt starts belongs to neither.
    lost_counts : int
        Samples at which ten or more counts seem to have gone missing; marked, not repaired.
    cpu_s : float
        CPU time spent, s.
    plateau_speed : float
        m/s: the speed most plateaus share, whatever the belt's is said to be; NaN without plateaus, or when the
        motion was read back from a file.
    belt_velocity, belt_velocity_errors : array or None
        m/s, signed, and one standard error, only with a belt channel: the belt's counts through the same filter.
    """

    recording: "Recording"
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    position_errors: Array
    velocity_errors: Array
    acceleration_errors: Array
    method: str
    window: int
    order: int
    times: str
    belt_speed: float
    stick: NDArray[np.bool_]
    phases: tuple[Phase, ...]
    lost_counts: int
    cpu_s: float
    plateau_speed: float = math.nan
    belt_velocity: Array | None = None
    belt_velocity_errors: Array | None = None

    @property
    def sticks(self) -> tuple[Phase, ...]:
        """The sticks, in order of time."""
        return tuple(phase for phase in self.phases if phase.kind == "stick")

    @property
    def slips(self) -> tuple[Phase, ...]:
        """The slips, in order of time."""
        return tuple(phase for phase in self.phases if phase.kind == "slip")

    @property
    def plateau_fraction(self) -> float:
        """Share of the record's samples spent stuck, 0 to 1."""
        return float(self.stick.mean()) if self.stick.size else 0.0
