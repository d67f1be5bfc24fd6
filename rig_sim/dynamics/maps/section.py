"""The Poincare section of two masses: where the first mass comes to rest over ground and turns forwards (x1' = 0)."""

import math

import numpy as np

from daq.compute.arrays import Array
from rig_sim.flow.two_mass import TwoMassFlow, slip_start
from rig_sim.integrate.pair_motion import CROSSINGS, PairMotion

STEPS_OF_CROSSING = 2_000  # integrator steps allowed per crossing; 60 are usual


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
    motion = PairMotion(flow, (x1, belt, x2, belt), STEPS_OF_CROSSING * asked, compiled=True)
    fr = motion.frame
    found = [fr.x0 + fr.mirror * row[1] for row in motion.rows([math.inf], CROSSINGS, most=asked)]
    return np.array(found[skip:])
