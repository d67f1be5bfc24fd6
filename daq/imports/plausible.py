"""Whether the numbers of a table can be what they are taken for: a question where a unit must be wrong.

Asked only of columns whose unit nobody stated, and only of tables long enough to be a record; the unit is the answer.
"""

import numpy as np

from daq.imports.table import Table
from daq.runfile.run_data import FEWEST_ROWS, explain_implausible
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

SLOWEST_S = 0.5  # between samples: 400 frames/s in ms are 2.5, and a record with fewer than 2 samples/s is rare
FARTHEST_M = 1e6  # a larger position is a typing error or a wrong unit
GAP = 100.0  # steps: a longer one is reported as a gap
HOUR_S = 3600.0
MOST_ROUNDINGS = 3.0  # longest steps of rounded times by which they may differ from even ones


def check_range(values: Array, most: float, cells: Table, column: int, unit: str, flag: str) -> None:
    """Raise InputError for a column with a value that is not finite or larger than ``most``, naming its line."""
    wrong = np.flatnonzero(~(np.abs(values) <= most))
    if wrong.size:
        row = int(wrong[0])
        raise InputError(
            f"{cells.label(column)} is {values[row]:.9g} {unit}",
            cells.locate(cells.lines[row], column),
            f"correct or delete that line; if the unit is wrong, use {flag}",
        )


def check_increasing(time: Array, cells: Table, column: int) -> None:
    wrong = np.flatnonzero(np.diff(time) <= 0)
    if not wrong.size:
        return
    row = int(wrong[0]) + 1
    what = f"time does not increase: {time[row]:.9g} s after {time[row - 1]:.9g} s"
    do = "delete or correct that line; if these are not times, choose the column with --time"
    if row == 1 and wrong.size == 1:
        do += f"; if the table begins here, use --preamble {cells.lines[0]}"
    if wrong.size > 1 and np.all(np.diff(time) >= 0):
        rate = (time.size - 1) / (time[-1] - time[0])
        what += f"; {wrong.size} lines repeat the time before, because times are rounded"
        do = f"space the samples evenly with --frame-rate '{rate:.4g} Hz', or with the exact rate of your board"
    raise InputError(what, cells.locate(cells.lines[row], column), do)


def number_evenly(time: Array, rate_hz: float, cells: Table, column: int, warnings: list[str]) -> Array:
    """Return even times in place of rounded ones that repeat, where they agree with a stated sample rate."""
    even: Array = time[0] + np.arange(time.size) / rate_hz
    rounding = float(np.max(np.diff(time)[np.diff(time) > 0], initial=0.0))
    worst = int(np.argmax(np.abs(time - even)))
    if abs(time[worst] - even[worst]) > MOST_ROUNDINGS * rounding:
        what = f"{cells.label(column)} differs by {time[worst] - even[worst]:.3g} s from even samples at {rate_hz:g} Hz"
        do = "check --frame-rate; if samples are missing, record times with more digits"
        raise InputError(what, cells.locate(cells.lines[worst], column), do)
    warnings.append(f"{cells.label(column)} repeats times, so the samples were spaced evenly at {rate_hz:g} Hz")
    return even


def describe_gap(time: Array, cells: Table, *, clock: bool) -> list[str]:
    """Return a warning that names the longest gap, where it is far longer than the steps."""
    step = np.diff(time)
    row = int(np.argmax(step))
    if step[row] <= GAP * np.median(step):
        return []
    hours = round(step[row] / HOUR_S)
    summer = clock and hours and abs(step[row] - hours * HOUR_S) <= GAP * np.median(step)
    why = "; did the clock change (summer time)?" if summer else ""
    return [f"there are no samples for {step[row]:.6g} s before line {cells.lines[row + 1]}{why}"]


def ask_for_time_unit(time: Array, cells: Table, column: int) -> None:
    """Raise InputError when times that were read in seconds are implausible."""
    step = float(np.median(np.diff(time))) if time.size >= FEWEST_ROWS else 0.0
    if step > SLOWEST_S:
        unit = "ms" if step < 1e3 * SLOWEST_S else "us"
        raise InputError(
            f"the times have no unit, and in seconds there would be a sample every {step:.3g} s",
            cells.locate(cells.header_line, column),
            f"state the unit, perhaps --t-unit={unit}; use --t-unit=s if the times are in seconds",
        )


def ask_for_length_unit(time: Array, position: Array, cells: Table, column: int, force: bool) -> None:
    """Raise InputError when positions read in metres, or forces (``force``) read in newtons, are implausible."""
    motion = explain_implausible(time, position)
    if motion is None:
        return
    if force:
        what = f"the forces have no unit, and in newtons {motion}"
        do = "such as --force-unit=mN or --force-unit=kgf; use --force-unit=N if the forces are in newtons"
    else:
        what = f"the positions have no unit, and in metres {motion}"
        do = (
            "such as --x-unit=mm, --x-unit=cm or --x-unit='0.25 mm' (a pixel); use --x-unit=m if the positions are in "
            "metres"
        )
    raise InputError(what, cells.locate(cells.header_line, column), f"state the unit, {do}")
