"""``processing.smooth`` for a run, a file, or two arrays."""

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
    """Estimate position, velocity and acceleration from a recording, a file or arrays.

    Parameters
    ----------
    run_or_time : Recording, path or array_like of shape (n,)
        A run, a file that `daq.load` reads, or times, s, of the ``position``.
    position : array_like of shape (n,), optional
        Positions, m (integers: counts), at these times; see `daq.Recording.from_arrays`, which also accepts the
        parameters of the rig.  After a run, the name of a method.
    method : {"auto", "segment", "rts", "sg", "fd"}
        "segment" smooths sticks and slips separately, with fitted corners; "rts" smooths all motion in one way; "auto"
        chooses "segment" if the record clearly contains sticks, else "rts" ("sg" if a window or an order is given);
        "sg" is Savitzky-Golay; "fd" the plain two-point difference, a baseline.
    window : int, "auto" or a duration such as "20ms"
        Length of the Savitzky-Golay window: an odd number of samples above the order, or chosen from the record.
    order : int, optional
        Degree of the local polynomial; by default chosen with the window, or 4 for a given window.
    times : {"recorded", "nominal"}
        Whether to trust the board's sample times or to assume an even grid.
    belt_speed : float, text with a unit, or "auto"
        m/s, or a text such as "22 cm/s"; signed.  "auto" determines it from the counts of the belt if recorded, else
        from the plateaus of the velocity.
    repair_counts : {"off", "flag", "fix"}
        How to treat steps of the position, caused by lost counts or a datum that moves: "off" does not search for
        them, "flag" marks them and leaves the position as counted, "fix" marks them and corrects the position.  With
        "flag" and "fix", velocity and acceleration are without the jump of the count.
    model : mapping, optional
        `Kinematics.model` of an earlier smoothing, applied without learning: it also determines method, window, order
        and belt speed.

    Returns
    -------
    Kinematics

    Raises
    ------
    InputError
        For an unknown method or repair, an even window, an order that the window cannot carry, a record with a number
        that is not finite or with times that do not increase (naming the sample), fewer than 5 samples, or a belt
        speed for positions in counts; times without positions, or positions for a run.

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
        check_type(method, str, "method", where, "a name, such as 'auto'", required=True)
    form = "'auto', an odd number of samples, or a time such as '20ms'"
    check_type(window, (str, Real), "window", where, form, required=True)
    check_type(order, Integral, "order", where, "a whole number")
    check_type(repair_counts, str, "repair_counts", where, "'off', 'flag' or 'fix'", required=True)
    check_type(model, Mapping, "model", where, "Kinematics.model of an earlier smoothing")
    if isinstance(window, Real) and not math.isfinite(window):
        raise InputError(f"window is {window}", where, f"use {form}")
    if belt_speed != "auto":
        belt_speed = units.in_si(belt_speed, "speed", "belt_speed").value
    if isinstance(run_or_time, daq.Recording | str | os.PathLike):
        if isinstance(position, str):
            method, position = position, None
        if position is not None:
            problem = "a position was passed in addition to a run"
            raise InputError(problem, where, "pass only the run: processing.smooth(run, method=...)")
        run = run_or_time if isinstance(run_or_time, daq.Recording) else daq.load(run_or_time)
    elif position is None:
        problem = f"a {type(run_or_time).__name__} without a position"
        advice = "pass a run, a file or two arrays: processing.smooth(time, position)"
        raise InputError(problem, where, advice)
    else:
        run = daq.Recording.from_arrays(run_or_time, position)
    return smoothing.smooth(run, method, window, order, times, belt_speed, repair_counts, model)
