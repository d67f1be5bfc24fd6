"""A run as a flat table for other programs: CSV or Parquet, one row a sample, units in the column names.

A CSV is written with as many digits as read back exactly, so ``daq import`` of an export gives the same motion.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from daq.errors import InputError
from daq.output import atomic

if TYPE_CHECKING:
    import pandas as pd


def write(rows: "pd.DataFrame", target: Path, form: str, *, force: bool = False) -> None:
    """Write a run's table.

    Parameters
    ----------
    rows : DataFrame
        As `daq.runfile.recording.Recording.to_dataframe` returns it.
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
