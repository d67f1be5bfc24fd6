"""A run as a flat table for other programs: CSV or Parquet, one row a sample, units in the column names.

A CSV is written with as many digits as read back exactly, so ``daq import`` of an export gives the same motion.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from stickslip.errors import InputError
from stickslip.output import atomic

if TYPE_CHECKING:
    import pandas as pd

TOGETHER = 65_536  # rows of a CSV between two reports of progress, some 0.3 s of CPU time


def write(
    rows: "pd.DataFrame",
    target: Path,
    form: str,
    *,
    force: bool = False,
    progress: Callable[[float], None] = lambda done: None,
) -> None:
    """Write a run's table as "csv" or "parquet"; ``progress`` is called with the number of rows written."""
    atomic.refuse_existing(target, force)
    with atomic.replacing(target, force) as temporary:
        if form == "csv":
            with temporary.open("w", encoding="utf-8", newline="") as file:
                for begin in range(0, max(len(rows), 1), TOGETHER):
                    chunk = rows.iloc[begin : begin + TOGETHER]
                    chunk.to_csv(file, index=False, header=begin == 0, lineterminator="\n")
                    progress(begin + len(chunk))
        else:
            try:
                rows.to_parquet(temporary, index=False)
            except ImportError as error:
                raise InputError(
                    "writing Parquet requires the package pyarrow",
                    "--parquet",
                    "install it (pip install pyarrow), or use --csv",
                ) from error
            progress(len(rows))
