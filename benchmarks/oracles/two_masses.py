"""Two masses by scipy: DOP853 between events that its own root finder locates; a peer for tests and benchmarks."""

import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from rig_sim.flow.two_mass import TwoMassFlow, slip_start
from rig_sim.friction.curve import magnitude

LONGEST = 100.0  # sqrt(m/k) between two events, after which there is none
MOST_CHANGES = 50  # landings and break-aways of an event, after which no global stick follows


def next_stick(flow: TwoMassFlow, d: float, *, rtol: float = 1e-12) -> tuple[float, str, float]:
    """Return (d, word, duration) of the event that follows a global stick of stretch ``d`` (m).

    As `rig_sim.systems.stick.StickMap.event`: NaN where no global stick follows within `LONGEST` or
    `MOST_CHANGES`.
    """
    mass = flow.mass
    belt = mass.v_belt
    stiffness = mass.k * np.array([[1.0 + flow.a, -flow.a], [-flow.a, 1.0 + flow.a]])
    levels = mass.Fs * mass.factor * np.array([1.0, flow.b])
    x = np.array(slip_start(flow, d))
    state = np.array([*x, belt, belt])
    load = stiffness @ (x - mass.x0) + mass.c * belt
    signs = [0, 0]  # of the friction; 0: stick
    excess = np.abs(load) - mass.static * levels
    breaking = int(np.argmax(excess))
    signs[breaking] = int(np.sign(load[breaking]))
    word, t = str(breaking + 1), 0.0

    def motion(_: float, s: Any) -> Any:
        accelerations = [0.0, 0.0]
        loads = stiffness @ (s[:2] - mass.x0) + mass.c * s[2:]
        for i in (0, 1):
            if signs[i]:
                slip = abs(s[2 + i] - belt)
                strength = magnitude(mass.curve, slip, 1.0, mass.G_slip / mass.Fs, mass.gamma)
                accelerations[i] = (signs[i] * levels[i] * strength - loads[i]) / mass.m
        return [s[2], s[3], *accelerations]

    def load_of(i: int, s: Any) -> float:
        return float((stiffness @ (s[:2] - mass.x0))[i] + mass.c * belt)

    def watch(event: Any) -> Any:
        event.terminal, event.direction = True, 1
        return event

    def landing(i: int) -> Any:
        return watch(lambda _, s: signs[i] * (s[2 + i] - belt))

    def break_away(i: int) -> Any:
        return watch(lambda _, s: abs(load_of(i, s)) - mass.static * levels[i])

    for _change in range(MOST_CHANGES):
        watched = [landing(i) if signs[i] else break_away(i) for i in (0, 1)]
        # past the instant at which slip has begun and its relative velocity is still 0
        begun = solve_ivp(motion, (t, t + 1e-4), state, method="DOP853", rtol=rtol, atol=rtol)
        run = solve_ivp(
            motion,
            (t + 1e-4, t + LONGEST),
            begun.y[:, -1],
            method="DOP853",
            rtol=rtol,
            atol=rtol,
            events=watched,
        )
        fired = [i for i, times in enumerate(run.t_events or []) if len(times)]
        if not fired:
            return math.nan, word, math.nan
        t, state, i = float(run.t[-1]), run.y[:, -1].copy(), fired[0]
        if signs[i]:
            state[2 + i] = belt
            load_now = load_of(i, state)
            signs[i] = int(np.sign(load_now)) if abs(load_now) > mass.static * levels[i] else 0
        else:
            signs[i] = int(np.sign(load_of(i, state)))
            word += str(i + 1)
        if signs == [0, 0]:
            return float(state[1] - state[0]), word, t
    return math.nan, word, math.nan
