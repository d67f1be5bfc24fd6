"""A departure: from a fitted motion to its effect, to first order in its parameters."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fitting.forces.fitted_motion import FittedMotion
from fitting.sensitivity.path import NO_DRAG
from fitting.sensitivity.rates import Drag
from stickslip.compute.arrays import Array

# Velocity, over the largest, within which a drag may jump at rest.  Without the drag in the motion a sample's change of
# velocity is 1 %, so a narrower turn is none that a step sees; ten times as wide, the kink by which a guide is
# recognised is lost.
TURN_IN_COLUMN = 0.005
# The same where the motion is followed with the drag, in steps as short as the turn.  At 0.005 the friction of a strong
# guide comes out 0.6 % too large.
TURN_IN_MOTION = 0.0005
# A drag's table: up to how far, of the largest velocity; how close its rows are about rest; how many they are.  They
# are a fifteenth of `TURN_IN_MOTION` apart there, and 0.03 at that velocity, where a square errs by 2e-4; half as many
# rows err by four times as much.
TABLE_REACH, TABLE_CONTRAST, TABLE_ROWS = 1.5, 8.0, 801


class Forcing(NamedTuple):
    """The effect of a departure with parameters of 1; k columns, one a parameter, or None."""

    # (M, k) force on the mass per unit mass at the stage points of the trajectory, m/s^2 per unit of the parameter
    acceleration: Array | None = None
    belt_speed: Array | None = None  # (M, k) change of the belt's speed there, m/s per unit of the parameter
    # (N, k) change of the position that is read at the samples, m per unit of the parameter
    reading: Array | None = None


@dataclass(frozen=True)
class Departure:
    """One assumption and how it may break."""

    name: str
    text: str  # what it says of the rig, to stand in a sentence after the best law's name
    # symbol and unit of its size: of the coefficient where there is one column, of the amplitude where there are two, a
    # sine and a cosine
    parameter: str
    unit: str
    # ``forcing(trajectory, scale)``; ``scale`` is NaN for a departure that has none
    forcing: Callable[[FittedMotion, float], Forcing]
    columns: int = 1  # 1 or 2
    scale: str = ""  # what else it depends on, such as a frequency: scanned
    scale_unit: str = ""
    # ``scales(trajectory)``: the values to scan, rising, at most half a resolution apart
    scales: Callable[[FittedMotion], Array] | None = None
    # (str, str) symbol and unit of the size times the mass, where the mass is known
    with_mass: tuple[str, str] | None = None
    # the same of a record that no encoder counted, where it then is another thing; else empty
    text_of_positions: str = ""
    # ``drag(velocity, turn)``: a force by the mass's own velocity alone, (n,) in m/s^2 per unit of the parameter, of a
    # departure that is nothing else (`by_velocity`).  Where it jumps at rest, it may do so within ``turn``, m/s. It is
    # followed together with the motion, any other force along the path before.
    drag: Callable[[Array, float], Array] | None = None

    def says(self, *, counted: bool) -> str:
        """Return its statement about the rig, by whether an encoder counted."""
        return self.text if counted or not self.text_of_positions else self.text_of_positions

    def drag_table(self, fastest: float) -> Drag:
        """Return the drag of a unit by velocity, up to about ``fastest``, m/s; empty without one."""
        if self.drag is None:
            return NO_DRAG
        velocity = (
            fastest
            * TABLE_REACH
            * np.sinh(TABLE_CONTRAST * np.linspace(-1.0, 1.0, TABLE_ROWS))
            / math.sinh(TABLE_CONTRAST)
        )
        turn = TURN_IN_MOTION * fastest
        return Drag(velocity, self.drag(velocity, turn), turn)


def by_velocity(drag: Callable[[Array, float], Array]) -> Callable[[FittedMotion, float], Forcing]:
    """Return the forcing of a force by the mass's velocity alone."""

    def forcing(trajectory: FittedMotion, _: float) -> Forcing:
        turn = TURN_IN_COLUMN * float(np.max(np.abs(trajectory.velocity)))
        return Forcing(acceleration=drag(trajectory.velocity, turn)[:, np.newaxis])

    return forcing


def harmonic(phase: Array, factor: Array | float = 1.0) -> Array:
    """Return sine and cosine of ``phase`` (n,) as columns (n, 2), times ``factor``."""
    return np.asarray(np.c_[factor * np.sin(phase), factor * np.cos(phase)])


def spaced(smallest: float, largest: float, length: float) -> Array:
    """Return wavelengths (or periods), descending, a quarter of the resolution of ``length`` apart."""
    if not 0 < smallest < largest or length <= 0:
        return np.empty(0)
    turns = np.arange(1 / largest, 1 / smallest, 0.25 / length)
    return np.asarray(1 / turns[turns > 0])


def speed_of_wave(length: float) -> float:
    return 2 * math.pi / length
