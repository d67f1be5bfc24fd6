"""A smoothed run as a flat CSV table: one row a sample, units in the column names, digits that read back exactly."""

from pathlib import Path

from processing.record.kinematics import Kinematics
from stickslip.output import tables


def write_csv(kinematics: Kinematics, target: Path, *, force: bool = False) -> list[str]:
    """Write the table and return its column names; an existing file is replaced only by ``force``."""
    rows = kinematics.to_dataframe()
    tables.write(rows, target, "csv", force=force)
    return list(rows.columns)
