"""The motion behind a run: position, velocity and acceleration with errors, and where the mass stuck and slipped.

`smooth` makes a `Kinematics` of a `daq.load`-ed recording; `load` reads back the one stored in a run file.
The rig's scene and its truth are never looked at here.
"""

import math
import time as clock
from dataclasses import dataclass
from pathlib import Path
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
        m/s, signed; NaN when the record shows no stick and nobody stated it.
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


def smooth(
    recording: "Recording",
    method: str = "auto",
    window: int | str = "auto",
    order: int | None = None,
    times: str = "recorded",
    belt_speed: float | str = "auto",
) -> Kinematics:
    """Rebuild position, velocity and acceleration from a recording.

    Parameters
    ----------
    recording : Recording
        Positions in metres (or counts) at times in seconds.
    method : {"auto", "sg", "fd"}
        "auto" takes Savitzky-Golay ("sg"); "fd" is the plain two-point difference, a baseline.
    window : int, "auto" or a duration such as "20ms"
        Length of the smoothing window: an odd number of samples above the order, or chosen from the record.
    order : int, optional
        Degree of the local polynomial; by default chosen with the window, or 4 beside a window that was given.
    times : {"recorded", "nominal"}
        Whether to trust the board's sample times or to assume an even grid.
    belt_speed : float or "auto"
        m/s, signed; "auto" finds it in the plateaus of the velocity.

    Returns
    -------
    Kinematics

    Raises
    ------
    InputError
        For an unknown method, an even window, an order that the window cannot carry, a record with a number that
        is not finite or with times that do not increase (naming the sample), or fewer than 5 samples.

    Notes
    -----
    Gaps and segments are never smoothed across: each piece ends in one-sided fits, with their larger errors.
    Lost counts are marked, not repaired.
    """
    from processing import faults, methods, phases, series
    from processing import window as windows

    begun = clock.process_time()
    data = series.of(recording, times)
    name = methods.resolve(method)
    setting = windows.setting(window, order, data)
    motion = methods.estimate(name, data, setting)
    jumps = faults.lost_counts(data)
    found = phases.find(data, motion, recording.rig.belt_speed, belt_speed, jumps)
    return Kinematics(
        recording=recording,
        time=data.time,
        position=motion.position,
        velocity=motion.velocity,
        acceleration=motion.acceleration,
        position_errors=motion.position_errors,
        velocity_errors=motion.velocity_errors,
        acceleration_errors=motion.acceleration_errors,
        method=name,
        window=motion.window,
        order=motion.order,
        times=times,
        belt_speed=found.belt_speed,
        stick=found.stick,
        phases=found.phases,
        lost_counts=len(jumps),
        cpu_s=clock.process_time() - begun,
        plateau_speed=found.plateau_speed,
    )


def load(path: str | Path) -> Kinematics | None:
    """Read the smoothed stage of a run file back, or None when the run was never smoothed.

    Raises
    ------
    InputError
        For a file that is not a run of a schema this version reads.
    """
    from processing import stage

    return stage.load(Path(path))


def save(kinematics: Kinematics, path: str | Path) -> None:
    """Write the motion into its run file beside the untouched raw data, replacing an earlier smoothing."""
    from processing import stage

    stage.save(kinematics, Path(path))
