"""A contradiction or a fault that a record shows: what it shows beside what was expected."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One finding."""

    code: str  # name for programs, in words joined by hyphens: "belt-speed", "spikes"
    text: str  # a sentence for a person, with both numbers and their unit
    # what the record shows, and what was stated or would be sound, in SI units; NaN where there is no such number
    value: float = math.nan
    expected: float = math.nan
    sigmas: float = math.nan  # standard deviations between both; NaN where the finding is no matter of scatter
