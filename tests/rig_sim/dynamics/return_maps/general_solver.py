"""The driven mass followed by scipy, from event to event: a peer that shares nothing with the maps."""

import math
import sys
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from rig_sim.flow.flow import Flow
from rig_sim.friction.curve import CONSTANT, LINEAR


def follow_by_scipy(
    flow: Flow, x: float, v: float, until: float, t: float = 0.0, landings: int = sys.maxsize
) -> tuple[Any, Any, Any]:
    """Return (t, x) of each break-away and of each landing, and (x, v) at phase 0: laws 1, 3, 5 with static 1."""
    belt, period = flow.v_belt, 2.0 * math.pi / flow.omega

    def drive(t):
        return flow.u0 * math.cos(flow.omega * t)

    def friction(s):
        return {CONSTANT: flow.Fs, LINEAR: flow.Fs - flow.G_slip * s}.get(flow.curve, flow.Fs / (1.0 + flow.gamma * s))

    def slip(side):
        def field(t, y):
            pull = side * friction(max(side * (belt - y[1]), 0.0))
            return [y[1], (pull + drive(t) - flow.c * y[1] - flow.k * y[0]) / flow.m]

        return field

    def event(function, direction=1.0):
        function.terminal, function.direction = True, direction
        return function

    broken, landed, strobes = [], [], {}
    load = flow.k * x + flow.c * v - drive(t)
    side = 0 if v == belt and abs(load) <= flow.Fs else (1 if v < belt or (v == belt and load > 0.0) else -1)
    while t < until and len(landed) < landings:
        if side == 0:
            fields = lambda t, y: [belt, 0.0]  # noqa: E731
            ends = [event(lambda t, y: abs(flow.k * y[0] + flow.c * belt - drive(t)) - flow.Fs)]
            first = 0.0
        else:
            fields = slip(side)
            ends = [event(lambda t, y, side=side: side * (y[1] - belt))]
            first = 1e-6  # past the instant at which slip has begun and its relative velocity is still 0
        state = [x, belt] if side == 0 else [x, v]
        settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12, "dense_output": True, "max_step": 0.2}
        if first:
            state = solve_ivp(fields, (t, t + first), state, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        run = solve_ivp(fields, (t + first, until), state, events=ends, **settings)
        for n in range(math.ceil((t + first) / period), math.floor(run.t[-1] / period) + 1):
            strobes[n] = run.sol(n * period)
        t, (x, v) = float(run.t[-1]), (float(run.y[0, -1]), float(run.y[1, -1]))
        if run.status == 0:
            break
        load = flow.k * x + flow.c * belt - drive(t)
        if side == 0:
            broken.append((t, x))
            side = 1 if load > 0.0 else -1
        else:
            landed.append((t, x))
            side = 0 if abs(load) <= flow.Fs else int(math.copysign(1.0, load))
        v = belt
    return np.array(broken), np.array(landed), np.array([strobes[n] for n in sorted(strobes) if n > 0])
