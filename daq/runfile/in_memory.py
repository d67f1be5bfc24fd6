"""A run made of arrays: the positions or counts that a program already has in memory, and what is known of the rig."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from daq.runfile import belt_counter
from daq.runfile.rig import Rig
from daq.runfile.run_data import FARTHEST, RunData, explain_implausible, explain_impossible, positions
from stickslip.compute.arrays import Array, Integers, numbers
from stickslip.errors import InputError, check_type
from stickslip.units import Measured, Stated, read_all_stated

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Made = TypeVar("Made", bound=RunData)
# Decimals of a position in m.  A coarser power of ten of which all readings are multiples is taken in their place; half
# as many are 30 um, more than most encoders resolve, and at 18 a belt of 9 m no longer fits into a whole number.
FINEST_DECIMALS = 9
DO = "pass a sequence of numbers"
# Share of the largest reading by which a decimal may be off where binary numbers hold it, after a change of units or
# two.
ULPS = 4.0


def from_arrays(
    make: Callable[..., Made],
    time: "ArrayLike",
    position: "ArrayLike",
    stated: Mapping[str, Stated | None],
    belt_position: "ArrayLike | None",
    title: str,
) -> Made:
    """Make a run of arrays by ``make``, its class; see `daq.runfile.recording.Recording.from_arrays`."""
    from daq.runfile import provenance

    check_type(title, str, "title", "from_arrays", "text")
    times, values = numbers(time, "time", "from_arrays", DO), numbers(position, "position", "from_arrays", DO)
    if len(times) != len(values):
        raise InputError(
            f"time has {len(times)} values, but position has {len(values)}",
            "from_arrays",
            "pass one value for each sample",
        )
    if len(times) < 2:
        raise InputError(f"time and position have {len(times)} sample(s)", "from_arrays", "pass two or more")
    seconds = times.astype(np.float64)
    seconds = seconds - seconds[0]
    quantities = read_all_stated(**stated)
    pitch = quantities.get("metres_per_count")
    metres = values.astype(np.float64)
    for name, column in (("time", seconds), ("position", metres)):
        _check_finite(column, name)
    count = read_counts(values, pitch, "position")
    if (wrong := explain_impossible(seconds, metres)) is not None:
        raise InputError(wrong, "from_arrays", "pass increasing times in s, and positions in m or counts")
    if count is None and (moved := explain_implausible(seconds, metres)) is not None:
        warnings.warn(f"are the positions in m? {moved}; if they are in mm, pass x / 1000", UserWarning, stacklevel=3)
    rig = Rig().stating(quantities)
    started = datetime.now(UTC)
    run = make(
        title=title or "arrays",
        started=started.isoformat(),
        ended=(started + timedelta(seconds=float(seconds[-1]))).isoformat(),
        rate_hz=measure_rate(seconds),
        rig=rig,
        time=seconds,
        position=metres if count is None else positions(count, rig),
        count=count,
        config_toml=rig.to_toml(),
        provenance=provenance.collect_provenance(),
    )
    if belt_position is None:
        return run
    belt = numbers(belt_position, "belt_position", "from_arrays", DO).astype(np.float64)
    if len(belt) != len(seconds):
        raise InputError(
            f"belt_position has {len(belt)} values, but time has {len(seconds)}",
            "from_arrays",
            "pass one value for each sample",
        )
    _check_finite(belt, "belt_position")
    return add_belt(run, belt)


def read_counts(values: "np.ndarray[Any, Any]", pitch: Measured | None, name: str) -> Integers | None:
    """Return positions as counts: whole numbers with a pitch, integers without; None where they are metres."""
    if values.dtype.kind in "iu":
        return np.asarray(values, np.int64)
    if pitch is None:
        return None
    whole = np.rint(values)
    off = np.flatnonzero(~(values == whole))
    if off.size:
        what = f"{name} is {values[off[0]]:g} at sample {off[0]}, which is not a count, but metres_per_count is given"
        raise InputError(what, name, "pass whole counts, or omit metres_per_count if these are metres")
    return np.asarray(whole, np.int64)


def add_belt(run: Made, belt: Array) -> Made:
    """Return a run with positions of its belt, (n,) m, as counts of their last decimal: of their own rounding."""
    pitch = find_last_decimal(belt)
    count = np.rint(belt / pitch).astype(np.int64)
    speed = np.concatenate([*belt_counter.yield_velocities(count, run.time, np.array([0]), run.rate_hz, pitch)])
    rig = replace(run.rig, belt_metres_per_count=Measured(pitch))
    return replace(run, rig=rig, belt_count=count, belt_velocity=speed, config_toml=rig.to_toml())


def find_last_decimal(values: Array) -> float:
    """Return the largest power of ten of which all values are multiples, 1e-9 (`FINEST_DECIMALS`) at least."""
    for decimals in range(FINEST_DECIMALS):
        number = values * 10.0**decimals
        if np.all(np.abs(number - np.rint(number)) <= ULPS * np.spacing(np.abs(number).max())):
            return float(10.0**-decimals)
    return float(10.0**-FINEST_DECIMALS)


def measure_rate(time: Array) -> float:
    """Return the rate of samples at times in s, Hz: that of the steps in which no sample is missing."""
    step = np.diff(time)  # their mean: the median alone carries the rounding of printed times
    return float(1 / step[step < 1.5 * np.median(step)].mean())


def _check_finite(values: Array, name: str) -> None:
    wrong = np.flatnonzero(~(np.abs(values) <= FARTHEST))
    if wrong.size:
        value = values[wrong[0]]
        do = f"remove those samples: keep = np.isfinite({name})" if not np.isfinite(value) else "check its unit"
        more = f" and {wrong.size - 1} more" if wrong.size > 1 else ""
        raise InputError(f"{name} is {value:g} at sample {wrong[0]}{more}", "from_arrays", do)
