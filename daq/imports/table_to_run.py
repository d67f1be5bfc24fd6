"""A table of t, x (a CSV, a MATLAB file) made into a run file: columns and units are found, the frame rate is checked.

Times must increase; they need not be even.  Nothing is repaired: a bad line is refused, or left out on request.

A column may hold the force of a spring that pulls a slider.  In the frame of the pulling end this is the belt rig: the
position is the spring's stretch, force / stiffness, and the belt's speed is the pulling speed, both positive.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.imports import labview, layout, plausible, table
from daq.imports.columns import belt_unit, called, find, is_length, is_stated, named, unit
from daq.imports.frame_rate import check_half_period
from daq.imports.options import ImportOptions
from daq.runfile import provenance
from daq.runfile.in_memory import counts, sample_rate, with_belt
from daq.runfile.recording import FASTEST_HZ, LONGEST_S, OF_FILE, Recording, impossible_motion, positions
from daq.runfile.rest_position import question
from daq.runfile.rig import Rig
from stickslip.compute.stages import Stages, silent
from stickslip.errors import InputError
from stickslip.toml import quoted
from stickslip.units import Measured

# Ratio of the times' rate to --frame-rate beyond which the times are corrected.  An error of 1 % in time
# is 1 % in velocity: double leaves 2 % uncorrected, half corrects what rounded times cause.  Not swept.
FRAME_RATE_TOLERANCE = 1.01
GRAVITY = 9.80665  # m/s^2, standard
WEIGHT = ("weight", "mg")  # words for a force divided by the slider's weight
DAY_S = 86400.0


@dataclass(frozen=True)
class Imported:
    """A run made of a table, how its columns were read, what was left out of it, and what looks wrong with it.

    ``assumed`` are the SI units of columns that state none.
    """

    run: Recording
    columns: dict[str, str]
    delimiter: str
    decimal: str
    even: bool
    skipped: int
    warnings: tuple[str, ...]
    assumed: tuple[str, ...] = ()


def read(path: Path, options: ImportOptions, progress: Stages = silent) -> Imported:
    """Read a table into a run; ``progress`` is called with the stage, the lines done, and all lines.

    Raises
    ------
    InputError
        For an unreadable table, an unknown column or unit, a cell that is not a number, or times that do not increase:
        each naming line and column and what to do; for numbers that cannot be in the unit they are taken for.
    """
    stated = options.stated()
    _check_options(options, stated)
    cells = named(_cells(path, options, progress))
    warnings: list[str] = []
    forces = options.spring_force is not None
    wanted, flag = (options.spring_force, "--spring-force") if forces else (options.position, "--position")
    b_column = None if options.belt_column is None else called(cells, options.belt_column, "--belt-column")
    rate_known = options.frame_rate_hz is not None
    t_column, x_column, frames = find(cells, options.time, wanted, rate_known, flag, b_column)
    coded = t_column is not None and _is_timecode(cells, t_column)
    if coded and not rate_known:
        what = f"{cells.label(t_column or 0)} holds time codes, whose last part may be frames or hundredths"
        raise InputError(what, str(path), "give --frame-rate, one line a frame, for example --frame-rate '400 fps'")
    t_column = None if coded else t_column
    if (t_column is None or frames) and options.frame_rate_hz is None:
        what = "has frame numbers but no times" if frames else "has no column of times"
        raise InputError(what, str(path), "give --frame-rate, for example --frame-rate '400 fps'")
    pitch = stated.get("metres_per_count")
    if isinstance(pitch, Measured):
        _check_counts(cells, x_column, options)
        x_size, x_unit = 1.0, f"counts of {pitch.value:g} m"
    else:
        x_size, x_unit = _position_unit(cells, x_column, options, warnings)
    readers: list[table.ColumnReader] = [(x_column, cells.number, "a number")]
    if t_column is not None:
        readers.append((t_column, layout.clock, "a time of day") if options.clock else _times(cells, t_column))
    if b_column is not None:
        readers.append((b_column, cells.number, "a number"))
    values, cells, skipped = cells.columns(readers, skip=options.skip_bad, progress=progress)
    if skipped:
        share = 100 * len(skipped) / (len(skipped) + len(cells.lines))
        warnings.append(
            f"{len(skipped)} lines ({share:.2g} %) could not be read and were left out: {table.listed(skipped)}"
        )
    if values.shape[1] < 2:
        raise InputError(
            f"holds {('no', 'a single')[values.shape[1]]} sample", str(path), "give a track of at least two"
        )
    count = counts(values[0], pitch, cells.label(x_column)) if isinstance(pitch, Measured) else None
    rig = _rig(options, stated)
    position = values[0] * x_size if count is None else positions(count, replace(rig, datum=None))
    plausible.check_range(position, plausible.FARTHEST_M, cells, x_column, "m", "its unit")
    t_unit = "frames"
    if t_column is None or frames:
        if options.frame_rate_hz is None:
            raise ValueError("frames without a frame rate")
        time = (values[1] if t_column is not None else np.arange(position.size)) / options.frame_rate_hz
    elif options.clock:
        t_unit = ""
        midnights = np.cumsum(np.diff(values[1], prepend=values[1][0]) < -DAY_S / 2)
        time = values[1] + DAY_S * midnights
    else:
        t_size, t_unit = unit(cells, t_column, options.t_unit, "time", "--t-unit", warnings)
        time = values[1] * t_size
    if t_column is not None:
        plausible.check_range(time, LONGEST_S, cells, t_column, "s", "--t-unit")
        plausible.check_increasing(time, cells, t_column)
        if not (frames or options.clock):
            if options.frame_rate_hz is not None:
                time = _retimed(time, options.frame_rate_hz, warnings)
            elif not is_stated(cells, t_column, options.t_unit):
                plausible.ask_for_time_unit(time, cells, t_column)
    time = time - time[0]
    if (wrong := impossible_motion(time, position)) is not None:
        do = "give the unit of the times with --t-unit" if options.frame_rate_hz is None else "check --frame-rate"
        raise InputError(wrong, str(path), do)
    sure = count is not None or is_stated(cells, x_column, options.force_unit if forces else options.x_unit)
    if not sure:
        plausible.ask_for_length_unit(time, position, cells, x_column, forces)
    step = np.diff(time)
    rate = sample_rate(time)
    rest = options.x0
    if options.datum is not None:
        rest = replace(options.datum, value=-options.datum.value)
    if rest is not None and (asked := question(rest, float(position.min()), float(position.max()))):
        warnings.append(asked)
    position = position + rig.offset
    if rig.mass is not None and rig.stiffness is not None:
        warnings += check_half_period(time, position, rig.mass.value, rig.stiffness.value)
    in_unit = ", times of day" if options.clock else f" in {t_unit}"
    columns = {
        "time": "frame rate" if t_column is None else f"{cells.label(t_column)}{in_unit}",
        "position": f"{cells.label(x_column)} in {x_unit}",
    }
    run = Recording("", "", "", rate, rig, time, position, count)
    if b_column is not None:
        of, size, name = belt_unit(cells, b_column, options.belt_unit)
        moved = values[-1] * size
        plausible.check_range(moved, plausible.FARTHEST_M, cells, b_column, "m", "--belt-unit")
        run = with_belt(run, moved if of == "length" else _travelled(time, moved))
        columns["belt"] = f"{cells.label(b_column)} in {name}, its {'position' if of == 'length' else of}"
    run = _run(path, options, run, cells, columns, skipped)
    even = bool(np.all(np.abs(step - step.mean()) <= 1e-3 * step.mean() + 1e-9))
    assumed = [] if sure else ["N" if forces else "m"]
    if t_column is not None and not (frames or options.clock or is_stated(cells, t_column, options.t_unit)):
        assumed.append("s")
    return Imported(
        run, columns, cells.delimiter_name, cells.decimal, even, len(skipped), tuple(warnings), tuple(assumed)
    )


def _travelled(time: NDArray[np.float64], speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positions, m, of a belt whose speeds, m/s, were measured: by the trapezoidal rule."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))))


def _is_timecode(cells: table.Table, column: int) -> bool:
    row = next((row for row in cells.rows if len(row) == cells.width), None)
    return row is not None and layout.is_timecode(row[column])


def _check_counts(cells: table.Table, column: int, options: ImportOptions) -> None:
    """Refuse a unit of length beside metres per count."""
    flag = "--x-unit" if options.x_unit is not None else "--spring-force" if options.spring_force is not None else ""
    if flag:
        raise InputError(f"{flag} beside metres per count", "command line", "leave one out: counts have no other unit")
    if cells.names and is_length(cells.names[column]):
        what = f"{cells.label(column)} is a length, and metres per count are given"
        do = "leave --metres-per-count out, or choose the column of counts by --position"
        raise InputError(what, cells.place(cells.header_line, column), do)


def _check_options(options: ImportOptions, stated: Mapping[str, Measured | int]) -> None:
    """Refuse flags that exclude or need each other."""
    if options.belt_unit is not None and options.belt_column is None:
        raise InputError("--belt-unit without --belt-column", "command line", "name the column of the belt")
    if options.preamble < 0:
        raise InputError(f"is {options.preamble}", "--preamble", "give a number of lines, 0 or more")
    if options.frame_rate_hz is not None and not 1 / LONGEST_S <= options.frame_rate_hz <= FASTEST_HZ:
        raise InputError(
            f"is {options.frame_rate_hz:.3g} Hz", "--frame-rate", "give the camera's rate, such as '400 fps'"
        )
    if options.clock and options.t_unit is not None:
        raise InputError("--clock and --t-unit exclude each other", "command line", "leave one out")
    if options.x0 is not None and options.datum is not None:
        raise InputError("--x0 and --datum together", "command line", "give --x0 alone: --datum is -x0")
    if options.spring_force is None:
        if options.force_unit is not None:
            raise InputError("--force-unit without --spring-force", "command line", "name the column of the force")
        return
    if options.position is not None or options.x_unit is not None:
        what = "--spring-force excludes --position and --x-unit"
        raise InputError(what, "command line", "give --force-unit for the unit of the force")
    if _is_over_weight(options) and options.mass is None:
        in_si = {"--belt": options.belt_speed, "--x0": options.x0, "--datum": options.datum}
        for flag, value in (in_si | {"--belt-column": options.belt_column}).items():
            if value is not None:
                what = f"{flag} is in SI, but positions are in units of weight / stiffness without the slider's --mass"
                raise InputError(what, flag, "give --mass and --stiffness, or leave it out")
    elif options.stiffness is None:
        raise InputError("--spring-force without the spring's stiffness", "command line", "give --stiffness")


def _is_over_weight(options: ImportOptions) -> bool:
    return options.force_unit is not None and options.force_unit.strip() in WEIGHT


def _position_unit(cells: table.Table, column: int, options: ImportOptions, warnings: list[str]) -> tuple[float, str]:
    """Return what a number of the column is multiplied by to be a position in m, and the unit in words."""
    if options.spring_force is None:
        return unit(cells, column, options.x_unit, "length", "--x-unit", warnings)
    if _is_over_weight(options):
        if options.mass is None or options.stiffness is None:
            warnings.append(
                "the weight is not known: positions are in units of weight / stiffness, written as m; times and ratios "
                "of lengths are right; give --mass and --stiffness for metres"
            )
            return 1.0, "units of weight, as a stretch in units of weight / stiffness"
        weight = options.mass.value * GRAVITY
        return (
            weight / options.stiffness.value,
            f"units of weight ({weight:.6g} N), over {options.stiffness.value:g} N/m",
        )
    size, name = unit(cells, column, options.force_unit, "force", "--force-unit", warnings)
    if not is_stated(cells, column, options.force_unit):
        warnings.append(
            f"{cells.label(column)} states no unit and is read in N; for a force divided by the weight give "
            "--force-unit weight"
        )
    if options.stiffness is None:
        raise ValueError("a force without a stiffness")
    return size / options.stiffness.value, f"{name}, over {options.stiffness.value:g} N/m"


def _rig(options: ImportOptions, stated: Mapping[str, Measured | int]) -> Rig:
    """Return the stated calibration; without the one that positions in units of weight / stiffness cannot use."""
    if _is_over_weight(options) and (options.mass is None or options.stiffness is None):
        return Rig(mass=options.mass)
    return replace(Rig(), datum=options.datum).stating(stated)


def _cells(path: Path, options: ImportOptions, progress: Stages) -> table.Table:
    kind = path.suffix.lower()
    if kind not in (".mat", ".xlsx", ".tdms"):
        text = table.text_of(path)
        if not text.startswith(labview.BEGINS):
            return table.of_lines(path, text.split("\n"), options.preamble, progress)
        _check_plain("a LabVIEW measurement", path, options)
        return labview.read(path, text)
    if kind == ".xlsx":
        from daq.imports import workbook

        return workbook.read(path, options.sheet, options.preamble, progress)
    from daq.imports import matfile, tdms

    name, module = ("a MATLAB file", matfile) if kind == ".mat" else ("a TDMS file", tdms)
    _check_plain(name, path, options)
    cells: table.Table = module.read(path)
    return cells


def _check_plain(kind: str, path: Path, options: ImportOptions) -> None:
    """Refuse flags about text of any program for a file whose form is known."""
    for flag, given in (("--preamble", options.preamble), ("--clock", options.clock)):
        if given:
            raise InputError(f"{flag} is for text; this is {kind}", str(path), "leave it out")


def _times(cells: table.Table, column: int) -> table.ColumnReader:
    """Return how to read a column of times; InputError for times of day, which need a flag."""
    row = next((row for row in cells.rows if len(row) == cells.width), None)
    if row is not None and cells.number(row[column]) is None and layout.clock(row[column]) is not None:
        what = f"{cells.label(column)} holds times of day such as {row[column].strip()}"
        raise InputError(
            what, cells.place(cells.lines[cells.rows.index(row)], column), "give --clock", python="give clock=True"
        )
    return column, cells.number, "a number"


def _retimed(time: NDArray[np.float64], rate_hz: float, warnings: list[str]) -> NDArray[np.float64]:
    # The flag is the camera's true rate; the column of times uses the rate that the tracking program assumed.
    assumed = sample_rate(time)
    ratio = assumed / rate_hz
    if 1 / FRAME_RATE_TOLERANCE <= ratio <= FRAME_RATE_TOLERANCE:
        return time
    warnings.append(
        f"the column of times gives {assumed:.4g} frames/s, --frame-rate {rate_hz:.4g}: "
        f"times were multiplied by {ratio:.6g} to agree with the flag"
    )
    return time * ratio


def _run(
    path: Path,
    options: ImportOptions,
    run: Recording,
    cells: table.Table,
    columns: dict[str, str],
    skipped: Sequence[table.Skipped],
) -> Recording:
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
    if cells.recorded:
        lines.append(f"recorded = {quoted(cells.recorded)}")
    if skipped:
        lines.append(f"skipped_lines = {[one.line for one in skipped]}")
    end = start + timedelta(seconds=float(run.time[-1]))
    origin = OF_FILE if options.started is None else "--start"
    return replace(
        run,
        title=f"{path.name}, imported",
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
