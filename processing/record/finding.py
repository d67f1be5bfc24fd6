"""A contradiction or a fault in a record: the value that it shows and the expected one."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    code: str  # name for programs, in words joined by hyphens: "belt-speed", "spikes"
    text: str  # a sentence for a person, with both numbers and their unit
    value: float = math.nan  # what the record shows, in SI units; NaN without a number
    expected: float = math.nan  # what was stated or would be sound
    sigmas: float = math.nan  # standard deviations between both; NaN without a scatter
