"""What a velocity method learns from a record, and then applies to the record or to any block of it."""

from dataclasses import dataclass, field

from processing.kalman import white_jerk
from processing.segmentation.plateaus import PlateauRule
from processing.segmentation.smoother import FirstPass, StickSlip


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodModel:
    """The method that runs, and what it learned.

    Attributes
    ----------
    method : str
        Never "auto".
    noise : float
        Standard deviation of a position, m.
    window, order : int
        Of Savitzky-Golay; 0 for the others.
    jerk : white_jerk.Noise
        Of the record as a motion of white jerk: of the smoothers, and of the motion where readings are missing.
    rule : PlateauRule or None
        How sticks show in the motion that ``jerk`` gives; None for a method without sticks.
    sticks : StickSlip or None
        How the record sticks and slips; None where it does not, or the method does not ask.
    stated : float or None
        Belt speed that a person stated, m/s, signed.
    known : FirstPass or None
        What was found on the way, which is not stored: the method goes on from there with the same series.
    """

    method: str
    noise: float
    jerk: white_jerk.Noise
    window: int = 0
    order: int = 0
    rule: PlateauRule | None = None
    sticks: StickSlip | None = None
    stated: float | None = None
    known: FirstPass | None = field(default=None, metadata={"stored": False})
