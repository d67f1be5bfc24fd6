"""Coulomb friction of the mass in its own guide: -Fg sign(v), with v its velocity over ground.

Fg in N, over the mass in m/s^2.  At one belt speed only the jump at v = 0, where the mass turns, distinguishes it from
a friction curve of the belt.  A guide that holds the mass at rest while the spring pulls less than Fg is not
modelled.  Source: B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083.
"""

import numpy as np

from fitting.forces.departure import Departure, by_velocity
from stickslip.compute.arrays import Array


def drag(velocity: Array, turn: float) -> Array:
    return np.asarray(-np.tanh(velocity / turn))


DEPARTURE = Departure(
    name="guide-friction",
    text="dry friction of the mass in its guide",
    parameter="Fg/m",
    unit="m s^-2",
    with_mass=("Fg", "N"),
    forcing=by_velocity(drag),
    drag=drag,
)
