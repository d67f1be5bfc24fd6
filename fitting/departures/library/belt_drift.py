"""A belt that drifts: its speed changes steadily over the record, v_b (1 + a (t - t_mid)).

a in 1/s, relative to the speed in the middle of the record.  Each run of a joint fit has the same a.
"""

import numpy as np

from fitting.forces.departure import Departure, Forcing
from fitting.forces.fitted_motion import FittedMotion


def forcing(trajectory: FittedMotion, _: float) -> Forcing:
    change = trajectory.belt_speed * trajectory.elapsed
    return Forcing(belt_speed=change[:, np.newaxis])


DEPARTURE = Departure(
    name="belt-drift",
    text="a belt whose speed drifts",
    parameter="(dv_dr/dt)/v_dr",
    unit="s^-1",
    forcing=forcing,
)
