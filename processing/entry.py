"""``processing.smooth``: of a run, of a file, or of two arrays."""

import math
import os
from collections.abc import Mapping
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

import daq
from processing import smoothing
from processing.record.kinematics import Kinematics
from stickslip import units
from stickslip.errors import InputError, check_type

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def smooth(
    run_or_time: "daq.Recording | str | os.PathLike[str] | ArrayLike",
    position: "ArrayLike | None" = None,
    *,
    method: str = "auto",
    window: int | str = "auto",
    order: int | None = None,
    times: str = "recorded",
    belt_speed: float | str = "auto",
    repair_counts: str = "flag",
    model: Mapping[str, Any] | None = None,
) -> Kinematics:
    """Rebuild position, velocity and acceleration from a recording, a file or arrays.

    Parameters
    ----------
    run_or_time : Recording, path or array_like of shape (n,)
        A run, a file that `daq.load` reads, or times, s, of the ``position``.
    position : array_like of shape (n,), optional
        Positions, m (integers: counts), beside times; see `daq.Recording.from_arrays`, which also takes what is known
        of the rig.  Beside a run, the name of a method.
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
    belt_speed : float, text with a unit, or "auto"
        m/s, or such as "22 cm/s"; signed.  "auto" takes it from the belt's own counts where there are any, else finds
        it in the plateaus of the velocity.
    repair_counts : {"off", "flag", "fix"}
        What to do about steps of the position, as where counts are lost or the datum moves: not to look for them; to
        mark them, and leave the position as it was counted; or to mark them and put them back.  Where they are looked
        for, velocity and acceleration are those of the motion on either side, without the jump of the count.
    model : mapping, optional
        `Kinematics.model` of an earlier smoothing, applied as it is: nothing is learned, and method, window, order and
        belt speed are its own.

    Returns
    -------
    Kinematics

    Raises
    ------
    InputError
        For an unknown method or repair, an even window, an order that the window cannot carry, a record with a number
        that is not finite or with times that do not increase (naming the sample), fewer than 5 samples, or a belt
        speed beside positions in counts; times without positions, or positions beside a run.

    Notes
    -----
    Gaps and segments are never smoothed across: each piece ends in one-sided fits, with their larger errors.

    Examples
    --------
    >>> import numpy as np
    >>> import processing
    >>> t = np.arange(2000) / 1000
    >>> motion = processing.smooth(t, 0.01 * np.sin(6 * t), method="rts")
    >>> float(motion.velocity[1000].round(4))
    0.0576
    """
    where = "processing.smooth"
    if not isinstance(position, str):
        check_type(method, str, "method", where, "a name, such as 'auto'")
    form = "'auto', an odd number of samples, or a time such as '20ms'"
    check_type(window, (str, Real), "window", where, form)
    check_type(order, Integral, "order", where, "a whole number")
    check_type(repair_counts, str, "repair_counts", where, "'off', 'flag' or 'fix'")
    check_type(model, Mapping, "model", where, "Kinematics.model of an earlier smoothing")
    if isinstance(window, Real) and not math.isfinite(window):
        raise InputError(f"window is {window}", where, f"give {form}")
    if belt_speed != "auto":
        belt_speed = units.in_si(belt_speed, "speed", "belt_speed").value
    if isinstance(run_or_time, daq.Recording | str | os.PathLike):
        if isinstance(position, str):
            method, position = position, None
        if position is not None:
            what = "a position beside a run, which has its own"
            raise InputError(what, where, "give the run alone: processing.smooth(run, method=...)")
        run = run_or_time if isinstance(run_or_time, daq.Recording) else daq.load(run_or_time)
    elif position is None:
        what = f"a {type(run_or_time).__name__} and no position"
        do = "give a run, a file or two arrays: processing.smooth(time, position)"
        raise InputError(what, where, do)
    else:
        run = daq.Recording.from_arrays(run_or_time, position)
    return smoothing.smooth(run, method, window, order, times, belt_speed, repair_counts, model)
