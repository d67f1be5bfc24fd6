"""What a system is to the analyses of this folder, which name none: a motion that passes a section again and again."""

from dataclasses import dataclass
from typing import Protocol

from daq.base.compute.arrays import Array
from rig_sim.flow.modes import Outcome


@dataclass(frozen=True)
class Passages:
    """Consecutive passages of a section.

    Attributes
    ----------
    times : (n,) float64
        When, in drive periods from the start of the motion; of a map how often it was applied.
    states : (n, d) float64
        The state there.
    growth : (n,) float64
        Logarithm of the factor by which a small deviation has grown since the passage before, along the direction
        that grows most; NaN where it has none, as beside a jump of the motion.
    outcome : Outcome
        'completed', or why there are fewer passages than were asked for.
    """

    times: Array
    states: Array
    growth: Array
    outcome: Outcome


class System(Protocol):
    """A motion from one start, whose state moves on with every call.

    Attributes
    ----------
    scale : (d,) float64
        A size of every coordinate of the state: deviations are judged relative to it.
    unit : int
        Passages within one oscillation of the system's own, 1 at the least: transients are counted in these.
    """

    scale: Array
    unit: int

    def follow(self, number: int, *, tangent: bool = False) -> Passages:
        """Return the next ``number`` passages of the section; ``tangent``: with the growth of a deviation."""
        ...

    def drawn(self, number: int) -> Array:
        """Return what a bifurcation diagram draws of the next ``number`` passages, shape (n,)."""
        ...
