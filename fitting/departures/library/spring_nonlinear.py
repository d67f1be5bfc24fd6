"""A spring that hardens or softens: its force is -k z - k3 z^3, with z the stretch.

k3 in N/m^3, positive for a hard spring; over the mass in m^-2 s^-2.  There is no quadratic term: a spring that pulls as
it pushes has none.  Source: A. H. Nayfeh, D. T. Mook, Nonlinear Oscillations, 1979, ch. 4.
"""

import numpy as np

from fitting.forces.departure import Departure, Forcing
from fitting.forces.fitted_motion import FittedMotion


def forcing(trajectory: FittedMotion, _: float) -> Forcing:
    return Forcing(acceleration=-(trajectory.stretch[:, np.newaxis] ** 3))


DEPARTURE = Departure(
    name="spring-nonlinear",
    text="a spring whose stiffness changes with its stretch",
    parameter="k3/m",
    unit="m^-2 s^-2",
    with_mass=("k3", "N/m^3"),
    forcing=forcing,
)
