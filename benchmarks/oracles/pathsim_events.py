"""Event lists by PathSim: a block diagram of the rig, with the zero-crossing events of that simulator.

Two integrators for position and slip speed, a source for the drive, a function block for the acceleration, and one zero
crossing whose function is what bounds the present mode: the slip speed in slip, the load in stick, both edges in a
ramp.  Its action changes the mode and puts the slip speed on the edge.  A mass that grazes the belt between the ends of
a step is not seen.

M. Rother: PathSim, a system simulation framework, J. Open Source Softw. (2025).
"""

import math
from typing import Any

import numpy as np
from pathsim import Connection, Simulation
from pathsim.blocks import Function, Integrator, Source
from pathsim.events import ZeroCrossing
from pathsim.solvers import RKDP87

from rig_sim.flow.flow import Flow
from rig_sim.friction.curve import HYPERBOLIC, LINEAR
from rig_sim.integrate.events import EventList

EVENT_TOLERANCE = 1e-13  # of the function that crosses 0: at 1e-15 a step of rounding never ends
LONGEST_STEP = 0.1  # of sqrt(m/k): PathSim sees a crossing between the ends of a step alone


class Rig:
    """One mass on a belt that runs forwards."""

    def __init__(self, flow: Flow, tolerance: float) -> None:
        if not flow.v_belt > 0.0 or flow.droop != 0.0:
            raise ValueError("the diagram knows a rigid belt that runs forwards")
        self.flow, self.tolerance = flow, tolerance
        self.A = flow.Fs * flow.factor
        self.B = self.A * flow.static
        self.d = flow.d if flow.ramp else 0.0

    def load(self, y: float, t: float) -> float:
        """Return what friction must hold in stick."""
        flow = self.flow
        return flow.k * y + flow.c * flow.v_belt - flow.u0 * math.cos(flow.omega * t + flow.phase)

    def friction(self, mode: str, w: float) -> float:
        """Return the friction on the mass."""
        if mode == "R":
            return -self.B / self.d * w
        flow, sign = self.flow, 1.0 if mode == "N" else -1.0
        s = -sign * w - self.d
        force = self.A
        if flow.curve == HYPERBOLIC:
            force = self.A / (1.0 + flow.gamma * s)
        elif flow.curve == LINEAR:
            force = self.A - flow.factor * flow.G_slip * s
        return sign * force

    def bound(self, mode: str, y: float, w: float, t: float) -> float:
        """Return a function that is 0 where the mode ends, and positive inside it."""
        if mode == "S":
            return self.B - abs(self.load(y, t))
        if mode == "R":
            return self.d - abs(w)
        return (-w if mode == "N" else w) - self.d

    def after(self, mode: str, y: float, w: float, t: float) -> tuple[str, float]:
        """Return the mode that follows, and the slip speed at its beginning."""
        if mode == "S":
            return ("N" if self.load(y, t) > 0 else "P"), 0.0
        if mode == "R":
            return ("P", self.d) if w > 0 else ("N", -self.d)
        if self.d > 0.0:
            return "R", -self.d if mode == "N" else self.d
        load = self.load(y, t)
        return ("S" if abs(load) <= self.B else "N" if load > 0 else "P"), 0.0

    def events(self, x: float, v: float, t_max: float) -> EventList:
        """Return the events from t = 0 to t_max of a motion that starts at x with velocity v."""
        flow = self.flow
        y, w = x - flow.x0, v - flow.v_belt
        slips = "N" if w < -self.d or (w == 0.0 and self.load(y, 0.0) > self.B) else "P"
        inside = abs(w) < self.d or (w == 0.0 and abs(self.load(y, 0.0)) <= self.B)
        mode = ("R" if self.d > 0.0 else "S") if inside else slips
        found: list[tuple[float, float, str]] = []

        def acceleration(y: float, w: float, push: float) -> float:
            if mode == "S":
                return 0.0
            u = w + flow.v_belt
            return (-flow.c * u - flow.k * y + self.friction(mode, w) + push) / flow.m

        def crossing(t: float) -> float:
            return self.bound(mode, *_states(place, speed), t)

        def act(t: float) -> None:
            nonlocal mode
            y, w = _states(place, speed)
            was = mode
            mode, w = self.after(mode, y, w, t)
            speed.engine.set(np.array([w]))
            found.append((t, flow.x0 + y, f"{was}>{mode}".replace("R", "S")))

        place, speed = Integrator(y), Integrator(w)
        belt, force = Function(lambda w: w + flow.v_belt), Function(acceleration)
        drive = Source(lambda t: flow.u0 * math.cos(flow.omega * t + flow.phase))
        simulation: Any = Simulation(
            [place, speed, belt, force, drive],
            [
                Connection(speed, belt, force[1]),
                Connection(belt, place),
                Connection(place, force[0]),
                Connection(drive, force[2]),
                Connection(force, speed),
            ],
            [ZeroCrossing(crossing, act, tolerance=EVENT_TOLERANCE)],
            dt=LONGEST_STEP * math.sqrt(flow.m / flow.k),
            dt_max=LONGEST_STEP * math.sqrt(flow.m / flow.k),
            Solver=RKDP87,
            tolerance_lte_abs=self.tolerance,
            tolerance_lte_rel=self.tolerance,
            log=False,
        )
        simulation.run(t_max)
        times, places, kinds = zip(*found, strict=True) if found else ((), (), ())
        return EventList(times, places, kinds, "completed", "", len(found))


def _states(*integrators: Integrator) -> list[float]:
    return [float(np.asarray(own.engine.state).item()) for own in integrators]
