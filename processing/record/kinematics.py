"""The motion behind a run: position, velocity and acceleration with errors, and where the mass stuck and slipped.

`processing.smoothing` makes a `Kinematics` of a recording, `processing.stage` keeps it in the run file.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from processing.defects import lost_counts
from processing.defects.lost_counts import Loss
from processing.defects.velocity_steps import Kick

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


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
    start_sd, end_sd : float
        Standard deviations of the times, s; infinite where they were not fitted, or where the phase is cut off by
        the end of a stretch.
    """

    kind: Literal["stick", "slip"]
    start: float
    end: float
    first: int
    last: int
    start_sd: float = math.inf
    end_sd: float = math.inf

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
        "segment", "rts", "sg" or "fd": what `auto` chose, never "auto" itself.
    window, order : int
        Samples in the smoothing window (2 for finite differences) and degree of its polynomial.  A smoother has no
        window: that of the Savitzky-Golay filter of order 4 that resembles "rts" is told; "segment" blurs less.
    times : str
        "recorded" or "nominal".
    belt_speed : float
        m/s, signed; with a belt channel the belt's median speed while the mass is in motion, unless one was stated;
        NaN when the record shows no stick and nobody stated it.
    stick : array of bool
        True while the mass rides on the belt.
    phases : tuple of Phase
        Sticks and slips in order of time; rest before the belt starts belongs to neither.
    losses : tuple of Loss
        Where ten or more counts went missing (`processing.defects.lost_counts`).
    repaired : bool
        Whether they were put back into the position.
    cpu_s : float
        CPU time spent, s.
    plateau_speed : float
        m/s: the speed most plateaus share, whatever the belt's is said to be; NaN without plateaus, or when the
        motion was read back from a file.
    belt_velocity, belt_velocity_errors : array or None
        m/s, signed, and one standard error, only with a belt channel: the belt's counts through the same filter.
    kicks : tuple of Kick
        Where the velocity stepped (`processing.defects.velocity_steps`); marked, and smoothed over.
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
    losses: tuple[Loss, ...]
    repaired: bool
    cpu_s: float
    plateau_speed: float = math.nan
    belt_velocity: Array | None = None
    belt_velocity_errors: Array | None = None
    kicks: tuple[Kick, ...] = ()

    @property
    def sticks(self) -> tuple[Phase, ...]:
        """The sticks, in order of time."""
        return tuple(phase for phase in self.phases if phase.kind == "stick")

    @property
    def slips(self) -> tuple[Phase, ...]:
        """The slips, in order of time."""
        return tuple(phase for phase in self.phases if phase.kind == "slip")

    @property
    def belt_counted(self) -> bool:
        """Whether the belt has counts of its own."""
        return self.belt_velocity is not None

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return int(self.time.size)

    @property
    def span(self) -> float:
        """From the first sample to the last, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def unit(self) -> str:
        """Unit of the position: "m", or "count"."""
        return self.recording.unit

    @property
    def lost_counts(self) -> int:
        """How many times counts went missing."""
        return len(self.losses)

    @property
    def measured(self) -> Array:
        """The recorded positions, m; with the lost counts where they were put back."""
        recording = self.recording
        if not self.repaired:
            return recording.position
        metres = recording.rig.metres_per_count
        pitch = abs(metres.value) if metres is not None else 1.0
        return recording.position - pitch * lost_counts.missing(recording.segment, self.losses)

    @property
    def plateau_fraction(self) -> float:
        """Share of the record's samples spent stuck, 0 to 1."""
        return float(self.stick.mean()) if self.stick.size else 0.0
