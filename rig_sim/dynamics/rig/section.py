"""The Poincare section of two masses: where the first mass comes to rest over ground and turns forwards (x1' = 0)."""

import math

import numpy as np

from daq.base.compute.arrays import Array
from rig_sim.flow.two_mass import TwoMassFlow, slip_start
from rig_sim.integrate.pair_motion import CROSSINGS, PairMotion

# Integrator steps allowed per crossing: so many, and so many more per unit of the fastest frequency, sqrt(1 + 2 a);
# 60 are usual.  Masses that come to rest cross no more: their steps, 10 us each, cost 2 s.
STEPS_OF_CROSSING, STEPS_PER_FREQUENCY = 200, 50.0


def section_points(flow: TwoMassFlow, d: float, crossings: int, *, skip: int = 0) -> Array:
    """Return x1 at crossings of the section, shape (n,), of the motion that follows a global stick of stretch d (m).

    Parameters
    ----------
    flow : TwoMassFlow
        The masses.
    d : float
        x2 - x1 while both stick, m.
    crossings, skip : int
        How many to return, after leaving out the first ``skip``.  Fewer are returned where the motion ends.
    """
    x1, x2 = slip_start(flow, d)
    belt = flow.mass.v_belt
    asked = crossings + skip
    allowed = int((STEPS_OF_CROSSING + STEPS_PER_FREQUENCY * math.sqrt(1.0 + 2.0 * flow.a)) * asked)
    motion = PairMotion(flow, (x1, belt, x2, belt), allowed, compiled=True)
    fr = motion.frame
    found = [fr.x0 + fr.mirror * row[1] for row in motion.rows([math.inf], CROSSINGS, most=asked)]
    return np.array(found[skip:])
