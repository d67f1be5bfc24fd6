"""Error against run time: every method on one scene, measured against an independent reference.

The error of a method is the largest difference of an event time.  CPU time is that of this process, the minimum of
several runs where one is short; compilation is reported separately.  The exact method steps through every cycle.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from rig_sim.comparison import reference
from rig_sim.comparison.rk4_henon import make_rk4_solver
from rig_sim.comparison.solve_ivp import make_ivp_solver
from rig_sim.comparison.stepping import sample_phase
from rig_sim.integrate.events import EventList, list_events
from rig_sim.motion.play import is_flow_constant, play_events
from rig_sim.scenes.model import Scene
from stickslip.errors import InputError

METHODS = ("exact", "rk4-henon", "dop853", "radau", "lsoda")
RK4_STEPS = (0.1, 0.03, 0.01, 0.003)  # of sqrt(m/k)
DOP853_RTOL = (1e-6, 1e-9, 1e-12, 2.3e-14)
STIFF_RTOL = (1e-6, 1e-9)
MOST_STEPS = 10**8
LONGEST = 2000  # periods of the oscillator: the slowest method takes a few minutes
LONG_ENOUGH_S = 0.5  # CPU time: a run is repeated until the sum exceeds it; 0: each runs once
NO_REFERENCE = (
    "the most accurate other method; the multi-precision reference does not cover droop or an equation of "
    "motion that changes between events, and such scenes are simulated with the interpreted method"
)
LAST = 1e-6  # share of the time span: an event this near its end may be missing from a list


@dataclass(frozen=True)
class MethodResult:
    """One method at one setting.

    ``error`` is in the scene's unit of time; None when the list of events differs (``note`` says where);
    ``us_per_cycle`` is per start of slip out of stick or ramp in the reference.
    """

    method: str
    setting: str
    error: float | None
    cpu_s: float
    us_per_cycle: float | None
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """The rows, their reference, and the CPU time of compiling (s; of loading, when it was cached)."""

    results: tuple[MethodResult, ...] = field(repr=False)
    reference: str
    compile_s: float
    cycles: int


Run = Callable[[], EventList]


def compare(
    scene: Scene,
    until: float,
    *,
    methods: Sequence[str] = METHODS,
    progress: Callable[[float], None] = lambda share: None,
) -> Comparison:
    """Run every method on a scene from t = 0 to ``until`` and return errors and CPU times.

    ``progress`` is called before each run with the percentage done.
    """
    if not (math.isfinite(until) and until > 0):
        raise InputError(f"is {until:g}", "--until", "use a positive number")
    for method in methods:
        if method not in METHODS:
            raise InputError(f"unknown method {method!r}", "methods", f"use some of {', '.join(METHODS)}")
    if scene.has_memory():
        scene.flow()  # says what covers such a scene
    swing = 2.0 * math.pi * math.sqrt(scene.mass.m / scene.spring.k)
    if until > LONGEST * swing:
        problem = (
            f"is {until:g}, {until / swing:.3g} periods of the mass, which is too long because every method steps "
            "through all of them"
        )
        raise InputError(problem, "--until", f"use {LONGEST * swing:.4g} ({LONGEST} periods) or less")
    is_constant = is_flow_constant(scene) and scene.droop is None
    runs = list_runs(scene, until, methods, is_constant)
    compile_s = measure_compilation(scene) if is_constant and "exact" in methods else 0.0
    measured = []
    for number, (method, setting, run) in enumerate(runs):
        progress(100.0 * number / (len(runs) + 1))  # the reference is the last
        measured.append((method, setting, *time_run(run)))
    progress(100.0 * len(runs) / (len(runs) + 1))
    expected, description = compute_reference(scene, until) if is_constant else ([], NO_REFERENCE)
    lists = {(method, setting): events for method, setting, events, _ in measured}
    if not (expected or next(iter(lists.values())).t):
        raise InputError("no event", "--until", "use a longer time")
    rows = []
    cycles = 0
    peers = {} if expected else {method: find_tightest(lists, method, until) for method in dict.fromkeys(methods)}
    if not expected:
        description += describe_peers(peers)
    for method, setting, events, cpu_s in measured:
        expected_events = expected or pair_events(lists[peers[method]])
        cycles = sum(kind[:2] == "S>" for _, kind in expected_events)
        error, note = difference(events, expected_events, until)
        rows.append(MethodResult(method, setting, error, cpu_s, 1e6 * cpu_s / cycles if cycles else None, note))
    return Comparison(tuple(rows), description, compile_s, cycles)


def list_runs(scene: Scene, until: float, methods: Sequence[str], is_constant: bool) -> list[tuple[str, str, Run]]:
    """Return (method, setting, run) of all runs to measure.

    The exact method lists the events of a constant flow in one call, interpreted and compiled; everything else is
    played phase by phase.
    """
    unit = math.sqrt(scene.mass.m / scene.spring.k)
    play = partial(play_events, scene, until, max_steps=MOST_STEPS)
    runs: list[tuple[str, str, Run]] = []
    for method in methods:
        if method == "exact" and is_constant:
            x, v = float(scene.start.x), float(scene.start.v)
            exact = partial(list_events, scene.flow(), x, v, until, every_cycle=True, max_steps=MOST_STEPS)
            runs += [(method, "interpreted", exact), (method, "compiled", partial(exact, compiled=True))]
        elif method == "exact":
            runs.append((method, "interpreted", play))
        elif method == "rk4-henon":
            solvers = {f"h {h:g}": make_rk4_solver(h * unit) for h in RK4_STEPS}
            runs += [(method, name, partial(play, partial(sample_phase, by))) for name, by in solvers.items()]
        else:
            tolerances = DOP853_RTOL if method == "dop853" else STIFF_RTOL
            solvers = {f"rtol {rtol:g}": make_ivp_solver(method, rtol, dense=False) for rtol in tolerances}
            runs += [(method, name, partial(play, partial(sample_phase, by))) for name, by in solvers.items()]
    return runs


def measure_compilation(scene: Scene) -> float:
    """Compile the exact method's kernel, or load it, and return the CPU seconds that took."""
    started = time.process_time()
    list_events(scene.flow(), float(scene.start.x), float(scene.start.v), 1e-9, compiled=True)
    return time.process_time() - started


def time_run(run: Run) -> tuple[EventList, float]:
    """Return the events of a run, and its CPU seconds: the least over the repeats within `LONG_ENOUGH_S`."""
    least = math.inf
    spent = 0.0
    while spent <= LONG_ENOUGH_S:
        started = time.process_time()
        events = run()
        duration = time.process_time() - started
        least = min(least, duration)
        spent += duration
    return events, least


def compute_reference(scene: Scene, until: float) -> tuple[list[tuple[Any, str]], str]:
    try:
        events = reference.events(scene.flow(), float(scene.start.x), float(scene.start.v), until)
    except reference.Uncovered as why:
        return [], f"the most accurate other method; the multi-precision reference does not cover {why}"
    return [(t, kind) for t, kind, _ in events], f"Taylor series in {reference.DIGITS}-digit arithmetic (mpmath)"


Lists = dict[tuple[str, str], EventList]  # by method and setting
BY_TIGHTNESS = ("exact", "dop853", "lsoda", "radau", "rk4-henon")


def find_tightest(lists: Lists, method: str, until: float) -> tuple[str, str]:
    """Return the tightest method that is not ``method``, with its setting, of those with the events of the tightest.

    A list with other events is no reference, however tight: a solver may find a landing twice.
    """
    keys = sort_by_tightness(lists)
    others = [key for key in keys if key[0] != method]
    if not others:
        raise InputError("nothing to compare with", "methods", "name two methods")
    expected = pair_events(lists[keys[0]])
    return next((key for key in others if difference(lists[key], expected, until)[0] is not None), others[0])


def describe_peers(peers: dict[str, tuple[str, str]]) -> str:
    """Return the method that each one was compared with, as text."""
    words = []
    for peer in dict.fromkeys(peers.values()):
        methods = ", ".join(method for method, compared in peers.items() if compared == peer)
        words.append(f"{methods} with {' '.join(peer)}")
    return f"; compared: {'; '.join(words)}"


def sort_by_tightness(lists: Lists) -> list[tuple[str, str]]:
    return [key for name in BY_TIGHTNESS for key in reversed(lists) if key[0] == name]


def pair_events(events: EventList) -> list[tuple[Any, str]]:
    return list(zip(events.t, events.kinds, strict=True))


def difference(events: EventList, expected: Sequence[tuple[Any, str]], until: float) -> tuple[float | None, str]:
    """Return the largest difference of an event time; or None, and where the lists start to differ.

    Lists of different lengths start to differ where an event of one is farther from its counterpart than from a
    neighbour.
    """
    if events.outcome != "completed":
        return None, events.outcome
    kinds = [kind for _, kind in expected]
    common = min(len(events.t), len(kinds))
    for i in range(common):
        if events.kinds[i] != kinds[i]:
            return None, f"other events from t = {float(expected[i][0]):.6g}"
    late = [float(t) for t, _ in expected[common:]] + list(events.t[common:])
    if late and min(late) < until * (1.0 - LAST):
        begins = min(late)
        for i, t in enumerate(events.t[:common]):
            near = min(
                (abs(float(expected[j][0]) - t) for j in (i - 1, i + 1) if 0 <= j < len(kinds)), default=math.inf
            )
            if near < abs(float(expected[i][0]) - t):
                begins = min(t, float(expected[i][0]))
                break
        return None, f"other events from t = {begins:.6g}"
    return max((abs(float(t - t_ref)) for t, (t_ref, _) in zip(events.t, expected, strict=False)), default=0.0), ""
