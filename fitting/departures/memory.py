"""Memory: friction that depends on the recent history of the speed, as of LuGre and of rate-and-state models.

No parameter is given.  Memory is suspected where not even a free function of speed describes the record, no departure
of the table explains most of what it leaves over or is confirmed, and friction lags behind the speed: f(s(t - lag)),
to first order f - lag f' ds/dt.  Sources: C. Canudas de Wit et al., IEEE Trans. Autom. Control 40 (1995) 419;
J. R. Rice, A. L. Ruina, J. Appl. Mech. 50 (1983) 343.
"""

import math

import numpy as np

from fitting.departures.base import Base
from fitting.departures.result import FoundDeparture
from fitting.departures.scores import score, sigmas
from fitting.departures.strongest import LEAST_SIGMAS
from fitting.forces.departure import Forcing
from fitting.model.parameters import PER_RUN, Global

# Share of the misfit beyond the noise: a departure that explains more needs no memory beside it.  True departures
# explain 0.8 to 1; of LuGre contacts the best explained 0.35 and 0.65.
MOST_EXPLAINED = 0.7


def suspect_memory(base: Base, explained: float) -> FoundDeparture | None:
    """Return memory as a departure, or None; ``explained`` is the best departure's share of the misfit."""
    if explained > MOST_EXPLAINED:
        return None
    tested = score(base.linear, base.respond([lag(base)]), [1])[0]
    if tested is None or sigmas(tested.log_p) < LEAST_SIGMAS:
        return None
    text = "friction that remembers the recent history of the speed"
    return FoundDeparture("memory", sigmas(tested.log_p), "", math.nan, math.nan, "", text, gain=tested.gain)


def lag(base: Base) -> Forcing:
    """Return the first-order effect on the acceleration of friction that lags the speed by 1 s."""
    path = base.path
    unknowns = path.u.reshape(-1, PER_RUN)[path.run]
    force = (
        -unknowns[:, Global.K] * base.trajectory.stretch - unknowns[:, Global.DAMPING] * path.velocity + path.friction
    )
    return Forcing(acceleration=np.where(path.stuck, 0.0, path.friction_slope * force)[:, np.newaxis])
