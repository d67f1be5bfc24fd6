"""From a recording to its motion: estimate, then find what is lost, where it stuck and how fast the belt ran.

The rig's scene and its truth are never looked at here.
"""

import time as clock
from typing import TYPE_CHECKING

from processing import belt as belts
from processing import faults, methods, phases, series
from processing import window as windows
from processing.kinematics import Kinematics

if TYPE_CHECKING:
    from daq.recording import Recording


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
        m/s, signed; "auto" takes it from the belt's own counts where there are any, else finds it in the plateaus of
        the velocity.

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
    begun = clock.process_time()
    data = series.of(recording, times)
    name = methods.resolve(method)
    setting = windows.setting(window, order, data)
    motion = methods.estimate(name, data, setting)
    jumps = faults.lost_counts(data)
    belt = belts.beside(recording, data, name, motion)
    found = phases.find(data, motion, recording.rig.belt_speed, belt_speed, jumps, belt)
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
        belt_velocity=None if belt is None else belt.velocity,
        belt_velocity_errors=None if belt is None else belt.velocity_errors,
    )
