"""A spring whose stiffness drifts, as by its temperature: k (1 + a (t - t_mid)).

a in 1/s, relative to the stiffness in the middle of the record.  Each run of a joint fit has the same a.
"""

import numpy as np

from fitting.forces.departure import Departure, Forcing
from fitting.forces.fitted_motion import FittedMotion


def forcing(trajectory: FittedMotion, _: float) -> Forcing:
    change = -trajectory.K * trajectory.stretch * trajectory.elapsed
    return Forcing(acceleration=change[:, np.newaxis])


DEPARTURE = Departure(
    name="stiffness-drift",
    text="a spring whose stiffness drifts",
    parameter="(dk/dt)/k",
    unit="s^-1",
    forcing=forcing,
)
