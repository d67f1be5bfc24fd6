"""Fixed points and periodic orbits of one mass on a belt along a parameter, and the points where they change.

At every value of the parameter the fixed point with its eigenvalues and the stable and the unstable orbit with their
multipliers are found anew, from the flow alone: the orbits of one mass are few, and the searches for them start from
the slip point and from the fixed point, not from the neighbouring value.  Special points:

hopf              the eigenvalues of the fixed point cross the imaginary axis: root of c - gamma_lin
grazing           the stick-slip orbit touches the belt's velocity no more: beyond, the mass swings in slip alone
border-collision  the fixed point crosses the edge of the ramp, where gamma_lin jumps and stability with it
fold              the stable and the unstable orbit meet and vanish.  Under a jump law this is discontinuous: the
                  unstable orbit touches the belt's velocity there, and its multiplier jumps to the 0 of the orbit that
                  sticks.  Under a ramp law both multipliers tend to 1.

How far special points move when the parameters of a flow are uncertain: each point found again for every draw.

A point is a change between two neighbouring values of the parameter: of the fixed point's stability (hopf,
border-collision), or of whether there is a stick-slip orbit (fold, grazing).  For a draw the change is looked for from
where it was, in steps that double, towards that end of the interval on whose side of it the draw lies, and located then
by bisection.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from rig_sim.analyses.limit_cycles.fixed_point import fixed_point, friction_at_rest
from rig_sim.analyses.limit_cycles.floquet import floquet
from rig_sim.analyses.limit_cycles.limit_cycle import cycle, has_stick_slip_orbit
from rig_sim.analyses.special_points import (
    Branch,
    BranchPoint,
    Continuation,
    SpecialPoint,
    bisect,
    find_zero,
    minimise,
)
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import displacement, frame
from rig_sim.integrate.work import new_work
from rig_sim.systems.turn import STEPS_OF_SEARCH, next_minimum
from stickslip.compute.arrays import Array

TOUCHED = 1e-13  # of the parameter, relative to its step: where the map touches the diagonal
TOUCH = 1e-9  # of the interval of starts: precision of the start that gains least
CROSSES = 1e-6  # share of the change of c - gamma_lin between two values: at a root it is below this, at a jump above

FlowAt = Callable[[float], Flow]


def continuation(
    flow_at: FlowAt, values: Array, *, progress: Callable[[float], None] = lambda done: None
) -> Continuation:
    """Return branches and special points.

    Special points are sought between neighbouring ``values``, rising or falling, and then refined; two of one kind
    between the same neighbours are missed: use a finer grid.  ``progress`` is called with the number of values done.
    """
    fixed, stable, unstable = [], [], []
    for done, value in enumerate(values.tolist()):
        flow = flow_at(value)
        orbit = cycle(flow)
        fixed.append(BranchPoint(value, fixed_point(flow)))
        stable.append(BranchPoint(value, floquet(flow, "stable", orbit=orbit)))
        unstable.append(BranchPoint(value, floquet(flow, "unstable", orbit=orbit)))
        progress(done + 1.0)
    points = [*find_stability_changes(flow_at, fixed), *find_folds(flow_at, stable)]
    branches = [
        *split_branches(
            "fixed point", True, fixed, lambda state: state.outcome == "fixed point" and state.stable is True
        ),
        *split_branches(
            "fixed point", False, fixed, lambda state: state.outcome == "fixed point" and state.stable is False
        ),
        *split_branches("orbit", True, stable, lambda state: bool(state.multipliers)),
        *split_branches("orbit", False, unstable, lambda state: bool(state.multipliers)),
    ]
    return Continuation(tuple(branches), tuple(sorted(points, key=lambda point: point.value)))


def split_branches(kind: str, stable: bool, rows: list[BranchPoint], exists: Callable[..., bool]) -> Iterator[Branch]:
    """Yield a branch for every run of neighbouring values at which ``exists`` holds."""
    branch = Branch(kind, stable)
    for row in rows:
        if exists(row.state):
            branch.rows.append(row)
        elif branch.rows:
            yield branch
            branch = Branch(kind, stable)
    if branch.rows:
        yield branch


def find_stability_changes(flow_at: FlowAt, rows: list[BranchPoint]) -> Iterator[SpecialPoint]:
    """Yield the points where c - gamma_lin changes its sign: through 0, or by a jump."""

    def damping(value: float) -> float:
        flow = flow_at(value)
        return flow.c - friction_at_rest(flow)[1]

    for before, after in pairwise(rows):
        if before.state.outcome != "fixed point" or after.state.outcome != "fixed point":
            continue
        ends = damping(before.value), damping(after.value)
        if (ends[0] > 0.0) == (ends[1] > 0.0):
            continue
        value = bisect(lambda candidate: damping(candidate) > 0.0, before.value, after.value)
        is_smooth = abs(damping(value)) < CROSSES * abs(ends[1] - ends[0])
        yield SpecialPoint("hopf" if is_smooth else "border-collision", value)


def find_folds(flow_at: FlowAt, rows: list[BranchPoint]) -> Iterator[SpecialPoint]:
    """Yield the points where the stable orbit ends: next to a stable fixed point, or where it no longer sticks."""
    for before, after in pairwise(rows):
        outcomes = {row.state.outcome for row in (before, after)}  # of the search for an orbit
        if "cycle" not in outcomes or not outcomes & {"fixed point", "pure slip"}:
            continue
        if frame(flow_at(before.value)).d == 0.0 or "pure slip" in outcomes:
            beyond: set[str] = set()

            def sticks(candidate: float, others: set[str] = beyond) -> bool:
                outcome = cycle(flow_at(candidate)).outcome
                if outcome != "cycle":
                    others.clear()
                    others.add(outcome)
                return outcome == "cycle"

            value = bisect(sticks, before.value, after.value)
            yield SpecialPoint("fold" if beyond == {"fixed point"} else "grazing", value)
        elif (touches := find_smooth_fold(flow_at, before.value, after.value)) is not None:
            yield SpecialPoint("fold", touches)


def find_smooth_fold(flow_at: FlowAt, first: float, last: float) -> float | None:
    """Return where the map from minimum to minimum (`least_gain`) just touches the diagonal; None where it does not."""
    return find_zero(lambda candidate: least_gain(flow_at(candidate)), first, last, TOUCHED)


def least_gain(flow: Flow) -> float:
    """Return by how much the next minimum lies nearer to the fixed point, relative to the one before.

    The least over all starts outside.  Below 0 a start moves outwards: an unstable orbit lies between it and the fixed
    point, a stable one outside.  1 for a start that does not turn again.
    """
    fr = frame(flow)
    p_rest = displacement(fr, fixed_point(flow).x or 0.0)

    def gain(p: float) -> float:
        turn = next_minimum(fr, float(p), new_work(STEPS_OF_SEARCH))
        return 1.0 if turn.end else (turn.p - p) / (p_rest - p)

    far = p_rest - 2.0 * fr.B / fr.k
    outer = far + gain(far) * (p_rest - far)
    if not outer < p_rest:  # even from far out the mass comes to rest
        return 1.0
    return minimise(gain, outer, p_rest, TOUCH * (p_rest - outer))[1]


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
