"""The map from one minimum of the position to the next, and its derivative: the multiplier of a periodic orbit.

At a minimum the mass stands and turns forwards (u = x' = 0, u' > 0).  From there the motion goes through whatever
phases follow, slip, stick or ramp, back to the next minimum, so the map p -> p is one-dimensional and sees stick-slip
cycles and orbits that never stick alike.  Undriven flows alone, in the frame of `rig_sim.flow.frame`.

The derivative is that of the flow in the plane across the orbit, which for an orbit is its Floquet multiplier beside 1:

    multiplier = product over events of u'_after/u'_before  times  exp(-integral of (c - F'(w))/m dt)

by Liouville's formula and the determinants of the saltation matrices.  A landing in stick has u'_after = 0, so the
multiplier of an orbit that sticks is 0: the stick forgets where it began.
"""

import math
from dataclasses import dataclass
from functools import cache

from rig_sim.flow import modes
from rig_sim.flow.contact_state import classify, transition
from rig_sim.flow.frame import Frame, free_acceleration, friction_slope, mode_bounds, steepest_slope
from rig_sim.integrate.phases import increments, is_series, phase_exit
from rig_sim.integrate.work import Work
from rig_sim.systems.turn import PHASES_PER_TURN, creeps

# Points of the Gauss-Legendre rule on every Taylor step.  A step ends at a quarter of the series' radius of
# convergence, where 8 points are right to 1e-17 of the integral.
POINTS = 8


@dataclass(frozen=True)
class MinimumTurn:
    """One passage from a minimum to the next; or, with an ``end`` other than '', where it ended."""

    end: str  # '' for a passage; 'fixed point' (the mass creeps to rest), 'no cycle', or an outcome of the integrator
    advice: str = ""
    # displacement from the slip point (m, in the frame) at the next minimum, and at the maximum between
    p: float = math.nan
    p_max: float = math.nan
    duration: float = math.nan  # s
    # derivative of the map, the multiplier of an orbit where p is its start; NaN where the motion only touches an edge
    multiplier: float = math.nan
    modes: tuple[int, ...] = ()  # of the phases in the frame, from the first


def next_minimum(fr: Frame, p: float, work: Work) -> MinimumTurn:
    """Follow the motion from a minimum at p (m, in the frame) to the next; a step limit ends one that never turns."""
    still = -fr.v  # w of a mass at rest over ground
    mode = classify(fr, p, still, 0.0)
    w, rising = still, True
    p_max = math.nan
    durations: list[float] = []
    decay = 0.0  # integral of (c - F')/m over the phases so far
    jumps = 1.0  # product of u'_after/u'_before
    visited_modes = [mode]
    while len(visited_modes) < PHASES_PER_TURN:
        lo, hi = mode_bounds(fr, mode)
        if lo <= still < hi:  # the phase is followed to where the mass turns, too
            lo, hi = (still, hi) if rising else (lo, still)
        if work.steps >= work.steps_allowed:
            return MinimumTurn(*modes.OUTCOMES[modes.STEP_LIMIT])
        work.steps += 1.0
        side, tau = phase_exit(fr, mode, p, w, 0.0, lo, hi, math.inf, work)
        if math.isinf(tau) or creeps_to_rest(fr, mode, p, w):
            return MinimumTurn("fixed point", "the mass comes to rest without turning again")
        decay += integrate_damping(fr, mode, p, w, tau, work)
        dp, dw = increments(fr, mode, p, w, 0.0, tau, work)
        p += dp
        w += dw
        durations.append(tau)
        if not math.isfinite(p + w):
            return MinimumTurn(*modes.OUTCOMES[modes.NOT_FINITE])
        if side == 0:
            continue
        w = 0.0 if mode == modes.STICK else (lo, hi)[side > 0]
        if mode != modes.STICK and w == still:
            if not rising:
                return MinimumTurn(
                    "", "", p, p_max, math.fsum(durations), jumps * math.exp(-decay), tuple(visited_modes)
                )
            p_max, rising = p, False
            continue
        entered = transition(fr, mode, side, p, 0.0)
        if entered >= modes.FORCE_REVERSAL:
            return MinimumTurn(*modes.OUTCOMES[entered])
        if entered == modes.STICK:
            jumps = 0.0
        elif mode != modes.STICK:
            before = free_acceleration(fr, mode, p, w, 0.0)
            jumps *= free_acceleration(fr, entered, p, w, 0.0) / before if before != 0.0 else math.nan
        mode = entered
        visited_modes.append(mode)
    return MinimumTurn("no cycle", f"no minimum within {PHASES_PER_TURN} phases")


def creeps_to_rest(fr: Frame, mode: int, p: float, w: float) -> bool:
    """Return whether a slip that slows down has too much damping ever to turn: see `turn.creeps`."""
    if mode != modes.NEGATIVE:
        return False
    a = free_acceleration(fr, mode, p, w, 0.0)
    return creeps(fr, w + fr.v, a, fr.c - steepest_slope(fr, fr.d, fr.v))


def integrate_damping(fr: Frame, mode: int, p: float, w: float, tau: float, work: Work) -> float:
    """Return the integral of (c - F'(w))/m over a step of ``tau`` (s) that `phase_exit` has just made; 0 in stick."""
    if mode == modes.STICK:
        return 0.0
    if not is_series(fr, mode):
        return (fr.c - friction_slope(fr, mode, w)) / fr.m * tau
    total = 0.0
    for share, weight in quadrature():
        dw = increments(fr, mode, p, w, 0.0, share * tau, work)[1]
        total += weight * (fr.c - friction_slope(fr, mode, w + dw))
    return total / fr.m * tau


@cache
def quadrature() -> tuple[tuple[float, float], ...]:
    """Return points and weights of the Gauss-Legendre rule on [0, 1]."""
    from numpy.polynomial.legendre import leggauss

    points, weights = leggauss(POINTS)
    return tuple(zip((0.5 + 0.5 * points).tolist(), (0.5 * weights).tolist(), strict=True))
