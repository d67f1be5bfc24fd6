"""The phase portrait: velocity against position, cut into the cycles a limit cycle repeats.

A cycle runs from one onset of slip to the next.  Over a stick the portrait is the flat top that the thesis looks for.
"""

from dataclasses import dataclass
from itertools import pairwise

from daq.compute.arrays import Array, Mask
from processing.record.kinematics import Kinematics


@dataclass(frozen=True, eq=False)
class Portrait:
    """Velocity (m/s) against position (m).

    Attributes
    ----------
    position, velocity : array of shape (n,)
        The whole record.
    stick : array of bool
        True in sticks.
    cycles : tuple of slice
        Samples of each complete cycle, from slip onset to slip onset.
    """

    position: Array
    velocity: Array
    stick: Mask
    cycles: tuple[slice, ...]


def from_kinematics(kinematics: Kinematics) -> Portrait:
    """Return the portrait; a record with fewer than two slips after a stick holds no complete cycle."""
    phases = kinematics.phases
    onsets = [
        after.first
        for before, after in pairwise(phases)
        if before.kind == "stick" and after.kind == "slip" and after.first == before.last + 1
    ]
    segment = kinematics.recording.segment
    cycles = tuple(slice(first, last) for first, last in pairwise(onsets) if segment[first] == segment[last])
    return Portrait(kinematics.position, kinematics.velocity, kinematics.stick, cycles)
