"""A smoothed run as a flat CSV table: one row a sample, units in the column names, digits that read back exactly."""

from pathlib import Path

import numpy as np
import pandas as pd

from daq.output import tables
from processing.record.kinematics import Kinematics

DERIVATIVES = {"position": "", "velocity": "_per_s", "acceleration": "_per_s2"}


def frame(kinematics: Kinematics) -> pd.DataFrame:
    """Return time, position, velocity, acceleration, their errors, the belt's velocity where counted, and the phase.

    The phase is "stick", "slip" or "rest".
    """
    unit = kinematics.recording.unit
    columns: dict[str, np.ndarray] = {"time_s": kinematics.time}
    for name, per in DERIVATIVES.items():
        columns[f"{name}_{unit}{per}"] = getattr(kinematics, name)
    for name, per in DERIVATIVES.items():
        columns[f"{name}_error_{unit}{per}"] = getattr(kinematics, f"{name}_errors")
    if kinematics.belt_velocity is not None and kinematics.belt_velocity_errors is not None:
        columns[f"belt_velocity_{unit}_per_s"] = kinematics.belt_velocity
        columns[f"belt_velocity_error_{unit}_per_s"] = kinematics.belt_velocity_errors
    phase = np.full(kinematics.time.size, "rest", dtype="U5")
    for found in kinematics.phases:
        phase[found.first : found.last + 1] = found.kind
    return pd.DataFrame(columns | {"phase": phase, "segment": kinematics.recording.segment})


def write_csv(kinematics: Kinematics, target: Path, *, force: bool = False) -> list[str]:
    """Write the table and return its column names; an existing file is replaced only by ``force``."""
    rows = frame(kinematics)
    tables.write(rows, target, "csv", force=force)
    return list(rows.columns)
