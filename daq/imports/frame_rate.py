"""The frame-rate check of a camera's track: a slip must last as long as mass and spring imply.

In a slip the mass swings from its turning point to the opposite one in pi sqrt(m/k): exactly with constant friction,
and within 10 % for linear and hyperbolic velocity weakening from weak to strong, whatever the belt's speed.  A track in
which that takes another time was filmed at another rate than its times imply, or the mass or the stiffness is wrong.

A turning point lies somewhere between the samples beside the extreme one: a swing of few samples has a range of
durations, and only what all of that range excludes is wrong.

Not modelled: strong damping, which lengthens the swing.
"""

import math
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from daq.runfile.spill import blocks

TOLERANCE = 1.25  # the laws stay within 1.1; the rest is for noise, coarse sampling and the errors of m and k


def check_half_period(
    time: NDArray[np.float64], position: NDArray[np.float64], mass: float, stiffness: float
) -> list[str]:
    """Return a warning when the swings of the slips do not take pi sqrt(m/k), or an empty list."""
    swing = measure_half_period(time, position)
    expected = math.pi * math.sqrt(mass / stiffness)
    if swing.number == 0:
        return ["the frame rate could not be checked: the track contains no complete slip"]
    if swing.shortest / expected <= TOLERANCE and 1 / TOLERANCE <= swing.longest / expected:
        return []
    measured, ratio = swing.duration, swing.duration / expected
    rate = 1 / float(np.median(np.diff(time)))
    return [
        f"the frame rate is probably wrong: a slip lasts {measured:.3g} s ({swing.number} found) where pi "
        f"sqrt(m/k) = {expected:.3g} s. The times give {rate:.4g} frames/s, {rate * ratio:.4g} would match. "
        "Either the mass and stiffness are wrong, or the true rate must be given with --frame-rate"
    ]


@dataclass(frozen=True)
class Swing:
    """The time from a turning point to the opposite one in a slip: medians over ``number`` slips."""

    duration: float  # between the extreme samples, s; not a number when there is none
    shortest: float  # what it can have been, s: between the samples beside the extreme ones, inside and outside of them
    longest: float
    number: int  # of slips; 0 when the track has no whole one


def measure_half_period(time: NDArray[np.float64], position: NDArray[np.float64]) -> Swing:
    """Return the time from a turning point to the opposite one in a slip, the quicker of the swings up and down."""
    turns = _find_turns(position)
    # The first and the last extreme may be mere ends of the record.
    inner = np.array(turns[1:-1], np.int64)
    if inner.size < 2:
        return Swing(math.nan, math.nan, math.nan, 0)
    first, last = inner[:-1], inner[1:]
    span = time[last] - time[first]
    down = position[last] < position[first]
    slips = min((kind for kind in (down, ~down) if kind.any()), key=lambda kind: float(np.median(span[kind])))
    spans = (span, time[last - 1] - time[first + 1], time[last + 1] - time[first - 1])
    duration, shortest, longest = (float(np.median(each[slips])) for each in spans)
    return Swing(duration, shortest, longest, int(slips.sum()))


def _find_turns(position: NDArray[np.float64]) -> list[int]:
    # Hysteresis of half the range: an extreme counts once the track has come back from it by that much.
    reach = 0.5 * float(np.ptp(position))
    if reach == 0:
        return []
    turns: list[int] = []
    high = low = 0
    rising: bool | None = None
    for i, x in enumerate(chain.from_iterable(block.tolist() for block in blocks(position))):
        if x > position[high]:
            high = i
        if x < position[low]:
            low = i
        if rising is not False and position[high] - x > reach:
            turns.append(high)
            low, rising = i, False
        elif rising is not True and x - position[low] > reach:
            turns.append(low)
            high, rising = i, True
    turns.append(high if rising else low)
    return turns
