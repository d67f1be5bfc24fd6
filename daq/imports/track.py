"""A table of t, x (a CSV, a MATLAB file) made into a run file: columns and units are found, the frame rate is checked.

Times must increase; they need not be even.  Nothing is repaired: a bad line is refused, with its number.
"""

import hashlib
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.errors import InputError
from daq.imports import table
from daq.imports.columns import find, unit
from daq.imports.frame_rate import check_half_period
from daq.imports.options import ImportOptions
from daq.output import provenance
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig, quoted

# Ratio of the times' rate to --frame-rate beyond which the times are corrected.  An error of 1 % in time
# is 1 % in velocity: double leaves 2 % uncorrected, half corrects what rounded times cause.  Not swept.
FRAME_RATE_TOLERANCE = 1.01
FARTHEST_M = 1e6  # a larger position is a typing error or a wrong unit


@dataclass(frozen=True)
class Imported:
    """A run made of a table, how its columns were read, and what looks wrong with it."""

    run: Recording
    columns: dict[str, str]
    delimiter: str
    decimal: str
    even: bool
    warnings: tuple[str, ...]


def read(path: Path, options: ImportOptions) -> Imported:
    """Read a table into a run.

    Raises
    ------
    InputError
        For an unreadable table, an unknown column or unit, a cell that is not a number, or times that do not increase:
        each naming the line and what to do.
    """
    cells = _cells(path)
    warnings: list[str] = []
    t_column, x_column, frames = find(cells, options.time, options.position, options.frame_rate_hz is not None)
    x_size, x_unit = unit(cells, x_column, options.x_unit, "length", "--x-unit", warnings)
    position = np.array(cells.numbers(x_column)) * x_size
    _plausible(position, cells)
    t_unit = "frames"
    if t_column is None or frames:
        if options.frame_rate_hz is None:
            what = "has frame numbers but no times" if frames else "has no column of times"
            raise InputError(what, str(path), "give --frame-rate, for example --frame-rate '400 fps'")
        index = np.arange(position.size, dtype=np.float64)
        if t_column is not None:
            index = np.array(cells.numbers(t_column))
        time = index / options.frame_rate_hz
        _increasing(time, cells)
    else:
        t_size, t_unit = unit(cells, t_column, options.t_unit, "time", "--t-unit", warnings)
        time = np.array(cells.numbers(t_column)) * t_size
        _increasing(time, cells)
        if options.frame_rate_hz is not None:
            time = _retimed(time, options.frame_rate_hz, warnings)
    if time.size < 2:
        raise InputError("holds a single sample", str(path), "give a track of at least two")
    time = time - time[0]
    step = np.diff(time)
    rate = _rate(time)
    rig = Rig(mass=options.mass, stiffness=options.stiffness, belt_speed=options.belt_speed, datum=options.datum)
    if options.datum is not None:
        position = position + options.datum.value
    if options.mass is not None and options.stiffness is not None:
        warnings += check_half_period(time, position, options.mass.value, options.stiffness.value)
    columns = {
        "time": "frame rate" if t_column is None else f"{cells.label(t_column)} in {t_unit}",
        "position": f"{cells.label(x_column)} in {x_unit}",
    }
    run = _run(path, options, Recording("", "", "", rate, rig, time, position), cells, columns)
    even = bool(np.all(np.abs(step - step.mean()) <= 1e-3 * step.mean() + 1e-9))
    return Imported(run, columns, cells.delimiter_name, cells.decimal, even, tuple(warnings))


def _cells(path: Path) -> table.Table:
    if path.suffix.lower() != ".mat":
        return table.read(path)
    from daq.imports import matfile

    return matfile.read(path)


def _plausible(position: NDArray[np.float64], cells: table.Table) -> None:
    wrong = np.flatnonzero(np.abs(position) > FARTHEST_M)
    if wrong.size:
        row = int(wrong[0])
        raise InputError(
            f"position is {position[row]:.9g} m",
            f"{cells.path}, line {cells.lines[row]}",
            "delete or correct that line; if the unit is wrong, give --x-unit",
        )


def _increasing(time: NDArray[np.float64], cells: table.Table) -> None:
    wrong = np.flatnonzero(np.diff(time) <= 0)
    if wrong.size:
        row = int(wrong[0]) + 1
        raise InputError(
            f"time does not increase: {time[row]:.9g} s after {time[row - 1]:.9g} s",
            f"{cells.path}, line {cells.lines[row]}",
            "delete or correct that line; if these are not times, choose the column by --time",
        )


def _rate(time: NDArray[np.float64]) -> float:
    # The mean of the steps in which no frame was dropped: the median alone carries the rounding of printed times.
    step = np.diff(time)
    return float(1 / step[step < 1.5 * np.median(step)].mean())


def _retimed(time: NDArray[np.float64], rate_hz: float, warnings: list[str]) -> NDArray[np.float64]:
    # The flag is the camera's true rate; the column of times uses the rate that the tracking program assumed.
    assumed = _rate(time)
    ratio = assumed / rate_hz
    if 1 / FRAME_RATE_TOLERANCE <= ratio <= FRAME_RATE_TOLERANCE:
        return time
    warnings.append(
        f"the column of times gives {assumed:.4g} frames/s, --frame-rate {rate_hz:.4g}: "
        f"times were multiplied by {ratio:.6g} to agree with the flag"
    )
    return time * ratio


def _run(path: Path, options: ImportOptions, run: Recording, cells: table.Table, columns: dict[str, str]) -> Recording:
    data = path.read_bytes()
    if options.started is None:
        start = datetime.fromtimestamp(path.stat().st_mtime, UTC).replace(microsecond=0)
    else:
        start = _start(options.started)
    settings = {
        "source": path.name,
        "source_sha256": hashlib.sha256(data).hexdigest(),
        "delimiter": cells.delimiter_name,
        "decimal": cells.decimal,
        **columns,
    }
    lines = [f"{key} = {quoted(value)}" for key, value in settings.items()]
    if options.frame_rate_hz is not None:
        lines.append(f"frame_rate_hz = {options.frame_rate_hz!r}")
    end = start + timedelta(seconds=float(run.time[-1]))
    origin = "file's time of modification" if options.started is None else "--start"
    return replace(
        run,
        title=options.title or f"{path.name}, imported",
        started=start.isoformat(),
        ended=end.isoformat(),
        config_toml=run.rig.to_toml() + "[import]\n" + "\n".join(lines) + "\n",
        provenance=provenance.here() | {"start_time_from": origin},
    )


def _start(text: str) -> datetime:
    try:
        start = datetime.fromisoformat(text)
    except ValueError:
        start = None
    if start is None or start.tzinfo is None:
        raise InputError(f"{text!r} is not a time with a zone", "--start", "write it like 2024-05-01T14:30:00+02:00")
    return start
