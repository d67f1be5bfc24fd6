"""Dither: whether a fast drive quenches the stick-slip of a mass, and the amplitude at which it begins to.

Under a drive much faster than the mass itself, the velocity swings with the amplitude

    V = u0 omega / abs(k - m omega^2 + i c omega)          (m = k = 1, c = 0: u0 omega/(omega^2 - 1))

As long as V stays below the belt's speed, friction acts with its falling slope all the time, and stick-slip continues.
Where V exceeds it, the mass overtakes the belt once per drive period, friction changes its sign there, and on average
it rises with speed and damps: the threshold is V = v_belt (Thomsen 1999).  A falling friction slope gamma_lin makes the
swing smaller, as a damping of its size does; with c - gamma_lin for c the threshold is closer to that of the
simulation.  In a ramp friction damps already at speeds below the belt's, so that less may do.

Simulated, a motion counts as quenched when it repeats with every drive period and swings not much further than the
spring and the mass alone under the drive.
"""

import math
from dataclasses import dataclass

import numpy as np

from rig_sim.dynamics.analyses.settling import TRANSIENTS, Settled, settled
from rig_sim.dynamics.return_maps.driven import DrivenMap
from rig_sim.dynamics.system.step_budget import StepBudget
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import frame, friction_slope
from rig_sim.flow.modes import COMPLETED, NEGATIVE, OUTCOMES, STEP_LIMIT
from rig_sim.integrate.phases import State
from rig_sim.integrate.sampled import sampled
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent

# Times the linear ripple that a quenched motion may swing: above the threshold it swings by 0.65 to 1.0 times it, and
# stick-slip that repeats with every period of a drive slower than the mass by 3 times it and more.
MOST_RIPPLE = 1.5
FIRST, FACTOR, LAST = 0.9, 1.03, 4.0  # of the formula's threshold: amplitudes at which the simulated one is looked for
DECAY = TRANSIENTS[:3]  # oscillations of the mass: above the threshold friction ends the old motion within some ten
PRECISION = 1e-3  # of the simulated threshold, relative; each halving costs one more motion
# Integrator steps of all motions, 8 s.  The thesis's cases take 1e5 to 1e6, drives 300 times faster than the mass 1e7.
STEPS_IN_ALL = 15_000_000
OSCILLATIONS = 10  # of the mass alone over which the swing of a motion is taken that does not repeat
# Samples of the motion in a drive period, or an oscillation of the mass if that is shorter, and in all, 1 s: with a
# drive more than 150 times faster than the mass there are fewer in a period.
SAMPLES, MOST_SAMPLES = 64, 100_000
MANY_PERIODS = 10_000  # of the drive: interpreted 3 s; above, compiled code is faster with its compilation


@dataclass(frozen=True)
class Quench:
    """Whether a drive quenches stick-slip.

    Attributes
    ----------
    outcome : str
        'quenched', 'not quenched', 'nothing to quench' (the motion without the drive comes to rest or slides), 'no
        drive' (u0 = 0), or why the motion ended.
    threshold, threshold_with_slope : float
        u0 (N) at which V reaches the belt's speed, without and with the slope of friction.
    ratio : float or None
        u0/threshold; None at the resonance of an undamped mass.
    predicted : bool
        u0 is above the threshold and the drive faster than the mass alone.
    quenched : bool
        By simulation from the scene's start.
    simulated_threshold : float or None
        u0 (N) from which on the simulated motion is quenched; None where it is not up to `LAST` times the threshold, or
        the drive is slower than the mass alone, or there is nothing to quench.
    swing, linear_ripple, free_swing : float
        Peak to peak of the position (m): simulated; of spring, mass and damper alone (None at undamped resonance);
        simulated without the drive.  NaN of a simulated motion that ended.
    """

    outcome: str
    threshold: float
    threshold_with_slope: float
    ratio: float | None
    predicted: bool
    quenched: bool
    simulated_threshold: float | None
    swing: float
    linear_ripple: float | None
    free_swing: float


def quench(flow: Flow, x: float, v: float, progress: Stages = silent) -> Quench:
    """Return whether the drive quenches the stick-slip of a mass that starts at x (m) with velocity v (m/s).

    ``progress`` is called with the stage and what is done of it.

    Raises
    ------
    ValueError
        The flow is not physical, or its drive has no period.
    """
    fr = frame(flow)
    start = np.array([x, v])
    steps = StepBudget(STEPS_IN_ALL)
    progress("settling", 0, 2)
    motion = settled(DrivenMap(flow, budget=steps).motion(start))
    progress("settling", 1, 2)
    still = flow._replace(u0=0.0)
    free = settled(DrivenMap(still, budget=steps).motion(start))
    free_swing = swing(still, free)
    size = (fr.B + fr.v * math.sqrt(flow.k * flow.m)) / flow.k
    self_excited = free.period is None and free.outcome == OUTCOMES[COMPLETED] and free_swing > 1e-6 * size
    least = threshold(flow)
    is_fast = abs(flow.omega) > fr.omega0
    quenched = is_quenched(flow, motion)
    simulated = simulated_threshold(flow, x, v, steps, progress) if is_fast and self_excited else None
    outcome = "quenched" if quenched else "not quenched"
    if motion.outcome != OUTCOMES[COMPLETED]:
        outcome = motion.outcome.name
    elif steps.left <= 0.0:
        outcome = OUTCOMES[STEP_LIMIT].name
    elif flow.u0 == 0.0:
        outcome = "no drive"
    elif not self_excited:
        outcome = "nothing to quench"
    return Quench(
        outcome,
        least,
        threshold(flow, -friction_slope(fr, NEGATIVE, -fr.v) if fr.v > fr.d else 0.0),
        abs(flow.u0) / least if least > 0.0 else None,
        is_fast and abs(flow.u0) > least > 0.0,
        quenched and self_excited and flow.u0 != 0.0,
        simulated,
        swing(flow, motion),
        linear_ripple(flow),
        free_swing,
    )


def threshold(flow: Flow, more_damping: float = 0.0) -> float:
    """Return the amplitude u0 (N) with which the mass, sliding under constant friction, just reaches the belt's speed.

    ``more_damping`` (N s/m) is added to the damper's.
    """
    return abs(flow.v_belt) * resistance(flow, more_damping) / abs(flow.omega)


def resistance(flow: Flow, more_damping: float = 0.0) -> float:
    """Return abs(k - m omega^2 + i c omega), N/m: force per displacement of spring, mass and damper."""
    return math.hypot(flow.k - flow.m * flow.omega * flow.omega, (flow.c + more_damping) * flow.omega)


def linear_ripple(flow: Flow) -> float | None:
    """Return the peak-to-peak displacement (m) of spring, mass and damper alone; None at undamped resonance."""
    against = resistance(flow)
    return 2.0 * abs(flow.u0) / against if against > 0.0 else None


def is_quenched(flow: Flow, motion: Settled) -> bool:
    """Return whether a motion repeats with every drive period and swings like the linear one."""
    ripple = linear_ripple(flow)
    return motion.period == 1 and ripple is not None and swing(flow, motion) <= MOST_RIPPLE * ripple


def simulated_threshold(flow: Flow, x: float, v: float, steps: StepBudget, progress: Stages = silent) -> float | None:
    """Return the least u0 (N), to `PRECISION`, from which on the simulated motion is quenched; None without one.

    None, too, when the ``steps`` that the motions may take between them are spent.  ``progress`` is called with the
    stage and what is done of it.
    """
    start = np.array([x, v])

    def quenched(u0: float) -> bool:
        driven = flow._replace(u0=u0)
        return is_quenched(driven, settled(DrivenMap(driven, budget=steps).motion(start), DECAY))

    least = threshold(flow)
    if not least > 0.0:
        return None
    most = math.ceil(math.log(LAST / FIRST) / math.log(FACTOR)) + 1
    lo, hi, tried = 0.0, FIRST * least, 0
    while not quenched(hi):
        lo, hi, tried = hi, hi * FACTOR, tried + 1
        progress("trying amplitudes", tried, most)
        if hi > LAST * least:
            return None
    while hi - lo > PRECISION * least:
        middle = 0.5 * (lo + hi)
        lo, hi = (lo, middle) if quenched(middle) else (middle, hi)
    return 0.5 * (lo + hi) if steps.left > 0.0 else None


def swing(flow: Flow, motion: Settled) -> float:
    """Return the peak-to-peak displacement (m) over the motion's period, or `OSCILLATIONS`; NaN where it ended."""
    if motion.outcome != OUTCOMES[COMPLETED]:
        return math.nan
    period, own = 2.0 * math.pi / abs(flow.omega), 2.0 * math.pi * math.sqrt(flow.m / flow.k)
    span = OSCILLATIONS * own if motion.period is None else motion.period * period
    x, v = motion.states[-1].tolist()
    samples = min(math.ceil(span / min(period, own) * SAMPLES), MOST_SAMPLES)
    return float(np.ptp(positions(flow, x, v, np.linspace(0.0, span, samples))))


def positions(flow: Flow, x: float, v: float, times: Array) -> Array:
    """Return x (m) at increasing times (s), (n,), of a motion from (x, v) at the first; fewer where the motion ends."""
    t = float(times[0])
    many = (times[-1] - times[0]) * abs(flow.omega) > 2.0 * math.pi * MANY_PERIODS and flow.u0 != 0.0
    at = State(initial_mode(flow, x, v, t), x, v - flow.v_belt, t)
    return sampled(flow, at, times, compiled=bool(many))[0]
