"""Intervals of what belongs to the rig, whichever law of the set holds.

A law's interval holds if that law does.  Where the record does not distinguish several laws, the true belt speed may
lie far outside the interval of the best one: a ramp lets the mass lag behind the belt that drags it, so that a jump
law, fitted to the same camera track, finds a belt slower by part of the ramp's width.
"""

from collections.abc import Sequence
from dataclasses import replace

from fitting.estimation.result import Parameter
from fitting.selection.result import LawResult

RIG = ("k/m", "v_dr", "x0", "c/m", "k", "c", "m")  # the others are parameters of a law, each with a meaning in it alone
# Relative standard error of a belt speed from which a law does not determine it: one drag too short to show it
# gives 1.  Laws that determine it have errors below 0.3.
OPEN_BELT_SPEED = 0.5


def over_the_set(rows: Sequence[LawResult]) -> list[LawResult]:
    """Return the rows of one run, by law; intervals of the rig's parameters contain those of every law of the set.

    The standard error becomes that of the longer half of the interval.  A parameter that a law does not determine, and
    rows outside the set, stay as they are.
    """
    members = [row for row in rows if row.in_set]
    if len(members) < 2:
        return list(rows)
    return [
        replace(row, parameters={name: _widened(name, item, members) for name, item in row.parameters.items()})
        if row.in_set
        else row
        for row in rows
    ]


def law_dependent(rows: Sequence[LawResult]) -> tuple[str, ...]:
    """Return the warning of belt speed and k/m that depend on the law, from the rows of one run; none without.

    ``rows`` have their laws' own intervals: a parameter depends on the law where another law's value lies outside.
    Laws that do not determine it do not count, as in `over_the_set`.
    """
    members = [row for row in rows if row.in_set]
    warned = []
    for name in ("v_dr", "k/m"):
        known = _determined(name, members)
        if any(not (one.lo <= other.value <= one.hi) for one in known.values() for other in known.values()):
            unit = next(iter(known.values())).unit
            values = ", ".join(f"{item.value:.4g} by law {law}" for law, item in known.items())
            warned.append(f"{name} depends on the law, in {unit}: {values}; its interval contains that of each")
    return tuple(warned)


def _determined(name: str, members: Sequence[LawResult]) -> dict[int | str, Parameter]:
    known = {row.law: row.parameters[name] for row in members if name in row.parameters}
    if name.startswith("v_dr"):
        return {law: item for law, item in known.items() if item.stderr < OPEN_BELT_SPEED * abs(item.value)}
    return known


def _widened(name: str, item: Parameter, members: Sequence[LawResult]) -> Parameter:
    """Return a parameter with the interval over the laws that determine it; one of the law alone as it is."""
    if name.split(" (")[0] not in RIG:  # of several runs: "v_dr (2)"
        return item
    known = [item, *_determined(name, members).values()]
    lo, hi = min(other.lo for other in known), max(other.hi for other in known)
    half = max(item.hi - item.value, item.value - item.lo)
    longer = max(hi - item.value, item.value - lo)
    return replace(item, lo=lo, hi=hi, stderr=item.stderr * longer / half if half > 0 else item.stderr)
