"""Error against run time: every method on one scene, measured against an independent reference.

The error of a method is the largest difference of an event time.  CPU time is that of this process, the minimum of
several runs where one is short; compilation is reported separately.  The exact method steps through every cycle.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

from rig_sim.comparison import reference
from rig_sim.comparison.rk4_henon import by_steps
from rig_sim.comparison.solve_ivp import by_solver
from rig_sim.comparison.stepping import sample_phase
from rig_sim.integrate.events import EventList, list_events
from rig_sim.motion.play import flow_never_changes, play_events
from rig_sim.scenes.model import Scene
from stickslip.errors import InputError

METHODS = ("exact", "rk4-henon", "dop853", "radau", "lsoda")
RK4_STEPS = (0.1, 0.03, 0.01, 0.003)  # of sqrt(m/k)
DOP853_RTOL = (1e-6, 1e-9, 1e-12, 2.3e-14)
STIFF_RTOL = (1e-6, 1e-9)
MOST_STEPS = 10**8
LONGEST = 2000  # periods of the oscillator: the slowest method takes some minutes for them
LONG_ENOUGH_S = 0.5  # CPU time: a run is repeated until all together have taken more; 0: each runs once
NO_REFERENCE = (
    "the tightest other method: the multi-precision reference covers neither droop nor an equation of motion that "
    "changes between events; such scenes are played interpreted"
)
LAST = 1e-6  # share of the time span: an event this near its end may be missing from a list; not swept


@dataclass(frozen=True)
class MethodResult:
    """One method at one setting.

    ``error`` is in the scene's unit of time; None when the list of events differs (``note`` says where);
    ``us_per_cycle`` is per beginning of slip out of stick or ramp in the reference.
    """

    method: str
    setting: str
    error: float | None
    cpu_s: float
    us_per_cycle: float | None
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """The rows, what they are measured against, and the CPU time of compiling (s; of loading, when it was cached)."""

    rows: tuple[MethodResult, ...]
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

    Raises
    ------
    InputError
        ``until`` is not positive or longer than `LONGEST` swings; an unknown method; a scene without events.
    """
    if not (math.isfinite(until) and until > 0):
        raise InputError(f"is {until:g}", "--until", "give a positive number")
    for method in methods:
        if method not in METHODS:
            raise InputError(f"unknown method {method!r}", "methods", f"take some of {', '.join(METHODS)}")
    swing = 2.0 * math.pi * math.sqrt(scene.mass.m / scene.spring.k)
    if until > LONGEST * swing:
        what = f"is {until:g}, {until / swing:.3g} periods of the mass: every method would step through all of them"
        raise InputError(what, "--until", f"give {LONGEST * swing:.4g} ({LONGEST} periods) or less")
    whole = flow_never_changes(scene) and scene.droop is None
    runs = _runs(scene, until, methods, whole)
    compile_s = _compile(scene) if whole and "exact" in methods else 0.0
    measured = []
    for done, (method, setting, run) in enumerate(runs):
        progress(100.0 * done / (len(runs) + 1))  # the reference is the last
        measured.append((method, setting, *_timed(run)))
    progress(100.0 * len(runs) / (len(runs) + 1))
    expected, described = _reference(scene, until) if whole else ([], NO_REFERENCE)
    lists = {(method, setting): found for method, setting, found, _ in measured}
    if not (expected or next(iter(lists.values())).t):
        raise InputError("no event", "--until", "give a longer time")
    rows = []
    cycles = 0
    peers = {} if expected else {method: tightest(lists, method, until) for method in dict.fromkeys(methods)}
    if not expected:
        described += compared_with(peers) + doubted(lists, until)
    for method, setting, found, cpu_s in measured:
        against = expected or _events(lists[peers[method]])
        cycles = sum(kind[:2] == "S>" for _, kind in against)
        error, note = difference(found, against, until)
        rows.append(MethodResult(method, setting, error, cpu_s, 1e6 * cpu_s / cycles if cycles else None, note))
    return Comparison(tuple(rows), described, compile_s, cycles)


def _runs(scene: Scene, until: float, methods: Sequence[str], whole: bool) -> list[tuple[str, str, Run]]:
    """Return (method, setting, run) of all that is to be measured.

    The exact method lists the events of a flow that never changes (``whole``) in one call, interpreted and compiled;
    everything else is played phase by phase.
    """
    unit = math.sqrt(scene.mass.m / scene.spring.k)
    played = partial(play_events, scene, until, max_steps=MOST_STEPS)
    runs: list[tuple[str, str, Run]] = []
    for method in methods:
        if method == "exact" and whole:
            x, v = float(scene.start.x), float(scene.start.v)
            exact = partial(list_events, scene.flow(), x, v, until, every_cycle=True, max_steps=MOST_STEPS)
            runs += [(method, "interpreted", exact), (method, "compiled", partial(exact, compiled=True))]
        elif method == "exact":
            runs.append((method, "interpreted", played))
        elif method == "rk4-henon":
            solvers = {f"h {h:g}": by_steps(h * unit) for h in RK4_STEPS}
            runs += [(method, name, partial(played, partial(sample_phase, by))) for name, by in solvers.items()]
        else:
            tolerances = DOP853_RTOL if method == "dop853" else STIFF_RTOL
            solvers = {f"rtol {rtol:g}": by_solver(method, rtol, dense=False) for rtol in tolerances}
            runs += [(method, name, partial(played, partial(sample_phase, by))) for name, by in solvers.items()]
    return runs


def _compile(scene: Scene) -> float:
    """Compile the exact method's kernel, or load it, and return the CPU seconds that took."""
    begun = time.process_time()
    list_events(scene.flow(), float(scene.start.x), float(scene.start.v), 1e-9, compiled=True)
    return time.process_time() - begun


def _timed(run: Run) -> tuple[EventList, float]:
    """Return what a run found, and its CPU seconds: the least of as many runs as `LONG_ENOUGH_S` takes."""
    least = math.inf
    spent = 0.0
    while spent <= LONG_ENOUGH_S:
        begun = time.process_time()
        found = run()
        took = time.process_time() - begun
        least = min(least, took)
        spent += took
    return found, least


def _reference(scene: Scene, until: float) -> tuple[list[tuple[Any, str]], str]:
    """Return the reference's events, and what it is; no events where it does not cover the scene."""
    try:
        found = reference.events(scene.flow(), float(scene.start.x), float(scene.start.v), until)
    except reference.Uncovered as why:
        return [], f"the tightest other method: the multi-precision reference does not cover {why}"
    return [(t, kind) for t, kind, _ in found], f"Taylor series in {reference.DIGITS}-digit arithmetic (mpmath)"


Lists = dict[tuple[str, str], EventList]  # by method and setting
BY_TIGHTNESS = ("exact", "dop853", "lsoda", "radau", "rk4-henon")


def tightest(lists: Lists, method: str, until: float) -> tuple[str, str]:
    """Return the tightest method that is not ``method``, with its setting, of those that most other lists agree with.

    A list of other events than all the rest is no reference, however tight: a solver may find a landing twice.
    """
    others = [key for key in _by_tightness(lists) if key[0] != method]
    if not others:
        raise InputError("nothing to compare with", "methods", "name two methods")
    return max(others, key=lambda key: len(_agreeing(lists, key, until)))  # of equals the first


def compared_with(peers: dict[str, tuple[str, str]]) -> str:
    """Return in words what each method was compared with."""
    words = []
    for peer in dict.fromkeys(peers.values()):
        methods = ", ".join(method for method, own in peers.items() if own == peer)
        words.append(f"{methods} with {' '.join(peer)}")
    return f"; compared: {'; '.join(words)}"


def doubted(lists: Lists, until: float) -> str:
    """Return in words which lists are no reference and why: fewer agree with them than with another one."""
    agreeing = {key: len(_agreeing(lists, key, until)) for key in _by_tightness(lists)}
    most = max(agreeing, key=lambda key: agreeing[key])
    words = []
    for (method, setting), number in agreeing.items():
        note = difference(lists[method, setting], _events(lists[most]), until)[1]
        if note and number < agreeing[most]:
            why = f"{note}, which {number} of {len(lists) - 1} others have" + _at_once(lists[method, setting])
            words.append(f"; {method} {setting} is no reference: {why}")
    return "".join(words)


def _at_once(listed: EventList) -> str:
    """Return in words the first two events of a list at one time, such as a landing found again at a break-away."""
    for (t, kind), (later, other) in pairwise(_events(listed)):
        if t == later:
            return f" ({kind} and {other} at the same time)"
    return ""


def _by_tightness(lists: Lists) -> list[tuple[str, str]]:
    """Return methods and settings, the tightest first."""
    return [key for name in BY_TIGHTNESS for key in reversed(lists) if key[0] == name]


def _agreeing(lists: Lists, key: tuple[str, str], until: float) -> list[tuple[str, str]]:
    """Return the other methods and settings whose lists hold the same events."""
    expected = _events(lists[key])
    return [one for one, found in lists.items() if one != key and difference(found, expected, until)[0] is not None]


def _events(listed: EventList) -> list[tuple[Any, str]]:
    return list(zip(listed.t, listed.kinds, strict=True))


def difference(listed: EventList, expected: Sequence[tuple[Any, str]], until: float) -> tuple[float | None, str]:
    """Return the largest difference of an event time; or None, and where the lists begin to differ.

    Lists of different lengths begin to differ where an event of one is farther from its like than from a neighbour.
    """
    if listed.outcome != "completed":
        return None, listed.outcome
    kinds = [kind for _, kind in expected]
    both = min(len(listed.t), len(kinds))
    for i in range(both):
        if listed.kinds[i] != kinds[i]:
            return None, f"other events from t = {float(expected[i][0]):.6g}"
    late = [float(t) for t, _ in expected[both:]] + list(listed.t[both:])
    if late and min(late) < until * (1.0 - LAST):
        begins = min(late)
        for i, t in enumerate(listed.t[:both]):
            near = min(
                (abs(float(expected[j][0]) - t) for j in (i - 1, i + 1) if 0 <= j < len(kinds)), default=math.inf
            )
            if near < abs(float(expected[i][0]) - t):
                begins = min(t, float(expected[i][0]))
                break
        return None, f"other events from t = {begins:.6g}"
    return max((abs(float(t - t_ref)) for t, (t_ref, _) in zip(listed.t, expected, strict=False)), default=0.0), ""
