"""A TDMS file of National Instruments as a table: channels of one length are its columns, with their units.

Where no channel holds the times, they follow from the increment of the waveform.  A child process reads the file, with
npTDMS of the extra ``formats``.
"""

import json
import logging
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daq.imports.extra import needed
from daq.imports.matfile import MEMORY, MOST_NUMBERS, SECONDS, packed, received
from daq.imports.table import Table
from daq.runfile.isolation import BrokenOffError, isolated
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

SAVE = "export it as CSV"


def read(path: Path) -> Table:
    """Read a TDMS file.

    Raises
    ------
    InputError
        When the file is missing, damaged or no TDMS file, npTDMS is not installed, or it holds no channel of numbers,
        or more than `daq.imports.matfile.MOST_NUMBERS`.
    """
    where = str(path)
    if not path.is_file():
        raise InputError("no such file", where, "check the path")
    needed("nptdms", path)
    try:
        sent = isolated(_channels, path, 10 * SECONDS, 2 * MEMORY)
    except BrokenOffError as error:
        raise InputError(f"is damaged: it {error}", where, SAVE) from error
    recorded, _, sent = sent.partition(b"\n")
    columns = dict(received(sent))
    if not columns:
        raise InputError("holds no channel of numbers", where, "give a file with times and positions in it")
    length = Counter(map(len, columns.values())).most_common(1)[0][0]
    names = tuple(name for name, cells in columns.items() if len(cells) == length)
    rows: list[Sequence[str]] = list(zip(*(columns[name] for name in names), strict=True))
    lines = list(range(1, length + 1))
    return Table(path, names, rows, lines, len(names), "", ".", kind="TDMS", recorded=json.loads(recorded))


def _channels(path: Path) -> bytes:
    """Return when the file was recorded, a line; a line of names and shapes of the channels, and their numbers."""
    import nptdms

    logging.getLogger("nptdms").setLevel(logging.CRITICAL)  # what is wrong is said once, by the error
    try:
        found = nptdms.TdmsFile.read(path)
        several = sum(bool(group.channels()) for group in found.groups()) > 1
        columns: dict[str, Array] = {}
        recorded = ""
        for group in found.groups():
            for channel in group.channels():
                values = np.asarray(channel[:])
                if values.dtype.kind in "iuf" and values.size >= 2:
                    columns[_name(channel, group.name if several else "")] = values.astype("<f8")
                    recorded = recorded or str(channel.properties.get("wf_start_time", ""))
        times = _times(found, several, columns)
    except MemoryError:
        raise
    except Exception as error:  # whatever the library stumbles over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a TDMS file ({reason})", str(path), SAVE) from error
    columns = times | columns
    numbers = sum(values.size for values in columns.values())
    if numbers > MOST_NUMBERS:
        what = f"holds {numbers} numbers; at most {MOST_NUMBERS} are read"
        raise InputError(what, str(path), "save the times and positions alone, or a part of them")
    return json.dumps(recorded).encode() + b"\n" + packed({name: x.reshape(1, -1) for name, x in columns.items()})


def _name(channel: Any, group: str) -> str:
    """Return the name of a channel with its unit, and with that of its group where there are several."""
    unit = str(channel.properties.get("unit_string", "") or "").strip()
    name = f"{group}/{channel.name}" if group else str(channel.name)
    return f"{name} ({unit})" if unit else name


def _times(found: Any, several: bool, columns: dict[str, Array]) -> dict[str, Array]:
    """Return the times of the waveforms by name: one where they agree, else one of each group."""
    times: dict[str, Array] = {}
    for group in found.groups():
        for channel in group.channels():
            own = columns.get(_name(channel, group.name if several else ""))
            step = float(channel.properties.get("wf_increment", 0.0) or 0.0)
            if own is None or step <= 0:
                continue
            time = float(channel.properties.get("wf_start_offset", 0.0) or 0.0) + step * np.arange(own.size)
            known = [name for name, other in times.items() if np.array_equal(other, time)]
            if not known:
                name = "Time (s)" if not times else f"Time of {group.name}/{channel.name} (s)"
                times[name] = time.astype("<f8")
    return times
