"""Intervals of the rig's parameters over all laws that the record does not exclude.

A law's interval holds if that law does.  Where several laws are compatible, the true belt speed may lie far outside the
interval of the best one: on a ramp the mass lags behind the belt, so that a jump law, fitted to the same camera track,
finds a belt slower by part of the ramp's width.  A law that leaves a parameter undetermined contains every value.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

from fitting.estimation.derived import UNDETERMINED_WITH
from fitting.estimation.result import Parameter
from fitting.selection.result import LawResult

RIG = ("k/m", "v_dr", "x0", "c/m", "k", "c", "m")  # the others are parameters of a law, each with a meaning in it alone
GROUPS = {group[0]: group for group in UNDETERMINED_WITH.values() if group[0] in RIG}  # what goes with each of them


def over_compatible_laws(rows: Sequence[LawResult], compatible: Collection[int | str]) -> list[LawResult]:
    """Return one run's rows; intervals of the rig's parameters contain those of every compatible law.

    The standard error becomes that of the longer half of the interval. What a compatible law leaves undetermined is
    withheld, with what is known only together with it. Rows outside the set do not change.
    """
    others = [row.parameters for row in rows if row.law in compatible]
    withheld = {name for lead, _ in _undetermined(rows, compatible) for name in GROUPS[lead]}
    found = []
    for row in rows:
        parameters = dict(row.parameters)
        for name, item in row.parameters.items() if row.in_set else ():
            own = name.split(" (")[0]  # of several runs: "v_dr (2)"
            if own in withheld and not item.fixed:
                parameters[name] = replace(item, trusted=False)
            elif own in RIG:
                parameters[name] = _widened(item, [other[name] for other in others if name in other])
        found.append(replace(row, parameters=parameters))
    return found


def law_dependent(rows: Sequence[LawResult], compatible: Collection[int | str]) -> tuple[str, ...]:
    """Return the warnings that belt speed or k/m depend on the law, or that a law leaves a parameter undetermined."""
    warned = [
        f"{name} is undetermined under law {law}, which the record does not exclude: its interval is withheld"
        for name, law in _undetermined(rows, compatible)
    ]
    for name in ("v_dr", "k/m"):
        known = {row.law: row.parameters[name] for row in rows if row.law in compatible and name in row.parameters}
        if any(not (one.lo <= other.value <= one.hi) for one in known.values() for other in known.values()):
            unit = next(iter(known.values())).unit
            values = ", ".join(f"{item.value:.4g} by law {law}" for law, item in known.items())
            warned.append(f"{name} depends on the law, in {unit}: {values}; its interval contains that of each")
    return tuple(warned)


def _undetermined(rows: Sequence[LawResult], compatible: Collection[int | str]) -> list[tuple[str, int | str]]:
    """Return the rig's parameters that a law of the set has and another compatible law has not, with that law."""
    names = {row.law: {name.split(" (")[0] for name in row.parameters} for row in rows if row.law in compatible}
    members = [row.law for row in rows if row.in_set]
    return [
        (lead, next(law for law, has in names.items() if lead not in has))
        for lead in GROUPS
        if any(lead in names[law] for law in members) and any(lead not in has for has in names.values())
    ]


def _widened(item: Parameter, others: Sequence[Parameter]) -> Parameter:
    lo, hi = min(other.lo for other in (item, *others)), max(other.hi for other in (item, *others))
    half = max(item.hi - item.value, item.value - item.lo)
    longer = max(hi - item.value, item.value - lo)
    return replace(item, lo=lo, hi=hi, stderr=item.stderr * longer / half if half > 0 else item.stderr)
