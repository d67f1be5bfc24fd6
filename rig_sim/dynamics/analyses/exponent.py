"""Lyapunov exponent of a motion per passage of its section, and its rotation number.

The exponent is the mean logarithm by which a small deviation grows from passage to passage: by the system's own
variational equation, or, of a map of an interval, by the slope of the map at every point of the orbit.  The rotation
number is the mean time between passages: in drive periods per landing, say.
"""

import math
from dataclasses import dataclass

import numpy as np

from rig_sim.dynamics.analyses.settling import GROWING, SAME, is_growing
from rig_sim.dynamics.system.interface import Motion, Passages
from rig_sim.dynamics.system.period import period_of
from rig_sim.flow.modes import COMPLETED, OUTCOMES
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, parts, silent

TRANSIENT = 1000  # passages before the mean; twice as many cost 1000 passages more
BLOCKS = 20  # of the orbit, whose means give the standard error; below 20 it would itself err by more than 16 %


@dataclass(frozen=True)
class Exponent:
    """A Lyapunov exponent.

    Attributes
    ----------
    exponent, stderr : float
        Per passage, and its standard error by the means of `BLOCKS` blocks; exact, with 0, on a periodic orbit.
    events : int
        Passages that it was taken over.
    period : int or None
        Of a periodic orbit.
    outcome : str
        'completed', or why there is no exponent, such as 'no attractor' where an orbit leaves its map's domain.
    """

    exponent: float
    stderr: float
    events: int
    period: int | None
    outcome: str


def exponent(motion: Motion, events: int, progress: Stages = silent) -> Exponent:
    """Return the exponent over ``events`` passages, after `TRANSIENT`; on a periodic orbit exact, over one period.

    ``progress`` is called with the stage and what is done of it.

    Raises
    ------
    ValueError
        Fewer events than `BLOCKS`.
    """
    if events < BLOCKS:
        raise ValueError(f"{events} events; need {BLOCKS} or more")
    by_slopes = getattr(motion.system, "growth_at", None)
    found = motion.follow(TRANSIENT, tangent=by_slopes is None)
    if found.outcome == OUTCOMES[COMPLETED]:
        found = followed(motion, events, progress, tangent=by_slopes is None)
    if found.outcome != OUTCOMES[COMPLETED]:
        return Exponent(np.nan, np.nan, 0, None, found.outcome.name)
    scale = motion.system.scale
    tenth = max(len(found.states) // 10, 1)
    if is_growing(found.states[:tenth] / scale, found.states[-tenth:] / scale):
        return Exponent(np.nan, np.nan, 0, None, GROWING.name)
    period = passages_per_period(found, scale)
    growth = found.growth
    if by_slopes is not None:
        orbit = found.states[:, 0] if period is None else found.states[-period:, 0]
        slopes = parts("slopes on its orbit", len(orbit), progress)
        growth = np.concatenate([by_slopes(orbit[begin:end]) for begin, end in slopes])
    if period is None:
        return mean_growth(growth)
    with np.errstate(invalid="ignore"):  # minus infinity, where a deviation vanishes, repeats nothing
        repeats = period if by_slopes is not None else period_of(growth, SAME)
    if repeats == period:
        return Exponent(float(np.mean(growth[-period:])), 0.0, period, period, "completed")
    # complex multipliers: the deviation turns, and its growth swings about the mean
    return Exponent(smooth_mean(growth), 0.0, len(growth), period, "completed")


def followed(motion: Motion, events: int, progress: Stages, *, tangent: bool) -> Passages:
    """Return the next passages up to where the motion ends; ``tangent``: with the growth of a deviation."""
    found: list[Passages] = []
    for begin, end in parts("following the motion", events, progress):
        found.append(motion.follow(end - begin, tangent=tangent))
        if found[-1].outcome != OUTCOMES[COMPLETED]:
            break
    times, states, growth = (
        np.concatenate([getattr(piece, name) for piece in found]) for name in ("times", "states", "growth")
    )
    return Passages(times, states, growth, found[-1].outcome)


def mean_growth(growth: Array) -> Exponent:
    """Return the exponent of a motion that is not periodic, on which a deviation's logarithm grows so, shape (n,).

    What is not finite, beside a jump of the motion, is left out.
    """
    growth = growth[np.isfinite(growth)]
    means = [float(np.mean(block)) for block in np.array_split(growth, BLOCKS)]
    return Exponent(
        float(np.mean(growth)), float(np.std(means, ddof=1)) / math.sqrt(BLOCKS), len(growth), None, "completed"
    )


def passages_per_period(passages: Passages, scale: Array) -> int | None:
    """Return after how many passages state and phase of the drive repeat; None for what is not periodic."""
    turn = 2.0 * np.pi * passages.times
    return period_of(np.column_stack([passages.states / scale, np.cos(turn), np.sin(turn)]), SAME)


def rotation_number(passages: Passages) -> float:
    """Return the mean time from passage to passage (drive periods)."""
    return smooth_mean(np.diff(passages.times))


def smooth_mean(values: Array) -> float:
    """Return the mean of a periodic or quasi-periodic sequence (n,), by weights that vanish smoothly at both ends.

    It converges faster than any power of n (Das, Saiki, Sander and Yorke 2017).
    """
    place = (np.arange(len(values)) + 1.0) / (len(values) + 1.0)
    weights = np.exp(-1.0 / (place * (1.0 - place)))
    return float(np.sum(weights * values) / np.sum(weights))
