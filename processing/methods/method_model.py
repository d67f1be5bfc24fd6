"""What a velocity method learns from a record, and then applies to the record or to any block of it."""

from dataclasses import dataclass, field

from processing.kalman import white_jerk
from processing.segmentation.plateaus import PlateauRule
from processing.segmentation.smoother import FirstPass, StickSlip


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodModel:
    """The method that runs, and what it learned."""

    method: str  # never "auto"
    noise: float  # standard deviation of a position, m
    # of the record as a motion of white jerk: of the smoothers, and of the motion where readings are missing
    jerk: white_jerk.Noise
    window: int = 0  # of Savitzky-Golay; 0 for the others
    order: int = 0
    # how sticks show in the motion that ``jerk`` gives; None for a method without sticks
    rule: PlateauRule | None = None
    # how the record sticks and slips; None where it does not, or the method does not ask
    sticks: StickSlip | None = None
    stated: float | None = None  # belt speed that a person stated, m/s, signed
    # what was found on the way, which is not stored: the method goes on from there with the same series
    known: FirstPass | None = field(default=None, metadata={"stored": False})
