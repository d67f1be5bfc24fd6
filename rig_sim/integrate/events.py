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

EVENTS_PER_CALL = 1024  # of the kernel


@dataclass(frozen=True)
class EventList:
    t: tuple[float, ...]  # s
    x: tuple[float, ...]  # m
    kinds: tuple[str, ...]  # 'N>S', 'S>N', 'N>P' ...: the mode left and the one entered (S: stick or ramp)
    outcome: str  # 'completed', or why the run ended early
    advice: str
    steps: int  # closed-form phases and Taylor steps


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

    Only events from ``since`` (s) on are listed.  The run ends early after ``max_steps`` integrator steps or
    ``max_events`` listed events.  Unless ``every_cycle``, an undriven motion is stepped until a start of slip recurs
    bit for bit, and the cycle between is listed again and again: the same events, without the steps.  ``compiled`` uses
    numba: worth its start-up above about 10^4 stepped events.
    """
    validate(flow)
    if not all(math.isfinite(number) for number in (x, v, t, t_max)):
        raise ValueError(f"x, v, t and t_max must be finite numbers, not {x}, {v}, {t} and {t_max}")
    state = State(initial_mode(flow, x, v, t), x, v - flow.v_belt, t)
    step: Callable[..., Any] = run
    if compiled:
        from rig_sim.integrate.compiled import compiled as compile_kernel
        from rig_sim.integrate.compiled import for_kernels

        step = compile_kernel(run)
        flow = for_kernels(flow)
    work = new_work(max_steps, compiled=compiled)
    lists = new_lists(EVENTS_PER_CALL, compiled=compiled)
    times: list[float] = []
    positions: list[float] = []
    kinds: list[str] = []
    outcome = modes.LIST_FULL
    while outcome == modes.LIST_FULL:
        outcome, count, first, state = step(flow, state, t_max, lists, 0 if every_cycle else 1, work)
        batch_times, batch_positions, batch_kinds = (
            read_numbers(lists.t, count),
            read_numbers(lists.x, count),
            read_kinds(lists.kind, count),
        )
        n_skipped = bisect_left(batch_times, since)
        times += batch_times[n_skipped:]
        positions += batch_positions[n_skipped:]
        kinds += batch_kinds[n_skipped:]
        if outcome == modes.RECURRED:
            outcome = modes.COMPLETED
            carries = read_numbers(lists.carry, count)
            for t_repeated, x_repeated, name in repeat_cycle(
                batch_times[first:], carries[first:], batch_positions[first:], batch_kinds[first:], since, t_max
            ):
                times.append(t_repeated)
                positions.append(x_repeated)
                kinds.append(name)
                if len(times) > max_events:
                    break
        if len(times) > max_events:
            outcome = modes.EVENT_LIMIT
            del times[max_events:], positions[max_events:], kinds[max_events:]
    name, advice = modes.OUTCOMES[outcome]
    return EventList(tuple(times), tuple(positions), tuple(kinds), name, advice, int(work.steps))


def repeat_cycle(
    times: list[float], carries: list[float], positions: list[float], kinds: list[str], since: float, t_max: float
) -> Iterator[tuple[float, float, str]]:
    """Yield the cycle after the first event up to the last again and again, from its second time on, up to t_max.

    Times are ``whole + rest``; they are added as whole numbers of a unit that divides them all, so that any number of
    cycles later each is the nearest float to the sum of the cycle's own times.
    """
    exact_times = [Fraction(t) + Fraction(carry) for t, carry in zip(times, carries, strict=True)]
    unit = max(time.denominator for time in exact_times)  # powers of 2: the largest is a multiple of the others
    ticks = [int(time * unit) for time in exact_times]
    period = ticks[-1] - ticks[0]
    turn = 1
    if math.isfinite(since):
        turn = max(1, (math.floor(Fraction(since) * unit) - ticks[-1]) // period)
    while True:
        for tick, x, kind in zip(ticks[1:], positions[1:], kinds[1:], strict=True):
            t = (tick + turn * period) / unit
            if t > t_max:
                return
            if t >= since:
                yield t, x, kind
        turn += 1


def read_numbers(buffer: Any, count: int) -> list[float]:
    """Return the first ``count`` numbers of a list or a (n,) array as a list of floats."""
    part = buffer[:count]
    return part if isinstance(part, list) else part.tolist()


def read_kinds(buffer: Any, count: int) -> list[str]:
    part = buffer[:count]
    if isinstance(part, list):
        return [modes.KINDS[int(code)] for code in part]
    return kind_names()[part.astype(int)].tolist()  # type: ignore[no-any-return]


@cache
def kind_names() -> Any:
    """Return the names of the kinds as an array, indexed by code."""
    import numpy

    return numpy.array([modes.KINDS.get(code, "") for code in range(max(modes.KINDS) + 1)], dtype=object)


def new_lists(capacity: int, *, compiled: bool) -> Lists:
    t, carry, x, kind = (zeros(capacity, compiled=compiled) for _ in range(4))
    return Lists(t, carry, x, kind, capacity)


def new_samples(times: Buffer, *, compiled: bool) -> Samples:
    """Return the record in which `sample_phase` stores the motion at ``times`` (s), interpreted or compiled."""
    n = len(times)
    x, v, mode = (zeros(n, compiled=compiled) for _ in range(3))
    return Samples(times, x, v, mode, n)
