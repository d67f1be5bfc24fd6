"""A measured quantity with its standard deviation, and the values that each known quantity of a rig may have."""

import math
from dataclasses import dataclass

from stickslip.errors import InputError


@dataclass(frozen=True)
class Measured:
    """A measured quantity and its standard deviation (0 when it is exact or was not stated)."""

    value: float
    sd: float = 0.0


# The rule that each value must obey; None where every finite number will do.
QUANTITIES: dict[str, str | None] = {
    "mass": "positive",
    "stiffness": "positive",
    "damping": "not negative",
    "belt_speed": None,
    "metres_per_count": "not zero",
    "datum": None,
    "belt_metres_per_count": "not zero",
    "x0": None,
}
_RULES = {"positive": lambda x: x > 0, "not negative": lambda x: x >= 0, "not zero": lambda x: x != 0}


def checked(key: str, value: float, sd: float, where: str) -> Measured:
    """Return the measured quantity ``key``, or raise InputError when its value or error is impossible."""
    rule = QUANTITIES[key]
    if not math.isfinite(value) or (rule is not None and not _RULES[rule](value)):
        raise InputError(f"{key} is {value:g}", where, f"it must be {rule or 'a finite number'}")
    if not (math.isfinite(sd) and sd >= 0):
        raise InputError(f"{key}_sd is {sd:g}", where, "a standard deviation is a finite number, not negative")
    return Measured(value, sd)
