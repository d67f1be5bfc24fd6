"""How far special points move when the parameters of a flow are uncertain: each point found again for every draw.

A point is a change between two neighbouring values of the parameter: of the fixed point's stability (hopf,
border-collision), or of whether there is a stick-slip orbit (fold, grazing).  For a draw the change is looked for from
where it was, in steps that double, towards that end of the interval on whose side of it the draw lies, and located then
by bisection.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rig_sim.dynamics.analyses.special_points import SpecialPoint, bisected
from rig_sim.dynamics.limit_cycles.branches import FlowAt
from rig_sim.dynamics.limit_cycles.fixed_point import fixed_point
from rig_sim.dynamics.limit_cycles.limit_cycle import sticks
from rig_sim.flow.flow import Flow
from stickslip.compute.arrays import Array

# Of the interval: the first step.  Draws scatter by about as much in a record of the rig; ten times more or less costs
# three more evaluations each.
FIRST_STEP = 1e-3
HALVINGS = 8  # of the last step: what is left of it is a hundredth of the draws' scatter
STABILITY = ("hopf", "border-collision")


@dataclass(frozen=True)
class PointInterval:
    """Where draws put a special point.

    Attributes
    ----------
    lo, hi : float or None
        Quantiles; None where they lie beyond the interval that was searched.
    found : int
        Draws in which the point lies within the interval.
    below, above : int
        Draws that put it beyond the interval's first or last value: one side's picture holds all over.
    """

    lo: float | None
    hi: float | None
    found: int
    below: int
    above: int


class MovingPoint:
    """A special point to be found again for other parameters.

    Parameters
    ----------
    point : SpecialPoint
        Where it lies for the fitted parameters.
    flow_at : callable
        The fitted flow at a value of the parameter.
    values : (n,) array
        As for `rig_sim.dynamics.limit_cycles.branches.continuation`.
    """

    def __init__(self, point: SpecialPoint, flow_at: FlowAt, values: Array) -> None:
        self.values = sorted(values.tolist())
        self.holds = _stable if point.kind in STABILITY else sticks
        self.place = min(max(point.value, self.values[0]), self.values[-1])
        below = max(value for value in self.values[:-1] if value <= point.value or value == self.values[0])
        self.before = self.holds(flow_at(below))

    def for_draw(self, flow_at: FlowAt) -> float:
        """Return the value at which the point lies for a draw's flow; infinite where it lies beyond an end.

        Raises
        ------
        ValueError
            For a flow that is not physical.
        """
        first, last = self.values[0], self.values[-1]
        place, held = self.place, self.holds(flow_at(self.place)) == self.before
        end = last if held else first
        step = math.copysign(FIRST_STEP * (last - first), end - place)
        while place != end:
            following = place + step if abs(step) < abs(end - place) else end
            if (self.holds(flow_at(following)) == self.before) != held:
                return bisected(lambda value: self.holds(flow_at(value)), place, following, HALVINGS)
            place, step = following, 2.0 * step
        return math.inf if held else -math.inf


def interval(places: Sequence[float], alpha: float = 0.05) -> PointInterval:
    """Return the interval between the quantiles alpha/2 and 1 - alpha/2 of ``places`` (`MovingPoint.for_draw`).

    The k-th of n draws in order is the quantile k/(n + 1), so that one draw more lies in the interval with probability
    1 - alpha; fewer than 2/alpha - 1 draws give the interval from the least to the largest.
    """
    ordered = sorted(places)

    def quantile(share: float) -> float | None:
        place = min(max(share * (len(ordered) + 1) - 1.0, 0.0), len(ordered) - 1.0)
        low, high = ordered[math.floor(place)], ordered[math.ceil(place)]
        if math.isinf(low) or math.isinf(high):
            return None
        return low + (place - math.floor(place)) * (high - low)

    below, above = ordered.count(-math.inf), ordered.count(math.inf)
    if not ordered:
        return PointInterval(None, None, 0, 0, 0)
    return PointInterval(quantile(alpha / 2), quantile(1 - alpha / 2), len(ordered) - below - above, below, above)


def _stable(flow: Flow) -> bool:
    return bool(fixed_point(flow).stable)
