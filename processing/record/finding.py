"""A contradiction or a fault that a record shows: what it shows beside what was expected."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes
    ----------
    code : str
        Name for programs, in words joined by hyphens: "belt-speed", "spikes".
    text : str
        A sentence for a person, with both numbers and their unit.
    value, expected : float
        What the record shows, and what was stated or would be sound, in SI units; NaN where there is no such number.
    sigmas : float
        Standard deviations between both; NaN where the finding is no matter of scatter.
    """

    code: str
    text: str
    value: float = math.nan
    expected: float = math.nan
    sigmas: float = math.nan
