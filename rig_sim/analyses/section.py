"""The Poincare section of two masses: where the first mass comes to rest over ground and turns forwards (x1' = 0)."""

import math
from collections.abc import Callable

import numpy as np

from rig_sim.analyses.basins import NOWHERE, basins
from rig_sim.analyses.sweep import SAME_POINT, AttractorAt, merge_close_points
from rig_sim.flow.modes import OUTCOMES, STEP_LIMIT
from rig_sim.flow.two_mass import TwoMassFlow, slip_start
from rig_sim.integrate.pair_motion import CROSSINGS, PairMotion
from rig_sim.systems.interface import StepBudget, StepLimitError
from rig_sim.systems.stick import StickMap
from stickslip.compute.arrays import Array

# Integrator steps allowed per crossing, and more per unit of the fastest frequency, sqrt(1 + 2 a); 60 are usual.
STEPS_OF_CROSSING, STEPS_PER_FREQUENCY = 200, 50.0
CELLS = 600  # of the cell mapping at each value; a basin narrower than a few cells may be missed
POINTS = 256  # points of the section on an attractor
SKIPPED_CROSSINGS = 200  # first crossings, skipped of a motion without global stick
# Integrator steps at one value, 10 s; values of the thesis take 200 000 to 500 000.
STEPS_OF_VALUE = 20_000_000


def section_points(flow: TwoMassFlow, d: float, crossings: int, *, skip: int = 0) -> Array:
    """Return x1 at crossings of the section, shape (n,), of the motion that follows a global stick of stretch d (m).

    The first ``skip`` crossings are left out; there are fewer than ``crossings`` where the motion ends.
    """
    x1, x2 = slip_start(flow, d)
    belt = flow.mass.v_belt
    number = crossings + skip
    allowed = int((STEPS_OF_CROSSING + STEPS_PER_FREQUENCY * math.sqrt(1.0 + 2.0 * flow.a)) * number)
    motion = PairMotion(flow, (x1, belt, x2, belt), allowed, compiled=True)
    fr = motion.frame
    positions = [fr.x0 + fr.mirror * row[1] for row in motion.rows([math.inf], CROSSINGS, most=number)]
    return np.array(positions[skip:])


def attractors_at(flow_at: Callable[[float], TwoMassFlow], section: str, value: float) -> list[AttractorAt]:
    """Return the attractors of two masses at one value of a parameter, the largest basin first.

    With the section 'map' the points are d in global stick, with 'poincare' x1 where the first mass turns forwards.
    """
    flow = flow_at(value)
    try:
        f = StickMap(flow, budget=StepBudget(STEPS_OF_VALUE))
        cells = basins(f, CELLS)
    except StepLimitError:
        return [AttractorAt(value, 0, (), None, math.nan, (math.nan, math.nan), outcome=OUTCOMES[STEP_LIMIT].name)]
    rows = []
    for attractor in cells.attractors:
        points = attractor.points
        if section == "poincare":
            points = merge_close_points(section_points(flow, points[0], POINTS).tolist(), SAME_POINT * (f.hi - f.lo))
        rows.append((points, attractor.period, attractor.share))
    if cells.nowhere > 0.0 and section == "poincare":
        start = float(cells.centres[np.flatnonzero(cells.fate == NOWHERE)[0]])
        crossed = section_points(flow, start, POINTS, skip=SKIPPED_CROSSINGS).tolist()
        rows.append((merge_close_points(crossed, SAME_POINT * (f.hi - f.lo)), None, cells.nowhere))
    return [
        AttractorAt(value, number, points, period, share, (min(points), max(points)))
        for number, (points, period, share) in enumerate(rows, 1)
        if points
    ]
