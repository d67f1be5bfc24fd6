"""Lyapunov exponent of a motion per passage of its section, and its rotation number.

The exponent is the mean logarithm by which a small deviation grows from passage to passage: by the system's own
variational equation, or, of a map of an interval, by the slope of the map at every point of the orbit.  The rotation
number is the mean time between passages: in drive periods per landing, say.
"""

import math
from dataclasses import dataclass

import numpy as np

from rig_sim.analyses.settling import GROWING, SAME, find_period, is_growing
from rig_sim.flow.modes import COMPLETED, OUTCOMES
from rig_sim.systems.interface import Motion, Passages
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, parts, silent

TRANSIENT = 1000  # passages before the mean
BLOCKS = 20  # of the orbit, whose means give the standard error, to 16 % with 20


@dataclass(frozen=True)
class Exponent:
    exponent: float  # per passage; exact on a periodic orbit
    stderr: float  # by the means of `BLOCKS` blocks; 0 on a periodic orbit
    events: int  # number of passages in the mean
    period: int | None  # of a periodic orbit
    # 'completed', or why there is no exponent, such as 'no attractor' where an orbit leaves its map's domain
    outcome: str


def exponent(motion: Motion, events: int, progress: Stages = silent) -> Exponent:
    """Return the exponent over ``events`` passages, after `TRANSIENT`; on a periodic orbit exact, over one period."""
    if events < BLOCKS:
        raise ValueError(f"the number of events must be {BLOCKS} or more, not {events}")
    growth_at = getattr(motion.system, "growth_at", None)
    passages = motion.follow(TRANSIENT, tangent=growth_at is None)
    if passages.outcome == OUTCOMES[COMPLETED]:
        passages = follow_motion(motion, events, progress, tangent=growth_at is None)
    if passages.outcome != OUTCOMES[COMPLETED]:
        return Exponent(np.nan, np.nan, 0, None, passages.outcome.name)
    scale = motion.system.scale
    tenth = max(len(passages.states) // 10, 1)
    if is_growing(passages.states[:tenth] / scale, passages.states[-tenth:] / scale):
        return Exponent(np.nan, np.nan, 0, None, GROWING.name)
    period = passages_per_period(passages, scale)
    growth = passages.growth
    if growth_at is not None:
        orbit = passages.states[:, 0] if period is None else passages.states[-period:, 0]
        slopes = parts("slopes on its orbit", len(orbit), progress)
        growth = np.concatenate([growth_at(orbit[begin:end]) for begin, end in slopes])
    if period is None:
        return average_growth(growth)
    with np.errstate(invalid="ignore"):  # minus infinity, where a deviation vanishes, repeats nothing
        repeats = period if growth_at is not None else find_period(growth, SAME)
    if repeats == period:
        return Exponent(float(np.mean(growth[-period:])), 0.0, period, period, "completed")
    # complex multipliers: the deviation turns, and its growth swings about the mean
    return Exponent(smooth_mean(growth), 0.0, len(growth), period, "completed")


def follow_motion(motion: Motion, events: int, progress: Stages, *, tangent: bool) -> Passages:
    """Return the next passages up to where the motion ends; ``tangent``: with the growth of a deviation."""
    pieces: list[Passages] = []
    for begin, end in parts("following the motion", events, progress):
        pieces.append(motion.follow(end - begin, tangent=tangent))
        if pieces[-1].outcome != OUTCOMES[COMPLETED]:
            break
    times, states, growth = (
        np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("times", "states", "growth")
    )
    return Passages(times, states, growth, pieces[-1].outcome)


def average_growth(growth: Array) -> Exponent:
    """Return the exponent of a motion that is not periodic from the growth (n,) of a deviation's logarithm.

    Values that are not finite, next to a jump of the motion, are left out.
    """
    growth = growth[np.isfinite(growth)]
    means = [float(np.mean(block)) for block in np.array_split(growth, BLOCKS)]
    return Exponent(
        float(np.mean(growth)), float(np.std(means, ddof=1)) / math.sqrt(BLOCKS), len(growth), None, "completed"
    )


def passages_per_period(passages: Passages, scale: Array) -> int | None:
    """Return after how many passages the state and the drive's phase repeat; None for a motion that is not periodic."""
    turn = 2.0 * np.pi * passages.times
    return find_period(np.column_stack([passages.states / scale, np.cos(turn), np.sin(turn)]), SAME)


def rotation_number(passages: Passages) -> float:
    return smooth_mean(np.diff(passages.times))


def smooth_mean(values: Array) -> float:
    """Return the mean of a periodic or quasi-periodic sequence (n,), by weights that vanish smoothly at both ends.

    It converges faster than any power of n (Das, Saiki, Sander and Yorke 2017).
    """
    position = (np.arange(len(values)) + 1.0) / (len(values) + 1.0)
    weights = np.exp(-1.0 / (position * (1.0 - position)))
    return float(np.sum(weights * values) / np.sum(weights))
