"""A run as a flat table for other programs: CSV or Parquet, one row a sample, units in the column names.

A CSV is written with as many digits as read back exactly, so ``daq import`` of an export gives the same motion.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from daq.errors import InputError
from daq.output import atomic

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from numpy.typing import NDArray

    from daq.runfile.recording import Recording


def frame(recording: "Recording") -> "pd.DataFrame":
    """Return a run as a pandas table.

    Columns: ``time_s``, ``position_m`` (``position_count`` for a rig without metres per count), then what the run
    has of ``count, segment, belt_velocity_m_per_s`` and the raw columns as sent.
    """
    import pandas as pd

    columns: dict[str, NDArray[np.generic]] = {
        "time_s": recording.time,
        f"position_{recording.unit}": recording.position,
    }
    if recording.count is not None:
        columns["count"] = recording.count
    if recording.raw is not None:
        columns["segment"] = recording.segment
    if recording.belt_velocity is not None:
        columns["belt_velocity_m_per_s"] = recording.belt_velocity
    if recording.raw is not None:
        units = {"device_time": "device_time_us", "edge_time": "edge_time_us"}
        for name, values in vars(recording.raw).items():
            if values is not None:
                columns[units.get(name, name)] = values
    return pd.DataFrame(columns)


def write(rows: "pd.DataFrame", target: Path, form: str, *, force: bool = False) -> None:
    """Write a run's table.

    Parameters
    ----------
    rows : DataFrame
        As `frame` makes it.
    target : Path
        The file.
    form : str
        "csv" or "parquet".
    force : bool
        Replace an existing file.

    Raises
    ------
    InputError
        When the file exists, or Parquet was asked for and pyarrow is not installed.
    """
    atomic.refuse_existing(target, force)
    with atomic.replacing(target, force) as temporary:
        if form == "csv":
            rows.to_csv(temporary, index=False, lineterminator="\n")
        else:
            try:
                rows.to_parquet(temporary, index=False)
            except ImportError as error:
                raise InputError("Parquet needs pyarrow", "--parquet", "pip install pyarrow, or use --csv") from error
