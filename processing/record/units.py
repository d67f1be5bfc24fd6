"""Units of a record: positions and times are scaled to them before smoothing, and back to SI units after it.

In between no second, hertz or metre exists: a threshold is a number of samples, of standard deviations of the noise, of
slips, or a ratio.  Both units are powers of two, so that the scaling rounds nothing, and a record whose positions or
times are multiplied by a power of two gives the same scaled numbers, bit for bit.  The unit of length is negative where
slips run towards +x: a mirrored record gives the same numbers, too.
"""

import math
from dataclasses import dataclass

from stickslip.units import Measured


@dataclass(frozen=True)
class Units:
    length_unit: float = 1.0  # m (or counts), signed: about the travel of the record
    time_unit: float = 1.0  # s: about its sample interval
    start: float = 0.0  # s: the time at which that of the record is 0

    def of(self, length: int, time: int) -> float:
        """Return the signed unit, in SI units, of a quantity with these powers of length and time."""
        return self.length_unit**length * self.time_unit**time


def power_of_two(size: float) -> float:
    """Return the power of two above a size, 1 for size 0."""
    return math.ldexp(1.0, math.frexp(size)[1]) if size > 0 else 1.0


def speed_in(units: Units, speed: float | None) -> float | None:
    return None if speed is None else speed / units.of(1, -1)


def measured_in(units: Units, speed: Measured | None) -> Measured | None:
    unit = units.of(1, -1)
    return None if speed is None else Measured(speed.value / unit, speed.sd / abs(unit))
