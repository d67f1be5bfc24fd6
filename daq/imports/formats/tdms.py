"""A TDMS file of National Instruments as a table: channels of one length are its columns, with their units.

Where no channel holds the times, they follow from the increment of the channel's own waveform.  A child process reads
the file, with npTDMS of the extra ``formats``.
"""

import io
import logging
from pathlib import Path
from typing import Any

import numpy as np

from daq.imports.formats.columns import Column, build_table, pack_columns, parse_isolated, require
from daq.imports.formats.matfile import MEMORY, SECONDS
from daq.imports.source import Source
from daq.imports.table import Table

SAVE = "export it as CSV"


def read(path: Path) -> Table:
    require("nptdms", path)
    message = parse_isolated(_parse, path, 10 * SECONDS, 2 * MEMORY, "TDMS file", SAVE)
    return build_table(path, message, "TDMS", "channel of numbers")


def _parse(path: Path) -> bytes:
    return pack_columns(_read_channels, path, "TDMS file", SAVE)


def _read_channels(file: Source) -> tuple[str, list[Column]]:
    import nptdms

    logging.getLogger("nptdms").setLevel(logging.CRITICAL)  # what is wrong is said once, by the error
    content = nptdms.TdmsFile.read(io.BytesIO(file.data))
    several = sum(bool(group.channels()) for group in content.groups()) > 1
    columns: list[Column] = []
    recorded = ""
    for group in content.groups():
        for channel in group.channels():
            values = np.asarray(channel[:])
            if values.dtype.kind in "iuf" and values.size >= 2:
                columns.append(
                    Column(_label_channel(channel, group.name if several else ""), values, _read_clock(channel))
                )
                recorded = recorded or str(channel.properties.get("wf_start_time", ""))
    return recorded, columns


def _label_channel(channel: Any, group: str) -> str:
    """Return the name of a channel with its unit, and with that of its group where there are several."""
    unit = str(channel.properties.get("unit_string", "") or "").strip()
    name = f"{group}/{channel.name}" if group else str(channel.name)
    return f"{name} ({unit})" if unit else name


def _read_clock(channel: Any) -> tuple[float, float] | None:
    step = float(channel.properties.get("wf_increment", 0.0) or 0.0)
    return (float(channel.properties.get("wf_start_offset", 0.0) or 0.0), step) if step > 0 else None
