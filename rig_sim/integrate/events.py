"""List the events of a flow: the Python interface of `rig_sim.integrate.phases.run`, interpreted or compiled."""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

from rig_sim.flow import modes
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow, validate
from rig_sim.integrate.phases import Lists, Samples, State, run
from rig_sim.integrate.work import Buffer, new_work, zeros

EVENTS_PER_CALL = 1024  # of the kernel; not swept


@dataclass(frozen=True)
class EventList:
    """Events of one run.

    t, x: Time (s) and position (m) of each event.
    kinds: 'N>S', 'S>N', 'N>P' ...: the mode left and the one entered (S: stick or ramp).
    outcome, advice: 'completed', or the reason why the run ended early and what to do.
    steps: Closed-form phases and Taylor steps taken.
    """

    t: tuple[float, ...]
    x: tuple[float, ...]
    kinds: tuple[str, ...]
    outcome: str
    advice: str
    steps: int


def list_events(
    flow: Flow,
    x: float,
    v: float,
    t_max: float,
    *,
    t: float = 0.0,
    since: float = -math.inf,
    max_steps: int = 1_000_000,
    max_events: int = 1_000_000,
    every_cycle: bool = False,
    compiled: bool = False,
) -> EventList:
    """Return the events between t and t_max (s) of a motion that starts at x (m) with velocity v (m/s).

    flow, x, v, t_max, t: What moves, from where, and until when.
    since: List only events at or after this time (s).
    max_steps, max_events: Integrator steps, and listed events, after which the run ends with the outcome 'step limit',
        'event limit'.
    every_cycle: Step through every cycle.  Otherwise an undriven motion is stepped until a beginning of slip recurs bit
        for bit, and the cycle between is listed again and again: to the same events, without the steps.
    compiled: Use numba: worth its start-up above some 10^4 stepped events.
    Raises ValueError: for a flow that is not physical, or a start or end that is not finite.
    """
    validate(flow)
    if not all(math.isfinite(number) for number in (x, v, t, t_max)):
        raise ValueError(f"x, v, t, t_max are {x}, {v}, {t}, {t_max}; need finite numbers")
    at = State(initial_mode(flow, x, v, t), x, v - flow.v_belt, t)
    step: Callable[..., Any] = run
    if compiled:
        from rig_sim.integrate.compiled import compiled as compile_kernel
        from rig_sim.integrate.compiled import for_kernels

        step = compile_kernel(run)
        flow = for_kernels(flow)
    work = new_work(max_steps, compiled=compiled)
    lists = new_lists(EVENTS_PER_CALL, compiled=compiled)
    times: list[float] = []
    places: list[float] = []
    kinds: list[str] = []
    outcome = modes.LIST_FULL
    while outcome == modes.LIST_FULL:
        outcome, count, first, at = step(flow, at, t_max, lists, 0 if every_cycle else 1, work)
        whole, where, names = listed(lists.t, count), listed(lists.x, count), named(lists.kind, count)
        skipped = bisect_left(whole, since)
        times += whole[skipped:]
        places += where[skipped:]
        kinds += names[skipped:]
        if outcome == modes.RECURRED:
            outcome = modes.COMPLETED
            rest = listed(lists.carry, count)
            for again, x_again, name in repeated(
                whole[first:], rest[first:], where[first:], names[first:], since, t_max
            ):
                times.append(again)
                places.append(x_again)
                kinds.append(name)
                if len(times) > max_events:
                    break
        if len(times) > max_events:
            outcome = modes.EVENT_LIMIT
            del times[max_events:], places[max_events:], kinds[max_events:]
    name, advice = modes.OUTCOMES[outcome]
    return EventList(tuple(times), tuple(places), tuple(kinds), name, advice, int(work.steps))


def repeated(
    whole: list[float], rest: list[float], places: list[float], kinds: list[str], since: float, t_max: float
) -> Iterator[tuple[float, float, str]]:
    """Yield the cycle after the first event up to the last again and again, from its second time on, up to t_max.

    Times are ``whole + rest``; they are added as whole numbers of a unit that divides them all, so that any number of
    cycles later each is the nearest float to what the cycle's own times say.
    """
    times = [Fraction(t) + Fraction(carry) for t, carry in zip(whole, rest, strict=True)]
    unit = max(time.denominator for time in times)  # powers of 2: the largest is a multiple of the others
    ticks = [int(time * unit) for time in times]
    period = ticks[-1] - ticks[0]
    turn = 1
    if math.isfinite(since):
        turn = max(1, (math.floor(Fraction(since) * unit) - ticks[-1]) // period)
    while True:
        for tick, x, kind in zip(ticks[1:], places[1:], kinds[1:], strict=True):
            t = (tick + turn * period) / unit
            if t > t_max:
                return
            if t >= since:
                yield t, x, kind
        turn += 1


def listed(buffer: Any, count: int) -> list[float]:
    """Return the first ``count`` numbers of a list or a (n,) array as a list of floats."""
    part = buffer[:count]
    return part if isinstance(part, list) else part.tolist()


def named(buffer: Any, count: int) -> list[str]:
    """Return the kinds whose codes are the first ``count`` numbers of a list or an array."""
    part = buffer[:count]
    if isinstance(part, list):
        return [modes.KINDS[int(code)] for code in part]
    return kind_names()[part.astype(int)].tolist()  # type: ignore[no-any-return]


@cache
def kind_names() -> Any:
    """Return the names of the kinds as an array, each in its code's place."""
    import numpy

    return numpy.array([modes.KINDS.get(code, "") for code in range(max(modes.KINDS) + 1)], dtype=object)


def new_lists(capacity: int, *, compiled: bool) -> Lists:
    """Return where `run` lists so many events, interpreted or compiled."""
    t, carry, x, kind = (zeros(capacity, compiled=compiled) for _ in range(4))
    return Lists(t, carry, x, kind, capacity)


def new_samples(times: Buffer, *, compiled: bool) -> Samples:
    """Return where `sample_phase` stores the motion at ``times`` (s), interpreted or compiled."""
    n = len(times)
    x, v, mode = (zeros(n, compiled=compiled) for _ in range(3))
    return Samples(times, x, v, mode, n)
