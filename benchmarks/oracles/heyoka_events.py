"""Event lists by heyoka: Taylor series with events of another house, an oracle that shares nothing with the kernels.

Every phase, stick included, is an adaptive Taylor integration of its own equation, ended by a terminal event on what
bounds it (w, in stick the load).  A phase begins on an edge; its first `BLIND` of sqrt(m/k) is integrated without
events, so that the beginning is not found again: shorter phases are not seen.  One integrator per mode is compiled
once (about a second); `Rig` keeps them.

F. Biscani, D. Izzo: Revisiting high-order Taylor methods for astrodynamics and celestial mechanics, MNRAS 504 (2021).
"""

import math
import time

import heyoka as hy

from rig_sim.flow.flow import Flow
from rig_sim.friction.curve import HYPERBOLIC, LINEAR
from rig_sim.integrate.events import EventList

TOLERANCE = 1e-18
BLIND = 1e-4
EVENTS_ALLOWED = 100_000


class Rig:
    """One mass on a belt that runs forwards: its integrators, compiled."""

    def __init__(self, flow: Flow, tolerance: float = TOLERANCE) -> None:
        if not flow.v_belt > 0.0 or flow.droop != 0.0:
            raise ValueError("the oracle knows a rigid belt that runs forwards")
        self.flow = flow
        self.A = flow.Fs * flow.factor
        self.B = self.A * flow.static
        self.d = flow.d if flow.ramp else 0.0
        self.blind = BLIND * math.sqrt(flow.m / flow.k)
        begun = time.process_time()
        y, w = hy.make_vars("y", "w")
        u = w + flow.v_belt
        push = flow.u0 * hy.cos(flow.omega * hy.time + flow.phase) if flow.u0 != 0.0 else 0.0
        self.modes = {}
        up, down = hy.event_direction.positive, hy.event_direction.negative
        for mode in ("N", "P", "R" if self.d > 0.0 else "S"):
            if mode == "S":
                load = flow.k * y + flow.c * flow.v_belt - push
                equations = [(y, flow.v_belt + 0.0 * y), (w, 0.0 * w)]
                events = [hy.t_event(load - self.B, direction=up), hy.t_event(load + self.B, direction=down)]
            elif mode == "R":
                equations = [(y, u), (w, (-flow.c * u - flow.k * y - self.B / self.d * w + push) / flow.m)]
                events = [hy.t_event(w - self.d, direction=up), hy.t_event(w + self.d, direction=down)]
            else:
                sign = 1.0 if mode == "N" else -1.0
                s = -sign * w - self.d
                force = self.A
                if flow.curve == HYPERBOLIC:
                    force = self.A / (1.0 + flow.gamma * s)
                elif flow.curve == LINEAR:
                    force = self.A - flow.factor * flow.G_slip * s
                equations = [(y, u), (w, (-flow.c * u - flow.k * y + sign * force + push) / flow.m)]
                events = [hy.t_event(w + sign * self.d, direction=up if sign > 0.0 else down)]
            state = [0.0, 0.0]
            self.modes[mode] = (
                hy.taylor_adaptive(equations, state, tol=tolerance),
                hy.taylor_adaptive(equations, state, tol=tolerance, t_events=events),
            )
        self.compile_s = time.process_time() - begun

    def load(self, y: float, t: float) -> float:
        """Return what friction must hold in stick."""
        flow = self.flow
        return flow.k * y + flow.c * flow.v_belt - flow.u0 * math.cos(flow.omega * t + flow.phase)

    def first(self, y: float, w: float) -> str:
        """Return the mode of the start."""
        if self.d > 0.0:
            return "R" if abs(w) < self.d else "N" if w < 0.0 else "P"
        if w != 0.0:
            return "N" if w < 0.0 else "P"
        load = self.load(y, 0.0)
        return "N" if load > self.B else "P" if load < -self.B else "S"

    def events(self, x: float, v: float, t_max: float) -> EventList:
        """Return the events from t = 0 to t_max of a motion that starts at x with velocity v."""
        t, y, w = 0.0, x - self.flow.x0, v - self.flow.v_belt
        mode = self.first(y, w)
        found = []
        outcome = "completed"
        while t < t_max:
            begun = t
            side = 0
            for ta in self.modes[mode]:
                ta.time = t
                ta.state[:] = [y, w]
                if ta.with_events:
                    ta.reset_cooldowns()
                    reason = ta.propagate_until(t_max)[0]
                    side = -int(reason) if reason != hy.taylor_outcome.time_limit else 0
                else:
                    ta.propagate_until(min(begun + self.blind, t_max))
                t, (y, w) = ta.time, ta.state.tolist()
            if side == 0:
                break
            upper = mode == "N" or (mode != "P" and side == 1)
            was = mode
            if mode == "S":
                mode = "N" if upper else "P"
            elif mode == "R":
                mode = "P" if upper else "N"
            elif self.d > 0.0:
                mode = "R"
            elif mode == "N":
                mode = "P" if self.load(y, t) < -self.B else "S"
            else:
                mode = "N" if self.load(y, t) > self.B else "S"
            w = (self.d if upper else -self.d) if self.d > 0.0 else 0.0
            if "R" in (was, mode):
                w = -self.d if "N" in (was, mode) else self.d
            found.append((t, self.flow.x0 + y, f"{was}>{mode}".replace("R", "S")))
            if len(found) >= EVENTS_ALLOWED:
                outcome = "event limit"
                break
        times, places, kinds = zip(*found, strict=True) if found else ((), (), ())
        return EventList(times, places, kinds, outcome, "", len(found))
