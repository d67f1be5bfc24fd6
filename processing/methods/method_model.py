"""The model that a velocity method learns from a record, and then applies to the record or to any block of it."""

from dataclasses import dataclass, field

from processing.kalman import white_jerk
from processing.segmentation.plateaus import PlateauRule
from processing.segmentation.smoother import FirstPass, StickSlip


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodModel:
    """The method that runs, and its learned parameters."""

    method: str  # never "auto"
    noise: float  # standard deviation of a position, m
    jerk: white_jerk.Noise  # of the record as a motion of white jerk, also used where readings are missing
    window: int = 0  # of Savitzky-Golay; 0 for the others
    order: int = 0
    rule: PlateauRule | None = None  # for finding sticks in the motion smoothed with ``jerk``; None without sticks
    sticks: StickSlip | None = None  # how the record sticks and slips; None if it does not, or for other methods
    stated: float | None = None  # belt speed that a person stated, m/s, signed
    # results of learning that are reused for the same series; not stored
    first_pass: FirstPass | None = field(default=None, metadata={"stored": False})
