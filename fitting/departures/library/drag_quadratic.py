"""Quadratic drag on the mass: -q v |v|, with v its velocity over ground.

q in N s^2/m^2, over the mass in 1/m.  At one belt speed v_b the velocity is v_b - s, with s the slip speed, so drag is
a function of s: a free friction curve takes it up, and only runs at several belt speeds, or a law whose curve is of
another form, show it.  Source: L. D. Landau, E. M. Lifshitz, Fluid Mechanics, 1987, par. 45.
"""

import numpy as np

from fitting.forces.departure import Departure, by_velocity
from stickslip.compute.arrays import Array


def drag(velocity: Array, _: float) -> Array:
    return -velocity * np.abs(velocity)


DEPARTURE = Departure(
    name="drag-quadratic",
    text="drag that grows with the square of the velocity",
    parameter="q/m",
    unit="m^-1",
    with_mass=("q", "N s^2/m^2"),
    forcing=by_velocity(drag),
    drag=drag,
)
