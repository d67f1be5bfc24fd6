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

from rig_sim.analyses.settling import TRANSIENTS, Settled, settle
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import frame, friction_slope
from rig_sim.flow.modes import COMPLETED, NEGATIVE, OUTCOMES, STEP_LIMIT
from rig_sim.integrate.phases import State
from rig_sim.integrate.sampled import sample_motion
from rig_sim.systems.driven import DrivenMap
from rig_sim.systems.interface import StepBudget
from stickslip.compute.arrays import Array
from stickslip.compute.stages import Stages, silent

# Largest swing of a quenched motion over the linear ripple: above the threshold it is 0.65 to 1.0; of stick-slip that
# repeats with every period of a drive slower than the mass, 3 and more.
MOST_RIPPLE = 1.5
FIRST, FACTOR, LAST = 0.9, 1.03, 4.0  # of the formula's threshold: amplitudes tried for the simulated one
DECAY = TRANSIENTS[:3]  # oscillations of the mass: above the threshold friction ends the old motion within about ten
PRECISION = 1e-3  # of the simulated threshold, relative
# Integrator steps of all motions, 8 s; the thesis's cases take 1e5 to 1e6.
STEPS_IN_ALL = 15_000_000
OSCILLATIONS = 10  # of the mass alone: the span whose swing is taken where the motion does not repeat
# Samples of the motion in a drive period, or in an oscillation of the mass if that is shorter, and in all, 1 s.
SAMPLES, MOST_SAMPLES = 64, 100_000
MANY_PERIODS = 10_000  # of the drive: interpreted 3 s; above, compiled code is faster including its compilation


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
    """Return whether the drive quenches the stick-slip of a mass that starts at x (m) with velocity v (m/s)."""
    fr = frame(flow)
    start = np.array([x, v])
    steps = StepBudget(STEPS_IN_ALL)
    progress("settling", 0, 2)
    motion = settle(DrivenMap(flow, budget=steps).motion(start))
    progress("settling", 1, 2)
    undriven = flow._replace(u0=0.0)
    free = settle(DrivenMap(undriven, budget=steps).motion(start))
    free_swing = measure_swing(undriven, free)
    size = (fr.B + fr.v * math.sqrt(flow.k * flow.m)) / flow.k
    self_excited = free.period is None and free.outcome == OUTCOMES[COMPLETED] and free_swing > 1e-6 * size
    threshold_by_formula = threshold(flow)
    is_fast = abs(flow.omega) > fr.omega0
    quenched = is_quenched(flow, motion)
    simulated = find_simulated_threshold(flow, x, v, steps, progress) if is_fast and self_excited else None
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
        threshold_by_formula,
        threshold(flow, -friction_slope(fr, NEGATIVE, -fr.v) if fr.v > fr.d else 0.0),
        abs(flow.u0) / threshold_by_formula if threshold_by_formula > 0.0 else None,
        is_fast and abs(flow.u0) > threshold_by_formula > 0.0,
        quenched and self_excited and flow.u0 != 0.0,
        simulated,
        measure_swing(flow, motion),
        linear_ripple(flow),
        free_swing,
    )


def threshold(flow: Flow, more_damping: float = 0.0) -> float:
    """Return the amplitude u0 (N) with which the mass, sliding under constant friction, just reaches the belt's speed.

    ``more_damping`` (N s/m) is added to the damper's.
    """
    return abs(flow.v_belt) * dynamic_stiffness(flow, more_damping) / abs(flow.omega)


def dynamic_stiffness(flow: Flow, more_damping: float = 0.0) -> float:
    """Return abs(k - m omega^2 + i c omega), N/m: force per displacement of spring, mass and damper."""
    return math.hypot(flow.k - flow.m * flow.omega * flow.omega, (flow.c + more_damping) * flow.omega)


def linear_ripple(flow: Flow) -> float | None:
    """Return the peak-to-peak displacement (m) of spring, mass and damper alone; None at undamped resonance."""
    stiffness = dynamic_stiffness(flow)
    return 2.0 * abs(flow.u0) / stiffness if stiffness > 0.0 else None


def is_quenched(flow: Flow, motion: Settled) -> bool:
    """Return whether a motion repeats with every drive period and swings like the linear one."""
    ripple = linear_ripple(flow)
    return motion.period == 1 and ripple is not None and measure_swing(flow, motion) <= MOST_RIPPLE * ripple


def find_simulated_threshold(
    flow: Flow, x: float, v: float, steps: StepBudget, progress: Stages = silent
) -> float | None:
    """Return the least u0 (N), to `PRECISION`, that quenches the simulated motion.

    None without one, or when the budget of ``steps`` is spent.
    """
    start = np.array([x, v])

    def quenched(u0: float) -> bool:
        driven = flow._replace(u0=u0)
        return is_quenched(driven, settle(DrivenMap(driven, budget=steps).motion(start), DECAY))

    threshold_by_formula = threshold(flow)
    if not threshold_by_formula > 0.0:
        return None
    most_tries = math.ceil(math.log(LAST / FIRST) / math.log(FACTOR)) + 1
    lo, hi, tried = 0.0, FIRST * threshold_by_formula, 0
    while not quenched(hi):
        lo, hi, tried = hi, hi * FACTOR, tried + 1
        progress("trying amplitudes", tried, most_tries)
        if hi > LAST * threshold_by_formula:
            return None
    while hi - lo > PRECISION * threshold_by_formula:
        middle = 0.5 * (lo + hi)
        lo, hi = (lo, middle) if quenched(middle) else (middle, hi)
    return 0.5 * (lo + hi) if steps.left > 0.0 else None


def measure_swing(flow: Flow, motion: Settled) -> float:
    """Return the peak-to-peak displacement (m) over the motion's period, or `OSCILLATIONS`; NaN where it ended."""
    if motion.outcome != OUTCOMES[COMPLETED]:
        return math.nan
    period, oscillation = 2.0 * math.pi / abs(flow.omega), 2.0 * math.pi * math.sqrt(flow.m / flow.k)
    span = OSCILLATIONS * oscillation if motion.period is None else motion.period * period
    x, v = motion.states[-1].tolist()
    samples = min(math.ceil(span / min(period, oscillation) * SAMPLES), MOST_SAMPLES)
    return float(np.ptp(sample_positions(flow, x, v, np.linspace(0.0, span, samples))))


def sample_positions(flow: Flow, x: float, v: float, times: Array) -> Array:
    """Return x (m) at increasing times (s), (n,), of a motion from (x, v) at the first; fewer where it ends."""
    t = float(times[0])
    is_long = (times[-1] - times[0]) * abs(flow.omega) > 2.0 * math.pi * MANY_PERIODS and flow.u0 != 0.0
    state = State(initial_mode(flow, x, v, t), x, v - flow.v_belt, t)
    return sample_motion(flow, state, times, compiled=bool(is_long))[0]
