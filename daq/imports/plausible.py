"""Whether the numbers of a table can be what they are taken for: a question where a unit must be wrong.

Asked only of columns whose unit nobody stated, and only of tables long enough to be a record; the unit is the answer.
"""

import numpy as np

from daq.imports.table import Table
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

# No mass on a spring in a laboratory is as fast, or moves as far.  The thesis's rig reaches 0.6 m/s and 0.3 m, so that
# its track in cm (60 m/s, 30 m) and in mm is asked about.  Halved, a fast rig of 5 m/s would be asked; doubled, a slow
# one in cm (0.15 m/s, 0.2 m) is not.
FASTEST_M_PER_S, LONGEST_M = 10.0, 10.0
SLOWEST_S = (
    0.5  # between samples: 400 frames/s in ms are 2.5, 1 kHz in ms is 1; a record with fewer than 2 samples/s is rare
)
FEWEST_ROWS = 100  # samples; nothing is asked of a shorter table, which is too short to be fitted
FARTHEST_M = 1e6  # a larger position is a typing error or a wrong unit
SPANS = 200  # pieces that the record is cut into to measure its speed: noise between neighbours is none


def check_range(values: Array, most: float, cells: Table, column: int, unit: str, flag: str) -> None:
    """Refuse a column with a value that is not finite or larger than ``most``, naming its line."""
    wrong = np.flatnonzero(~(np.abs(values) <= most))
    if wrong.size:
        row = int(wrong[0])
        raise InputError(
            f"{cells.label(column)} is {values[row]:.9g} {unit}",
            cells.place(cells.lines[row], column),
            f"correct or delete that line; if the unit is wrong, give {flag}",
        )


def check_increasing(time: Array, cells: Table, column: int) -> None:
    """Refuse times that do not increase, naming the first line."""
    wrong = np.flatnonzero(np.diff(time) <= 0)
    if wrong.size:
        row = int(wrong[0]) + 1
        raise InputError(
            f"time does not increase: {time[row]:.9g} s after {time[row - 1]:.9g} s",
            cells.place(cells.lines[row], column),
            "delete or correct that line; if these are not times, choose the column by --time",
        )


def ask_for_time_unit(time: Array, cells: Table, column: int) -> None:
    """Raise InputError when times that were taken for seconds can hardly be."""
    step = float(np.median(np.diff(time))) if time.size >= FEWEST_ROWS else 0.0
    if step > SLOWEST_S:
        unit = "ms" if step < 1e3 * SLOWEST_S else "us"
        raise InputError(
            f"the unit of the times is not stated; in s there would be a sample every {step:.3g} s",
            cells.place(cells.header_line, column),
            f"give the unit: --t-unit {unit}? (--t-unit s if they are seconds)",
            python=f"give the unit: t_unit={unit!r}? (t_unit='s' if they are seconds)",
        )


def ask_for_length_unit(time: Array, position: Array, cells: Table, column: int, force: bool) -> None:
    """Raise InputError when positions that were taken for metres, or forces for newtons, can hardly be.

    Parameters
    ----------
    time, position : array of shape (n,)
        s, m.
    cells, column : Table, int
        Where the positions come from, for the message.
    force : bool
        Whether they were made of forces.
    """
    if time.size < FEWEST_ROWS:
        return
    low, high = np.percentile(position, [1, 99])  # a single wild sample is a fault, not a unit
    lag = max(1, time.size // SPANS)
    speed = float(np.percentile(np.abs(position[lag:] - position[:-lag]) / (time[lag:] - time[:-lag]), 90))
    travel = float(high - low)
    if speed <= FASTEST_M_PER_S and travel <= LONGEST_M:
        return
    moved = f"the mass would move {travel:.3g} m, at {speed:.3g} m/s"
    if force:
        what = f"the unit of the forces is not known: none is stated, and in N {moved}"
        do = "give it: --force-unit mN? --force-unit kgf? (--force-unit N if they are newtons)"
        python = "give it: force_unit='mN'? force_unit='kgf'? (force_unit='N' if they are newtons)"
    else:
        what = f"the unit of the positions is not known: none is stated, and in m {moved}"
        do = "give it: --x-unit mm? --x-unit cm? --x-unit '0.25 mm', a pixel? (--x-unit m if they are metres)"
        python = "give it: x_unit='mm'? x_unit='cm'? x_unit='0.25 mm', a pixel? (x_unit='m' if they are metres)"
    raise InputError(what, cells.place(cells.header_line, column), do, python=python)
