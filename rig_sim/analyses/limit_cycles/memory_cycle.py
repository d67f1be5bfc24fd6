"""The fixed point and the periodic orbit of one mass whose friction has a memory.

Steady sliding is stable for a spring stiffer than a critical one, which for rate and state is (b - a)/D to first order
(J. Rice, A. Ruina, J. Appl. Mech. 50 (1983) 343).  The orbit is found by following the motion from a mass that the belt
carries: a stick forgets almost all of the slip before it, so that few turns repeat.
"""

import math

from rig_sim.analyses.limit_cycles.fixed_point import FixedPoint
from rig_sim.analyses.limit_cycles.limit_cycle import Orbit
from rig_sim.flow import modes
from rig_sim.flow.memory import (
    RELATIVE_TOLERANCE,
    MemoryFlow,
    jacobian,
    memory_rate,
    motion_of,
    second_variable,
)
from rig_sim.friction.memory import BRISTLE
from rig_sim.integrate.memory import MemoryWork, new_memory_work, sample_memory_phase
from rig_sim.integrate.phases import Samples, State

TURNS = 100
STEPS = 200_000  # of the search
# A mass that slips, or sticks, for longer goes on so: in natural periods, and in times that the belt takes to stretch
# the spring to the level of friction.
WAITED, LOADED = 100.0, 3.0
CLOSED = 1e-6  # of the stretch, and of the period: what two turns may differ by
POINTS = 20_001  # of an orbit, for its extremes


def memory_fixed_point(flow: MemoryFlow) -> FixedPoint:
    """Return the fixed point of steady sliding, and the eigenvalues of the motion and the memory about it."""
    import numpy as np

    if flow.u0 != 0.0:
        return FixedPoint("driven", "a driven mass does not come to rest; remove the drive")
    speed = flow.v_belt
    z = -math.log(abs(speed) / flow.v0) if flow.law != BRISTLE else 0.0
    if flow.law == BRISTLE:
        z = -speed / memory_rate(flow, speed, 0.0)[2]
    y = second_variable(flow, -speed, z)
    x = flow.x0 + flow.m * motion_of(flow, 0.0, (flow.x0, y, z))[2] / flow.k
    matrix = np.array(jacobian(flow, 0.0, (x, y, z)))
    roots = sorted((complex(root) for root in np.linalg.eigvals(matrix)), key=lambda root: (root.real, root.imag))
    return FixedPoint("fixed point", "", x, tuple(roots), roots[-1].real < 0.0)


def memory_cycle(flow: MemoryFlow) -> tuple[Orbit, Samples]:
    """Return the periodic orbit reached by a mass that the belt carries from the spring's rest, and its motion."""
    unsampled = Samples([], [], [], [], 0)
    if flow.u0 != 0.0:
        return Orbit("driven", "this analysis does not apply to a driven mass; list its events instead"), unsampled
    work = new_memory_work(STEPS)
    state = State(modes.STICK, flow.x0, 0.0, 0.0)
    reach = flow.tolerance / RELATIVE_TOLERANCE
    wait = WAITED * 2.0 * math.pi * math.sqrt(flow.m / flow.k) + LOADED * reach / abs(flow.v_belt)
    phases: list[tuple[int, State]] = []  # of this turn: the mode, and the state at its end
    slip = before = state  # where this turn and the turn before began
    for _ in range(20 * TURNS):
        mode = state.mode
        kind, state, _ = sample_memory_phase(flow, state, state.t + wait, unsampled, 0, work)
        if kind >= modes.FORCE_REVERSAL:
            return Orbit(*modes.OUTCOMES[kind]), unsampled
        if kind == modes.COMPLETED:
            rest = memory_fixed_point(flow)
            if rest.stable:
                advice = "steady sliding is stable; reduce spring.k or belt.speed"
                return Orbit("fixed point", advice, x_rest=rest.x), unsampled
            return Orbit("pure slip", "the mass oscillates without ever sticking; list its motion with run"), unsampled
        phases.append((mode, state))
        if mode != modes.STICK:
            continue
        period = state.t - slip.t
        if abs(state.x - slip.x) <= CLOSED * reach and abs(period - (slip.t - before.t)) <= CLOSED * period:
            return measure_orbit(flow, slip, phases, work)
        before, slip, phases = slip, state, []
    return Orbit("no cycle", f"the motion did not settle within {TURNS} turns"), unsampled


def measure_orbit(
    flow: MemoryFlow, slip: State, phases: list[tuple[int, State]], work: MemoryWork
) -> tuple[Orbit, Samples]:
    """Return the orbit of a closed turn, which began at ``slip``; its motion is that of the turn that follows."""
    end = phases[-1][1]
    period = end.t - slip.t
    times = [end.t + period * i / (POINTS - 1) for i in range(POINTS)]
    samples = Samples(times, [0.0] * POINTS, [0.0] * POINTS, [0.0] * POINTS, POINTS)
    state, reached = end, 0
    while reached < POINTS:
        kind, state, reached = sample_memory_phase(flow, state, times[-1], samples, reached, work)
        if kind >= modes.FORCE_REVERSAL:
            return Orbit(*modes.OUTCOMES[kind]), samples
    starts = [slip.t, *(at.t for _, at in phases)]
    t_stick = sum(at.t - t for (mode, at), t in zip(phases, starts, strict=False) if mode == modes.STICK)
    orbit = Orbit(
        "cycle",
        period=period,
        t_stick=t_stick,
        t_slip=period - t_stick,
        x_slip=end.x,
        x_stick=phases[-2][1].x,
        x_min=min(samples.x),
        x_max=max(samples.x),
        v_min=min(samples.v),
        v_max=max(samples.v),
        sequence="".join(modes.LETTERS[mode] for mode, _ in phases),
    )
    return orbit, samples
