"""Intervals of the rig's parameters over all laws of the set.

A law's interval holds if that law does.  Where several laws are compatible, the true belt speed may lie far outside the
interval of the best one: on a ramp the mass lags behind the belt, so that a jump law, fitted to the same camera track,
finds a belt slower by part of the ramp's width.
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
    """Return one run's rows; intervals of the rig's parameters contain those of every compatible law.

    The standard error becomes that of the longer half of the interval. Undetermined parameters and rows outside the set
    do not change.
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
    """Return the warning that belt speed or k/m depend on the law, if another law's value lies outside its interval."""
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
    """Return a parameter with the interval over the laws that determine it, or unchanged if not the rig's."""
    if name.split(" (")[0] not in RIG:  # of several runs: "v_dr (2)"
        return item
    known = [item, *_determined(name, members).values()]
    lo, hi = min(other.lo for other in known), max(other.hi for other in known)
    half = max(item.hi - item.value, item.value - item.lo)
    longer = max(hi - item.value, item.value - lo)
    return replace(item, lo=lo, hi=hi, stderr=item.stderr * longer / half if half > 0 else item.stderr)
