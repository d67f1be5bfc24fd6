"""A table of t, x (a CSV, a MATLAB file) made into a run file: columns and units are found, the frame rate is checked.

Times must increase; they need not be even.  Nothing is repaired: a bad line is refused, or left out on request.

A column may hold the force of a spring that pulls a slider.  In the frame of the pulling end this is the belt rig: the
position is the spring's stretch, force / stiffness, and the belt's speed is the pulling speed, both positive.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np

from daq.imports import layout, plausible, source, table
from daq.imports.columns import (
    check_clock,
    find_by_name,
    find_columns,
    find_dimension,
    is_stated,
    name_from_comment,
    read_belt_unit,
    read_unit,
)
from daq.imports.formats import labview
from daq.imports.frame_rate import check_half_period
from daq.imports.lines import number_lines
from daq.imports.options import ImportOptions
from daq.runfile import provenance
from daq.runfile.in_memory import add_belt, measure_rate, read_counts
from daq.runfile.recording import Recording
from daq.runfile.rest_position import question_rest_position
from daq.runfile.rig import Rig
from daq.runfile.run_data import FASTEST_HZ, LONGEST_S, OF_FILE, explain_impossible, positions
from daq.wire.roll_over import find_roll_over, unroll
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError
from stickslip.toml import quote
from stickslip.units import Measured

# Ratio of the times' rate to --frame-rate beyond which times are corrected; 1 % in time is 1 % in velocity.
FRAME_RATE_TOLERANCE = 1.01
GRAVITY = 9.80665  # m/s^2, standard
WEIGHT = ("weight", "mg")  # words for a force divided by the slider's weight
DAY_S = 86400.0
MOST_TICKS = 2.0**53  # whole numbers up to here are exact


@dataclass(frozen=True)
class Imported:
    """A run made of a table, how its columns were read, what was left out of it, and what looks wrong with it."""

    run: Recording
    columns: dict[str, str]
    delimiter: str
    decimal: str
    even: bool
    skipped: int
    warnings: tuple[str, ...]
    assumed: tuple[str, ...] = ()


class Columns(NamedTuple):
    """Which columns hold what; None where a column is missing."""

    time: int | None
    position: int
    belt: int | None
    frames: bool  # whether the times are frame numbers


def read(path: Path, options: ImportOptions, progress: Stages = silent) -> Imported:
    """Read a table into a run; ``progress`` is called with the stage, the lines done, and all lines."""
    stated = options.stated()
    _check_options(options, stated)
    cells = name_from_comment(_read_cells(path, options, progress))
    warnings: list[str] = []
    forces = options.spring_force is not None
    columns = _choose_columns(cells, options)
    if len(cells.starts) > 1:
        cells = cells.segment(options.segment)
        options = options if options.segment == 0 else replace(options, segment=None)
    pitch = stated.get("metres_per_count")
    if isinstance(pitch, Measured):
        _check_counts(cells, columns.position, options)
        x_size, x_unit = 1.0, f"counts of {pitch.value:g} m"
    else:
        x_size, x_unit = _read_position_unit(cells, columns.position, options, warnings)
    values, cells, skipped = _read_numbers(cells, columns, options, progress)
    if skipped:
        share = 100 * len(skipped) / (len(skipped) + len(cells.lines))
        lines = table.list_lines(skipped)
        warnings.append(f"{len(skipped)} lines ({share:.2g} %) could not be read and were skipped: {lines}")
    if cells.beside:
        count_of = f"{len(cells.beside)} line{'s' if len(cells.beside) > 1 else ''}"
        warnings.append(
            f"{count_of} were skipped because all their cells are outside the table: {table.list_lines(cells.beside)}"
        )
    if values.shape[1] < 2:
        what = f"has {('no', 'a single')[values.shape[1]]} sample"
        raise InputError(what, str(path), "use a track of at least two samples")
    time, t_unit, chosen = _read_times(values, cells, columns, options, warnings)
    values = values[:, chosen]
    cells = cells.take(chosen)
    count = read_counts(values[0], pitch, cells.label(columns.position)) if isinstance(pitch, Measured) else None
    if count is not None and (roll_over := find_roll_over(count)) is not None:
        count = unroll(count, roll_over)
        warnings.append(f"the counter rolled over or restarted {roll_over}; these jumps were removed")
    rig = _build_rig(options, stated)
    position = values[0]
    position *= x_size
    if count is not None:
        position = positions(count, replace(rig, datum=None))
    plausible.check_range(position, plausible.FARTHEST_M, cells, columns.position, "m", "its unit")
    if (impossible := explain_impossible(time, position)) is not None:
        do = "state the unit of the times with --t-unit" if options.frame_rate_hz is None else "check --frame-rate"
        raise InputError(impossible, str(path), do)
    has_unit = count is not None or is_stated(cells, columns.position, options.force_unit if forces else options.x_unit)
    if not has_unit:
        plausible.ask_for_length_unit(time, position, cells, columns.position, forces)
    rest_position = options.x0
    if options.datum is not None:
        rest_position = replace(options.datum, value=-options.datum.value)
    if rest_position is not None and (
        doubt := question_rest_position(rest_position, float(position.min()), float(position.max()))
    ):
        warnings.append(doubt)
    position += rig.offset
    if rig.mass is not None and rig.stiffness is not None:
        warnings += check_half_period(time, position, rig.mass.value, rig.stiffness.value)
    in_unit = ", times of day" if options.clock else f" in {t_unit}"
    sources = {
        "time": "frame rate" if columns.time is None else f"{cells.label(columns.time)}{in_unit}",
        "position": f"{cells.label(columns.position)} in {x_unit}",
    }
    run = Recording("", "", "", measure_rate(time), rig, time, position, count)
    if columns.belt is not None:
        dimension, size, name = read_belt_unit(cells, columns.belt, options.belt_unit)
        belt = values[-1] * size
        plausible.check_range(belt, plausible.FARTHEST_M, cells, columns.belt, "m", "--belt-unit")
        if dimension == "speed":  # by the trapezoidal rule
            belt = np.concatenate(([0.0], np.cumsum(0.5 * (belt[1:] + belt[:-1]) * np.diff(time))))
        run = add_belt(run, belt)
        kind = "position" if dimension == "length" else dimension
        sources["belt"] = f"{cells.label(columns.belt)} in {name}, its {kind}"
    run = _complete_run(options, run, cells, sources, skipped)
    step = np.diff(time)
    mean = step.mean()
    even = bool(max(step.max() - mean, mean - step.min()) <= 1e-3 * mean + 1e-9)
    assumed = [] if has_unit else ["N" if forces else "m"]
    if columns.time is not None and not (
        columns.frames or options.clock or is_stated(cells, columns.time, options.t_unit)
    ):
        assumed.append("s")
    return Imported(
        run, sources, cells.delimiter_name, cells.decimal, even, len(skipped), tuple(warnings), tuple(assumed)
    )


def _choose_columns(cells: table.Table, options: ImportOptions) -> Columns:
    forces = options.spring_force is not None
    requested, flag = (options.spring_force, "--spring-force") if forces else (options.position, "--position")
    belt = None if options.belt_column is None else find_by_name(cells, options.belt_column, "--belt-column")
    rate_known = options.frame_rate_hz is not None
    time, position, frames = find_columns(cells, options.time, requested, rate_known, flag, belt)
    if belt is not None and check_clock(cells, belt, time) != time:
        what = f"{cells.label(belt)} and {cells.label(position)} have different times"
        raise InputError(what, str(cells.path), "export both channels at the same times")
    has_timecodes = time is not None and _is_timecode(cells, time)
    if has_timecodes and not rate_known:
        what = f"{cells.label(time or 0)} contains time codes, whose last part may be frames or hundredths"
        do = "add --frame-rate, for example --frame-rate '400 fps', if each line is one frame"
        raise InputError(what, str(cells.path), do)
    time = None if has_timecodes else time
    if (time is None or frames) and not rate_known:
        what = "contains frame numbers but no times" if frames else "has no column of times"
        raise InputError(what, str(cells.path), "add --frame-rate, for example --frame-rate '400 fps'")
    return Columns(time, position, belt, frames)


def _read_numbers(
    cells: table.Table, columns: Columns, options: ImportOptions, progress: Stages
) -> tuple[Array, table.Table, tuple[int, ...]]:
    """Return positions, times if any, and the belt if any, as `daq.imports.table.Table.columns` does."""
    readers: list[table.ColumnReader] = [(columns.position, cells.number, "a number")]
    if columns.time is not None:
        readers.append(_choose_time_reader(cells, columns.time, clock=options.clock))
    if columns.belt is not None:
        readers.append((columns.belt, cells.number, "a number"))
    return cells.columns(readers, skip=options.skip_bad, progress=progress)


def _read_times(
    values: Array, cells: table.Table, columns: Columns, options: ImportOptions, warnings: list[str]
) -> tuple[Array, str, slice]:
    """Return the times from the first sample on, s, their unit, and the lines of the chosen measurement."""
    every = slice(0, values.shape[1])
    rate = options.frame_rate_hz
    if columns.time is None:
        return np.arange(values.shape[1]) / (rate or math.nan), "frames", every
    time, t_unit = values[1], "frames"
    if columns.frames:
        time = time / (rate or math.nan)
    elif options.clock:
        t_unit = ""
        time = time + DAY_S * np.cumsum(np.diff(time, prepend=time[0]) < -DAY_S / 2)  # times past midnight
    else:
        size, t_unit = read_unit(cells, columns.time, options.t_unit, "time", "--t-unit", warnings)
        time = _unroll_times(time, warnings)
        time *= size  # in place: a long table takes 8 bytes a sample for each copy
    time, chosen = _choose_measurement(time, cells, options.segment)
    cells = replace(cells, lines=cells.lines[chosen])
    time = time[chosen]
    plausible.check_range(time - time[0], LONGEST_S, cells, columns.time, "s", "--t-unit")
    if not (columns.frames or options.clock) and rate is not None and np.any(np.diff(time) == 0):
        time = plausible.number_evenly(time, rate, cells, columns.time, warnings)
    plausible.check_increasing(time, cells, columns.time)
    if not (columns.frames or options.clock):
        if rate is not None:
            time = _correct_times(time, rate, warnings)
        elif not is_stated(cells, columns.time, options.t_unit):
            plausible.ask_for_time_unit(time, cells, columns.time)
    warnings += plausible.describe_gap(time, cells, clock=options.clock)
    time -= time[0]
    return time, t_unit, chosen


def _unroll_times(time: Array, warnings: list[str]) -> Array:
    """Return the stamps of a board's clock, micros() or millis(), without the jumps where it rolled over."""
    if np.all(np.diff(time) >= 0) or not np.all(time == np.rint(time)) or np.max(np.abs(time)) > MOST_TICKS:
        return time
    ticks = time.astype(np.int64)
    roll_over = find_roll_over(ticks)
    if roll_over is None or roll_over.counts not in (1 << 16, 1 << 32):
        return time
    warnings.append(f"the clock of the times rolled over {roll_over}; these jumps were removed")
    return unroll(ticks, roll_over).astype(np.float64)


def _choose_measurement(time: Array, cells: table.Table, segment: int | None) -> tuple[Array, slice]:
    """Return times and lines of a measurement, which starts where times restart; 0 joins them at a usual step."""
    step = np.diff(time)
    backward_rows = np.flatnonzero(step < 0) + 1
    if not backward_rows.size and not segment:
        return time, slice(0, time.size)
    restarts = backward_rows[time[backward_rows] <= time[0] + np.median(np.abs(step))]
    starts = (0, *(int(row) for row in restarts))
    if backward_rows.size != restarts.size or min(np.diff([*starts, time.size])) < 2:
        starts = (0,)  # times out of order, of which `plausible` names the line
    if segment == 0:
        lag = np.zeros(time.size)
        lag[list(starts[1:])] = np.median(np.abs(step)) - step[np.array(starts[1:], int) - 1]
        return time + np.cumsum(lag), slice(0, time.size)
    chosen = replace(cells, starts=starts).segment(segment)
    first = int(np.argmax(cells.lines == chosen.lines[0]))
    return time, slice(first, first + len(chosen.lines))


def _is_timecode(cells: table.Table, column: int) -> bool:
    row = next((row for row in cells.rows if len(row) == cells.width), None)
    return row is not None and layout.is_timecode(row[column])


def _check_counts(cells: table.Table, column: int, options: ImportOptions) -> None:
    """Reject a unit of length given together with metres per count."""
    flag = "--x-unit" if options.x_unit is not None else "--spring-force" if options.spring_force is not None else ""
    if flag:
        raise InputError(
            f"{flag} cannot be combined with metres per count",
            "command line",
            "omit one of them, because counts have no other unit",
        )
    if cells.names and find_dimension(cells.names[column]) == "length":
        what = f"{cells.label(column)} is a length, but metres per count are given"
        do = "omit --metres-per-count, or choose the column of counts with --position"
        raise InputError(what, cells.locate(cells.header_line, column), do)


def _check_options(options: ImportOptions, stated: Mapping[str, Measured | int]) -> None:
    """Reject flags that exclude or need each other."""
    if options.belt_unit is not None and options.belt_column is None:
        raise InputError("--belt-unit requires --belt-column", "command line", "add the column of the belt")
    if options.preamble < 0:
        raise InputError(f"is {options.preamble}", "--preamble", "use a number of lines, 0 or more")
    if options.frame_rate_hz is not None and not 1 / LONGEST_S <= options.frame_rate_hz <= FASTEST_HZ:
        raise InputError(
            f"is {options.frame_rate_hz:.3g} Hz", "--frame-rate", "use the rate of the camera, such as '400 fps'"
        )
    if options.clock and options.t_unit is not None:
        raise InputError("--clock and --t-unit cannot be combined", "command line", "omit one")
    if options.x0 is not None and options.datum is not None:
        raise InputError("--x0 and --datum cannot be combined", "command line", "use only --x0; the datum is -x0")
    if options.spring_force is None:
        if options.force_unit is not None:
            raise InputError("--force-unit requires --spring-force", "command line", "add the column of the force")
        return
    if options.position is not None or options.x_unit is not None:
        what = "--spring-force cannot be combined with --position or --x-unit"
        raise InputError(what, "command line", "state the unit of the force with --force-unit")
    if _is_over_weight(options) and options.mass is None:
        in_si = {"--belt-speed": options.belt_speed, "--x0": options.x0, "--datum": options.datum}
        for flag, value in (in_si | {"--belt-column": options.belt_column}).items():
            if value is not None:
                what = f"{flag} is in SI units, but without --mass positions are in units of weight / stiffness"
                raise InputError(what, flag, "add --mass and --stiffness, or omit it")
    elif options.stiffness is None:
        raise InputError("--spring-force requires the stiffness of the spring", "command line", "add --stiffness")


def _is_over_weight(options: ImportOptions) -> bool:
    return options.force_unit is not None and options.force_unit.strip() in WEIGHT


def _read_position_unit(
    cells: table.Table, column: int, options: ImportOptions, warnings: list[str]
) -> tuple[float, str]:
    """Return the factor from numbers of the column to positions in m, and the unit in words."""
    if options.spring_force is None:
        return read_unit(cells, column, options.x_unit, "length", "--x-unit", warnings)
    if _is_over_weight(options):
        if options.mass is None or options.stiffness is None:
            warnings.append(
                "the weight is not known, so positions are in units of weight / stiffness, written as m. "
                "Times and ratios of lengths are correct. Add --mass and --stiffness to obtain metres"
            )
            return 1.0, "units of weight, as an extension in units of weight / stiffness"
        weight = options.mass.value * GRAVITY
        return (
            weight / options.stiffness.value,
            f"units of weight ({weight:.6g} N), over {options.stiffness.value:g} N/m",
        )
    size, name = read_unit(cells, column, options.force_unit, "force", "--force-unit", warnings)
    if not is_stated(cells, column, options.force_unit):
        warnings.append(
            f"{cells.label(column)} has no unit, so N is assumed; for a force divided by the weight, use "
            "--force-unit weight"
        )
    if options.stiffness is None:
        raise ValueError("a force requires a stiffness")
    return size / options.stiffness.value, f"{name}, over {options.stiffness.value:g} N/m"


def _build_rig(options: ImportOptions, stated: Mapping[str, Measured | int]) -> Rig:
    """Return the stated calibration; without what positions in units of weight / stiffness cannot use."""
    if _is_over_weight(options) and (options.mass is None or options.stiffness is None):
        return Rig(mass=options.mass)
    return replace(Rig(), datum=options.datum).stating(stated)


def _read_cells(path: Path, options: ImportOptions, progress: Stages) -> table.Table:
    kind = path.suffix.lower()
    if kind == ".xlsx":
        from daq.imports.formats import workbook

        return workbook.read(path, options.sheet, options.preamble, progress)
    if kind in (".mat", ".tdms"):
        from daq.imports.formats import matfile, tdms

        name, module = ("a MATLAB file", matfile) if kind == ".mat" else ("a TDMS file", tdms)
        _check_plain(name, path, options)
        cells: table.Table = module.read(path)
        return cells
    file = source.read(path)
    text, sha256, modified_s = table.decode_text(file), file.sha256, file.modified_s
    del file  # a long one has as many bytes again
    if text.startswith(labview.BEGINS):
        _check_plain("a LabVIEW measurement", path, options)
        cells = labview.read(path, text)
    else:
        lines = number_lines(text)
        del text
        cells = table.parse_lines(path, lines, options.preamble, progress)
    return replace(cells, sha256=sha256, modified_s=modified_s)


def _check_plain(kind: str, path: Path, options: ImportOptions) -> None:
    """Reject flags about text of any program for a file of a known form."""
    for flag, value in (("--preamble", options.preamble), ("--clock", options.clock)):
        if value:
            raise InputError(f"{flag} applies only to text files, but this is {kind}", str(path), "omit it")


def _choose_time_reader(cells: table.Table, column: int, *, clock: bool) -> table.ColumnReader:
    if clock:
        return column, _Clock().read, "write times of day, with or without a date such as 2026-03-27"
    index, row = next(((index, row) for index, row in enumerate(cells.rows) if len(row) == cells.width), (0, None))
    if row is not None and cells.number(row[column]) is None and layout.read_clock(row[column]) is not None:
        what = f"{cells.label(column)} contains times of day such as {row[column].strip()}"
        where = cells.locate(int(cells.lines[index]), column)
        raise InputError(what, where, "add --clock", python="pass clock=True")
    return column, cells.number, "a number"


class _Clock:
    """Reads times of day, with the dates before them, as seconds from the first midnight."""

    def __init__(self) -> None:
        self._date: str | None = None
        self._day: int | None = None

    def read(self, cell: str) -> float | None:
        """Return a cell in s; None where it is not a time, or its date is another one that cannot be read."""
        seconds, day = layout.read_clock(cell), layout.read_day(cell)
        date = cell.strip()[: -len(layout.strip_date(cell))].strip(" T")
        if self._date is None:
            self._date, self._day = date, day
        if seconds is None or (date != self._date and (day is None or self._day is None)):
            return None
        return seconds + (DAY_S * (day - self._day) if day is not None and self._day is not None else 0.0)


def _correct_times(time: Array, rate_hz: float, warnings: list[str]) -> Array:
    # The flag is the camera's true rate; the column of times uses the rate that the tracking program assumed.
    assumed = measure_rate(time)
    ratio = assumed / rate_hz
    if 1 / FRAME_RATE_TOLERANCE <= ratio <= FRAME_RATE_TOLERANCE:
        return time
    warnings.append(
        f"the column of times gives {assumed:.4g} frames/s, --frame-rate {rate_hz:.4g}: "
        f"times were multiplied by {ratio:.6g} to agree with the flag"
    )
    return time * ratio


def _complete_run(
    options: ImportOptions,
    run: Recording,
    cells: table.Table,
    columns: dict[str, str],
    skipped: Sequence[int],
) -> Recording:
    if options.started is None:
        start = datetime.fromtimestamp(cells.modified_s, UTC).replace(microsecond=0)
    else:
        start = _parse_start(options.started)
    settings = {"source": cells.path.name, "source_sha256": cells.sha256, "delimiter": cells.delimiter_name}
    settings |= {"decimal": cells.decimal} | columns
    lines = [f"{key} = {quote(value)}" for key, value in settings.items()]
    if options.frame_rate_hz is not None:
        lines.append(f"frame_rate_hz = {options.frame_rate_hz!r}")
    if cells.recorded:
        lines.append(f"recorded = {quote(cells.recorded)}")
    if skipped:
        lines.append(f"skipped_lines = {[*skipped]}")
    try:
        end = start + timedelta(seconds=float(run.time[-1]))
        end.timestamp()
    except (OverflowError, ValueError) as error:  # beyond the years that a calendar has
        raise InputError(f"a run of {run.time[-1]:g} s cannot start at {start}", "--start", "correct it") from error
    origin = OF_FILE if options.started is None else "--start"
    return replace(
        run,
        title=f"{cells.path.name}, imported",
        started=start.isoformat(),
        ended=end.isoformat(),
        config_toml=run.rig.to_toml() + "[import]\n" + "\n".join(lines) + "\n",
        provenance=provenance.collect_provenance() | {"start_time_from": origin},
    )


def _parse_start(text: str) -> datetime:
    try:
        start = datetime.fromisoformat(text)
    except ValueError:
        start = None
    if start is None or start.tzinfo is None:
        raise InputError(
            f"{text!r} is not a time with a time zone", "--start", "write it as in 2024-05-01T14:30:00+02:00"
        )
    return start
