"""Lyapunov exponent of a system per passage of its section, and its rotation number.

The exponent is the mean logarithm by which a small deviation grows from passage to passage, by the system's own
variational equation.  The rotation number is the mean time between passages: in drive periods per landing, say.
"""

import numpy as np

from daq.base.compute.arrays import Array
from daq.base.compute.stages import Stages, parts, silent
from rig_sim.dynamics.analyses.lyapunov import BLOCKS, Exponent, mean_growth
from rig_sim.dynamics.analyses.settling import GROWING, SAME, is_growing
from rig_sim.dynamics.system.period import period_of
from rig_sim.dynamics.system.system import Passages, System
from rig_sim.flow.modes import COMPLETED, OUTCOMES

TRANSIENT = 1000  # passages before the mean; twice as many cost 1000 passages more


def exponent(system: System, events: int, progress: Stages = silent) -> Exponent:
    """Return the exponent over ``events`` passages, after `TRANSIENT`; on a periodic orbit exact, over one period.

    ``progress`` is called with the stage and what is done of it.

    Raises
    ------
    ValueError
        Fewer events than `BLOCKS`.
    """
    if events < BLOCKS:
        raise ValueError(f"{events} events; need {BLOCKS} or more")
    found = system.follow(TRANSIENT, tangent=True)
    if found.outcome == OUTCOMES[COMPLETED]:
        found = followed(system, events, progress)
    if found.outcome != OUTCOMES[COMPLETED]:
        return Exponent(np.nan, np.nan, 0, None, found.outcome.name)
    tenth = max(len(found.states) // 10, 1)
    if is_growing(found.states[:tenth] / system.scale, found.states[-tenth:] / system.scale):
        return Exponent(np.nan, np.nan, 0, None, GROWING.name)
    period = passages_per_period(found, system)
    if period is None:
        return mean_growth(found.growth)
    with np.errstate(invalid="ignore"):  # minus infinity, where a deviation vanishes, repeats nothing
        repeats = period_of(found.growth, SAME)
    if repeats == period:
        return Exponent(float(np.mean(found.growth[-period:])), 0.0, period, period, "completed")
    # complex multipliers: the deviation turns, and its growth swings about the mean
    return Exponent(smooth_mean(found.growth), 0.0, len(found.growth), period, "completed")


def followed(system: System, events: int, progress: Stages) -> Passages:
    """Return the next passages with the growth of a deviation, up to where the motion ends."""
    found: list[Passages] = []
    for begin, end in parts("following the motion", events, progress):
        found.append(system.follow(end - begin, tangent=True))
        if found[-1].outcome != OUTCOMES[COMPLETED]:
            break
    times, states, growth = (
        np.concatenate([getattr(piece, name) for piece in found]) for name in ("times", "states", "growth")
    )
    return Passages(times, states, growth, found[-1].outcome)


def passages_per_period(found: Passages, system: System) -> int | None:
    """Return after how many passages state and phase of the drive repeat; None for what is not periodic."""
    turn = 2.0 * np.pi * found.times
    return period_of(np.column_stack([found.states / system.scale, np.cos(turn), np.sin(turn)]), SAME)


def rotation_number(found: Passages) -> float:
    """Return the mean time from passage to passage (drive periods)."""
    return smooth_mean(np.diff(found.times))


def smooth_mean(values: Array) -> float:
    """Return the mean of a periodic or quasi-periodic sequence (n,), by weights that vanish smoothly at both ends.

    It converges faster than any power of n (Das, Saiki, Sander and Yorke 2017).
    """
    place = (np.arange(len(values)) + 1.0) / (len(values) + 1.0)
    weights = np.exp(-1.0 / (place * (1.0 - place)))
    return float(np.sum(weights * values) / np.sum(weights))
