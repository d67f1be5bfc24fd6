"""How far special points move when the parameters of a flow are uncertain: each point found again for every draw.

A point is a change between two neighbouring values of the parameter: of the fixed point's stability (hopf,
border-collision), or of whether there is a stick-slip orbit (fold, grazing).  For a draw the change is looked for from
where it was, in steps that double, towards that end of the interval on whose side of it the draw lies, and located then
by bisection.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rig_sim.analyses.limit_cycles.branches import FlowAt
from rig_sim.analyses.limit_cycles.fixed_point import fixed_point
from rig_sim.analyses.limit_cycles.limit_cycle import has_stick_slip_orbit
from rig_sim.analyses.special_points import SpecialPoint, bisect
from rig_sim.flow.flow import Flow
from stickslip.compute.arrays import Array

# First step over the interval: about the scatter of draws in a record of the rig.
FIRST_STEP = 1e-3
HALVINGS = 8  # of the last step, down to a hundredth of the draws' scatter
STABILITY = ("hopf", "border-collision")


@dataclass(frozen=True)
class PointInterval:
    """The interval of a special point over draws."""

    lo: float | None  # quantiles; None beyond the searched interval
    hi: float | None
    inside: int  # draws in which the point lies within the interval
    below: int  # draws with the point below the interval's first value
    above: int  # draws with the point above the interval's last value


class MovingPoint:
    """A special point of the fitted flow, to be located again for other parameters."""

    def __init__(self, point: SpecialPoint, flow_at: FlowAt, values: Array) -> None:
        self.values = sorted(values.tolist())
        self.holds: Callable[[Flow], bool] = has_stick_slip_orbit
        if point.kind in STABILITY:
            self.holds = lambda flow: bool(fixed_point(flow).stable)
        self.fitted_value = min(max(point.value, self.values[0]), self.values[-1])
        below = max(value for value in self.values[:-1] if value <= point.value or value == self.values[0])
        self.before = self.holds(flow_at(below))

    def locate(self, flow_at: FlowAt) -> float:
        """Return the value at which the point lies for a draw's flow; infinite where it lies beyond an end."""
        first, last = self.values[0], self.values[-1]
        value, holds_before = self.fitted_value, self.holds(flow_at(self.fitted_value)) == self.before
        end = last if holds_before else first
        step = math.copysign(FIRST_STEP * (last - first), end - value)
        while value != end:
            following = value + step if abs(step) < abs(end - value) else end
            if (self.holds(flow_at(following)) == self.before) != holds_before:
                return bisect(lambda value: self.holds(flow_at(value)), value, following, HALVINGS)
            value, step = following, 2.0 * step
        return math.inf if holds_before else -math.inf


def estimate_interval(values: Sequence[float], alpha: float = 0.05) -> PointInterval:
    """Return the interval between the quantiles alpha/2 and 1 - alpha/2 of ``values`` (`MovingPoint.locate`).

    The k-th of n draws in order is the quantile k/(n + 1), so that one draw more lies in the interval with probability
    1 - alpha; fewer than 2/alpha - 1 draws give the interval from the least to the largest.
    """
    ordered = sorted(values)

    def quantile(share: float) -> float | None:
        rank = min(max(share * (len(ordered) + 1) - 1.0, 0.0), len(ordered) - 1.0)
        low, high = ordered[math.floor(rank)], ordered[math.ceil(rank)]
        if math.isinf(low) or math.isinf(high):
            return None
        return low + (rank - math.floor(rank)) * (high - low)

    below, above = ordered.count(-math.inf), ordered.count(math.inf)
    if not ordered:
        return PointInterval(None, None, 0, 0, 0)
    return PointInterval(quantile(alpha / 2), quantile(1 - alpha / 2), len(ordered) - below - above, below, above)
