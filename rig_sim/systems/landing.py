"""The map of a driven mass from one landing on the belt to the next; the drive's amplitude is its control parameter.

A landing is a passage from slip to stick, of a ramp law into the ramp from its slower edge.  Its state is the phase of
the drive, as a time (s) within the drive's period, and the position (m): both are needed, since the position at
break-away alone has two phases.  The amplitude u0 (N) is the parameter that the thesis perturbs; a change holds from
one landing to the next.
"""

import math
from dataclasses import dataclass

import numpy as np

from rig_sim.flow import modes
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow, validate
from rig_sim.flow.frame import frame
from rig_sim.integrate.compiled import compiled, for_kernels
from rig_sim.integrate.events import new_lists
from rig_sim.integrate.phases import Lists, State, run
from rig_sim.integrate.sampled import sample_motion
from rig_sim.integrate.work import Work, new_work, unboxed
from rig_sim.systems.formula import FormulaMap
from rig_sim.systems.interface import StepBudget
from stickslip.compute.arrays import Array

# Integrator steps between two landings, 0.5 us each; the thesis's motions take 15.  A motion that takes more counts as
# one that does not land.
STEPS_OF_LANDING = 20_000
OSCILLATIONS = 1000.0  # of the mass alone, plus the longest stick, within which it has to land
# Steps added for each application of the map, for the 30 us of its call.
STEPS_OF_CALL = 60
LANDED = -1  # an outcome of the kernel


@dataclass(frozen=True)
class Landing:
    """The motion from a state to the next landing."""

    state: Array  # (2,) time within the drive's period (s) and position (m) at the landing; NaN without one
    duration: float  # s
    x_slip: float  # position of the last break-away before, m (the thesis's X_A)
    outcome: str  # 'completed'; 'no landing'; or how the integrator ended


class LandingMap(FormulaMap):
    """The map from landing to landing of a driven mass: a `Controlled` system of two numbers.

    The scales are the drive's period (s) and the largest stretch (m), the strength is u0.  Without a budget the
    integrator steps of all applications are not limited.
    """

    def __init__(self, flow: Flow, *, budget: StepBudget | None = None) -> None:
        validate(flow)
        if flow.u0 == 0.0 or flow.omega == 0.0:
            raise ValueError("has no drive whose amplitude could be controlled")
        fr = frame(flow)
        self.flow = flow
        self._compiled_flow = for_kernels(flow)
        self.period = 2.0 * math.pi / abs(flow.omega)
        strength = abs(flow.u0)
        size = (fr.B + strength) / fr.k
        scale = [self.period, size + fr.v / fr.omega0]
        super().__init__(scale, turn=[self.period, math.inf], strength=strength)
        stick = 2.0 * (size + strength / fr.k) / fr.v if fr.v > 0.0 else 0.0
        self._horizon = stick + OSCILLATIONS * 2.0 * math.pi / fr.omega0 + self.period
        self._mode = modes.RAMP if fr.d > 0.0 else modes.STICK
        self._edge = -fr.mirror * fr.d
        self._behind = modes.NEGATIVE if fr.mirror > 0.0 else modes.POSITIVE
        self._budget = budget or StepBudget(math.inf)
        self._one = new_lists(1, compiled=True)
        self._work = new_work(STEPS_OF_LANDING, compiled=True)

    def step(self, state: Array, change: float = 0.0) -> tuple[Array, None, float]:
        """Return the next landing, (2,), with u0 changed by ``change`` (N), and the drive periods to it; NaN without.

        Raises StepLimitError when the budget is spent.
        """
        if self._budget.left <= 0.0:
            raise self._budget.limit_error("map of landings", "apply the map less often")
        landing = self.find_landing(state, change)
        self._budget.left -= self._steps + STEPS_OF_CALL
        return landing.state, None, landing.duration / self.period

    def find_landing(self, state: Array, change: float = 0.0) -> Landing:
        return self._follow_to_landing(State(self._mode, state[1], self._edge, state[0] % self.period), change)

    def first_landing(self, x: float, v: float) -> Landing:
        """Return the first landing of a motion that starts at x (m) with velocity v (m/s) at phase 0."""
        return self._follow_to_landing(State(initial_mode(self.flow, x, v, 0.0), x, v - self.flow.v_belt, 0.0), 0.0)

    def _follow_to_landing(self, state: State, change: float) -> Landing:
        flow = self._compiled_flow._replace(u0=self.flow.u0 + change)
        end = state.t + self._horizon
        follow = compiled(next_landing, __name__)
        outcome, end_state, x_slip, self._steps = follow(flow, state, end, self._behind, self._one, self._work)
        if outcome != LANDED:
            name = modes.OUTCOMES[outcome].name
            reason = "no landing" if outcome in (modes.COMPLETED, modes.STEP_LIMIT) else name
            return Landing(np.full(2, np.nan), math.nan, x_slip, reason)
        landed_state = np.array([(end_state.t + end_state.carry) % self.period, end_state.x])
        return Landing(landed_state, end_state.t - state.t, x_slip, "completed")

    def sample_motion(self, states: Array, changes: Array, rate: float) -> tuple[Array, Array, Array]:
        """Return time (s, from the first landing), x (m) and v (m/s) of a motion under control, (n,) each.

        Starts at the landings ``states``, (n, 2), and changes u0 by ``changes`` (N) from each to the next; ``rate``
        samples per second, and every landing.
        """
        time = 0.0
        pieces = []
        for state, change in zip(states, changes, strict=True):
            times, x, v = self._sample_flight(state, float(change), rate)
            pieces.append((time + times, x, v))
            time += times[-1]
        t, x, v = (np.concatenate([piece[i] for piece in pieces] or [np.zeros(0)]) for i in range(3))
        return t, x, v

    def _sample_flight(self, state: Array, change: float, rate: float) -> tuple[Array, Array, Array]:
        """Return times since a landing, x and v up to the next one, both landings included."""
        start = state[0] % self.period
        times = np.append(np.arange(0.0, duration := self.find_landing(state, change).duration, 1.0 / rate), duration)
        flow = self.flow._replace(u0=self.flow.u0 + change)
        x, v = sample_motion(flow, State(self._mode, float(state[1]), self._edge, float(start)), start + times)
        if len(x) < len(times):
            raise RuntimeError("the motion ended before it landed")
        return times, x, v


def next_landing(
    flow: Flow, state: State, end: float, slow_mode: int, event_list: Lists, work: Work
) -> tuple[int, State, float, float]:
    """Follow the motion event by event to the next landing, or to ``end`` (s).

    A ramp is entered at a landing from ``slow_mode``, that of a mass slower than the belt.  ``event_list`` has
    room for one event.  Returns `LANDED`, or how the motion ended; the state there; the last break-away (m, or NaN);
    steps taken.
    """
    work = unboxed(work)
    work.steps = 0.0
    work.rapid = 0.0
    x_slip = math.nan
    while True:
        before = state.mode
        outcome, count, _, state = run(flow, state, end, event_list, 0, work)
        if outcome != modes.LIST_FULL or count == 0:
            return outcome, state, x_slip, work.steps
        if before == modes.STICK or before == modes.RAMP:
            x_slip = state.x
        elif state.mode == modes.STICK or (state.mode == modes.RAMP and before == slow_mode):
            return LANDED, state, x_slip, work.steps
