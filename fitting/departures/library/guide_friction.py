"""Coulomb friction of the mass in its own guide: -Fg sign(v), with v its velocity over ground.

Fg in N, over the mass in m/s^2.  At one belt speed only the jump at v = 0, where the mass turns, distinguishes it from
a friction curve of the belt.  A guide that holds the mass at rest while the spring pulls less than Fg is not
modelled.  Source: B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083.
"""

import numpy as np

from fitting.departures.definition.departure import Departure, Forcing
from fitting.departures.definition.fitted_motion import FittedMotion

# Of the largest velocity: a sample's change of velocity is 1 %, so a narrower turn is none that a step sees; ten times
# as wide, the kink at v = 0 by which the guide is recognised is lost.
TURN = 0.005


def forcing(trajectory: FittedMotion, _: float) -> Forcing:
    """Return -sign(v), as a tanh."""
    width = TURN * float(np.max(np.abs(trajectory.velocity)))
    return Forcing(acceleration=-np.tanh(trajectory.velocity[:, np.newaxis] / width))


DEPARTURE = Departure(
    name="guide-friction",
    text="dry friction of the mass in its guide",
    parameter="Fg/m",
    unit="m s^-2",
    with_mass=("Fg", "N"),
    forcing=forcing,
)
