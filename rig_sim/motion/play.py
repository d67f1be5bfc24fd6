"""Play a scene: the exact motion at requested times, and the events.

The integrator runs one phase at a time.  What changes the equation of motion between phases:

    belt.start          the belt steps from rest to its speed; the mass keeps its velocity
    joint               the mass's velocity steps by ``kick`` each time belt.length has passed since the belt's start
    wear, scatter       one factor on the whole friction curve, evaluated at each landing on the belt (entering stick or
                        the ramp; a stick of zero length is a landing too): (1 - rate t)(1 + Fs g), g drawn from the
                        normal distribution; never below `LEAST_FACTOR`; 1 until the first landing
    shaker              tuned again to friction's slope at each such landing; off before belt.start

Random numbers come from one stream per effect, seeded by the scene's ``seed`` and the effect's name, so that adding an
effect does not change the numbers of another one.

The belt's compliance (droop) is part of the flow (`rig_sim.flow.modes`), and so is its ripple, in coordinates that
swing with the belt (`rig_sim.effects.ripple`).  Not modelled: creep in stick; the joint passes as on a belt without
ripple.
"""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rig_sim.flow import modes
from rig_sim.flow.contact_state import force, initial_mode
from rig_sim.flow.flow import Flow, steepest_fall
from rig_sim.flow.memory import MemoryFlow
from rig_sim.friction.curve import MEASURED
from rig_sim.integrate import memory
from rig_sim.integrate.events import EventList, list_events
from rig_sim.integrate.phases import Samples, State, sample_phase
from rig_sim.integrate.work import Buffer, new_work
from rig_sim.scenes.model import Scene
from stickslip.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rig_sim.effects.ripple import SwingingBelt
    from rig_sim.motion.trajectory import Trajectory

DEFAULT_MAX_STEPS = 1_000_000
INTERPRETED_STEPS = 50_000  # 1 to 2 s of CPU; a motion that takes more is restarted in compiled code
MOST_NODES = 10_000_000  # of one stretch of motion that an encoder reads: 80 MB a column
MOST_EVENTS = 1_000_000  # of a list: repeated cycles are listed without integrator steps
SamplePhase = Callable[..., Any]  # the signature of `rig_sim.integrate.phases.sample_phase`
LEAST_FACTOR = 0.05  # share of Fs: lower limit of the factor; scatter of 30 % reaches it at 3.2 standard deviations


@dataclass(frozen=True, slots=True)
class Event:
    """At time t (s) and position x (m) the mass passed from one kind of contact to another.

    ``kind`` is 'N>S', 'S>N', 'N>P' ...: N slip slower than the belt, P faster, S stick or ramp; 'kick' where the belt's
    joint passed.
    """

    t: float
    x: float
    kind: str


AnyEvent = TypeVar("AnyEvent")


@dataclass(frozen=True)
class Events(Generic[AnyEvent]):
    """The events of one run, in order, and its end.

    ``outcome`` is 'completed' or the reason why it ended early, with ``advice``; ``steps`` counts the integrator's
    steps.
    """

    events: tuple[AnyEvent, ...]
    outcome: str
    advice: str
    steps: int


class ScenePlayer:
    """Plays a scene forwards in time: the state of the mass, and what changes between phases.

    ``max_steps`` integrator steps end the motion with the outcome 'step limit'.
    """

    def __init__(self, scene: Scene, *, max_steps: float = math.inf, phases: SamplePhase = sample_phase) -> None:
        self.scene = scene
        self.t = 0.0  # s
        self.outcome: modes.Outcome = modes.OUTCOMES[modes.COMPLETED]
        self.events: list[Event] | None = None  # set to a list to collect the events
        self._has_memory = scene.has_memory()
        if self._has_memory and phases is not sample_phase:
            problem = "has a friction law with memory, which this method does not support"
            raise InputError(problem, f"scene {scene.name}", "use the method exact")
        self._make_flow = scene.memory_flow if self._has_memory else scene.flow
        self._phases: SamplePhase = memory.sample_memory_phase if self._has_memory else phases
        self.flow: Flow | MemoryFlow = self._make_flow(belt_running=not (scene.belt and scene.belt.start > 0))
        self._belt_waits = scene.belt is not None and scene.belt.start > 0
        self._swing: SwingingBelt | None = None
        self._store_state(float(scene.start.x), float(scene.start.v))
        # Of this stretch, each with the number of corners before it
        self._flows: list[tuple[int, Flow | MemoryFlow]] = []
        self._kicks = 0
        self._scatter = random.Random(f"{scene.seed}/scatter")
        self._landings_matter = scene.wear is not None or scene.scatter is not None
        self._work: Any = memory.new_memory_work(max_steps) if self._has_memory else new_work(max_steps)
        self._mode = self._classify()

    @property
    def x(self) -> float:
        """Position of the mass, m."""
        return self._xi if self._swing is None else self._xi + self._swing.position(self.t)

    @property
    def v(self) -> float:
        """Velocity of the mass, m/s."""
        v = self._w + self.flow.v_belt
        return v if self._swing is None else v + self._swing.speed(self.t)

    def _classify(self) -> int:
        v = self._w + self.flow.v_belt
        if isinstance(self.flow, MemoryFlow):
            return memory.initial_mode(self.flow, v)
        return initial_mode(self.flow, self._xi, v, self.t)

    def _store_state(self, x: float, v: float) -> None:
        """Store the state in the coordinates of the present flow: on a belt that ripples, those that swing with it.

        The relative velocity w is kept, not v: on a ramp's edge it is d to the last bit.
        """
        belt = self.scene.belt
        if belt is not None and belt.ripple and not self._belt_waits:
            self._swing = belt.swing()
            x, v = x - self._swing.position(self.t), v - self._swing.speed(self.t)
        self._xi, self._w = x, v - self.flow.v_belt

    @property
    def steps(self) -> int:
        return int(self._work.steps)

    def advance(self, until: float) -> bool:
        """Play up to a time (s) and return whether the motion continues there."""
        self._play([until], [])
        return self.outcome.name == modes.OUTCOMES[modes.COMPLETED].name

    def follow(self, instants: "NDArray[np.float64]", *, forces: bool = False) -> "Trajectory":
        """Play through increasing times (s, from ``t`` itself on) and return the motion; ``forces`` adds friction."""
        import numpy as np

        from rig_sim.motion.trajectory import Nodes, Trajectory

        times, sample_indices = refine_times(np.concatenate(([self.t], instants)), self._node_spacing())
        requested: list[float] = times.tolist()
        corners: list[tuple[int, float, float, float]] = []
        self._flows = [(0, self.flow)]
        x, v, F, reached = self._play(requested, corners, forces=forces)
        before = np.array([corner[0] for corner in corners], dtype=np.int64)
        t_corner, x_corner, v_corner = np.array([corner[1:] for corner in corners], dtype=np.float64).reshape(-1, 3).T
        nodes = Nodes(
            np.maximum.accumulate(np.insert(times[:reached], before, t_corner)),
            np.insert(np.array(x[:reached]), before, x_corner),
            np.insert(np.array(v[:reached]), before, v_corner),
        )
        reached_samples = sample_indices[1:][sample_indices[1:] < reached]
        friction = np.array(F)[reached_samples] if forces else np.empty(0)
        flows = tuple((int(before[corner - 1]) + corner - 1 if corner else 0, flow) for corner, flow in self._flows)
        return Trajectory(
            nodes, reached_samples + np.searchsorted(before, reached_samples, side="right"), friction, flows
        )

    def columns(self, instants: "NDArray[np.float64]") -> "tuple[NDArray[np.float64], ...]":
        """Play through increasing times (s) and return t, x, v, F there, each (n,): fewer where the motion ends."""
        path = self.follow(instants, forces=True)
        samples = path.samples
        return path.nodes.t[samples], path.nodes.x[samples], path.nodes.v[samples], path.F

    def _play(
        self,
        times: Sequence[float],
        corners: list[tuple[int, float, float, float]],
        *,
        forces: bool = False,
    ) -> tuple[Buffer, Buffer, Buffer, int]:
        """Play through ``times``; return x, v, F there and how many were reached.

        Each event appends (number of times before it, t, x, v) to ``corners``; a kick appends two.
        """
        n = len(times)
        samples, reached = Samples(times, [0.0] * n, [0.0] * n, [0.0] * n, n), 0
        while self.outcome.name == modes.OUTCOMES[modes.COMPLETED].name:
            end = min(times[-1], self._next_change())
            if self._has_memory and self.steps > INTERPRETED_STEPS and isinstance(samples.x, list):
                self._phases, self._work, samples = memory.compile_phases(self._work, samples)
            first, previous_mode = reached, self._mode
            x, v, F = samples.x, samples.v, samples.mode
            state = State(previous_mode, self._xi, self._w, self.t)
            kind, state, reached = self._phases(self.flow, state, end, samples, reached, self._work)
            self._mode, self._xi, self._w, self.t, _ = state
            if forces and isinstance(self.flow, Flow):
                for i in range(first, reached):
                    F[i] = force(self.flow, previous_mode, x[i], v[i] - self.flow.v_belt, times[i])
            if self._swing is not None:
                for i in range(first, reached):
                    x[i] += self._swing.position(times[i])
                    v[i] += self._swing.speed(times[i])
            if kind >= modes.FORCE_REVERSAL:
                self.outcome = modes.OUTCOMES[kind]
            elif kind != modes.COMPLETED:
                corners.append((reached, self.t, self.x, self.v))
                self._record_event(modes.KINDS[kind])
                if self._landings_matter and self._mode in (modes.STICK, modes.RAMP):
                    self._set_factor(self._draw_factor())
                    self._flows.append((len(corners), self.flow))
            elif self.t >= self._next_change():
                self._apply_change(reached, corners)
            elif reached == n:
                break
        return samples.x, samples.v, samples.mode, reached

    def _next_change(self) -> float:
        """Return the time (s) of the belt's start or of the joint's next passage."""
        belt = self.scene.belt
        if belt is None:
            return math.inf
        if self._belt_waits:
            return belt.start
        if self.scene.joint is None or belt.length is None or belt.speed == 0.0:
            return math.inf
        return belt.start + (self._kicks + 1) * belt.length / abs(belt.speed)

    def _apply_change(self, reached: int, corners: list[tuple[int, float, float, float]]) -> None:
        """Start the belt, or kick the mass."""
        corners.append((reached, self.t, self.x, self.v))
        previous_mode = self._mode
        if self._belt_waits:
            self._belt_waits = False
            x, v = self.x, self.v
            self._set_flow(self.flow.factor)
            self._flows.append((len(corners), self.flow))
            self._store_state(x, v)
        elif self.scene.joint is not None:
            self._kicks += 1
            self._w += self.scene.joint.kick
            corners.append((reached, self.t, self.x, self.v))
            self._record_event("kick")
        self._mode = self._classify()
        if modes.LETTERS[self._mode] != modes.LETTERS[previous_mode]:
            self._record_event(f"{modes.LETTERS[previous_mode]}>{modes.LETTERS[self._mode]}")

    def _set_factor(self, factor: float) -> None:
        """Set the factor on the friction curve, and tune the shaker to it again."""
        if self.scene.shaker is None:
            self.flow = self.flow._replace(factor=factor)
        else:
            self._set_flow(factor)

    def _set_flow(self, factor: float) -> None:
        """Build the flow with this factor; a shaker that cannot be tuned to it ends the motion."""
        try:
            self.flow = self._make_flow(belt_running=not self._belt_waits, factor=factor)
        except ValueError as error:
            self.outcome = modes.Outcome("shaker out of tune", f"{error}; reduce shaker.a, wear or scatter")

    def _draw_factor(self) -> float:
        """Return the factor on the friction curve from this landing on."""
        factor = 1.0
        if self.scene.wear is not None:
            factor = 1.0 - self.scene.wear.rate * self.t
        if self.scene.scatter is not None:
            factor *= 1.0 + self._scatter.gauss(0.0, self.scene.scatter.Fs)
        return max(LEAST_FACTOR, factor)

    def _record_event(self, kind: str) -> None:
        if self.events is not None:
            self.events.append(Event(self.t, self.x, kind))

    def _node_spacing(self) -> float:
        """Return the spacing of nodes (s) at which the cubic between them is much finer than an encoder's count."""
        if self.scene.encoder is None:
            return math.inf
        if isinstance(self.flow, MemoryFlow):  # a jump of the force within a node's step moves x by a 64th of a count
            jump = math.sqrt(self.scene.encoder.metres_per_count * self.flow.m / max(self.flow.Fs, self.flow.F0))
            return min(0.05 * math.sqrt(self.flow.m / self.flow.k), jump)
        rate = math.sqrt(self.flow.k / self.flow.m) + (self.flow.gamma * self.flow.Fs + self.flow.G_slip) / self.flow.m
        if self.flow.curve == MEASURED:
            rate += steepest_fall(self.flow) * self.flow.Fs / self.flow.m
        if self._swing is not None:
            rate += self.flow.omega
        return 0.05 / rate


def refine_times(times: "NDArray[np.float64]", spacing: float) -> "tuple[NDArray[np.float64], NDArray[np.int64]]":
    """Return times with points inserted where gaps exceed ``spacing``, and the indices of the given times."""
    import numpy as np

    gaps = np.diff(times)
    counts = np.maximum(1, np.ceil(gaps / spacing))
    if not counts.sum() <= MOST_NODES:
        problem = f"the motion changes within {spacing:.2g} s, which is too fast for steps of {gaps.max():.2g} s"
        raise InputError(problem, "scene", "increase mass.m, or reduce spring.k, friction.Fs or friction.gamma")
    parts = counts.astype(np.int64)
    indices = np.concatenate(([0], np.cumsum(parts)))
    if indices[-1] == len(gaps):
        return times, indices
    within = np.arange(indices[-1]) - np.repeat(indices[:-1], parts)
    fine = np.repeat(times[:-1], parts) + np.repeat(gaps / parts, parts) * within
    return np.append(fine, times[-1]), indices


def events(scene: Scene, until: float, *, since: float = 0.0, max_steps: int = DEFAULT_MAX_STEPS) -> Events[Event]:
    """Return when and where the mass sticks and slips, from t = 0 to ``until`` (s); only those from ``since`` on.

    A motion that repeats bit for bit is integrated once and its cycle listed again and again: at most `MOST_EVENTS`
    events, then the outcome is 'event limit'.
    """
    if not (math.isfinite(until) and until > 0):
        raise InputError(f"is {until:g}", "--until", "use a positive number")
    if not math.isfinite(since):
        raise InputError(f"is {since:g}", "--since", "use a number")
    if max_steps < 1:
        raise InputError(f"is {max_steps}", "--max-steps", "use a positive number")
    if is_flow_constant(scene):
        x, v = float(scene.start.x), float(scene.start.v)
        list_run = partial(list_events, scene.flow(), x, v, until, since=since, max_events=MOST_EVENTS)
        run = list_run(max_steps=min(max_steps, INTERPRETED_STEPS))
        if run.outcome == modes.OUTCOMES[modes.STEP_LIMIT].name and max_steps > INTERPRETED_STEPS:
            run = list_run(max_steps=max_steps, compiled=True)  # the same list, from the same source
    else:
        run = play_events(scene, until, max_steps=max_steps)
    kept = (Event(t, x, kind) for t, x, kind in zip(run.t, run.x, run.kinds, strict=True) if t >= since)
    return Events(tuple(kept), run.outcome, run.advice, run.steps)


def play_events(scene: Scene, until: float, phases: SamplePhase = sample_phase, *, max_steps: float) -> EventList:
    """Return the events from t = 0 to ``until`` (s), phase by phase, by any method; ``phases`` as for `ScenePlayer`."""
    player = ScenePlayer(scene, max_steps=max_steps, phases=phases)
    player.events = []
    player.advance(until)
    events = player.events
    return EventList(
        tuple(event.t for event in events),
        tuple(event.x for event in events),
        tuple(event.kind for event in events),
        player.outcome.name,
        player.outcome.advice,
        player.steps,
    )


def is_flow_constant(scene: Scene) -> bool:
    """Return whether nothing changes the flow between events: one call of the integrator then plays the whole run."""
    effects = (scene.wear, scene.scatter, scene.joint)
    belt_changes = scene.belt is not None and (scene.belt.start > 0 or bool(scene.belt.ripple))
    return all(effect is None for effect in effects) and not belt_changes and not scene.has_memory()
