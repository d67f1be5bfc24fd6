"""From a recording to its motion: estimate, then find what is lost, where it stuck and how fast the belt ran.

The rig's scene and its truth are never looked at here.
"""

import time as clock
from dataclasses import replace
from typing import TYPE_CHECKING

from daq.errors import InputError, nearest
from processing import belt_motion as belts
from processing.defects import lost_counts, velocity_steps
from processing.methods import registry
from processing.record import series
from processing.record.kinematics import Kinematics
from processing.record.lost_counts import counts_missing, restore_counts
from processing.record.setting import parse_belt_speed, parse_window
from processing.segmentation import plateaus

REPAIRS = ("off", "flag", "fix")

if TYPE_CHECKING:
    from daq.runfile.recording import Recording


def smooth(
    recording: "Recording",
    method: str = "auto",
    window: int | str = "auto",
    order: int | None = None,
    times: str = "recorded",
    belt_speed: float | str = "auto",
    repair_counts: str = "flag",
) -> Kinematics:
    """Rebuild position, velocity and acceleration from a recording.

    Parameters
    ----------
    recording : Recording
        Positions in metres (or counts) at times in seconds.
    method : {"auto", "segment", "rts", "sg", "fd"}
        "segment" smooths sticks and slips apart, with fitted corners; "rts" smooths all alike; "auto" takes "segment"
        where its sticks are beyond doubt, else "rts" ("sg" where a window or an order is asked for); "sg" is
        Savitzky-Golay; "fd" the plain two-point difference, a baseline.
    window : int, "auto" or a duration such as "20ms"
        Length of the Savitzky-Golay window: an odd number of samples above the order, or chosen from the record.
    order : int, optional
        Degree of the local polynomial; by default chosen with the window, or 4 beside a window that was given.
    times : {"recorded", "nominal"}
        Whether to trust the board's sample times or to assume an even grid.
    belt_speed : float or "auto"
        m/s, signed; "auto" takes it from the belt's own counts where there are any, else finds it in the plateaus of
        the velocity.
    repair_counts : {"off", "flag", "fix"}
        What to do about lost counts (`processing.defects.lost_counts`): not to look for them; to mark them, and leave
        the position as it was counted; or to mark them and put them back.  Where they are looked for, velocity and
        acceleration are those of the motion on either side, without the jump of the count.

    Returns
    -------
    Kinematics

    Raises
    ------
    InputError
        For an unknown method or repair, an even window, an order that the window cannot carry, a record with a number
        that is not finite or with times that do not increase (naming the sample), or fewer than 5 samples.

    Notes
    -----
    Gaps and segments are never smoothed across: each piece ends in one-sided fits, with their larger errors.
    """
    begun = clock.process_time()
    registry.check(method)
    if repair_counts not in REPAIRS:
        raise InputError(f"is {repair_counts!r}", "--repair-counts", nearest(repair_counts, REPAIRS))
    data = series.from_recording(recording, times)
    losses = lost_counts.losses(data) if repair_counts != "off" else ()
    behind = counts_missing(recording.segment, losses)
    data = restore_counts(data, behind)
    setting = parse_window(window, order, data)
    setting = replace(setting, belt_speed=parse_belt_speed(belt_speed))
    motion = registry.estimate(method, data, setting)
    belt = belts.smooth_belt(recording, data, motion)
    kicked = velocity_steps.kicks(data)
    found = plateaus.segment(data, motion, recording.rig.belt_speed, belt_speed, belt)
    return Kinematics(
        recording=recording,
        time=data.time,
        position=motion.position if repair_counts == "fix" else motion.position + data.pitch * behind,
        velocity=motion.velocity,
        acceleration=motion.acceleration,
        position_errors=motion.position_errors,
        velocity_errors=motion.velocity_errors,
        acceleration_errors=motion.acceleration_errors,
        method=motion.method,
        window=motion.window,
        order=motion.order,
        times=times,
        belt_speed=found.belt_speed,
        stick=found.stick,
        phases=found.phases,
        losses=losses,
        repaired=repair_counts == "fix" and bool(losses),
        cpu_s=clock.process_time() - begun,
        plateau_speed=found.plateau_speed,
        belt_velocity=None if belt is None else belt.velocity,
        belt_velocity_errors=None if belt is None else belt.velocity_errors,
        kicks=kicked,
    )
